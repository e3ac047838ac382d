"""`InspectorWindow`: the Qt window of a run or model. Import only after `require_desktop`.

Map and 3D view show the same layers; a camera selected by table, click or tour is marked in both,
and its photograph is shown. Docks and tools see the window through the protocols in `host`, which
document the shared methods.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QAction, QCloseEvent, QShowEvent
from PySide6.QtWidgets import QApplication, QDockWidget, QFileDialog, QMainWindow, QMessageBox, QPushButton, QSplitter

from radiant_core.choices import Painter
from radiant_core.errors import BadInput, RadiantError
from radiant_core.numerics import FloatArray
from radiant_viewer.docks.layer_dock import LayerDock
from radiant_viewer.editing.planning import make_planning
from radiant_viewer.editing.store.plan_files import PlanSetting
from radiant_viewer.host.canvas import FIT_ANGLE_DEG, Canvas
from radiant_viewer.host.marks import Marks
from radiant_viewer.layers.camera_layer import highlight_layer
from radiant_viewer.layers.layer import Layer, framing_positions
from radiant_viewer.layers.themes import LIGHT, THEMES, Theme, ThemeName, apply_theme, style_sheet
from radiant_viewer.pictures.images import Image, save_png
from radiant_viewer.pictures.offscreen import fitting_pose
from radiant_viewer.pictures.view_motion import SIDES_DEG, Side
from radiant_viewer.pictures.view_pose import camera_pose
from radiant_viewer.runs.bookmarks import Bookmarks
from radiant_viewer.runs.growing_model import GROWING_S
from radiant_viewer.runs.run_feeds import RunFeeds
from radiant_viewer.runs.run_layers import hidden_at_first
from radiant_viewer.runs.run_view import RunView, file_stamps
from radiant_viewer.runs.shown_model import MODEL, SURROUNDINGS, model_layers, seen_of
from radiant_viewer.splats.model_view import ModelView
from radiant_viewer.window.actions import add_actions
from radiant_viewer.window.bookmark_keys import BookmarkKeys
from radiant_viewer.window.docks import make_docks, place_docks, place_plan_docks, resize_docks
from radiant_viewer.window.panels import Panels
from radiant_viewer.window.place_label import PlaceLabel
from radiant_viewer.window.places_dialog import PlacesDialog
from radiant_viewer.window.qt_palette import qt_palette
from radiant_viewer.window.subject import Subject
from radiant_viewer.window.window_size import fit_to_screen, remember_size

SELECTED = "Selected camera"
MAP_SHARE, EDITED_SHARE = 0.35, 0.6
"""Share of the map of both views' width; larger while a plan is edited on it."""
PICK_PX = 14
"""Largest distance of a click from the camera that it selects."""
_Result = TypeVar("_Result")


class InspectorWindow(QMainWindow):
    """The window of one run or model; `wants_reload` requests a new one for changed files."""

    wants_reload = Signal()

    def __init__(
        self,
        subject: Subject,
        feeds: RunFeeds | None = None,
        theme: ThemeName = "light",
        setting: PlanSetting | None = None,
        restore: Callable[[InspectorWindow], None] | None = None,
        painter: Painter | None = None,
    ) -> None:
        super().__init__()
        self.subject, self.run = subject, subject.run
        self.layers: list[Layer] = list(subject.layers)
        positions = framing_positions(self.layers)
        self.origin: FloatArray = (positions.min(axis=0) + positions.max(axis=0)) / 2
        self.theme: Theme = LIGHT
        self.selected: int | None = None
        self._was_shown = False
        self._restore = restore
        self._tried, self._read_at_s = subject.stamps, time.monotonic()
        self.dark_button: QAction | None = None
        self.edit_button: QAction | None = None
        self.setWindowTitle(f"Radiant: {subject.path.resolve().name}")
        self.setDockOptions(self.dockOptions() | QMainWindow.DockOption.AllowNestedDocks)
        self.splitter = splitter = QSplitter(Qt.Orientation.Horizontal)
        self.map = Canvas(splitter, "Map", is_map=True, origin=self.origin, unit=subject.unit)
        self.view = Canvas(splitter, "3D", is_map=False, origin=self.origin)
        self.view.show_message, self.view.ground_under = self.show_status, subject.ground_under
        self._marks = Marks((self.map, self.view))
        splitter.setStretchFactor(1, 1)
        self.setCentralWidget(splitter)
        self.layer_dock = LayerDock(self.layers, hidden_at_first(self.layers), self._on_visibility)
        self.addDockWidget(Qt.DockWidgetArea.LeftDockWidgetArea, self.layer_dock)
        for canvas in (self.map, self.view):
            canvas.click_takers.append(self._pick)
        mask = self._visible_mask()
        self.model = None if subject.model is None or mask is None else ModelView(self, subject.model.whole, mask, painter)
        self.docks = make_docks(self, subject, feeds or RunFeeds(), None if self.model is None else self.model.ply_path)
        place_docks(self, self.docks)
        if self.model is not None:
            self.model.failed.connect(self._on_model_failed)
        if self.docks.cleaning.session is not None:
            self.docks.cleaning.session.changed = self._on_cleaned
        if self.docks.cameras is not None:
            self.docks.cameras.chosen.connect(self.mark_camera)
        if self.docks.progress is not None:
            self.docks.progress.polled.connect(self._on_polled)
        self.planning = make_planning(self, subject.run, setting)
        if self.planning is not None:
            place_plan_docks(self, self.planning, self.layer_dock, self.docks.cameras)
        self.panels = Panels(self, self.all_docks())
        self.bookmarks = BookmarkKeys(self, self, Bookmarks(subject.path))
        self.shortcuts = add_actions(self, self)
        self.place = PlaceLabel(self.statusBar(), self.map, None if subject.run is None else subject.run.scene.frame)
        self.set_theme(theme)
        self.show_status(".   ".join(filter(None, (subject.summary, "" if setting is None else setting.reason))))

    def show_status(self, message: str) -> None:
        self.statusBar().showMessage(message)

    def attempt(self, action: Callable[[], _Result]) -> _Result | None:
        """As in `Host`; the sentence is shown in the status bar and in a box."""
        try:
            return action()
        except RadiantError as error:
            self.show_status(str(error))
            box = QMessageBox(QMessageBox.Icon.Warning, "Radiant", str(error), QMessageBox.StandardButton.Ok, self)
            # Not modal: it must not block a film, or a test.
            box.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
            box.open()
            return None

    def set_layer_visible(self, name: str, visible: bool) -> None:
        self.layer_dock.set_visible(name, visible)

    def replace_layer(self, layer: Layer, *, map_only: bool = False) -> None:
        names = [layer_drawn.name for layer_drawn in self.layers]
        if map_only:
            slot = names.index(layer.name) if layer.name in names else len(names)
            self.map.draw(layer, slot, visible=self.layer_dock.is_visible(layer.name))
            return
        if layer.name in names:
            self.layers[names.index(layer.name)] = layer
        else:
            self.layers.append(layer)
        self.layer_dock.update_legend(apply_theme(layer, self.theme))
        self._draw(layer)

    def show_run(self, run: RunView) -> None:
        self.run = run
        if self.docks.cameras is not None:
            self.docks.cameras.show_run(run)
        if self.docks.seams is not None:
            for layer in self.docks.seams.show_plan(run.cloud_plan):
                self.layer_dock.update_legend(apply_theme(layer, self.theme))

    def visible_layers(self) -> list[Layer]:
        return [layer for layer in self.layers if self.layer_dock.is_visible(layer.name)]

    def draw_mark(self, layer: Layer) -> None:
        self._marks.draw(layer)

    def remove_mark(self, name: str) -> None:
        self._marks.remove(name)

    def select_camera(self, name: str) -> None:
        if self.run is None or name not in self.run.photographs:
            raise BadInput(f"there is no camera named {name!r} in this run: check the first column of the table.")
        self.select_index(self.run.photographs.index(name))

    def select_index(self, index: int) -> None:
        """Select photograph `index` of `RunView.photographs` through its row of the table."""
        if self.docks.cameras is not None:
            self.docks.cameras.select(index)

    def mark_camera(self, index: int) -> None:
        """Show a selected photograph: mark in both views, picture, line in the status bar."""
        if self.run is None:
            return
        is_placed = index < len(self.run.scene.cameras)
        self.selected = index if is_placed else None
        if is_placed:
            self.draw_mark(highlight_layer(self.run.scene.cameras, index))
        else:
            self.remove_mark(SELECTED)
        if self.docks.photo is not None:
            self.docks.photo.show_camera(index)
        if self.docks.cameras is not None:
            row = self.docks.cameras.cameras.rows[index]
            self.show_status("   ·   ".join(str(cell) for cell in row[:4] if cell))
        if self.isVisible() and is_placed:
            self._show_on_map(self.run.scene.cameras.centers[index])
        self.render_views()

    def fly_to_selected(self) -> None:
        if self.run is None or self.selected is None:
            self.show_status("No camera with a known place is selected: click one in a view or in the table.")
            return
        center = self.run.scene.cameras.centers[self.selected]
        distance = max(float(abs(center[2] - self.subject.ground)), 1e-3)
        pose = camera_pose(self.run.scene.cameras, self.selected, distance)
        self.view.set_pose(pose)
        self._show_on_map(center)
        self.render_views()

    def _show_on_map(self, place: FloatArray) -> None:
        """Centre the map on a place (3,) that lies outside of it."""
        pixel = self.map.pixels_of(place[None])[0]
        if not ((pixel >= 0) & (pixel <= self.map.size_wh)).all():
            self.map.center_on(place[:2])

    def raise_dock(self, dock: QDockWidget | None) -> None:
        """Bring a dock to the front."""
        if dock is not None:
            dock.show()
            dock.raise_()

    @property
    def crop_box(self) -> FloatArray | None:
        # Asked for while the docks are made.
        return self.docks.cleaning.box.active_box if hasattr(self, "docks") else None

    @property
    def kept_path(self) -> Path | None:
        return None if self.model is None else self.model.kept_path

    def set_theme(self, name: ThemeName) -> None:
        """Use the light or the dark theme, also in the views."""
        self.theme = THEMES[name]
        if self.dark_button is not None:
            self.dark_button.blockSignals(True)
            self.dark_button.setChecked(name == "dark")
            self.dark_button.blockSignals(False)
        QApplication.setPalette(qt_palette(self.theme))
        self.setStyleSheet(style_sheet(self.theme))
        for canvas in (self.map, self.view):
            canvas.set_theme(self.theme)
        for layer in self.layers:
            self.layer_dock.update_legend(apply_theme(layer, self.theme))
        if self.docks.gantt is not None:
            self.docks.gantt.follow_theme()
        self._draw_all()

    def reset_views(self) -> None:
        """Fit the scene into both views; of a model alone all there is."""
        for canvas in (self.map, self.view):
            canvas.fit(self.subject.framing)
        self.render_views()

    def render_views(self, *, map_only: bool = False) -> None:
        if self.isVisible():
            if self.model is not None and not map_only:
                self.model.look()
            for canvas in (self.map,) if map_only else (self.map, self.view):
                canvas.render()

    def screenshot(self) -> Image:
        """Return map and 3D view side by side (H,W,3)."""
        images = [canvas.screenshot() for canvas in (self.map, self.view)]
        height = min(image.shape[0] for image in images)
        return np.concatenate([image[:height] for image in images], axis=1)

    def save_screenshot(self, path: Path) -> None:
        """Write `screenshot` as PNG; BadInput where it cannot be written."""
        save_png(path, self.screenshot())
        self.show_status(f"Saved {path}")

    def save_window_picture(self, path: Path) -> None:
        """Write the window with its docks as PNG; BadInput where it cannot be written."""
        # Of the screen: Qt's own picture of a widget leaves out what OpenGL drew.
        if not self.screen().grabWindow(int(self.winId())).save(str(path), "PNG"):
            raise BadInput(f"cannot write {path}: choose a folder that exists and a name that ends in .png.")
        self.show_status(f"Saved {path}")

    def reload(self) -> None:
        self.wants_reload.emit()

    def all_docks(self) -> list[QDockWidget]:
        """Return all docks, in the order of the menu."""
        planning = [] if self.planning is None else [self.planning.dock, self.planning.loads]
        return [self.layer_dock, *planning, *self.docks.all()]

    def showEvent(self, event: QShowEvent) -> None:
        """Fit the layers once the views have their size."""
        super().showEvent(event)
        QTimer.singleShot(0, self._on_first_shown)

    def closeEvent(self, event: QCloseEvent) -> None:
        """Stop background work and close the views before Qt destroys their windows under VTK."""
        self.end()
        remember_size(self)
        for canvas in (self.map, self.view):
            canvas.plotter.close()
        super().closeEvent(event)

    def end(self) -> None:
        """Stop renderers, polling, films, planning; edits being solved stay in their file."""
        if self.model is not None:
            self.model.end()
        self.docks.end()
        if self.planning is not None:
            self.planning.end()

    def _on_first_shown(self) -> None:
        if self.isVisible() and not self._was_shown:
            self._was_shown = True
            if self._restore is None:
                # Before the docks are laid out Qt takes a window for wider than it needs to be.
                fit_to_screen(self)
            resize_docks(self, self.docks, self.layer_dock)
            # Qt lays out later; the views must have their sizes before anything is fitted to them.
            layout = self.layout()
            assert layout is not None
            layout.activate()
            self._share_views(MAP_SHARE)
            self.reset_views()
            if self._restore is not None:
                self._restore(self)

    def _on_polled(self) -> None:
        """Request a reload once the files have changed, unless the user is busy in the window."""
        stamps = file_stamps(self.subject.path)
        is_early = self.run is not None and self.run.is_growing and time.monotonic() - self._read_at_s < GROWING_S
        if stamps == self._tried or self._is_busy() or is_early:
            return
        self._tried = stamps
        self.reload()

    def _is_busy(self) -> bool:
        is_editing = self.planning is not None and self.planning.is_busy
        has_dialog = QApplication.activeModalWidget() is not None or QApplication.activePopupWidget() is not None
        is_pressed = QApplication.mouseButtons() != Qt.MouseButton.NoButton
        return is_editing or has_dialog or is_pressed or self.docks.is_busy or self.crop_box is not None

    def begin_tour(self) -> None:
        """Go to the worst seam."""
        if self.docks.seams is not None:
            self.raise_dock(self.docks.seams)
            self.docks.seams.go(0)

    def see_from(self, side: Side) -> None:
        """Fit the scene into the 3D view from a side."""
        self.view.set_pose(fitting_pose(self.subject.framing, self.view.size_wh, FIT_ANGLE_DEG, SIDES_DEG[side]))
        self.render_views()

    def _visible_mask(self) -> NDArray[np.bool_] | None:
        """Which Gaussians (N,) the views show; None without a model."""
        session = self.docks.cleaning.session if hasattr(self, "docks") else None
        model = self.subject.model if session is None else session.model
        return None if model is None else seen_of(model, self.subject.box, self.layer_dock.is_visible)

    def set_editing(self, active: bool) -> None:
        """Edit the plan on the map, or not."""
        assert self.planning is not None
        self._share_views(EDITED_SHARE if active else MAP_SHARE)
        self.planning.set_active(active)

    def set_measuring(self, active: bool) -> None:
        """Let clicks in both views measure, with the panel that shows it in front."""
        self.docks.survey.click.setChecked(active)
        self.raise_dock(self.docks.survey if active else None)

    def choose_by(self, button: QPushButton) -> None:
        """Turn lasso or brush on or off, with the panel of the cleaning in front."""
        button.toggle()
        self.raise_dock(self.docks.cleaning if button.isChecked() else None)

    def show_places(self) -> None:
        """Ask for titles and notes of the bookmarked views."""
        if (dialog := self.attempt(lambda: PlacesDialog(self, self.bookmarks))) is not None:
            dialog.open()

    def set_cropping(self, active: bool) -> None:
        """Show the box of the cleaning, or take it away."""
        self.docks.cleaning.box.active.setChecked(active)
        self.raise_dock(self.docks.cleaning if active else None)

    def _on_cleaned(self) -> None:
        """Show the model without what its cleaning leaves out now."""
        session = self.docks.cleaning.session
        assert session is not None
        self.run = None if self.run is None else replace(self.run, model=session.model)
        self._tried = file_stamps(self.subject.path)
        if self.model is not None and (mask := self._visible_mask()) is not None:
            self.model.set_seen(mask)
        for layer in model_layers(session.model.splats, self.subject.box):
            self.replace_layer(layer)
        self.docks.cleaning.show_session()
        self.render_views()

    def _share_views(self, map_share: float) -> None:
        width = self.splitter.width()
        self.splitter.setSizes([round(map_share * width), round((1 - map_share) * width)])

    def _draw_all(self) -> None:
        for layer in self.layers:
            self._draw(layer)
        self._marks.redraw()
        self.render_views()

    def _draw(self, layer: Layer) -> None:
        slot = next(index for index, drawn_layer in enumerate(self.layers) if drawn_layer.name == layer.name)
        for canvas in (self.map, self.view):
            canvas.draw(layer, slot, visible=self._draws(layer))
            self.docks.cleaning.box.apply_to(canvas)

    def _draws(self, layer: Layer) -> bool:
        """Whether a layer is drawn as it is: Gaussians are drawn as the model while that can be."""
        is_drawn = layer.name in (MODEL, SURROUNDINGS) and self.model is not None and not self.model.has_failed
        return self.layer_dock.is_visible(layer.name) and not is_drawn

    def _on_model_failed(self, reason: str) -> None:
        self._on_visibility()
        self.show_status(reason)

    def _on_visibility(self) -> None:
        for layer in self.layers:
            for canvas in (self.map, self.view):
                canvas.show(layer.name, self._draws(layer))
        self._marks.follow_solo(self.layer_dock.solo is not None, (self.docks.cleaning.polygon,))
        if self.model is not None and (mask := self._visible_mask()) is not None:
            self.model.set_seen(mask)
        self.render_views()

    def _pick(self, canvas: Canvas, pixel: tuple[int, int]) -> bool:
        if self.run is None or not len(self.run.scene.cameras):
            return False
        away = np.linalg.norm(canvas.pixels_of(self.run.scene.cameras.centers) - pixel, axis=1)
        away = np.where(np.isfinite(away), away, np.inf)
        index = int(np.argmin(away))
        if away[index] > PICK_PX:
            return False
        self.select_index(index)
        return True

    def ask_screenshot(self) -> None:
        """Ask for a name and save both views."""
        path, _ = QFileDialog.getSaveFileName(self, "Save screenshot", str(Path.cwd() / "inspect.png"), "PNG (*.png)")
        if path:
            self.attempt(lambda: self.save_screenshot(Path(path)))

    def ask_window_picture(self) -> None:
        """Ask for a name and save the window."""
        path, _ = QFileDialog.getSaveFileName(self, "Save window", str(Path.cwd() / "window.png"), "PNG (*.png)")
        if path:  # The dialog must have left the screen.
            QTimer.singleShot(300, lambda: self.attempt(lambda: self.save_window_picture(Path(path))))
