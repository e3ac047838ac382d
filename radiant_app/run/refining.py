"""Refines a joined scene where its photographs are. In rounds, between joining and scoring.

In every round the tree of the run is folded once more, in a folder inside that of every node
(`refined_at`): each device whose model is in the scene fits that to its own photographs, edges
average, the cloud puts the mean into the scene, and the next round starts somewhat further on
(`averaging.start_of_next_round`). A machine that fails here costs its part of the round, not the
scene.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from radiant_app.events import Decided, Listener, Warned
from radiant_app.executors.protocol import NodeTask
from radiant_app.run.dealing import Dealer, count_received, deal_files
from radiant_app.workers.delivering import DELIVERIES, identify_part, sign_task
from radiant_app.workers.inbox import REFUSED_NAME
from radiant_app.workers.refining import KEPT_SCENE, NEXT_SCENE, REFINED_SCENE, counted_file, is_counted
from radiant_app.workers.tasks import SIGNED, AverageTask, FinishTask, Move, RefineNodeTask
from radiant_core import __version__
from radiant_core.aggregate.tree import Tree, refined_at, refines_for
from radiant_core.decisions import Decision
from radiant_core.frames import Sim3
from radiant_core.hierarchy.codec import CAMERAS_NAME, MODEL_NAME, REFINED_NAME, ROWS_NAME, SUMMARY_NAME, TASK_NAME, save_task, task_key
from radiant_core.hierarchy.messages import RefineTask
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.refining_plan import LEAST_DEVICES, STAGE, RefiningPlan, choose_rounds, plan_refining
from radiant_core.io.run_store import content_key, file_sha256, is_sealed, read_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME

SCENE_NAME = "scene.ply"
LATE = "its process ended, or was given up, before its refinement was there; the warnings say how."
UNUSED = "its edge sent no refinement that could be used."


def expected_refines(recipe: Recipe, tree: Tree) -> list[str]:
    """The nodes that are to be expected to refine this tree's scene: all, in every round, where the
    settings ask for it and devices differ. Which do is known when their models are in the scene."""
    if "cloud" in recipe.groups or not recipe.aggregate.refine.is_asked_for or sum(node.tier == "device" for node in tree) < LEAST_DEVICES:
        return []
    return [refined_at(node.id, number) for number in range(1, choose_rounds(recipe) + 1) for node in tree]


def plan_rounds(dealer: Dealer, moves: Mapping[str, Sequence[Sim3]]) -> tuple[Refining, ...]:
    """All rounds of refining a run's scene; none where no device is to refine it."""
    rounds: list[Refining] = []
    for number in range(1, choose_rounds(dealer.recipe) + 1):
        before = rounds[-1] if rounds else None
        planned = None if before is None else before.plan
        rounds.append(Refining(dealer=dealer, moves=moves, number=number, before=before, planned=planned))
    return tuple(rounds)


def fold_rounds(rounds: Sequence[Refining], fold: Callable[[Refining, Tree], None], listen: Listener) -> tuple[Refining, ...]:
    """Let `fold` run the tree of one round after another until one makes no scene; the rounds that
    were tried. The scene of the last that made one is the dealer's `refined`."""
    tried: list[Refining] = []
    for decision in rounds[0].plan.decisions:
        listen(Decided(decision=decision))
    for message in rounds[0].plan.warnings:
        listen(Warned(stage=STAGE, message=message))
    for refining in rounds:
        if (tree := refining.tree) is None:
            break
        fold(refining, tree)
        tried.append(refining)
        refining.dealer.refined = refining.scene_folder
        if not refining.is_done(tree.id):
            state = "the cloud left it" if refining.dealer.refined is None else f"round {refining.number - 1} left it"
            listen(Warned(stage=tree.id, message=f"the scene stays as {state}: no refinement arrived; --resume tries again."))
            break
    if tried and left_out(tried).keys() >= set().union(*tried[0].plan.devices.values()):
        # What came back are the Gaussians that went out.
        tried[0].dealer.refined = None
    if tried and (missing := {**left_out(tried), **partly_left_out(tried)}):
        stage, num_devices = tried[-1].node("cloud"), sum(map(len, tried[0].plan.devices.values()))
        listen(Decided(decision=left_out_decision(stage, missing, num_devices)))
    return tuple(tried)


def left_out(rounds: Sequence[Refining]) -> dict[str, str]:
    """Device that was to refine the scene and did so in none of these rounds → the last reason."""
    return {device: missed[-1][1] for device, missed in _missed_in(rounds).items() if len(missed) == len(rounds)}


def partly_left_out(rounds: Sequence[Refining]) -> dict[str, str]:
    """Device that refined the scene in some of these rounds alone → in which it did not, and the
    last reason."""
    missed_by_some = {device: missed for device, missed in _missed_in(rounds).items() if len(missed) < len(rounds)}
    return {
        device: f"not in round {_listed([number for number, _ in missed])}: {missed[-1][1]}" for device, missed in missed_by_some.items()
    }


def _missed_in(rounds: Sequence[Refining]) -> dict[str, list[tuple[int, str]]]:
    missed: dict[str, list[tuple[int, str]]] = {}
    for refining in rounds:
        for device, reason in refining.left_out().items():
            missed.setdefault(device, []).append((refining.number, reason))
    return missed


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


@dataclass(kw_only=True)
class Refining:
    """One round of refining a run's scene."""

    dealer: Dealer
    moves: Mapping[str, Sequence[Sim3]]
    """Device with a model in the scene → similarities from its frame to that."""
    keys: dict[str, str] = field(default_factory=dict)
    """Node id → the key of its seal."""
    planned: RefiningPlan | None = None
    """What was planned elsewhere, with all devices in view; None: it is planned here."""
    number: int = 1
    """Of the round, from 1."""
    before: Refining | None = None
    """The round before, which says where this one starts."""
    joined: str | None = None
    """SHA-256 of the scene before any round, where somebody else has that."""

    @cached_property
    def plan(self) -> RefiningPlan:
        """Which devices refine, and why others do not."""
        if self.planned is not None:
            return self.planned
        recipe = self.dealer.recipe
        present = {plan.edge_id: [name for name in plan.device_ids if name in self.moves] for plan in recipe.edge_plans}
        num_splats = int(read_json(self.dealer.run / "cloud" / SUMMARY_NAME, ("num_splats",))["num_splats"])
        return plan_refining(recipe, present, num_splats)

    @cached_property
    def joined_sha256(self) -> str:
        """Of the scene before any round."""
        return self.joined or file_sha256(self.dealer.run / "cloud" / SCENE_NAME)

    @property
    def tree(self) -> Tree | None:
        """The nodes that refine; None where there are none."""
        edges = []
        for edge, names in self.plan.devices.items():
            devices = tuple(Tree(id=self.node(f"devices/{name}"), tier="device") for name in names)
            edges.append(Tree(id=self.node(f"edges/{edge}"), tier="edge", children=devices))
        return Tree(id=self.node("cloud"), tier="cloud", children=tuple(edges)) if edges else None

    def node(self, owner: str) -> str:
        """The id of the node at which a device, edge or the cloud works in this round."""
        return refined_at(owner, self.number)

    def left_out(self) -> dict[str, str]:
        """Device that was to refine the scene and did not → the reason."""
        reasons: dict[str, str] = {}
        for edge in self.plan.devices:
            reasons |= self.left_out_of(edge)
        return reasons

    def left_out_of(self, edge: str) -> dict[str, str]:
        """Those of one edge."""
        reasons: dict[str, str] = {}
        average = self.node(f"edges/{edge}")
        refused = self._refused_at(average)
        # What the cloud did not get of an edge, it did not get of its devices.
        of_edge = self._refused_at(self.node("cloud")).get(edge) or (None if self.is_done(average) else UNUSED)
        for name in self.plan.devices[edge]:
            reason = refused.get(name) or of_edge
            if not self.is_done(self.node(f"devices/{name}")):
                reason = LATE
            if reason is not None:
                reasons[name] = reason
        return reasons

    def is_done(self, node: str) -> bool:
        """Whether the node with this id is done in this run."""
        return node in self.keys and is_sealed(self.dealer.run / node, self.keys[node])

    def _refused_at(self, node: str) -> dict[str, str]:
        return read_json(self.dealer.run / node / REFUSED_NAME) if self.is_done(node) else {}

    @property
    def scene_folder(self) -> Path | None:
        """Where the scene lies after this round, or after the last one that made one; None where
        none did."""
        node = self.node("cloud")
        if self.is_done(node):
            return (self.dealer.run / node / REFINED_SCENE).parent
        return None if self.before is None else self.before.scene_folder

    @property
    def start_folder(self) -> Path:
        """Where the scene lies that this round refines."""
        if self.before is None:
            return self.dealer.run / "cloud"
        node = self.before.node("cloud")
        return (self.dealer.run / node / NEXT_SCENE).parent if self.before.is_done(node) else self.before.start_folder

    def prepare(self, node: Tree) -> NodeTask | None:
        """Fill the node's folder and return its task; None if nothing arrived to be averaged."""
        run, folder = self.dealer.run, self.dealer.run / node.id
        owner = refines_for(node.id)
        folder.mkdir(parents=True, exist_ok=True)
        fills: dict[str, Callable[[Tree, Path], tuple[Any, list[Path]] | None]] = {
            "device": self._fill_device,
            "edge": self._fill_edge,
            "cloud": self._fill_cloud,
        }
        filled = fills[node.tier](node, folder)
        if filled is None:
            return None
        task, inputs = filled
        deal_files(self.start_folder, [SCENE_NAME], folder)
        save_task(folder, task)
        above = None if node.tier == "cloud" else self.dealer.parent_of(owner)
        identify_part(run, node.id, owner, above)
        kind = {"device": "refine", "edge": "average", "cloud": "finish"}[node.tier]
        if above is not None and self.dealer.signs_for(above):
            sign_task(run, above, owner, SIGNED[kind], folder, [TASK_NAME, SCENE_NAME])
        received = [folder / SCENE_NAME, *(path for path in (folder / "inbox", folder / DELIVERIES) if path.is_dir())]
        self.dealer.access_log.append({"node": node.id, "tier": node.tier, **count_received(received)})
        key = self.keys[node.id] = content_key(__version__, task_key(task), folder / SCENE_NAME, *inputs)
        return NodeTask(kind=kind, stage=node.id, folder=folder, key=key)

    def _fill_device(self, node: Tree, folder: Path) -> tuple[Any, list[Path]]:
        del folder
        device_folder = self.dealer.run / refines_for(node.id)
        settings = self.dealer.recipe.refine_task(device_folder.name)
        common = {field.name: getattr(settings, field.name) for field in fields(RefineTask)}
        # Its own model stands for the photographs, which it was made from.
        return RefineNodeTask(corrections=tuple(map(Move.of, self.moves[device_folder.name])), **common), [device_folder / MODEL_NAME]

    def _fill_edge(self, node: Tree, folder: Path) -> tuple[Any, list[Path]] | None:
        senders = self._receive(node, folder)
        num_dealt = tuple(map(self.dealer.photographs.num_dealt, senders))
        moves = tuple(tuple(map(Move.of, self.moves[sender])) for sender in senders)
        recipe = self.dealer.recipe
        task = AverageTask(
            senders=senders,
            num_dealt=num_dealt,
            corrections=moves,
            upload=recipe.upload,
            backend=recipe.backend,
            long_side_px=recipe.train.long_side_px,
            joined=self.joined_sha256,
            counted_in=tuple(self._counted_in(node, sender) for sender in senders),
        )
        cameras = [folder.parent / "inbox" / sender / CAMERAS_NAME for sender in senders]
        return (task, [folder / "inbox", *cameras]) if senders else None

    def _counted_in(self, node: Tree, device: str) -> int:
        """The earlier round in which an edge counted what a device's photographs show; 0: none."""
        owner, joined = refines_for(node.id), self.joined_sha256
        places = ((number, self.dealer.run / refined_at(owner, number) / counted_file(device)) for number in range(1, self.number))
        return next((number for number, path in places if is_counted(path, joined)), 0)

    def _fill_cloud(self, node: Tree, folder: Path) -> tuple[Any, list[Path]] | None:
        senders = self._receive(node, folder)
        below = {Path(edge.id).parent.name: [Path(device.id).parent.name for device in edge.children] for edge in node.children}
        num_dealt = tuple(sum(map(self.dealer.photographs.num_dealt, below[edge])) for edge in senders)
        inputs, kept_scene = [folder / "inbox"], folder / KEPT_SCENE
        shutil.rmtree(kept_scene.parent, ignore_errors=True)
        if self.before is not None and (scene_folder := self.before.scene_folder) is not None:
            deal_files(scene_folder, [SCENE_NAME], kept_scene.parent)
            inputs.append(kept_scene)
        another = self.number < choose_rounds(self.dealer.recipe)
        return (FinishTask(senders=senders, num_dealt=num_dealt, another_round=another), inputs) if senders else None

    def _receive(self, node: Tree, folder: Path) -> tuple[str, ...]:
        """Copy the refinements of a node's children that have one; the names of these."""
        for place in ("inbox", DELIVERIES):
            shutil.rmtree(folder / place, ignore_errors=True)
        senders = []
        for child in node.children:
            if self.is_done(child.id):
                senders.append(Path(child.id).parent.name)
                deal_files(self.dealer.run / child.id, [REFINED_NAME, ROWS_NAME], folder / "inbox" / senders[-1])
                deal_files(self.dealer.run / child.id, [RECORD_NAME, SIGNATURE_NAME], folder / DELIVERIES / senders[-1])
        return tuple(senders)
