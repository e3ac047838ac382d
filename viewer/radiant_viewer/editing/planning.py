"""`Planning`: what the window does to a plan; ties its session to the map, the docks and the layers. Needs the `desktop` extra.

Frames of a drag redraw the map alone; 3D view and tables follow when the edit is done.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PySide6.QtCore import Qt, QTimer
from PySide6.QtWidgets import QFileDialog, QTabWidget, QWidget

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_viewer.editing.edited_plan import EditedPlan
from radiant_viewer.editing.load_dock import LoadDock
from radiant_viewer.editing.map_tools import MapTools
from radiant_viewer.editing.plan_difference import PlanDifference, plan_difference
from radiant_viewer.editing.plan_dock import PlanDock
from radiant_viewer.editing.plan_editor import PlanEditor
from radiant_viewer.editing.plan_edits import (
    AddDevice,
    AddEdge,
    Edit,
    FreeRegion,
    LockRegion,
    PinCameras,
    ReleaseAll,
    RemoveDevice,
    RemoveEdge,
    SetSlack,
)
from radiant_viewer.editing.plan_files import PlanSetting, load_other_plan, save_edited_plan, save_plan_geojson, subject_of
from radiant_viewer.editing.plan_layers import edited_layers, roles_of, scene_footprints
from radiant_viewer.editing.plan_report import compared_rows, load_rows
from radiant_viewer.editing.plan_session import PlanSession
from radiant_viewer.layers.change_layer import selection_layer
from radiant_viewer.layers.layer import Layer, at_height, outline_segments
from radiant_viewer.layers.palette import VERMILLION
from radiant_viewer.runs.camera_figures import CameraFigures, camera_figures, filtered_rows
from radiant_viewer.runs.run_pictures import ground_height
from radiant_viewer.runs.run_view import RunView

if TYPE_CHECKING:
    from radiant_viewer.window.window import InspectorWindow

WATCH_MS = 1000
"""How soon a window hears that another one changed the edits of its plan."""
COMPARED = "Elsewhere in the other plan"
NO_SYSTEM = "The plan cannot be changed here: its machines are not known."


def add_planning(window: InspectorWindow, setting: PlanSetting | None) -> Planning | None:
    """Docks, map tools and shortcuts of planning; None where the window shows a model alone, or what was made without a plan."""
    if window.run is None or window.run.kind != "run" or not len(window.run.scene.cameras):
        return None
    return Planning(window, window.run, setting)


class Planning:
    """`session` is None where the plan can only be looked at; `selected`: names of planned cameras."""

    def __init__(self, window: InspectorWindow, run: RunView, setting: PlanSetting | None) -> None:
        self.window, self.run, self.setting = window, run, setting
        self.session: PlanSession | None = None
        self.selected: tuple[str, ...] = ()
        self.comparison: PlanDifference | None = None
        self._was_drawn = False
        self._footprints = scene_footprints(run.scene, ground_height(run.scene))
        self.figures: CameraFigures = self._figures_of(run)
        reason = self._open_session()
        self.dock = PlanDock(self, tuple(self.figures.columns))
        self.loads = LoadDock(window, self.dock.choose)
        self.tools = MapTools(self)
        self._place_docks()
        self.dock.show_selected(0)
        if self.session is None:
            self.dock.show_figures(run.cloud_plan, reason)
            self.dock.show_reason(reason)
            return
        self.session.changed.connect(self._show_state)
        self.session.previewed.connect(self._show_preview)
        self.session.failed.connect(self._tell_failure)
        self.session.busy.connect(self.dock.working.setVisible)
        self.session.settled.connect(self._tell_settled)
        self._watch = QTimer(window)
        self._watch.timeout.connect(self._look_for_other)
        self._watch.start(WATCH_MS)
        told = list(self.session.editor.restore())
        self._show_state(restored=told)
        if told or self.session.editor.edits:
            count = len(self.session.editor.edits)
            sentence = " ".join([f"{count} edit{'s' if count != 1 else ''} of the last time restored (Ctrl+Z takes them back).", *told])
            # After the window's own greeting.
            QTimer.singleShot(0, lambda: window.tell(sentence))

    def do(self, edit: Edit) -> None:
        """Do an edit beside the window; told where it cannot be."""
        if self.session is None:
            self.window.tell(NO_SYSTEM)
        else:
            self.session.edit(edit)

    def drag_to(self, edit: Edit) -> None:
        """Show what an edit would give."""
        if self.session is not None:
            self.session.drag_to(edit)

    def drop_preview(self) -> None:
        """Show the plan as it is again."""
        if self.session is not None:
            self.session.drop_preview()

    def undo(self) -> None:
        """Take the last edit back."""
        if self.session is not None:
            self.session.undo()

    def redo(self) -> None:
        """Do what was undone again."""
        if self.session is not None:
            self.session.redo()

    def settle(self, *, take_over: bool) -> None:
        """Another window changed the edits, too: this window's count, or the other one's."""
        if self.session is not None:
            self.session.settle(take_over=take_over)

    def free_everything(self) -> None:
        """Back to the best plan of the machines as they are."""
        self.do(ReleaseAll())

    def pin(self, edge: str | None) -> None:
        """Pin the selected cameras to an edge, or take their pins out."""
        self.do(PinCameras(cameras=self.selected, edge=edge))

    def lock(self, edge: str) -> None:
        """Keep a region's cameras as they are."""
        self.do(LockRegion(edge=edge))

    def free(self, edge: str) -> None:
        """Take a region's lock and dragged borders back."""
        self.do(FreeRegion(edge=edge))

    def add_edge(self, like: str) -> None:
        """A new edge in the middle of what the map shows."""
        if self.session is not None:
            x, y = (float(value) for value in np.array(self.window.map.plotter.camera.focal_point[:2]) + self.window.map.origin[:2])
            taken = {edge.id for edge in self.session.editor.state.wishes.system.edges}
            self.do(AddEdge(edge=_new_name("edge", taken), position=(x, y), like=like))

    def remove_edge(self, edge: str) -> None:
        """An edge and its devices go."""
        self.do(RemoveEdge(edge=edge))

    def add_device(self, edge: str, like: str | None) -> None:
        """A device more at an edge, like the chosen one or the edge's last."""
        if self.session is None:
            return
        system = self.session.editor.state.wishes.system
        own = [device.id for one in system.edges if one.id == edge for device in one.devices]
        taken = {device.id for device in system.devices}
        model = like or (own[-1] if own else "")
        self.do(AddDevice(edge=edge, device=_new_name(edge, taken), like=model))

    def remove_device(self, device: str | None) -> None:
        """A device goes."""
        if device is not None:
            self.do(RemoveDevice(device=device))

    def set_slack(self, slack: float) -> None:
        """Plan with a slack; 1 takes it back."""
        self.do(SetSlack(slack=slack if slack > 1 else None))

    def select(self, names: Sequence[str]) -> None:
        """Select planned cameras by name; they are marked in both views."""
        self.selected = tuple(names)
        chosen = set(self.selected)
        rows = [index for index, name in enumerate(self.run.scene.cameras.names) if name in chosen]
        if rows:
            self.window.draw_mark(selection_layer(self.run.scene.cameras.centers[rows]))
        else:
            self.window.remove_mark("Selection")
        self.dock.show_selected(len(self.selected), self._likely_target(rows))
        self.window.render_views()

    def select_none(self) -> None:
        """Select nothing."""
        self.select(())

    def select_box(self, low: FloatArray, high: FloatArray, *, add: bool = False) -> None:
        """Select the planned cameras between two corners (2,) of the map."""
        places = self.run.scene.cameras.centers[:, :2]
        inside = ((places >= low) & (places <= high)).all(axis=1) & (self.run.roles.edge_of_camera >= 0)
        names = self.run.scene.cameras.names
        found = [names[index] for index in np.flatnonzero(inside).tolist()]
        self.select([*self.selected, *(name for name in found if name not in self.selected)] if add else found)

    def select_filtered(self, text: str) -> None:
        """Select the planned cameras that meet a filter; told where it cannot be read."""
        try:
            rows = filtered_rows(self.figures, text)
        except BadInput as error:
            self.window.tell(str(error))
            return
        planned = self.run.roles.edge_of_camera >= 0
        names = self.run.scene.cameras.names
        self.select([names[row] for row in rows.tolist() if planned[row]])
        left_out = len(rows) - len(self.selected)
        self.window.tell(f"{len(self.selected)} selected{f', {left_out} held-out ones left out' if left_out else ''}")

    def save(self, path: Path) -> None:
        """Write the plan and what goes with it; BadInput where it cannot be."""
        if self.session is None or self.setting is None:
            raise BadInput(NO_SYSTEM)
        if self.session.is_busy:
            raise BadInput("The plan is being solved: wait a moment.")
        editor = self.session.editor
        written = save_edited_plan(path, editor.subject, editor.state, self.setting)
        self.window.tell(f"Saved {', '.join(file.name for file in written)} in {path.parent}")

    def load(self, path: Path) -> None:
        """Put the plan of a file in the place of this one; BadInput where it is of other cameras or machines."""
        if self.session is None:
            raise BadInput(NO_SYSTEM)
        self.do(load_other_plan(path, self.session.editor.subject))

    def compare(self, path: Path) -> PlanDifference:
        """Mark the cameras that another plan gives to other edges and draw its borders, with the figures of both beside each other;
        BadInput for a plan of other cameras."""
        subject = subject_of(self.run) if self.session is None else self.session.editor.subject
        other = load_other_plan(path, subject)
        mine = (self.run.cloud_plan, self.run.edge_plans)
        found = self.comparison = plan_difference(mine, (other.cloud, other.edges))
        ground = ground_height(self.run.scene)
        sides = outline_segments([at_height(border, ground) for border in other.cloud.borders])
        marked = replace(
            selection_layer(subject.positions[found.new_edge]),
            name=COMPARED,
            segments=sides,
            segment_colors=np.tile(np.array(VERMILLION, np.uint8), (len(sides), 1)),
            line_width_px=1.5,
            in_front=True,
        )
        self.window.draw_mark(marked)
        self.window.render_views()
        self.dock.show_comparison(path.name, found.text, compared_rows(mine[0], other.cloud))
        self.window.tell(f"Against {path.name}: {found.text}")
        return found

    def save_regions(self, path: Path) -> None:
        """Write regions, strips and cameras of the plan as it is now as GeoJSON; BadInput where they are not on the globe."""
        save_plan_geojson(path, subject_of(self.run), (self.run.cloud_plan, self.run.edge_plans), self.setting)
        self.window.tell(f"Saved {path}")

    def ask_regions(self) -> None:
        """Save the regions under a name that the user gives."""
        start = self.run.folder if self.run.folder.is_dir() else self.run.folder.parent
        path, _ = QFileDialog.getSaveFileName(self.window, "Save regions", str(start / "regions.geojson"), "GeoJSON (*.geojson *.json)")
        if path:
            self.window.attempt(lambda: self.save_regions(Path(path)))

    def ask_save(self) -> None:
        """Save under a name that the user gives."""
        start = self.run.folder if self.run.folder.is_dir() else self.run.folder.parent
        path, _ = QFileDialog.getSaveFileName(self.window, "Save plan", str(start / "edited.json"), "Plan (*.json)")
        if path:
            self.window.attempt(lambda: self.save(Path(path)))

    def ask_load(self) -> None:
        """Load a plan that the user names."""
        if path := self._ask_plan("Load plan"):
            self.window.attempt(lambda: self.load(path))

    def ask_compare(self) -> None:
        """Compare with a plan that the user names."""
        if path := self._ask_plan("Compare with plan"):
            self.window.attempt(lambda: self.compare(path))

    def set_active(self, active: bool) -> None:
        """Let the mouse change the plan on the map, or only look."""
        self.tools.set_active(active)
        if active:
            self.window.raise_dock(self.dock)
            if self.session is None:
                self.window.tell(NO_SYSTEM)
            else:
                self.window.tell("Drag an edge's square or a border; Shift and drag selects cameras; E ends.")

    def end(self) -> None:
        """The window closes: a drag counts as released, and what is being solved is kept in the file."""
        edit = self.tools.end_drag()
        self.tools.close()
        if self.session is not None:
            self._watch.stop()
            if edit is not None:
                self.session.edit(edit)
            self.session.close()

    def _open_session(self) -> str:
        """Make the session, or return why there is none."""
        if self.setting is None or self.setting.system is None:
            return NO_SYSTEM if self.setting is None else self.setting.reason
        plan = (self.run.cloud_plan, self.run.edge_plans)
        try:
            editor = PlanEditor(subject_of(self.run), self.setting.system, plan, self.setting.keep_in)
        except BadInput as error:
            return f"The plan cannot be changed: {error}"
        self.session = PlanSession(editor, self.window)
        return ""

    def _place_docks(self) -> None:
        window = self.window
        window.addDockWidget(Qt.DockWidgetArea.LeftDockWidgetArea, self.dock)
        window.tabifyDockWidget(window.layer_dock, self.dock)
        window.setTabPosition(Qt.DockWidgetArea.LeftDockWidgetArea, QTabWidget.TabPosition.North)
        for dock in (window.layer_dock, self.dock, self.loads):
            # The tab says the same.
            dock.setTitleBarWidget(QWidget())
        window.layer_dock.raise_()
        bottom = window.docks.cameras
        window.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, self.loads)
        if bottom is not None:
            window.tabifyDockWidget(bottom, self.loads)
            bottom.raise_()

    def _show_state(self, restored: Sequence[str] = ()) -> None:
        assert self.session is not None
        editor = self.session.editor
        state = editor.state
        self.run = replace(self.run, cloud_plan=state.cloud, edge_plans=state.edges, roles=roles_of(self.run, state))
        self.figures = self._figures_of(self.run)
        self.window.remove_mark(COMPARED)
        changes = editor.since_last_edit.text if editor.edits else "As it was opened."
        if len(editor.edits) > 1:
            changes += f" Since the opening: {editor.since_start.text}"
        for sentence in (*restored, editor.keeping_failed):
            changes += f" {sentence}" if sentence else ""
        if editor.edits or restored or self._was_drawn:
            self._draw(edited_layers(self.run, editor.subject, state, editor.base), both=True)
            self.window.take_run(self.run)
        self._was_drawn = True
        self.dock.show_plan(state, changes)
        self.loads.show_rows(load_rows(state.cloud, state.edges, state.wishes.system, state.wishes.constraints))
        self.window.tell(f"{editor.undo_text}: {editor.since_last_edit.text}" if editor.edits else "The plan is as it was opened.")
        self._show_conflict()

    def _look_for_other(self) -> None:
        """Tell as soon as another window changed the edits of this plan."""
        assert self.session is not None
        was_known = bool(self.session.editor.conflict)
        if not was_known and not self.session.is_busy and self.session.editor.find_conflict():
            self._show_conflict()

    def _show_conflict(self) -> None:
        assert self.session is not None
        sentence = self.session.editor.conflict
        is_new = bool(sentence) and self.dock.conflict.isHidden()
        self.dock.show_conflict(sentence)
        if is_new:
            self.window.raise_dock(self.dock)
            self.window.tell(sentence)

    def _tell_settled(self, sentence: str) -> None:
        self.dock.changes.setText(f"{self.dock.changes.text()} {sentence}")
        self.window.tell(sentence)

    def _show_preview(self, plan: EditedPlan) -> None:
        assert self.session is not None
        editor = self.session.editor
        if not self.tools.is_dragging:
            return
        self.window.map.detail.stir()
        self._draw(edited_layers(self.run, editor.subject, plan, editor.base), both=False)
        difference = plan_difference((editor.state.cloud, ()), (plan.cloud, ()))
        self.dock.show_figures(plan.cloud, difference.text)
        self.loads.show_rows(load_rows(plan.cloud, (), plan.wishes.system, plan.wishes.constraints))

    def _tell_failure(self, sentence: str) -> None:
        self.dock.changes.setText(f"Not done: {sentence}")
        self.window.tell(sentence)

    def _draw(self, layers: Sequence[Layer], *, both: bool) -> None:
        for layer in layers:
            if both:
                self.window.replace_layer(layer)
            else:
                self.window.draw_on_map(layer)
        if not self.window.isVisible():
            return
        if both:
            self.window.render_views()
        else:
            self.window.map.render()

    def _likely_target(self, rows: Sequence[int]) -> str | None:
        """Of the edges that have least of the selected cameras, the one that is done first; None without a selection."""
        if not rows:
            return None
        cloud = self.run.cloud_plan
        own = np.bincount(self.run.roles.edge_of_camera[list(rows)], minlength=len(cloud.edge_ids))
        return cloud.edge_ids[int(np.lexsort((cloud.edge_time_s, own))[0])]

    def _figures_of(self, run: RunView) -> CameraFigures:
        return camera_figures(run.scene, run.roles, run.cloud_plan, run.psnr_db, self._footprints)

    def _ask_plan(self, title: str) -> Path | None:
        start = self.run.folder if self.run.folder.is_dir() else self.run.folder.parent
        path, _ = QFileDialog.getOpenFileName(self.window, title, str(start), "Plan (*.json)")
        return Path(path) if path else None


def _new_name(stem: str, taken: set[str]) -> str:
    number = len(taken) + 1 if stem == "edge" else 1
    while (name := f"{stem}-{number}") in taken:
        number += 1
    return name
