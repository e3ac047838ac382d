"""The docks of a window and their places: layers left, pictures right, all others below."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDockWidget, QMainWindow, QPushButton, QTabWidget, QWidget

from radiant_viewer.docks.camera_dock import CameraDock
from radiant_viewer.docks.cleaning_dock import CleaningDock
from radiant_viewer.docks.control_dock import ControlDock
from radiant_viewer.docks.fly_dock import FlyDock
from radiant_viewer.docks.gantt_dock import GanttDock
from radiant_viewer.docks.pages_job import PagesJob
from radiant_viewer.docks.photo_dock import PhotoDock
from radiant_viewer.docks.progress_dock import ProgressDock
from radiant_viewer.docks.seam_dock import SeamDock, make_seam_dock
from radiant_viewer.docks.survey_dock import SurveyDock
from radiant_viewer.editing.planning import Planning
from radiant_viewer.host.protocols import Host
from radiant_viewer.runs.flight_file import FlightFile
from radiant_viewer.runs.run_feeds import RunFeeds
from radiant_viewer.runs.run_figures import image_figures
from radiant_viewer.window.subject import Subject

LEFT_PX, RIGHT_PX, BOTTOM_PX = 235, 345, 215


@dataclass(frozen=True, kw_only=True)
class Docks:
    """A dock is None where it would be empty: a model alone has no cameras, a plan no seams."""

    fly: FlyDock
    cleaning: CleaningDock
    survey: SurveyDock
    photo: PhotoDock | None = None
    cameras: CameraDock | None = None
    seams: SeamDock | None = None
    gantt: GanttDock | None = None
    progress: ProgressDock | None = None
    control: ControlDock | None = None

    @property
    def is_busy(self) -> bool:
        """Whether a film, a polygon, a selection, a measure or the marking of a point is in
        progress."""
        is_marking = self.control is not None and self.control.isVisible() and self.control.photograph != ""
        is_choosing = self.cleaning.polygon.is_active or (self.cleaning.select is not None and self.cleaning.select.is_active)
        return self.survey.is_busy or is_marking or self.fly.job is not None or is_choosing

    @property
    def click_buttons(self) -> list[QPushButton]:
        """What lets clicks and drags in the views make places, corners or strokes."""
        select = self.cleaning.select
        return [self.cleaning.draw, self.survey.click, *([] if select is None else [select.lasso, select.brush])]

    def undo_corner(self) -> None:
        """Take the last clicked place, drawn corner or stroke back."""
        self.cleaning.polygon.undo()
        self.survey.tool.undo()
        if self.cleaning.select is not None and self.cleaning.select.is_active:
            self.cleaning.select.tool.undo()

    def end_clicks(self) -> None:
        """Leave clicks and drags to the views, and choose nothing."""
        for button in self.click_buttons:
            button.setChecked(False)
        if self.cleaning.select is not None:
            self.cleaning.select.end()

    def end(self) -> None:
        """Stop polling, films and what runs in processes of its own."""
        self.fly.stop()
        self.cleaning.pages.end()
        for dock in (self.progress, self.survey):
            if dock is not None:
                dock.end()

    def all(self) -> list[QDockWidget]:
        """Return the docks that exist, in the order of their tabs."""
        docks = (self.control, self.photo, self.cameras, self.seams, self.gantt, self.progress, self.survey, self.fly, self.cleaning)
        return [dock for dock in docks if dock is not None]


def make_docks(host: Host, subject: Subject, feeds: RunFeeds, ply_path: Path | None) -> Docks:
    """Make the docks for what a window shows, its model as a file; `place_docks` places them."""
    run = subject.run
    fly = FlyDock(host, ply_path, FlightFile(subject.path))
    cleaning = CleaningDock(host, subject.cleaning_session(), subject.unit, subject.ground, PagesJob(host, subject.path, feeds.pages))
    survey = SurveyDock(host, run, feeds.survey if run is None or run.kind != "scene" else None, subject.ground, subject.unit)
    if run is None:
        return Docks(fly=fly, cleaning=cleaning, survey=survey)
    figures = image_figures(run.folder)
    return Docks(
        fly=fly,
        cleaning=cleaning,
        survey=survey,
        photo=PhotoDock(host, run, figures),
        cameras=CameraDock(host, run, figures),
        seams=make_seam_dock(host, run),
        gantt=GanttDock(host, feeds),
        progress=ProgressDock(host, feeds),
        control=ControlDock(host, run),
    )


def place_docks(window: QMainWindow, docks: Docks) -> None:
    """Put pictures at the right and everything else below, each side as tabs."""
    right, bottom = Qt.DockWidgetArea.RightDockWidgetArea, Qt.DockWidgetArea.BottomDockWidgetArea
    rights = [dock for dock in (docks.control, docks.photo) if dock is not None]
    bottoms = [dock for dock in docks.all() if dock not in rights]
    for dock in rights:
        window.addDockWidget(right, dock)
    for dock in bottoms:
        window.addDockWidget(bottom, dock)
    for dock in (dock for group in (rights, bottoms) if len(group) > 1 for dock in group):
        # The tab repeats the title, and at 1280×800 a title bar costs a row of the table.
        dock.setTitleBarWidget(QWidget())
    for first, second in zip([*rights[:-1], *bottoms[:-1]], [*rights[1:], *bottoms[1:]], strict=True):
        window.tabifyDockWidget(first, second)
    for corner, area in (
        (Qt.Corner.BottomLeftCorner, bottom),
        (Qt.Corner.BottomRightCorner, bottom),
        (Qt.Corner.TopRightCorner, right),
    ):
        window.setCorner(corner, area)
    window.setTabPosition(right | bottom, QTabWidget.TabPosition.North)
    for dock in (*rights[-1:], *bottoms[:1]):
        dock.raise_()


def place_plan_docks(window: QMainWindow, planning: Planning, layer_dock: QDockWidget, camera_dock: QDockWidget | None) -> None:
    """Put the plan's dock beside the layers and its loads beside the cameras."""
    window.addDockWidget(Qt.DockWidgetArea.LeftDockWidgetArea, planning.dock)
    window.tabifyDockWidget(layer_dock, planning.dock)
    window.setTabPosition(Qt.DockWidgetArea.LeftDockWidgetArea, QTabWidget.TabPosition.North)
    for dock in (layer_dock, planning.dock, planning.loads):
        # The tab repeats the title.
        dock.setTitleBarWidget(QWidget())
    layer_dock.raise_()
    window.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, planning.loads)
    if camera_dock is not None:
        window.tabifyDockWidget(camera_dock, planning.loads)
        camera_dock.raise_()


def resize_docks(window: QMainWindow, docks: Docks, layer_dock: QDockWidget) -> None:
    """Give each side its share of the window, once it is shown: Qt forgets earlier sizes."""
    sides = [(layer_dock, LEFT_PX), *([] if docks.photo is None else [(docks.photo, RIGHT_PX)])]
    window.resizeDocks([dock for dock, _ in sides], [width for _, width in sides], Qt.Orientation.Horizontal)
    window.resizeDocks([docks.cameras or docks.fly], [BOTTOM_PX], Qt.Orientation.Vertical)
