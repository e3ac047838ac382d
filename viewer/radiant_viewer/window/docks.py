"""Which docks a window has and where they stand: layers left, pictures right, tables and tools below, each kind as tabs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDockWidget, QTabWidget, QWidget

from radiant_core.splats import Splats
from radiant_viewer.docks.camera_dock import CameraDock
from radiant_viewer.docks.crop_dock import CropDock
from radiant_viewer.docks.fly_dock import FlyDock
from radiant_viewer.docks.gantt_dock import GanttDock
from radiant_viewer.docks.photo_dock import PhotoDock
from radiant_viewer.docks.progress_dock import ProgressDock
from radiant_viewer.docks.seam_dock import SeamDock, seam_dock
from radiant_viewer.docks.splat_dock import SplatDock
from radiant_viewer.runs.run_feeds import RunFeeds
from radiant_viewer.runs.run_figures import image_figures
from radiant_viewer.runs.run_view import RunView

if TYPE_CHECKING:
    from radiant_viewer.window.window import InspectorWindow

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
    for dock in (dock for group in (rights, bottoms) if len(group) > 1 for dock in group):
        # The tab says the same, and at 1280×800 a title more is a row of the table less.
        dock.setTitleBarWidget(QWidget())
    for first, other in zip([*rights[:-1], *bottoms[:-1]], [*rights[1:], *bottoms[1:]], strict=True):
        window.tabifyDockWidget(first, other)
    for corner, area in (
        (Qt.Corner.BottomLeftCorner, bottom),
        (Qt.Corner.BottomRightCorner, bottom),
        (Qt.Corner.TopRightCorner, right),
    ):
        window.setCorner(corner, area)
    window.setTabPosition(right | bottom, QTabWidget.TabPosition.North)
    for dock in (*rights[-1:], *bottoms[:1]):
        dock.raise_()
    return docks


def share_room(window: InspectorWindow) -> None:
    """Give each side its share of the window; Qt forgets it where it is asked before the window is shown."""
    docks = window.docks
    right = docks.photo or docks.splats
    sides = [(window.layer_dock, LEFT_PX), *([] if right is None else [(right, RIGHT_PX)])]
    window.resizeDocks([dock for dock, _ in sides], [width for _, width in sides], Qt.Orientation.Horizontal)
    lower = docks.cameras or docks.fly
    if lower is not None:
        window.resizeDocks([lower], [BOTTOM_PX], Qt.Orientation.Vertical)
