"""`Source`: what a run needs of its photographs, pooled or on devices. Once per run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from radiant_app.executors.protocol import Executor
from radiant_app.run.dealing import Dealer
from radiant_app.run.photographs import Photographs
from radiant_app.run.progress import Progress
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput, StageFailed
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.system import System
from radiant_core.plan.together.groups import GroupPlan
from radiant_core.train.config import TrainConfig


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """The plan of a run, of both levels, and the system it was made for."""

    system: System
    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]
    groups: tuple[GroupPlan, ...] = ()
    """Machines that train together; none where all models are joined."""
    num_workers: int | None = None
    """Trainings that this machine's memory holds side by side; None: as many as it has cores."""


class Source(Photographs, Protocol):
    """The photographs of a run: planned, dealt (`Photographs`) and scored with."""

    def make_plan(self, system: System, progress: Progress) -> Plan:
        """Plan the training photographs and write plan.json; BadInput where no plan fits."""
        ...

    def check(self, train: TrainConfig) -> None:
        """Raise BadInput if photographs are too small to be scored at the size of the training."""
        ...

    def stages(self, tree: Tree) -> tuple[Sequence[str], Sequence[str]]:
        """Stages of the run before and after the nodes of its tree."""
        ...

    def may_fail(self, node: Tree, error: BadInput | StageFailed) -> bool:
        """Whether the run goes on without a node that failed with this error."""
        ...

    def score(self, dealer: Dealer, executor: Executor, progress: Progress) -> None:
        """Score the finished scene on the held-out photographs; completes the access log."""
        ...
