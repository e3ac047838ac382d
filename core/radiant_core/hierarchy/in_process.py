"""The whole hierarchy in one process: devices, edges and the cloud as plain calls, the oracle of
every executor. Once per scene.

What crosses between two nodes passes through the codec, so that the bits are those of a delivery.
Devices in a group of the recipe train one model: below the cloud it is the scene, below an edge
that edge's model, which is joined and refined as any other. The reporter of a group's root hears of
its training, and of nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.averaging import Refinement, admit_refinement, join_refinements, refine_scene, start_of_next_round
from radiant_core.aggregate.tree import refined_at
from radiant_core.choices import Version
from radiant_core.evaluate.shown_pixels import count_shown_photographs
from radiant_core.frames import Sim3
from radiant_core.hierarchy.choosing import Choice, choose_version, in_order
from radiant_core.hierarchy.cloud import join_cloud
from radiant_core.hierarchy.codec import passed_on, passed_refinement
from radiant_core.hierarchy.decisions import refinement_decision
from radiant_core.hierarchy.device import train_device
from radiant_core.hierarchy.edge import join_edge
from radiant_core.hierarchy.group_in_process import GroupRun, train_group
from radiant_core.hierarchy.group_models import edge_of_group, scene_of_group
from radiant_core.hierarchy.joining import UNMOVED
from radiant_core.hierarchy.messages import DeviceModel, DeviceTask, EdgeModel, SceneModel, device_task
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.refine import refine_device
from radiant_core.hierarchy.refining_plan import choose_rounds, plan_refining
from radiant_core.hierarchy.reporter import Machine, Recorder, Reporter
from radiant_core.plan.plans import EdgePlan
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.views import TrainingViews
from radiant_core.train.worth import worth_training


@dataclass(frozen=True, kw_only=True, eq=False)
class InProcessRun:
    """The scene, and what each edge sent."""

    scene: SceneModel
    edges: Mapping[str, EdgeModel]
    refinements: Mapping[str, Refinement]
    """What was sent while the scene was refined, by the id of the node."""
    joined: SceneModel
    """The scene before it was refined."""
    choice: Choice | None = None
    """Which version of the scene this is; None: not compared by photographs held out."""
    groups: Mapping[str, GroupRun] = field(default_factory=dict)
    """Trainings of several devices, by their root."""

    @property
    def versions(self) -> dict[Version, Splats]:
        """Of the scene, the one that is kept without a comparison first."""
        refined = self.scene.splats if any(len(refinement.rows) for refinement in self.refinements.values()) else None
        return in_order(refined, self.joined.splats, self.joined.cut, only_faded=self.joined.only_faded)


def run_in_process(
    recipe: Recipe,
    scene: SfmScene,
    views: TrainingViews,
    reporter_of: Callable[[str], Reporter] = lambda stage: Recorder(stage=stage),
    machine: Machine = Machine(),
    train: Callable[[DeviceTask, TrainingViews, Reporter], DeviceModel] = train_device,
) -> InProcessRun:
    """What a run by this recipe makes of the planned cameras' scene and photographs.

    `train` may be replaced by a function that keeps models it has trained before.
    """
    if (whole := recipe.groups.get("cloud")) is not None:
        return _scene_of_all(train_group(recipe, whole, scene, views, reporter_of))
    groups: dict[str, GroupRun] = {}
    edges: dict[str, EdgeModel] = {}
    sent: dict[str, EdgeModel | str] = {}
    num_dealt: dict[str, int] = {}
    joined: dict[str, Mapping[str, float | int]] = {}
    for plan in recipe.edge_plans:
        dealt = {device: len(rows) for device in plan.device_ids if len(rows := plan.cameras_of(device))}
        if not dealt:
            continue
        task, stage = recipe.edge_task(plan.edge_id, dealt), f"edges/{plan.edge_id}"
        if (group := recipe.groups.get(stage)) is not None:
            groups[stage] = trained = train_group(recipe, group, scene, views, reporter_of)
            edge = edge_of_group(task, trained.starts, trained.result)
        else:
            edge = join_edge(task, _device_models(recipe, plan, scene, views, reporter_of, train), reporter_of(stage))
        edges[plan.edge_id] = edge
        if edge.splats is not None:
            sent[plan.edge_id] = passed_on(edge, recipe.upload)
            num_dealt[plan.edge_id], joined[plan.edge_id] = sum(dealt.values()), edge.summary
    scene_model = join_cloud(recipe.cloud_task(num_dealt, joined), sent, reporter_of("cloud"), machine)
    joined_run = InProcessRun(scene=scene_model, edges=edges, refinements={}, joined=scene_model, groups=groups)
    return _refine(recipe, joined_run, scene, views, reporter_of)


def _device_models(
    recipe: Recipe,
    plan: EdgePlan,
    scene: SfmScene,
    views: TrainingViews,
    reporter_of: Callable[[str], Reporter],
    train: Callable[[DeviceTask, TrainingViews, Reporter], DeviceModel],
) -> dict[str, DeviceModel | str]:
    """Models of an edge's devices, each trained alone, as they arrive there."""
    models = {}
    for device in plan.device_ids:
        if len(rows := plan.cameras_of(device)):
            task = device_task(recipe.device_settings(device), scene.restricted_to(rows))
            model = train(task, views.select(rows), reporter_of(f"devices/{device}"))
            models[device] = passed_on(model, recipe.upload)
    return models


def _scene_of_all(trained: GroupRun) -> InProcessRun:
    """The run of devices that all trained one model: edges have none, and nothing is refined."""
    scene = scene_of_group(trained.plan, trained.starts, trained.result)
    edges = {edge: EdgeModel(splats=None, corrections=dict.fromkeys(devices, UNMOVED)) for edge, devices in trained.plan.views.items()}
    return InProcessRun(scene=scene, edges=edges, refinements={}, joined=scene, groups={trained.plan.root: trained})


def _refine(
    recipe: Recipe, joined: InProcessRun, scene: SfmScene, views: TrainingViews, reporter_of: Callable[[str], Reporter]
) -> InProcessRun:
    """The run after the devices in the scene have refined it."""
    splats = joined.scene.splats
    if splats is None:
        return joined
    present = {edge: devices_in(joined.edges[edge].corrections) for edge in devices_in(joined.scene.corrections)}
    if not (refining := plan_refining(recipe, present, len(splats)).devices):
        return _usual(joined)
    refiner = _Refiner(recipe=recipe, devices=refining, scene=scene, views=views, reporter_of=reporter_of)
    sent: dict[str, Refinement] = {}
    start, previous = splats, None
    for number in range(1, choose_rounds(recipe) + 1):
        splats, sent_now = refiner.refine(start, number, previous)
        start, previous = start_of_next_round(start, splats), splats
        sent |= sent_now
    return _usual(replace(joined, scene=replace(joined.scene, splats=splats), refinements=sent))


def _usual(run: InProcessRun) -> InProcessRun:
    """The run with the version of its scene that is kept without a comparison."""
    return replace(run, scene=replace(run.scene, splats=next(iter(run.versions.values()))))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Refiner:
    """Rounds of refining a scene."""

    recipe: Recipe
    devices: Mapping[str, Sequence[str]]
    """Edge → its devices that refine."""
    scene: SfmScene
    views: TrainingViews
    reporter_of: Callable[[str], Reporter]
    shown_shares: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """Device → what its photographs show of the scene, as its edge counted it."""

    def refine(self, splats: Splats, number: int, previous: Splats | None = None) -> tuple[Splats, dict[str, Refinement]]:
        """The scene after a round that starts from `splats`, and what nodes sent in it; `previous`:
        the scene that the round before made."""
        sent: dict[str, Refinement] = {}

        def send(node: str, refinement: Refinement) -> list[Refinement]:
            arrived = passed_refinement(refinement, self.recipe.upload, splats)
            return [] if isinstance(arrived, str) else [sent.setdefault(node, arrived)]

        by_edge: list[Refinement] = []
        for edge, devices in self.devices.items():
            arrived = [
                (device, refinement)
                for device in devices
                for refinement in send(refined_at(f"devices/{device}", number), self._refine_device(device, splats, number))
            ]
            node = refined_at(f"edges/{edge}", number)
            self.reporter_of(node)
            admitted = [admit_refinement(refinement, splats, self._shown_shares(device, splats)) for device, refinement in arrived]
            by_edge += [admit_refinement(refinement, splats) for refinement in send(node, join_refinements(admitted, splats))]
        reporter = self.reporter_of(refined_at("cloud", number))
        reporter.decide(refinement_decision(reporter.stage, [len(refinement.rows) for refinement in by_edge], splats))
        return refine_scene(splats, by_edge, previous), sent

    def _refine_device(self, device: str, splats: Splats, number: int) -> Refinement:
        rows, recipe = self.recipe.cameras_of(device), self.recipe
        _, views, _ = worth_training(self.scene.restricted_to(rows), self.views.select(rows), recipe.train)
        return refine_device(recipe.refine_task(device), splats, views, self.reporter_of(refined_at(f"devices/{device}", number)))

    def _shown_shares(self, device: str, splats: Splats) -> NDArray[np.float32]:
        """Counted in the first round in which the device sends anything."""
        if device not in self.shown_shares:
            cameras = self.scene.cameras.select(self.recipe.cameras_of(device)).scaled(self.recipe.train.long_side_px)
            self.shown_shares[device] = count_shown_photographs(splats, cameras, self.recipe.backend).astype(np.float32)
        return self.shown_shares[device]


def keep_best(run: InProcessRun, compare: Callable[[Splats], Sequence[float]], reporter: Reporter) -> InProcessRun:
    """The run with the version of its scene that is best by `compare`, which gives the PSNR of one
    in photographs that were in no training."""
    versions = run.versions
    choice = choose_version([*versions], [{name: compare(splats) for name, splats in versions.items()}])
    if choice is None:
        return run
    reporter.decide(choice.decision(reporter.stage))
    return replace(run, scene=replace(run.scene, splats=versions[choice.version]), choice=choice)


def devices_in(corrections: Mapping[str, Sim3 | None]) -> list[str]:
    """Those whose models were joined, in their order."""
    return [device for device, move in corrections.items() if move is not None]
