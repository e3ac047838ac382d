"""The whole hierarchy in one process: devices, edges and the cloud as plain calls, the oracle of
every executor. Once per scene.

What crosses between two nodes passes through the codec, so that the bits are those of a delivery.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from radiant_core.hierarchy.cloud import join_cloud
from radiant_core.hierarchy.device import train_device
from radiant_core.hierarchy.edge import join_edge
from radiant_core.hierarchy.messages import DeviceModel, DeviceTask, EdgeModel, SceneModel, device_task
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.reporter import Machine, Recorder, Reporter
from radiant_core.io.messages import passed_on
from radiant_core.scene import SfmScene
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
    joined_scene = join_cloud(recipe.cloud_task(num_dealt, joined), sent, reporter_of("cloud"), machine)
    return InProcessRun(scene=joined_scene, edges=edges)
