"""`Source`: what a run asks its photographs for, wherever they are. Once per run."""

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
from radiant_core.train.config import TrainConfig


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """What a run planned: the system as it was planned, and both levels of the plan."""

    system: System
    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]


class Source(Photographs, Protocol):
    """The photographs of a run: planned, dealt (`Photographs`) and, held out, scored with."""

    def planned(self, system: System, progress: Progress) -> Plan:
        """The plan of the training photographs, also in plan.json; BadInput where they cannot be planned."""
        ...

    def check(self, train: TrainConfig) -> None:
        """Raise BadInput where photographs cannot be scored at the size of the training."""
        ...

    def stages(self, tree: Tree) -> tuple[Sequence[str], Sequence[str]]:
        """Stages of the run before and after the nodes of its tree."""
        ...

    def may_fail(self, node: Tree, error: BadInput | StageFailed) -> bool:
        """Whether the rest goes on without a node that failed so."""
        ...

    def score(self, dealer: Dealer, executor: Executor, progress: Progress) -> None:
        """Score the finished scene on what was held out, in evaluation/, and complete the ledger."""
        ...
