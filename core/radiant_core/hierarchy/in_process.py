"""The whole hierarchy in one process: devices, edges and the cloud as plain calls, the oracle of
every executor. Once per scene.

What crosses between two nodes passes through the codec, so that the bits are those of a delivery.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from radiant_core.aggregate.averaging import Refinement, average_refinements, refine_scene
from radiant_core.frames import Sim3
from radiant_core.hierarchy.cloud import join_cloud
from radiant_core.hierarchy.device import train_device
from radiant_core.hierarchy.edge import join_edge
from radiant_core.hierarchy.messages import DeviceModel, DeviceTask, EdgeModel, SceneModel, device_task
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.refine import refine_device
from radiant_core.hierarchy.reporter import Machine, Recorder, Reporter
from radiant_core.io.messages import passed_on, passed_refinement
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.views import TrainingViews


@dataclass(frozen=True, kw_only=True, eq=False)
class InProcessRun:
    """The scene, and what each edge sent."""

    scene: SceneModel
    edges: Mapping[str, EdgeModel]


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
    edges: dict[str, EdgeModel] = {}
    sent: dict[str, EdgeModel | str] = {}
    num_dealt: dict[str, int] = {}
    joined: dict[str, Mapping[str, float | int]] = {}
    for plan in recipe.edge_plans:
        dealt = {device: len(rows) for device in plan.device_ids if len(rows := plan.cameras_of(device))}
        models = {}
        for device in dealt:
            rows = plan.cameras_of(device)
            task = device_task(recipe.device_settings(device), scene.restricted_to(rows))
            model = train(task, views.select(rows), reporter_of(f"devices/{device}"))
            models[device] = passed_on(model, recipe.upload)
        if not models:
            continue
        edge = join_edge(recipe.edge_task(plan.edge_id, dealt), models, reporter_of(f"edges/{plan.edge_id}"))
        edges[plan.edge_id] = edge
        if edge.splats is not None:
            sent[plan.edge_id] = passed_on(edge, recipe.upload)
            num_dealt[plan.edge_id], joined[plan.edge_id] = sum(dealt.values()), edge.summary
    scene_model = join_cloud(recipe.cloud_task(num_dealt, joined), sent, reporter_of("cloud"), machine)
    refined = _refine(recipe, scene_model, edges, views, reporter_of)
    return InProcessRun(scene=replace(scene_model, splats=refined), edges=edges)


def _refine(
    recipe: Recipe,
    joined: SceneModel,
    edges: Mapping[str, EdgeModel],
    views: TrainingViews,
    reporter_of: Callable[[str], Reporter],
) -> Splats | None:
    """The scene after the devices in it have refined it."""
    splats = joined.splats
    present = [devices_in(edges[edge].corrections) for edge in devices_in(joined.corrections)]
    if splats is None or not recipe.aggregate.refine_epochs or sum(map(len, present)) < 2:
        return splats
    by_edge: list[Refinement] = []
    for devices in present:
        own = []
        for device in devices:
            shown = views.select(recipe.cameras_of(device))
            refinement = refine_device(recipe.refine_task(device), splats, shown, reporter_of(f"devices/{device}/refine"))
            own.append(passed_refinement(refinement, recipe.upload, splats))
        mean = average_refinements([each for each in own if not isinstance(each, str)], splats)
        passed = passed_refinement(mean, recipe.upload, splats)
        by_edge += [] if isinstance(passed, str) else [passed]
    return refine_scene(splats, by_edge)


def devices_in(corrections: Mapping[str, Sim3 | None]) -> list[str]:
    """Those whose models were joined, in their order."""
    return [device for device, move in corrections.items() if move is not None]
