"""The whole hierarchy in one process: devices, edges and the cloud as plain calls, the oracle of every executor. Once per scene.

What crosses between two nodes passes through the codec, so that the bits are those of a delivery.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

from radiant_core.hierarchy.cloud import join_cloud
from radiant_core.hierarchy.device import train_device
from radiant_core.hierarchy.edge import join_edge
from radiant_core.hierarchy.messages import DeviceModel, DeviceSettings, DeviceTask, SceneModel
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.reporter import Machine, Recorder, Reporter
from radiant_core.io.messages import passed_on
from radiant_core.scene import SfmScene
from radiant_core.train.views import TrainingViews

Trainer = Callable[[DeviceTask, TrainingViews], DeviceModel]


def run_in_process(
    recipe: Recipe,
    scene: SfmScene,
    views: TrainingViews,
    reporter_of: Callable[[str], Reporter] = lambda stage: Recorder(stage=stage),
    machine: Machine = Machine(),
    train: Callable[[DeviceTask, TrainingViews, Reporter], DeviceModel] = train_device,
) -> SceneModel:
    """The scene that a run by this recipe makes of the planned cameras' scene and photographs.

    `train` may be replaced by a function that keeps models it has trained before.
    """
    edges = {}
    for plan in recipe.edge_plans:
        num_dealt = {device: len(plan.cameras_of(device)) for device in plan.device_ids if len(plan.cameras_of(device))}
        models = {}
        for device in num_dealt:
            rows = recipe.cameras_of(device)
            task = device_task(recipe.device_settings(device), scene.restricted_to(rows))
            model = train(task, views.select(rows), reporter_of(f"devices/{device}"))
            models[device] = passed_on(model, recipe.upload, recipe.train.long_side_px)
        if models:
            edges[plan.edge_id] = (
                join_edge(recipe.edge_task(plan.edge_id, num_dealt), models, reporter_of(f"edges/{plan.edge_id}")),
                sum(num_dealt.values()),
            )
    placed = {edge: model for edge, (model, _) in edges.items() if model.splats is not None}
    task = recipe.cloud_task({edge: edges[edge][1] for edge in placed}, {edge: model.summary for edge, model in placed.items()})
    sent = {edge: passed_on(model, recipe.upload, recipe.train.long_side_px) for edge, model in placed.items()}
    return join_cloud(task, sent, reporter_of("cloud"), machine)


def device_task(settings: DeviceSettings, scene: SfmScene) -> DeviceTask:
    """The task of a device with that scene."""
    return DeviceTask(scene=scene, **{field.name: getattr(settings, field.name) for field in fields(settings)})
