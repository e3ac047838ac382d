"""Inputs and warnings of a plan's predictions: the curves' training, and the limits by memory.

Once per plan. The limits come from the trainer's own model of memory (`train.memory`), which `plan`
must not import.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from radiant_app.files.system_file import even_system
from radiant_core.aggregate.config import CLOUD_EPOCHS, EDGE_EPOCHS, AggregateConfig, AggregatePreset
from radiant_core.decisions import Decision
from radiant_core.hierarchy.recipe import trainings_of
from radiant_core.hierarchy.refining_plan import refining_steps
from radiant_core.plan.counts.wide_deadline import system_capacity
from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.profile import ProfileKey
from radiant_core.plan.profiles.profile_warnings import profile_warnings
from radiant_core.plan.profiles.step_law import curve_through
from radiant_core.plan.system import Device, Edge, System
from radiant_core.plan.timeline.refining import RefiningLaw
from radiant_core.splats import SH_BASES
from radiant_core.train.config import Preset, TrainConfig, train_preset
from radiant_core.train.needs import Overrides, fit_to_backend, step_law_of

BESIDE_EPOCHS = 0.12
"""Of a join in all of its epochs, what it takes in none: 0.09 to 0.12 of the edges of four runs
(docs/experiments/planner.md, "Predicted against measured")."""
BESIDE_EPOCHS_AT_CLOUD = 0.06
"""The same at the cloud, which renders less beside: 0.06 to 0.07 of four runs
(docs/experiments/planner.md)."""
KNOWN_POSES_SHARE = 0.65
"""Of structure from motion that profiles measure, what points for given poses take: 10 to 18 of 17
to 23 s with 13 photographs of the town, in four runs (docs/experiments/planner.md)."""


def planned_training(preset: Preset, overrides: Overrides) -> TrainConfig:
    """The training of devices on a machine like this one; it reports its decisions itself."""
    from radiant_core.render.backends import resolve_backend

    return fit_to_backend(train_preset(preset), resolve_backend("auto"), overrides)[0]


def training_key_of(train: TrainConfig, preset: Preset, aggregate: AggregatePreset = "default") -> ProfileKey:
    """The key of profiles whose curves hold for this training."""
    return ProfileKey(
        preset=preset,
        num_steps=train.num_steps,
        long_side_px=train.long_side_px,
        max_num_splats=train.max_num_splats,
        aggregate_preset=aggregate,
    )


def with_step_law(system: System, train: TrainConfig, num_cameras: int) -> System:
    """The system for a plan of so many cameras whose devices train by their photographs, by
    `StepLaw`: profiles hold for a number of steps. Curves that a system file spells out stay."""
    law = step_law_of(train, num_cameras, len(system.devices)) if system.devices and num_cameras else None

    def by_photographs(device: Device) -> Device:
        if law is None or device.profile is None:
            return device
        return replace(device, train_s=law.cost(device.train_s, device.profile.key.num_steps, num_cameras))

    return replace(system, edges=tuple(replace(edge, devices=tuple(map(by_photographs, edge.devices))) for edge in system.edges))


def with_fixed_steps(system: System, train: TrainConfig) -> System:
    """The system whose devices take as many steps as this training has, whatever their photographs.
    Curves that a system file spells out stay."""

    def fixed(device: Device) -> Device:
        share = 1.0 if device.profile is None else train.num_steps / device.profile.key.num_steps
        return device if share == 1.0 else replace(device, train_s=device.train_s.scaled(share))

    return replace(system, edges=tuple(replace(edge, devices=tuple(map(fixed, edge.devices))) for edge in system.edges))


def joining_shares(train: TrainConfig, aggregate: AggregateConfig, num_photographs: int, num_devices: int) -> tuple[float, float]:
    """Of a join in `EDGE_EPOCHS` or `CLOUD_EPOCHS`, for which profiles hold, what one takes at the
    edges and at the cloud after such trainings."""
    if aggregate.edge.method == "paper" or not num_photographs or not num_devices:
        return 1.0, 1.0
    edge, cloud = aggregate.epochs_after(trainings_of(train, num_photographs, num_devices))
    return share_of_epochs(edge, EDGE_EPOCHS), share_of_epochs(cloud, CLOUD_EPOCHS, BESIDE_EPOCHS_AT_CLOUD)


def share_of_epochs(epochs: int, most: int, share_beside: float = BESIDE_EPOCHS) -> float:
    """Of a join in so many epochs at `most`, what one in fewer takes; `share_beside`: in none."""
    return 1 - (1 - share_beside) * (1 - epochs / most)


def with_short_joins(system: System, train: TrainConfig, num_cameras: int, aggregate: AggregateConfig) -> System:
    """The system whose edges and cloud join in as many epochs as after such trainings, where the
    costs of edges come from a profile."""
    at_edges, at_cloud = joining_shares(train, aggregate, num_cameras, len(system.devices))
    if at_edges == at_cloud == 1.0 or not any(edge.profile for edge in system.edges):
        return system

    def shorter(edge: Edge) -> Edge:
        if edge.profile is None or edge.aggregate_alone_s is None:
            return edge if edge.profile is None else replace(edge, aggregate_s=edge.aggregate_s.scaled(at_edges))
        joined, alone = edge.aggregate_s, edge.aggregate_alone_s
        # With one device an edge does all but the epochs.
        return replace(edge, aggregate_s=curve_through(lambda n: alone(n) + at_edges * np.maximum(joined(n) - alone(n), 0.0), num_cameras))

    merge_s = None if system.cloud.merge_s is None else system.cloud.merge_s.scaled(at_cloud)
    return replace(system, edges=tuple(map(shorter, system.edges)), cloud=replace(system.cloud, merge_s=merge_s))


def refining_law_of(
    train: TrainConfig, aggregate: AggregateConfig, num_photographs: int, num_devices: int, *, fixed: bool = False
) -> RefiningLaw:
    """How a scene of so many training photographs is refined after such trainings, of which each
    has as many steps where these are `fixed`. The devices are all of the system, as in
    `with_step_law`: a share counts beside its costs of training."""
    if not aggregate.refine.is_asked_for or not num_photographs or not num_devices:
        return RefiningLaw(num_rounds=0, share_of_training=lambda count: 0.0)
    law, trainings = step_law_of(train, num_photographs, num_devices), trainings_of(train, num_photographs, num_devices)
    epochs = aggregate.refine.epochs_after(trainings)

    def share_of(count: int) -> float:
        return refining_steps(epochs, count) / (train.num_steps if fixed else law.steps(count))

    return RefiningLaw(num_rounds=aggregate.refine.rounds_after(trainings), share_of_training=share_of)


def with_own_frames(system: System, num_cameras: int, *, known_poses: bool = False) -> System:
    """The system whose devices place their photographs themselves: G with their structure from
    motion, and what bringing models that GPS has placed into one frame takes the edges and the
    cloud, where profiles were measured with it."""
    share = KNOWN_POSES_SHARE if known_poses else 1.0

    def placing(device: Device) -> Device:
        sfm = None if device.profile is None else device.profile.sfm_s
        if device.profile is None or sfm is None:
            return device
        init_s, slower = device.init_s, share * _slowness(device)
        return replace(device, init_s=curve_through(lambda counts: init_s(counts) + slower * sfm.curve(counts), num_cameras))

    def bringing_together(edge: Edge) -> Edge:
        placed = replace(edge, devices=tuple(map(placing, edge.devices)))
        frames_s = None if known_poses or edge.profile is None else edge.profile.frames_s
        return placed if frames_s is None else replace(placed, aggregate_s=_with_frames(placed.aggregate_s, frames_s, len(placed.devices)))

    cloud, merge_s = system.cloud, system.cloud.merge_s
    frames_s = None if known_poses or cloud.profile is None else cloud.profile.frames_alone_s
    if merge_s is not None and frames_s is not None:
        cloud = replace(cloud, merge_s=_with_frames(merge_s, frames_s, len(system.edges)))
    return replace(system, edges=tuple(map(bringing_together, system.edges)), cloud=cloud)


def _with_frames(join_s: CostCurve, frames_s: float, num_models: int) -> CostCurve:
    """The cost of a join that brings each model but the first into the others' frame."""
    return replace(join_s, constant=join_s.constant + frames_s * max(num_models - 1, 0))


def predicts_frames(system: System) -> bool:
    """Whether profiles of edges and the cloud say what it takes to bring models into one frame,
    where these have a profile and several models to join."""
    cloud = system.cloud.profile
    at_cloud = cloud is None or cloud.frames_alone_s is not None or len(system.edges) < 2
    return at_cloud and all(edge.profile is None or edge.profile.frames_s is not None or len(edge.devices) < 2 for edge in system.edges)


def _slowness(device: Device) -> float:
    """How many times as long as its profile's machine a device takes (1 / relative_speed)."""
    assert device.profile is not None
    profile_s = float(device.profile.init_s.curve(1))
    return float(device.init_s(1)) / profile_s if profile_s else 1.0


def depends_on_training(system: System) -> bool:
    """Whether a plan depends on the training: by profiles, or memory without a count of cameras."""
    machines: Sequence[Device | Edge] = (*system.devices, *system.edges)
    return any(machine.profile is not None for machine in machines) or any(map(_is_limited_by_memory, system.devices))


def with_camera_limits(
    system: System, train: TrainConfig, num_cameras: int, model_factor: float = 1.0
) -> tuple[System, Decision | None, tuple[str, ...]]:
    """The system with `max_cameras` where a device gives memory alone, the decision, and warnings.

    A device holds as many photographs as fit with the Gaussians that its curve H has for them;
    `model_factor`: what H was multiplied by for uploads. Where all together hold too few of the
    `num_cameras`, devices will train with fewer Gaussians, and only photographs are a limit.
    """
    limited = [device for device in system.devices if _is_limited_by_memory(device)]
    if not limited:
        return system, None, ()
    splat_bytes = 4 * (11 + 3 * SH_BASES[train.sh_degree]) * model_factor

    def limits(share: float) -> dict[str, int]:
        from radiant_core.train.memory import most_cameras

        def capacity_of(device: Device) -> int:
            def splats_of(count: int) -> float:
                return share * float(device.model_bytes(count)) / splat_bytes

            assert device.memory_bytes is not None
            return most_cameras(train, device.memory_bytes, splats_of, num_cameras)

        return {device.id: capacity_of(device) for device in limited}

    def limit_to(limit_of: dict[str, int]) -> System:
        edges = (
            replace(e, devices=tuple(replace(d, max_cameras=limit_of.get(d.id, d.max_cameras)) for d in e.devices)) for e in system.edges
        )
        return replace(system, edges=tuple(edges))

    limit_of, warnings = limits(1.0), ()
    capacity = system_capacity(limit_to(limit_of), num_cameras)
    if capacity < num_cameras:
        warnings = (
            f"memory holds {capacity} of {num_cameras} photographs with all the Gaussians they call for: devices will train with fewer; "
            "give more memory_gb, or add devices.",
        )
        limit_of = limits(0.0)
    least = min(limited, key=lambda device: limit_of[device.id])
    assert least.memory_bytes is not None
    decision = Decision(
        stage="plan",
        topic="memory",
        choice=f"{len(limited)} devices hold {limit_of[least.id]:,} photographs or more, {least.id} the fewest",
        figure=least.memory_bytes / 1e9,
        unit=f"GB at {least.id}",
        reason="photographs, Gaussians, one step and the libraries must fit; max_cameras in the system file sets the count itself",
    )
    return limit_to(limit_of), decision, warnings


def prediction_warnings(system: System, edge_plans: Sequence[EdgePlan], training: ProfileKey) -> tuple[str, ...]:
    """See `profile_warnings`, for a plan of the system; and devices whose costs are nobody's beside
    such of known machines."""
    quotas = {name: len(plan.cameras_of(name)) for plan in edge_plans for name in plan.device_ids}
    warnings = profile_warnings(system, [quotas[device.id] for device in system.devices], training)
    default = even_system(1, 1).devices[0]
    costs = (default.init_s, default.train_s)
    guessed = [device.id for device in system.devices if device.origin is None and (device.init_s, device.train_s) == costs]
    if not guessed or len(guessed) == len(system.devices):
        return warnings
    names = f"device{'s' * (len(guessed) > 1)} {', '.join(guessed)}"
    warning = f"the costs of {names} are a system file's defaults and no machine's, beside those of others: give a profile or costs there."
    return (*warnings, warning)


def _is_limited_by_memory(device: Device) -> bool:
    return device.memory_bytes is not None and device.max_cameras is None
