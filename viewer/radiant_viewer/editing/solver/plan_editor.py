"""`PlanEditor`: a plan with undo and redo, its edits stored in a file. No window, no thread.

    editor.apply(edit)                                                   in one step
    editor.begin(edit); plan = apply_edit(…); editor.finish(edit, plan)  the middle on any thread

An impossible edit raises BadInput with one sentence and changes nothing. Earlier states are kept as
objects, so undo restores them bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.system import System
from radiant_viewer.editing.model.edited_plan import EditedPlan, PlanSubject, add_strips, initial_plan
from radiant_viewer.editing.model.plan_difference import PlanDifference, plan_difference
from radiant_viewer.editing.model.plan_edits import Edit, apply_edit
from radiant_viewer.editing.store.edit_file import EditFile, EditHistory, plan_key


@dataclass(frozen=True, kw_only=True, eq=False)
class _Step:
    edit: Edit
    after: EditedPlan


class PlanEditor:
    """One plan and its history; edits are kept in the file `edits_path`, if any. Raises BadInput
    where plan, cameras and system do not belong together."""

    def __init__(
        self, subject: PlanSubject, system: System, plan: tuple[CloudPlan, tuple[EdgePlan, ...]], edits_path: Path | None = None
    ) -> None:
        self.subject = subject
        self.base = initial_plan(subject, system, *plan)
        self._file = None if edits_path is None else EditFile(edits_path, plan_key(*plan))
        self._steps: list[_Step] = []
        self._undone: list[_Step] = []
        self._pending: tuple[Edit, ...] = ()
        self.save_error = ""
        """Why edits cannot be stored, one sentence; empty where they can."""

    @property
    def conflict(self) -> str:
        """One sentence if another window changed the edits of this plan, else empty."""
        if self._file is None or self._file.aside is None:
            return ""
        return " ".join(["Another window changed the edits of this plan.", *self._aside_sentences()])

    @property
    def state(self) -> EditedPlan:
        """The present plan, with strips."""
        return self._steps[-1].after if self._steps else self.base

    @property
    def edits(self) -> tuple[Edit, ...]:
        """The edits in effect, in order."""
        return tuple(step.edit for step in self._steps)

    @property
    def undo_text(self) -> str:
        """The edit that `undo` would undo, empty without one."""
        return self._steps[-1].edit.text if self._steps else ""

    @property
    def redo_text(self) -> str:
        """The edit that `redo` would redo, empty without one."""
        return self._undone[-1].edit.text if self._undone else ""

    @property
    def changes_since_start(self) -> PlanDifference:
        """The difference from the plan that was opened."""
        return plan_difference((self.base.cloud, self.base.edges), (self.state.cloud, self.state.edges))

    @property
    def changes_since_last_edit(self) -> PlanDifference:
        """The difference from the plan before the last edit."""
        before = self._steps[-2].after if len(self._steps) > 1 else self.base
        return plan_difference((before.cloud, before.edges), (self.state.cloud, self.state.edges))

    def apply(self, edit: Edit) -> EditedPlan:
        """Do an edit and return the plan; an impossible one raises BadInput and changes nothing."""
        self.begin(edit)
        try:
            after = apply_edit(self.subject, self.state, edit)
        except BaseException:
            self.abandon()
            raise
        return self.finish(edit, after)

    def begin(self, *edits: Edit) -> None:
        """Store an edit, and those queued behind it, before it is solved."""
        self._pending = edits
        self._keep()

    def finish(self, edit: Edit, after: EditedPlan) -> EditedPlan:
        """Record the solved plan of an edit; undone edits can no longer be redone."""
        self._steps.append(_Step(edit=edit, after=after))
        self._undone.clear()
        self._pending = ()
        self._keep()
        return after

    def abandon(self) -> None:
        """Drop the edit that was begun and could not be solved."""
        self._pending = ()
        self._keep()

    def undo(self) -> EditedPlan:
        """Undo the last edit; BadInput without one."""
        if not self._steps:
            raise BadInput("there is nothing to undo: the plan is as it was opened.")
        self._undone.append(self._steps.pop())
        return self._finish_step()

    def redo(self) -> EditedPlan:
        """Redo the edit that was undone last; BadInput without one."""
        if not self._undone:
            raise BadInput("there is nothing to redo.")
        self._steps.append(self._undone.pop())
        return self._finish_step()

    def restore(self) -> tuple[str, ...]:
        """Replay the stored edits, once, before the first edit; return sentences on failed ones."""
        if self._file is None:
            return ()
        history, sentence = self._file.load()
        sentences = [sentence] if sentence else []
        for edit in history.edits:
            sentences += self._replay(edit, self._steps)
        undone: list[_Step] = []
        # The last undone edit is the next to redo; if one fails, those after it are dropped too.
        for edit in reversed(history.undone):
            failed = self._replay(edit, undone)
            if failed:
                sentences += failed
                break
        self._undone = undone[::-1]
        self._finish_step()
        return tuple(sentences)

    def _replay(self, edit: Edit, steps: list[_Step]) -> list[str]:
        """Append the step of a stored edit, or return a sentence why not. Regions only: strips are
        added to what is shown."""
        try:
            after = apply_edit(self.subject, steps[-1].after if steps else self.state, edit, strips=False)
        except BadInput as error:
            return [f"A kept edit is left out, {edit.text}: {error}"]
        steps.append(_Step(edit=edit, after=after))
        return []

    def _finish_step(self) -> EditedPlan:
        if self._steps:
            last = self._steps[-1]
            self._steps[-1] = _Step(edit=last.edit, after=add_strips(self.subject, last.after))
        self._keep()
        return self.state

    def find_conflict(self) -> str:
        """Check whether another window wrote the file of the edits, and return `conflict`."""
        if self._file is not None:
            self._file.has_foreign_edits()
        return self.conflict

    def take_over(self) -> tuple[str, ...]:
        """Store this window's edits in the file and the other's beside it; return sentences about
        it. Raises BadInput as `EditFile.save`."""
        return () if self._file is None else (self._file.take_over(self._history()),)

    def adopt_other(self) -> tuple[str, ...]:
        """Replay the other window's edits, as `restore`; this window's stay in a file beside it."""
        sentences = self._aside_sentences()
        self._steps, self._undone = [], []
        return (*sentences, *self.restore())

    def _aside_sentences(self) -> list[str]:
        aside = None if self._file is None else self._file.aside
        return [f"This window's are kept in {aside.name}."] if aside is not None and aside.exists() else []

    def _history(self) -> EditHistory:
        # An edit that is being solved makes the undone ones unreachable.
        undone = () if self._pending else tuple(step.edit for step in self._undone)
        return EditHistory(edits=(*self.edits, *self._pending), undone=undone)

    def _keep(self) -> None:
        if self._file is None:
            return
        self.save_error = ""
        try:
            self._file.save(self._history())
        except (BadInput, OSError) as error:
            self.save_error = f"Edits are not kept: {error}"
