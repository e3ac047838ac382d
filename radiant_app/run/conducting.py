"""`conduct`: one run from its plan to its score, wherever photographs are and whoever works. Once
per run.

    Source      where photographs are: planned, dealt and scored (pooled.py, on_devices.py;
                network/far_devices.py)
    Conductor   who does the work of nodes: this machine or its cluster (here.py), or machines of
                owners (network/cloud.py); at an edge of these, its devices (network/regions.py)

    plan ─ fold the tree ─ a model? ─ fold rounds of refining ─ score
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Listener, Outlined
from radiant_app.executors.fold import Deadlines, RetryPolicy
from radiant_app.executors.protocol import Executor, NodeTime, Prepare
from radiant_app.run.dealing import Dealer
from radiant_app.run.foreseen import foresee_planned
from radiant_app.run.groups import end_groups, prepare_meetings, tell_parents, with_groups
from radiant_app.run.progress import Progress
from radiant_app.run.reassignment import Reassignment, load_replan, plan_key
from radiant_app.run.refining import expected_refines, fold_rounds, plan_rounds
from radiant_app.run.source import Plan, Source
from radiant_app.run.stages import make_recipe, make_time_left_listener
from radiant_core.aggregate.tree import Tree, tree_of_plan
from radiant_core.errors import StageFailed
from radiant_core.hierarchy.recipe import Recipe, devices_with_photographs

Clock = Callable[[], float]
Times = Mapping[str, Mapping[str, float]]
"""Node → started_s and ended_s."""


class Conductor(Protocol):
    """Who does the work of a run's nodes."""

    def make_dealer(self, recipe: Recipe, source: Source) -> Dealer:
        """The dealer of the run, with the keys of its machines."""
        ...

    def num_workers(self, plan: Plan, tree: Tree) -> int:
        """Processes of devices and edges at a time."""
        ...

    def make_executor(self, plan: Plan, clock: Clock, retry_policy: RetryPolicy) -> Executor:
        """Runs trees of the run."""
        ...

    def preparing(self, dealer: Dealer) -> Prepare:
        """Fills the folder of a node of the run's tree, or of a round."""
        ...

    def refining_deadlines(self, dealer: Dealer, tree: Tree, times: Times) -> Deadlines | None:
        """How long nodes of a round may take; None: who works keeps to deadlines of its own."""
        ...


@dataclass(frozen=True, kw_only=True)
class Folding:
    """Folds the trees of one run, or of a region of it: that of its models, and its rounds."""

    dealer: Dealer
    conductor: Conductor
    plan: Plan
    clock: Clock

    def make_executor(self, policy: RetryPolicy) -> Executor:
        """The conductor's, for this plan."""
        return self.conductor.make_executor(self.plan, self.clock, policy)

    def fold(self, tree: Tree, executor: Executor, listen: Listener) -> Mapping[str, NodeTime]:
        """Let the devices of a tree work, and what is above them; when each node did."""
        return executor.fold(tree, self.conductor.preparing(self.dealer), listen)

    def fold_round(self, tree: Tree, times: Times, listen: Listener) -> None:
        """Let devices refine the scene, and average upwards; `times`: of nodes, what they took
        before."""
        deadlines = self.conductor.refining_deadlines(self.dealer, tree, times)
        self.fold(tree, self.make_executor(RetryPolicy(may_fail=lambda node, error: True, deadlines=deadlines)), listen)


@dataclass(frozen=True, kw_only=True)
class Conducted:
    """A run whose scene is scored."""

    dealer: Dealer
    tree: Tree
    rounds: tuple[Tree, ...]
    """Those in which devices refined the scene, or were to."""


def conduct(config: RunConfig, source: Source, conductor: Conductor, plan: Plan, progress: Progress) -> Conducted:
    """Fold the tree of a plan, refine the scene and score it; StageFailed where no model is
    usable."""
    first_key, num_devices = plan_key(plan.cloud, plan.edges), devices_with_photographs(plan.edges)
    if source.positions is not None:
        plan = load_replan(config.out, plan)
    recipe = make_recipe(config, plan, num_devices, progress)
    source.check(recipe.train)
    dealer = conductor.make_dealer(recipe, source)
    tree = with_groups(tree_of_plan(plan.cloud, plan.edges), recipe.groups)
    prepare_meetings(config.out, recipe)
    before, after = source.stages(tree)
    nodes, refines = [node.id for node in tree], expected_refines(recipe, tree)
    progress.manifest.keep_stages({*before, *after, *nodes, *refines})
    before = [stage for stage in before if stage in progress.manifest.stages]
    progress.listen(Outlined(stages=(*before, *nodes, *refines, *after)))
    progress.listen(foresee_planned(config, plan, recipe, conductor.num_workers(plan, tree)))
    listen = make_time_left_listener(config, plan, progress)
    retry_policy = RetryPolicy(may_fail=source.may_fail, deadlines=listen)
    if source.positions is not None:
        reassignment = Reassignment(dealer=dealer, positions=source.positions, tree=tree, first_plan_key=first_key, listen=listen)
        retry_policy = replace(retry_policy, on_given_up=reassignment)
    retry_policy = replace(retry_policy, on_given_up=tell_parents(config.out, recipe, retry_policy.on_given_up))
    folding = Folding(dealer=dealer, conductor=conductor, plan=plan, clock=progress.clock)
    executor = folding.make_executor(retry_policy)
    folding.fold(tree, executor, listen)
    end_groups(config.out, recipe)
    _require_model(dealer)
    # Nodes without a result, or with nothing to do now, would be waited for in every count.
    absent = {f"devices/{device}/score" for device in dealer.missing_devices()}
    after = [stage for stage in after if stage not in absent]
    finished = [*before, *filter(dealer.is_done, nodes)]
    rounds = plan_rounds(dealer, progress.listen)
    progress.listen(Outlined(stages=(*finished, *(node.id for round_tree in rounds for node in round_tree), *after)))
    times = {**progress.manifest.stages, **progress.manifest.emulated}
    rounds = fold_rounds(dealer, rounds, lambda round_tree: folding.fold_round(round_tree, times, progress.listen), progress.listen)
    refined = [node.id for round_tree in rounds for node in round_tree if dealer.is_done(node.id)]
    progress.listen(Outlined(stages=(*finished, *refined, *after)))
    source.score(dealer, executor, progress)
    return Conducted(dealer=dealer, tree=tree, rounds=rounds)


def _require_model(dealer: Dealer) -> None:
    if not dealer.has_model("cloud"):
        reasons = " ".join(f"{device}: {reason}" for device, reason in dealer.missing_devices().items())
        raise StageFailed(f"no device delivered a model that could be used. {reasons}")
