"""Which docks a window has and where they stand: layers left, pictures right, tables and tools below, each kind as tabs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDockWidget, QTabWidget

from radiant_core.splats import Splats
from radiant_viewer.camera_dock import CameraDock
from radiant_viewer.crop_dock import CropDock
from radiant_viewer.fly_dock import FlyDock
from radiant_viewer.gantt_dock import GanttDock
from radiant_viewer.photo_dock import PhotoDock
from radiant_viewer.progress_dock import ProgressDock
from radiant_viewer.run_feeds import RunFeeds
from radiant_viewer.run_figures import image_figures
from radiant_viewer.run_view import RunView
from radiant_viewer.seam_dock import SeamDock, seam_dock
from radiant_viewer.splat_dock import SplatDock

if TYPE_CHECKING:
    from radiant_viewer.window import InspectorWindow

LEFT_PX, RIGHT_PX, BOTTOM_PX = 235, 345, 215


@dataclass(kw_only=True)
class Docks:
    """None where what is shown has nothing for a dock: a model alone has no cameras, a plan alone no splats."""

    splats: SplatDock | None = None
    photo: PhotoDock | None = None
    cameras: CameraDock | None = None
    seams: SeamDock | None = None
    gantt: GanttDock | None = None
    progress: ProgressDock | None = None
    fly: FlyDock | None = None
    crop: CropDock | None = None

    def all(self) -> list[QDockWidget]:
        """Those that are there, in the order of their tabs."""
        docks = (self.photo, self.splats, self.cameras, self.seams, self.gantt, self.progress, self.fly, self.crop)
        return [dock for dock in docks if dock is not None]


def add_docks(window: InspectorWindow, run: RunView | None, splats: Splats | None, feeds: RunFeeds, unit: str) -> Docks:
    """Make the docks and place them."""
    docks = window.docks = Docks()
    right, bottom = Qt.DockWidgetArea.RightDockWidgetArea, Qt.DockWidgetArea.BottomDockWidgetArea
    if splats is not None:
        docks.splats = SplatDock(window, splats)
    if run is not None:
        figures = image_figures(run.folder)
        docks.photo = PhotoDock(window, run, figures)
        docks.cameras = CameraDock(window, run, figures)
        docks.seams = seam_dock(window, run)
        docks.gantt, docks.progress = GanttDock(window, feeds), ProgressDock(window, feeds)
    docks.fly, docks.crop = FlyDock(window), CropDock(window, splats, unit)
    rights = [dock for dock in (docks.photo, docks.splats) if dock is not None]
    bottoms = [dock for dock in docks.all() if dock not in rights]
    for dock in rights:
        window.addDockWidget(right, dock)
    for dock in bottoms:
        window.addDockWidget(bottom, dock)
    for first, other in zip([*rights[:-1], *bottoms[:-1]], [*rights[1:], *bottoms[1:]], strict=True):
        window.tabifyDockWidget(first, other)
    for corner, area in (
        (Qt.Corner.BottomLeftCorner, bottom),
        (Qt.Corner.BottomRightCorner, bottom),
        (Qt.Corner.TopRightCorner, right),
    ):
        window.setCorner(corner, area)
    window.setTabPosition(right | bottom, QTabWidget.TabPosition.North)
    window.resizeDocks([window.layer_dock, *rights[:1]], [LEFT_PX, RIGHT_PX][: 1 + len(rights[:1])], Qt.Orientation.Horizontal)
    window.resizeDocks(bottoms[:1], [BOTTOM_PX], Qt.Orientation.Vertical)
    for dock in (*rights[-1:], *bottoms[:1]):
        dock.raise_()
    return docks
