"""Refines a joined scene where its photographs are. In rounds, between joining and scoring.

Every round is a tree of its own, which the run's `Dealer` prepares: each device whose model is in
the scene fits that to its own photographs, edges average, the cloud puts the mean into the scene,
and the next round starts somewhat further on (`averaging.start_of_next_round`). A machine that
fails here costs its part of the round, not the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from radiant_app.events import Decided, Listener, Warned
from radiant_app.run.dealing import Dealer, Refining
from radiant_app.workers.inbox import REFUSED_NAME
from radiant_core.aggregate.tree import Tree, refined_at, refines_for, round_of, tree_of_round
from radiant_core.decisions import Decision
from radiant_core.hierarchy.codec import SUMMARY_NAME
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.refining_plan import LEAST_DEVICES, STAGE, choose_rounds, plan_refining
from radiant_core.io.run_store import read_json

LATE = "its process ended, or was given up, before its refinement was there; the warnings say how."
UNUSED = "its edge sent no refinement that could be used."


def expected_refines(recipe: Recipe, tree: Tree) -> list[str]:
    """The nodes that are to be expected to refine this tree's scene: all, in every round, where the
    settings ask for it and devices differ. Which do is known when their models are in the scene."""
    if "cloud" in recipe.groups or not recipe.aggregate.refine.is_asked_for or sum(node.tier == "device" for node in tree) < LEAST_DEVICES:
        return []
    return [refined_at(node.id, number) for number in range(1, choose_rounds(recipe) + 1) for node in tree]


def plan_rounds(dealer: Dealer, listen: Listener) -> tuple[Tree, ...]:
    """The trees of all rounds in which a run's scene is refined; none where no device is to refine
    it. Says which devices are."""
    recipe, moves = dealer.recipe, dealer.load_moves()
    present = {plan.edge_id: [name for name in plan.device_ids if name in moves] for plan in recipe.edge_plans}
    num_splats = int(read_json(dealer.run / "cloud" / SUMMARY_NAME, ("num_splats",))["num_splats"])
    plan = plan_refining(recipe, present, num_splats)
    dealer.refining, dealer.refined = Refining(run=dealer.run, devices=plan.devices, moves=moves), None
    for decision in plan.decisions:
        listen(Decided(decision=decision))
    for message in plan.warnings:
        listen(Warned(stage=STAGE, message=message))
    return tuple(tree_of_round(plan.devices, number) for number in range(1, choose_rounds(recipe) + 1)) if plan.devices else ()


def fold_rounds(dealer: Dealer, rounds: Sequence[Tree], fold: Callable[[Tree], None], listen: Listener) -> tuple[Tree, ...]:
    """Let `fold` run one round after another until one makes no scene; the rounds that were tried.
    The scene of the last that made one is the dealer's `refined`."""
    tried: list[Tree] = []
    for tree in rounds:
        fold(tree)
        tried.append(tree)
        number = round_of(tree.id)
        dealer.refined = dealer.refined_by(number)
        if not dealer.is_done(tree.id):
            state = "the cloud left it" if dealer.refined is None else f"round {number - 1} left it"
            listen(Warned(stage=tree.id, message=f"the scene stays as {state}: no refinement arrived; --resume tries again."))
            break
    if not tried:
        return ()
    devices = {_owner(node) for node in tried[0] if node.tier == "device"}
    if left_out(dealer, tried).keys() >= devices:
        # What came back are the Gaussians that went out.
        dealer.refined = None
    if missing := {**left_out(dealer, tried), **partly_left_out(dealer, tried)}:
        listen(Decided(decision=left_out_decision(tried[-1].id, missing, len(devices))))
    return tuple(tried)


def left_out(dealer: Dealer, rounds: Sequence[Tree]) -> dict[str, str]:
    """Device that was to refine the scene and did so in none of these rounds → the last reason."""
    return {device: missed[-1][1] for device, missed in _missed_in(dealer, rounds).items() if len(missed) == len(rounds)}


def partly_left_out(dealer: Dealer, rounds: Sequence[Tree]) -> dict[str, str]:
    """Device that refined the scene in some of these rounds alone → in which it did not, and the
    last reason."""
    missed_by_some = {device: missed for device, missed in _missed_in(dealer, rounds).items() if len(missed) < len(rounds)}
    return {
        device: f"not in round {_listed([number for number, _ in missed])}: {missed[-1][1]}" for device, missed in missed_by_some.items()
    }


def _missed_in(dealer: Dealer, rounds: Sequence[Tree]) -> dict[str, list[tuple[int, str]]]:
    missed: dict[str, list[tuple[int, str]]] = {}
    for tree in rounds:
        refused = _refused_at(dealer, tree)
        for edge in tree.children:
            # What the cloud did not get of an edge, it did not get of its devices.
            for device, reason in left_out_of(dealer, edge, refused.get(_owner(edge))).items():
                missed.setdefault(device, []).append((round_of(tree.id), reason))
    return missed


def left_out_of(dealer: Dealer, edge: Tree, reason: str | None = None) -> dict[str, str]:
    """Device of an edge that was to refine the scene in a round and did not → the reason;
    `reason`: why the cloud did not take what the edge sent."""
    refused, of_edge = _refused_at(dealer, edge), reason or (None if dealer.is_done(edge.id) else UNUSED)
    reasons = {_owner(device): refused.get(_owner(device)) or of_edge for device in edge.children}
    reasons |= {_owner(device): LATE for device in edge.children if not dealer.is_done(device.id)}
    return {device: why for device, why in reasons.items() if why is not None}


def _refused_at(dealer: Dealer, node: Tree) -> dict[str, str]:
    return read_json(dealer.run / node.id / REFUSED_NAME) if dealer.is_done(node.id) else {}


def _owner(node: Tree) -> str:
    """The name of the device or edge that works at a node of a round."""
    return refines_for(node.id).rsplit("/", 1)[-1]


def _listed(numbers: Sequence[int]) -> str:
    return " and ".join([*([", ".join(map(str, numbers[:-1]))] if len(numbers) > 1 else []), str(numbers[-1])])


def left_out_decision(stage: str, left_out: Mapping[str, str], num_devices: int) -> Decision:
    """That the scene was refined, or stays as it is, without these of so many devices."""
    return Decision(
        stage=stage,
        topic="refinement",
        choice=f"the photographs of {', '.join(left_out)} do not refine the scene",
        figure=float(len(left_out)),
        unit=f"of {num_devices} devices",
        reason="; ".join(f"{device}: {reason.rstrip('.')}" for device, reason in left_out.items()),
    )
