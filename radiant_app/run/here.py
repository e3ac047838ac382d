"""`Here`: this machine, or the cluster of its owner, does the work of a run's nodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from radiant_app.config.run_config import RunConfig
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.protocol import Executor, Prepare
from radiant_app.run.dealing import Dealer
from radiant_app.run.refining_deadlines import RefiningDeadlines, expected_times
from radiant_app.run.source import Plan, Source
from radiant_app.run.stages import make_executor, workers_of
from radiant_core.aggregate.tree import Tree
from radiant_core.hierarchy.recipe import Recipe


@dataclass(frozen=True, kw_only=True)
class Here:
    """See `Conductor`."""

    config: RunConfig

    def make_dealer(self, recipe: Recipe, source: Source) -> Dealer:
        """Makes the keys of all nodes itself."""
        return Dealer(run=self.config.out, recipe=recipe, photographs=source)

    def num_workers(self, plan: Plan, tree: Tree) -> int:
        """As many as the user asks for, else as cores and memory allow."""
        del tree
        return workers_of(self.config, plan)

    def make_executor(self, plan: Plan, clock: Callable[[], float], retry_policy: RetryPolicy) -> Executor:
        """Local, emulated or a Ray cluster."""
        return make_executor(self.config, plan, clock, retry_policy)

    def preparing(self, dealer: Dealer) -> Prepare:
        """As it is dealt."""
        return dealer.prepare

    def refining_deadlines(self, dealer: Dealer, tree: Tree, times: Mapping[str, Mapping[str, float]]) -> RefiningDeadlines:
        """By what its machines took before."""
        expected_s = expected_times(dealer, tree, times)
        return RefiningDeadlines(expected_s=expected_s, deadline_factor=self.config.execution.deadline_factor)
