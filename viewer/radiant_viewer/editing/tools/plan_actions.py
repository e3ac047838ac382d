"""`PlanActions`: everything that a user can do to a plan in the window. Needs the `desktop` extra.

The dock's buttons, the map tools and the window's shortcuts call it; `Planning` shows what follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from PySide6.QtCore import QObject, Signal
from PySide6.QtWidgets import QFileDialog

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_viewer.editing.model.plan_difference import PlanDifference, plan_difference
from radiant_viewer.editing.model.plan_edits import AddDevice, AddEdge, Edit, PinCameras, RemoveDevice, SetSlack
from radiant_viewer.editing.model.plan_report import compare_figures
from radiant_viewer.editing.solver.plan_editor import PlanEditor
from radiant_viewer.editing.solver.plan_session import PlanSession
from radiant_viewer.editing.store.plan_files import PlanSetting, load_other_plan, plan_subject, save_edited_plan, save_plan_geojson
from radiant_viewer.editing.tools.plan_layers import edited_roles, scene_footprints
from radiant_viewer.host.protocols import PlanHost
from radiant_viewer.layers.change_layer import selection_layer
from radiant_viewer.layers.layer import at_height, outline_segments
from radiant_viewer.layers.palette import VERMILLION
from radiant_viewer.runs.camera_figures import CameraFigures, camera_figures, filter_rows
from radiant_viewer.runs.run_layers import ground_height
from radiant_viewer.runs.run_view import RunView

COMPARED = "Elsewhere in the other plan"
NO_SYSTEM = "The plan cannot be changed here: its machines are not known."


class PlanActions(QObject):
    """`session` is None where the plan can only be viewed, for `reason`; `selected`: names of the
    chosen cameras; `run` and `figures` follow the session's plan. The signal `compared` carries the
    name of the other plan's file and the figures of both."""

    selection_changed = Signal()
    compared = Signal(str, object)

    def __init__(self, host: PlanHost, run: RunView, setting: PlanSetting | None) -> None:
        super().__init__(host.map.frame)
        self.host, self.run, self.setting = host, run, setting
        self.selected: tuple[str, ...] = ()
        self.comparison: PlanDifference | None = None
        self._footprints = scene_footprints(run.scene, ground_height(run.scene))
        self.figures = self._figures_of(run)
        self.session: PlanSession | None = None
        self.reason = self._open_session()

    def do(self, edit: Edit) -> None:
        """Solve an edit beside the window; where plans cannot change, the status bar says so."""
        if self.session is None:
            self.host.show_status(NO_SYSTEM)
        else:
            self.session.edit(edit)

    def drag_to(self, edit: Edit) -> None:
        """Preview an edit without doing it."""
        if self.session is not None:
            self.session.drag_to(edit)

    def drop_preview(self) -> None:
        """Show the plan without the preview."""
        if self.session is not None:
            self.session.drop_preview()

    def undo(self) -> None:
        """Undo the last edit."""
        if self.session is not None:
            self.session.undo()

    def redo(self) -> None:
        """Redo the edit that was undone last."""
        if self.session is not None:
            self.session.redo()

    def resolve_conflict(self, *, take_over: bool) -> None:
        """Resolve a conflict: keep this window's edits, or take the other window's."""
        if self.session is not None:
            self.session.resolve_conflict(take_over=take_over)

    def pin(self, edge: str | None) -> None:
        """Pin the selected cameras to an edge, or with None remove their pins."""
        self.do(PinCameras(cameras=self.selected, edge=edge))

    def add_edge(self, like: str) -> None:
        """Add an edge with the devices of `like` in the middle of what the map shows."""
        if self.session is not None:
            x, y = self.host.map.pose.focal_point[:2].tolist()
            names = {edge.id for edge in self.session.editor.state.wishes.system.edges}
            self.do(AddEdge(edge=_new_name("edge", names), position=(x, y), like=like))

    def add_device(self, edge: str, like: str | None) -> None:
        """Add a device to an edge, with the cost of `like` or of the edge's last device."""
        if self.session is None:
            return
        system = self.session.editor.state.wishes.system
        device_ids = [device.id for one in system.edges if one.id == edge for device in one.devices]
        names = {device.id for device in system.devices}
        model = like or (device_ids[-1] if device_ids else "")
        self.do(AddDevice(edge=edge, device=_new_name(edge, names), like=model))

    def remove_device(self, device: str | None) -> None:
        """Remove a device; nothing for None."""
        if device is not None:
            self.do(RemoveDevice(device=device))

    def set_slack(self, slack: float) -> None:
        """Plan with a slack; 1 removes it."""
        self.do(SetSlack(slack=slack if slack > 1 else None))

    def select(self, names: Sequence[str]) -> None:
        """Select planned cameras by name and mark them in both views."""
        self.selected = tuple(names)
        rows = self._selected_rows()
        if rows:
            self.host.draw_mark(selection_layer(self.run.scene.cameras.centers[rows]))
        else:
            self.host.remove_mark("Selection")
        self.selection_changed.emit()
        self.host.render_views()

    def select_box(self, low: FloatArray, high: FloatArray, *, add: bool = False) -> None:
        """Select the planned cameras between corners (2,); `add` keeps the earlier selection."""
        places = self.run.scene.cameras.centers[:, :2]
        inside = ((places >= low) & (places <= high)).all(axis=1) & (self.run.roles.edge_of_camera >= 0)
        names = self.run.scene.cameras.names
        inside_names = [names[index] for index in np.flatnonzero(inside).tolist()]
        self.select([*self.selected, *(name for name in inside_names if name not in self.selected)] if add else inside_names)

    def select_filtered(self, text: str) -> None:
        """Select the planned cameras that meet a filter; the status bar reports a bad filter."""
        try:
            rows = filter_rows(self.figures, text)
        except BadInput as error:
            self.host.show_status(str(error))
            return
        planned = self.run.roles.edge_of_camera >= 0
        names = self.run.scene.cameras.names
        self.select([names[row] for row in rows.tolist() if planned[row]])
        left_out = len(rows) - len(self.selected)
        self.host.show_status(f"{len(self.selected)} selected{f', {left_out} held-out ones left out' if left_out else ''}")

    @property
    def likely_target(self) -> str | None:
        """Of the edges with the fewest selected cameras, the first to finish; None without any."""
        rows = self._selected_rows()
        if not rows:
            return None
        cloud = self.run.cloud_plan
        counts = np.bincount(self.run.roles.edge_of_camera[rows], minlength=len(cloud.edge_ids))
        return cloud.edge_ids[int(np.lexsort((cloud.edge_time_s, counts))[0])]

    def save(self, path: Path) -> None:
        """Write the plan with its system and constraints; BadInput where it cannot be written or is
        being solved."""
        if self.session is None or self.setting is None:
            raise BadInput(NO_SYSTEM)
        if self.session.is_busy:
            raise BadInput("The plan is being solved: wait a moment.")
        editor = self.session.editor
        written = save_edited_plan(path, editor.subject, editor.state, self.setting)
        self.host.show_status(f"Saved {', '.join(file.name for file in written)} in {path.parent}")

    def load(self, path: Path) -> None:
        """Replace the plan by that of a file; BadInput where it is of other cameras or machines."""
        if self.session is None:
            raise BadInput(NO_SYSTEM)
        self.do(load_other_plan(path, self.session.editor.subject))

    def compare(self, path: Path) -> PlanDifference:
        """Mark the cameras that another plan gives to other edges, draw its borders and emit
        `compared`; BadInput for a plan of other cameras."""
        subject = plan_subject(self.run) if self.session is None else self.session.editor.subject
        compared = load_other_plan(path, subject)
        mine = (self.run.cloud_plan, self.run.edge_plans)
        difference = self.comparison = plan_difference(mine, (compared.cloud, compared.edges))
        ground = ground_height(self.run.scene)
        sides = outline_segments([at_height(border, ground) for border in compared.cloud.borders])
        marked = replace(
            selection_layer(subject.positions[difference.new_edge]),
            name=COMPARED,
            segments=sides,
            segment_colors=np.tile(np.array(VERMILLION, np.uint8), (len(sides), 1)),
            line_width_px=1.5,
            in_front=True,
        )
        self.host.draw_mark(marked)
        self.host.render_views()
        self.compared.emit(path.name, compare_figures(mine[0], compared.cloud))
        self.host.show_status(f"Against {path.name}: {difference.text}")
        return difference

    def save_regions(self, path: Path) -> None:
        """Write regions, strips and cameras as GeoJSON; BadInput if they are not on the globe."""
        save_plan_geojson(path, plan_subject(self.run), (self.run.cloud_plan, self.run.edge_plans), self.setting)
        self.host.show_status(f"Saved {path}")

    def ask_save(self) -> None:
        """Save under a name that the user gives."""
        if path := self._ask_new("Save plan", "edited.json", "Plan (*.json)"):
            self.host.attempt(lambda: self.save(path))

    def ask_regions(self) -> None:
        """Save the regions under a name that the user gives."""
        if path := self._ask_new("Save regions", "regions.geojson", "GeoJSON (*.geojson *.json)"):
            self.host.attempt(lambda: self.save_regions(path))

    def ask_load(self) -> None:
        """Load a plan that the user names."""
        if path := self._ask_plan("Load plan"):
            self.host.attempt(lambda: self.load(path))

    def ask_compare(self) -> None:
        """Compare with a plan that the user names."""
        if path := self._ask_plan("Compare with plan"):
            self.host.attempt(lambda: self.compare(path))

    def follow_session(self) -> None:
        """Give `run` and `figures` the plan that the session holds now."""
        assert self.session is not None
        state = self.session.editor.state
        self.run = replace(self.run, cloud_plan=state.cloud, edge_plans=state.edges, roles=edited_roles(self.run, state))
        self.figures = self._figures_of(self.run)

    def _selected_rows(self) -> list[int]:
        chosen = set(self.selected)
        return [index for index, name in enumerate(self.run.scene.cameras.names) if name in chosen]

    def _open_session(self) -> str:
        """Open the session; return why there is none, or an empty text."""
        if self.setting is None or self.setting.system is None:
            return NO_SYSTEM if self.setting is None else self.setting.reason
        plan = (self.run.cloud_plan, self.run.edge_plans)
        try:
            editor = PlanEditor(plan_subject(self.run), self.setting.system, plan, self.setting.edits_path)
        except BadInput as error:
            return f"The plan cannot be changed: {error}"
        self.session = PlanSession(editor, self)
        return ""

    def _figures_of(self, run: RunView) -> CameraFigures:
        return camera_figures(run.scene, run.roles, run.cloud_plan, run.psnr_db, self._footprints)

    def _ask_new(self, title: str, name: str, kinds: str) -> Path | None:
        path, _ = QFileDialog.getSaveFileName(self.host.map.frame, title, str(self._start_folder / name), kinds)
        return Path(path) if path else None

    def _ask_plan(self, title: str) -> Path | None:
        path, _ = QFileDialog.getOpenFileName(self.host.map.frame, title, str(self._start_folder), "Plan (*.json)")
        return Path(path) if path else None

    @property
    def _start_folder(self) -> Path:
        return self.run.folder if self.run.folder.is_dir() else self.run.folder.parent


def _new_name(stem: str, names: set[str]) -> str:
    number = len(names) + 1 if stem == "edge" else 1
    while (name := f"{stem}-{number}") in names:
        number += 1
    return name
