"""`Planning`: docks and map tools that edit a plan, and how the window shows it. Frames of a drag
redraw the map alone; 3D view and tables follow the finished edit. Needs the `desktop` extra."""

from __future__ import annotations

from collections.abc import Sequence

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QDockWidget

from radiant_viewer.editing.dock.load_dock import LoadDock
from radiant_viewer.editing.dock.plan_dock import PlanDock
from radiant_viewer.editing.model.edited_plan import EditedPlan
from radiant_viewer.editing.model.plan_difference import plan_difference
from radiant_viewer.editing.model.plan_report import ComparedRow, load_rows
from radiant_viewer.editing.solver.plan_session import PlanSession
from radiant_viewer.editing.store.plan_files import PlanSetting
from radiant_viewer.editing.tools.map_tools import MapTools
from radiant_viewer.editing.tools.plan_actions import COMPARED, NO_SYSTEM, PlanActions
from radiant_viewer.editing.tools.plan_layers import edited_layers
from radiant_viewer.host.protocols import PlanHost
from radiant_viewer.layers.layer import Layer
from radiant_viewer.runs.run_view import RunView

WATCH_MS = 1000
"""How often the file of edits is checked for another window's changes."""


def make_planning(host: PlanHost, run: RunView | None, setting: PlanSetting | None) -> Planning | None:
    """Return the editing of a run's plan; None for a model alone, or where there is no plan."""
    if run is None or run.kind != "run" or not len(run.scene.cameras):
        return None
    return Planning(host, PlanActions(host, run, setting))


class Planning:
    """`dock` and `loads` are placed by the window; `tools` take the mouse on its map."""

    def __init__(self, host: PlanHost, actions: PlanActions) -> None:
        self.actions, self._host = actions, host
        self._was_drawn = False
        self.dock = PlanDock(actions)
        self.loads = LoadDock(self.dock.choose)
        self.tools = MapTools(actions)
        self.dock.show_selected(0)
        actions.selection_changed.connect(self._show_selected)
        actions.compared.connect(self._show_comparison)
        session = actions.session
        if session is None:
            self.dock.show_figures(actions.run.cloud_plan, actions.reason)
            self.dock.show_reason(actions.reason)
            return
        session.changed.connect(self._show_state)
        session.previewed.connect(self._show_preview)
        session.failed.connect(self._show_failure)
        session.busy.connect(self.dock.working.setVisible)
        session.conflict_resolved.connect(self._show_settled)
        self._watch = QTimer(actions)
        self._watch.timeout.connect(self._look_for_conflict)
        self._watch.start(WATCH_MS)
        messages = list(session.editor.restore())
        self._show_state(restored=messages)
        if messages or session.editor.edits:
            count = len(session.editor.edits)
            sentence = " ".join([f"{count} edit{'s' if count != 1 else ''} of the last time restored (Ctrl+Z takes them back).", *messages])
            # After the window's own greeting.
            QTimer.singleShot(0, lambda: host.show_status(sentence))

    @property
    def session(self) -> PlanSession | None:
        """The session of `actions`."""
        return self.actions.session

    @property
    def is_busy(self) -> bool:
        """Whether a border or edge is dragged, or an edit is being solved."""
        return self.tools.is_dragging or (self.session is not None and self.session.is_busy)

    def set_active(self, active: bool) -> None:
        """Let the mouse on the map edit the plan, or only move the view."""
        self.tools.set_active(active)
        if active:
            _raise(self.dock)
            if self.session is None:
                self._host.show_status(NO_SYSTEM)
            else:
                self._host.show_status("Drag an edge's square or a border; Shift and drag selects cameras; E ends.")

    def end(self) -> None:
        """Close the session: a drag counts as released; an edit being solved stays in the file."""
        edit = self.tools.end_drag()
        self.tools.close()
        if self.session is not None:
            self._watch.stop()
            if edit is not None:
                self.session.edit(edit)
            self.session.close()

    def _show_selected(self) -> None:
        self.dock.show_selected(len(self.actions.selected), self.actions.likely_target)

    def _show_comparison(self, file_name: str, rows: tuple[ComparedRow, ...]) -> None:
        assert self.actions.comparison is not None
        self.dock.show_comparison(file_name, self.actions.comparison.text, rows)

    def _show_state(self, restored: Sequence[str] = ()) -> None:
        assert self.session is not None
        editor = self.session.editor
        state = editor.state
        self.actions.follow_session()
        run = self.actions.run
        self._host.remove_mark(COMPARED)
        changes = editor.changes_since_last_edit.text if editor.edits else "As it was opened."
        if len(editor.edits) > 1:
            changes += f" Since the opening: {editor.changes_since_start.text}"
        for sentence in (*restored, editor.save_error):
            changes += f" {sentence}" if sentence else ""
        if editor.edits or restored or self._was_drawn:
            self._draw(edited_layers(run, editor.subject, state, editor.base))
            self._host.show_run(run)
        self._was_drawn = True
        self.dock.show_plan(state, changes)
        self.loads.show_rows(load_rows(state.cloud, state.edges, state.wishes.system, state.wishes.constraints))
        status = f"{editor.undo_text}: {editor.changes_since_last_edit.text}" if editor.edits else "The plan is as it was opened."
        self._host.show_status(status)
        self._show_conflict()

    def _look_for_conflict(self) -> None:
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
            _raise(self.dock)
            self._host.show_status(sentence)

    def _show_settled(self, sentence: str) -> None:
        self.dock.changes.setText(f"{self.dock.changes.text()} {sentence}")
        self._host.show_status(sentence)

    def _show_preview(self, plan: EditedPlan) -> None:
        assert self.session is not None
        editor = self.session.editor
        if not self.tools.is_dragging:
            return
        self._host.map.detail.coarsen()
        self._draw(edited_layers(self.actions.run, editor.subject, plan, editor.base), map_only=True)
        difference = plan_difference((editor.state.cloud, ()), (plan.cloud, ()))
        self.dock.show_figures(plan.cloud, difference.text)
        self.loads.show_rows(load_rows(plan.cloud, (), plan.wishes.system, plan.wishes.constraints))

    def _show_failure(self, sentence: str) -> None:
        self.dock.changes.setText(f"Not done: {sentence}")
        self._host.show_status(sentence)

    def _draw(self, layers: Sequence[Layer], *, map_only: bool = False) -> None:
        for layer in layers:
            self._host.replace_layer(layer, map_only=map_only)
        self._host.render_views(map_only=map_only)


def _raise(dock: QDockWidget) -> None:
    dock.show()
    dock.raise_()
