"""`Recipe`: what a run has decided before its first node starts, and the task of every node that
follows from it. Once per run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.config import AggregateConfig, Trainings
from radiant_core.choices import StepPolicy
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.hierarchy.messages import CloudTask, DeviceSettings, EdgeTask, RefineTask, Renderer, Training
from radiant_core.io.transport.upload import UploadFormat
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.profiles.step_law import StepLaw
from radiant_core.plan.system import System
from radiant_core.plan.together.groups import GroupPlan
from radiant_core.train.config import CHECKPOINT_EVERY_S, TrainConfig
from radiant_core.train.needs import step_law_of


def devices_with_photographs(edge_plans: Sequence[EdgePlan]) -> int:
    """The number of devices that have photographs in a plan."""
    return sum(len(plan.cameras_of(device)) > 0 for plan in edge_plans for device in plan.device_ids)


def training_among(num_devices: int, train: TrainConfig) -> TrainConfig:
    """The training of one of so many devices whose models are joined: what is for models that stand
    alone is off."""
    if num_devices < 2:
        return train
    # What a device lacks photographs of its neighbours know (docs/experiments/training.md).
    drop_gaussians = "none" if train.drop_gaussians == "auto" else train.drop_gaussians
    return replace(train, drop_gaussians=drop_gaussians, cross_validate="none")


def trainings_of(train: TrainConfig, num_photographs: int, num_devices: int) -> Trainings:
    """How long devices train that share so many photographs; without any, as long as may be."""
    if not num_photographs:
        return Trainings(num_devices=num_devices, photograph_shows=float("inf"), num_steps=float("inf"))
    law = step_law_of(train, num_photographs, num_devices)
    return Trainings(num_devices=num_devices, photograph_shows=law.per_photograph, num_steps=law.num_steps)


@dataclass(frozen=True, kw_only=True, eq=False)
class Recipe:
    """The plan of a run and its settings."""

    system: System
    cloud_plan: CloudPlan
    edge_plans: tuple[EdgePlan, ...]
    train: TrainConfig
    aggregate: AggregateConfig
    backend: Renderer
    upload: UploadFormat = "float32"
    checkpoint_every_s: float = CHECKPOINT_EVERY_S
    num_devices: int | None = None
    """Devices that share the steps, whatever becomes of them; None: those that have photographs."""
    step_policy: StepPolicy = "per_photograph"
    num_photographs: int | None = None
    """Planned ones of the whole run, where the plans are those of some edges alone."""
    groups: Mapping[str, GroupTraining] = field(default_factory=dict)
    """Root → who trains as one model below it; others train alone and are joined."""

    def with_plan(self, cloud_plan: CloudPlan, edge_plans: tuple[EdgePlan, ...]) -> Recipe:
        """The same settings, and steps per photograph, by another plan."""
        num_devices = self.num_devices or devices_with_photographs(self.edge_plans)
        return replace(self, cloud_plan=cloud_plan, edge_plans=edge_plans, num_devices=num_devices)

    def plan_of(self, device: str) -> EdgePlan:
        """The plan of the edge that a device belongs to."""
        return next(plan for plan in self.edge_plans if device in plan.device_ids)

    def cameras_of(self, device: str) -> NDArray[np.int64]:
        """Rows of the planned cameras that a device trains on."""
        return self.plan_of(device).cameras_of(device)

    @property
    def trainings(self) -> Trainings:
        """How long devices train, in the mean."""
        return trainings_of(self.train, self._total_photographs, self._total_devices)

    @property
    def joining(self) -> AggregateConfig:
        """How tiers join models after such trainings."""
        return self.aggregate.joining_after(self.trainings)

    @property
    def common(self) -> dict[str, Any]:
        """What the tasks of all nodes have in common, see `Training`."""
        return {name: getattr(self, name) for name in (item.name for item in fields(Training))}

    @property
    def refining_epochs(self) -> int:
        """How often a device shows each of its photographs to the scene in a round."""
        return self.aggregate.refine.epochs_after(self.trainings)

    @property
    def _total_devices(self) -> int:
        return self.num_devices or devices_with_photographs(self.edge_plans)

    @property
    def _total_photographs(self) -> int:
        return self.num_photographs or sum(len(plan.camera_indices) for plan in self.edge_plans)

    @property
    def step_law(self) -> StepLaw | None:
        """The steps of devices by their photographs; None: all take those of `train`."""
        if self.step_policy == "fixed" or not self._total_photographs:
            return None
        return step_law_of(self.train, self._total_photographs, self._total_devices)

    def training_of(self, device: str) -> TrainConfig:
        """The training of a device, as long as its photographs ask for."""
        train = training_among(self._total_devices, self.train)
        if (law := self.step_law) is None:
            return train
        return replace(train, num_steps=law.steps(len(self.cameras_of(device))), max_epochs=None)

    def device_settings(self, device: str) -> DeviceSettings:
        """How a device trains."""
        return DeviceSettings(
            **{**self.common, "train": self.training_of(device)},
            upload=self.upload,
            memory_bytes=next(spec.memory_bytes for spec in self.system.devices if spec.id == device),
            seat=None if (group := self.group_of(device)) is None else group.seat_of(device),
        )

    def with_groups(self, plans: Sequence[GroupPlan], *, masked: bool = False) -> Recipe:
        """The same settings, with machines that train together as planned: they show as many views
        as if each trained alone. BadInput where gradients are to be `masked` and cannot be."""
        groups = {}
        for plan in plans:
            below = [edge for edge in self.edge_plans if edge.edge_id in plan.edges]
            views = {
                edge.edge_id: {name: plan.views[name] for name in edge.device_ids if name in plan.views and len(edge.cameras_of(name))}
                for edge in below
            }
            views = {edge: devices for edge, devices in views.items() if devices}
            num_steps = sum(self.training_of(device).num_steps for devices in views.values() for device in devices)
            root = "cloud" if plan.level == "cloud" else f"edges/{plan.edges[0]}"
            groups[root] = GroupTraining(root=root, views=views, num_steps=num_steps, overlaps=plan.overlaps, masked=masked)
        return replace(self, groups=groups)

    def group_of(self, device: str) -> GroupTraining | None:
        """The group that a device trains in; None: it trains alone."""
        return next((group for group in self.groups.values() if device in group.of_devices), None)

    def refine_task(self, device: str) -> RefineTask:
        """Fit the joined scene to a device's photographs."""
        return RefineTask(
            **self.common,
            epochs=self.refining_epochs,
            max_num_steps=self.aggregate.refine.max_num_steps,
            upload=self.upload,
            memory_bytes=next(spec.memory_bytes for spec in self.system.devices if spec.id == device),
        )

    def edge_task(self, edge: str, num_dealt: Mapping[str, int]) -> EdgeTask:
        """Join the models of the devices that delivered one; `num_dealt`: photographs of each."""
        plan = next(plan for plan in self.edge_plans if plan.edge_id == edge)
        strips = [plan.strips[plan.device_ids.index(device)].tolist() for device in num_dealt]
        return EdgeTask(
            devices=tuple(num_dealt),
            num_dealt=tuple(num_dealt.values()),
            strips=tuple(tuple((float(x), float(y)) for x, y in strip) for strip in strips),
            **self.common,
            join=self.joining.edge,
            draws_cameras=self.aggregate.cloud.method != "crop_merge",
            upload=self.upload,
            memory_bytes=next(spec.memory_bytes for spec in self.system.edges if spec.id == edge),
            group=next((group.of_edge(edge) for group in self.groups.values() if edge in group.views), None),
        )

    def cloud_task(self, num_dealt: Mapping[str, int], joined: Mapping[str, Mapping[str, float | int]]) -> CloudTask:
        """Join the models of the edges that delivered one.

        Args:
            num_dealt: photographs dealt below each edge.
            joined: summary of each edge's join, whose seconds count where the cloud's time is
                limited.
        """
        rows = [self.cloud_plan.edge_ids.index(edge) for edge in num_dealt]
        retrains, limits = self.aggregate.cloud.method != "crop_merge", self.system.cloud
        # Measured times differ from run to run: they are dealt only where they decide.
        timed = retrains and limits.time_s is not None and "cloud" not in self.groups
        return CloudTask(
            edges=tuple(num_dealt),
            num_dealt=tuple(num_dealt.values()),
            sites=tuple((float(x), float(y)) for x, y in self.cloud_plan.sites[rows]),
            weights=tuple(float(weight) for weight in self.cloud_plan.weights[rows]),
            **self.common,
            join=self.joining.cloud,
            limits=limits if retrains else None,
            edge_times_s=tuple(self._join_s(edge, joined[edge]) for edge in num_dealt) if timed else None,
            group=(group := self.groups.get("cloud")),
            of_devices=None if group is None else tuple(len(self.cameras_of(device)) for device in group.of_devices),
        )

    def _join_s(self, edge: str, summary: Mapping[str, float | int]) -> float:
        """Seconds that the edge's retraining would take in the cloud's epochs; by its cost curve
        where it did none or its devices trained one model."""
        if summary["num_steps"] and f"edges/{edge}" not in self.groups:
            at_edge, at_cloud = self.aggregate.epochs_after(self.trainings)
            return float(summary["train_s"]) * at_cloud / at_edge
        row = self.cloud_plan.edge_ids.index(edge)
        return float(self.system.edges[row].aggregate_s(int(self.cloud_plan.counts[row])))
