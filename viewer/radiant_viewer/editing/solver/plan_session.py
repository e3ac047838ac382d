"""`PlanSession`: a `PlanEditor` solving beside the window. Needs the `desktop` extra.

One thread solves. Edits are solved in the order of their calls; of the frames of a drag only the
latest waits, so a slow plan skips frames instead of queueing them. An edit that is unsolved when
the window closes is in the editor's file already.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from PySide6.QtCore import QObject, Signal

from radiant_core.errors import BadInput
from radiant_viewer.editing.model.edited_plan import EditedPlan
from radiant_viewer.editing.model.plan_edits import Edit, apply_edit
from radiant_viewer.editing.solver.plan_editor import PlanEditor


class PlanSession(QObject):
    """Signals: changed: the plan; previewed: the `EditedPlan` of a drag; failed: one sentence;
    busy: solving or not; conflict_resolved: where the dropped edits are."""

    changed = Signal()
    previewed = Signal(object)
    failed = Signal(str)
    busy = Signal(bool)
    conflict_resolved = Signal(str)
    _solved = Signal(object)

    def __init__(self, editor: PlanEditor, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self.editor = editor
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="plan")
        self._waiting: list[Edit] = []
        self._solving: Edit | None = None
        self._is_previewing = False
        self._next_preview: Edit | None = None
        self._is_closed = False
        # A signal moves the result from the pool's thread to this object's.
        self._solved.connect(self._deliver)

    @property
    def is_busy(self) -> bool:
        """Whether an edit is being solved or queued."""
        return self._solving is not None or bool(self._waiting)

    def edit(self, edit: Edit) -> None:
        """Queue an edit; the preview of a drag is dropped."""
        self._next_preview = None
        self._waiting.append(edit)
        if self._solving is not None:
            self.editor.begin(self._solving, *self._waiting)
        self._begin_next()

    def drag_to(self, edit: Edit) -> None:
        """Preview an edit; only the latest call is solved."""
        if self.is_busy:
            return
        self._next_preview = edit
        self._preview_next()

    def undo(self) -> None:
        """Undo the last edit; emits `failed` where there is none or one is being solved."""
        self._step(self.editor.undo)

    def redo(self) -> None:
        """Redo the last undone edit; `failed` as in `undo`."""
        self._step(self.editor.redo)

    def resolve_conflict(self, *, take_over: bool) -> None:
        """Keep this window's edits or adopt the other window's; emits `conflict_resolved`."""
        sentences: list[str] = []
        self._step(lambda: sentences.extend(self.editor.take_over() if take_over else self.editor.adopt_other()))
        if sentences:
            self.conflict_resolved.emit(" ".join(sentences))

    def drop_preview(self) -> None:
        """Drop the preview of a cancelled drag."""
        self._next_preview = None
        self.changed.emit()

    def close(self) -> None:
        """Stop the thread; unsolved and queued edits stay in the editor's file."""
        self._is_closed = True
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _step(self, action: Callable[[], object]) -> None:
        if self.is_busy:
            self.failed.emit("The plan is being solved: wait a moment.")
            return
        try:
            action()
        except BadInput as error:
            self.failed.emit(str(error))
            return
        self.changed.emit()

    def _begin_next(self) -> None:
        if self._solving is not None or not self._waiting or self._is_closed:
            return
        edit = self._solving = self._waiting.pop(0)
        self.busy.emit(True)
        self.editor.begin(edit, *self._waiting)
        subject, state = self.editor.subject, self.editor.state
        self._pool.submit(apply_edit, subject, state, edit).add_done_callback(lambda future: self._hand_over("edit", future))

    def _preview_next(self) -> None:
        edit = self._next_preview
        if edit is None or self._is_previewing or self._is_closed:
            return
        self._next_preview, self._is_previewing = None, True
        subject, state = self.editor.subject, self.editor.state
        future = self._pool.submit(apply_edit, subject, state, edit, strips=False)
        future.add_done_callback(lambda future: self._hand_over("preview", future))

    def _hand_over(self, kind: str, future: Future[EditedPlan]) -> None:
        if not self._is_closed and not future.cancelled():
            self._solved.emit((kind, future))

    def _deliver(self, solved: tuple[str, Future[EditedPlan]]) -> None:
        if self._is_closed:
            return
        kind, future = solved
        error = future.exception()
        if error is not None and not isinstance(error, BadInput):
            raise error
        if kind == "preview":
            self._is_previewing = False
            if error is not None:
                self.failed.emit(str(error))
            elif not self.is_busy:
                self.previewed.emit(future.result())
            self._preview_next()
            return
        edit, self._solving = self._solving, None
        assert edit is not None
        if error is None:
            self.editor.finish(edit, future.result())
        else:
            self.editor.abandon()
        self.changed.emit()
        if error is not None:
            self.failed.emit(str(error))
        self.busy.emit(self.is_busy)
        self._begin_next()
