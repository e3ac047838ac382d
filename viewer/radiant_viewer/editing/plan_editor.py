"""`PlanEditor`: a plan under change, with undo and redo and its edits kept in a file. No window, no thread.

    editor.apply(edit)                                       all at once
    editor.begin(edit); plan = applied(…); editor.finish(edit, plan)     the same in three steps, the middle one on any thread

An edit that cannot be done raises BadInput with one sentence and leaves everything as it was. A state that was reached once is kept as
the object it was, so undo gives it back bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.system import System
from radiant_viewer.editing.edit_file import EditFile
from radiant_viewer.editing.edit_log import EditHistory, plan_key
from radiant_viewer.editing.edited_plan import EditedPlan, PlanSubject, add_strips, initial_plan
from radiant_viewer.editing.plan_difference import PlanDifference, plan_difference
from radiant_viewer.editing.plan_edits import Edit, apply_edit


@dataclass(frozen=True, kw_only=True, eq=False)
class _Step:
    edit: Edit
    after: EditedPlan


class PlanEditor:
    """One plan and its history.

    `edits_path`: the file in which edits are kept; None: nowhere. Raises BadInput when plan, cameras and system do not belong together.
    """

    def __init__(
        self, subject: PlanSubject, system: System, plan: tuple[CloudPlan, tuple[EdgePlan, ...]], edits_path: Path | None = None
    ) -> None:
        self.subject = subject
        self.base = initial_plan(subject, system, *plan)
        self._file = None if edits_path is None else EditFile(edits_path, plan_key(*plan))
        self._done: list[_Step] = []
        self._undone: list[_Step] = []
        self._pending: tuple[Edit, ...] = ()
        self.save_error = ""
        """Why edits cannot be kept, one sentence, empty where they are."""

    @property
    def conflict(self) -> str:
        """One sentence where another window changed the edits of this plan, empty where this one has them for itself."""
        if self._file is None or self._file.aside is None:
            return ""
        return " ".join(["Another window changed the edits of this plan.", *self._aside_sentences()])

    @property
    def state(self) -> EditedPlan:
        """The plan as it is now, with strips."""
        return self._done[-1].after if self._done else self.base

    @property
    def edits(self) -> tuple[Edit, ...]:
        """What was done, in order, without what was undone."""
        return tuple(step.edit for step in self._done)

    @property
    def undo_text(self) -> str:
        """What `undo` would take back, empty where there is nothing."""
        return self._done[-1].edit.text if self._done else ""

    @property
    def redo_text(self) -> str:
        """What `redo` would do again, empty where there is nothing."""
        return self._undone[-1].edit.text if self._undone else ""

    @property
    def changes_since_start(self) -> PlanDifference:
        """How the plan differs from the one that was opened."""
        return plan_difference((self.base.cloud, self.base.edges), (self.state.cloud, self.state.edges))

    @property
    def changes_since_last_edit(self) -> PlanDifference:
        """How the plan differs from the one before the last edit."""
        before = self._done[-2].after if len(self._done) > 1 else self.base
        return plan_difference((before.cloud, before.edges), (self.state.cloud, self.state.edges))

    def preview(self, edit: Edit) -> EditedPlan:
        """The regions that an edit would give, without strips; changes nothing. BadInput as `apply`."""
        return apply_edit(self.subject, self.state, edit, strips=False)

    def apply(self, edit: Edit) -> EditedPlan:
        """Do an edit; BadInput with one sentence, and nothing changed, where it cannot be done."""
        self.begin(edit)
        try:
            after = apply_edit(self.subject, self.state, edit)
        except BaseException:
            self.abandon()
            raise
        return self.finish(edit, after)

    def begin(self, *edits: Edit) -> None:
        """Keep an edit, and those that wait behind it, in the file before it is solved."""
        self._pending = edits
        self._keep()

    def finish(self, edit: Edit, after: EditedPlan) -> EditedPlan:
        """Take the plan that an edit gave on the present state; what was undone before can no longer be redone."""
        self._done.append(_Step(edit=edit, after=after))
        self._undone.clear()
        self._pending = ()
        self._keep()
        return after

    def abandon(self) -> None:
        """The edit that was begun could not be done."""
        self._pending = ()
        self._keep()

    def undo(self) -> EditedPlan:
        """Take back the last edit; BadInput where there is none."""
        if not self._done:
            raise BadInput("there is nothing to undo: the plan is as it was opened.")
        self._undone.append(self._done.pop())
        return self._reached()

    def redo(self) -> EditedPlan:
        """Do again what was undone last; BadInput where there is nothing."""
        if not self._undone:
            raise BadInput("there is nothing to redo.")
        self._done.append(self._undone.pop())
        return self._reached()

    def restore(self) -> tuple[str, ...]:
        """Do again what the file keeps, and return sentences about what could not be; once, before the first edit."""
        if self._file is None:
            return ()
        kept, sentence = self._file.load()
        told = [sentence] if sentence else []
        for edit in kept.done:
            told += self._replay(edit, self._done)
        undone: list[_Step] = []
        # The next to redo comes last in the file and follows on the plan first; one that fails takes those after it along.
        for edit in reversed(kept.undone):
            failed = self._replay(edit, undone)
            if failed:
                told += failed
                break
        self._undone = undone[::-1]
        self._reached()
        return tuple(told)

    def _replay(self, edit: Edit, steps: list[_Step]) -> list[str]:
        """Append the step of a kept edit; a sentence where it cannot be done. Regions alone: strips are made of what is shown."""
        try:
            after = apply_edit(self.subject, steps[-1].after if steps else self.state, edit, strips=False)
        except BadInput as error:
            return [f"A kept edit is left out, {edit.text}: {error}"]
        steps.append(_Step(edit=edit, after=after))
        return []

    def _reached(self) -> EditedPlan:
        if self._done:
            last = self._done[-1]
            self._done[-1] = _Step(edit=last.edit, after=add_strips(self.subject, last.after))
        self._keep()
        return self.state

    def find_conflict(self) -> str:
        """Look whether another window wrote the file of the edits; `conflict` afterwards."""
        if self._file is not None:
            self._file.has_foreign_edits()
        return self.conflict

    def take_over(self) -> tuple[str, ...]:
        """This window's edits count: they go into the file, those of the other window beside it; sentences about that, BadInput where
        they cannot be kept."""
        return () if self._file is None else (self._file.take_over(self._kept()),)

    def adopt_other(self) -> tuple[str, ...]:
        """The other window's edits count: do what the file keeps, as `restore`; this window's stay beside it where it made any."""
        told = self._aside_sentences()
        self._done, self._undone = [], []
        return (*told, *self.restore())

    def _aside_sentences(self) -> list[str]:
        """Where this window's own edits are since another one has the file."""
        aside = None if self._file is None else self._file.aside
        return [f"This window's are kept in {aside.name}."] if aside is not None and aside.exists() else []

    def _kept(self) -> EditHistory:
        # With an edit on the way, what was undone before is out of reach.
        undone = () if self._pending else tuple(step.edit for step in self._undone)
        return EditHistory(done=(*self.edits, *self._pending), undone=undone)

    def _keep(self) -> None:
        if self._file is None:
            return
        self.save_error = ""
        try:
            self._file.save(self._kept())
        except (BadInput, OSError) as error:
            self.save_error = f"Edits are not kept: {error}"
