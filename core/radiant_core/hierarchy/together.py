"""How machines that train together begin: each prepares its photographs, one plans the start.

    photographs ── prepare_share ─→ ShareStart ┐                         on each device
                                               ├─ begin_group ─→ GroupStart     at the root
    photographs ── prepare_share ─→ ShareStart ┘
    GroupStart, photographs ── hold_share ─→ Holder                      on each device

A start has cameras and points, as a sparse model does, and no pixel. Colours of its points say by
how much one device's photographs are brighter than another's, so that all have one light. Steps
follow in `train/together`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from numpy.typing import NDArray

from radiant_core.cameras import Cameras, concatenate_cameras, number_cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput, StageFailed
from radiant_core.hierarchy.decisions import sky_decision
from radiant_core.hierarchy.device import choose_for_share
from radiant_core.hierarchy.groups import GroupTraining, Seat
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Machine, Reporter, fit_options
from radiant_core.light.canonical import canonical_views
from radiant_core.light.lights import Lights, in_canonical_light
from radiant_core.light.offsets import PointLogs, light_offsets, point_logs
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.splats import TENSORS, Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.extent import extent_decision, working_extent
from radiant_core.train.fill_in import AddedPoints
from radiant_core.train.initialize import initial_gaussians, room_to_fill, sky_rgb_of, sky_share
from radiant_core.train.memory import STATISTICS_BUDGET_BYTES, memory_plan
from radiant_core.train.needs import fit_to_cameras
from radiant_core.train.results import TrainState
from radiant_core.train.shapes import with_needle_width
from radiant_core.train.together.gradients import Layout
from radiant_core.train.together.masking import MaskKeys
from radiant_core.train.together.replica import Group, Replica, Share, require_shareable
from radiant_core.train.together.roles import Holder
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews
from radiant_core.train.worth import worth_training


@dataclass(frozen=True, kw_only=True, eq=False)
class ShareStart:
    """What a device says of its photographs before the first step."""

    cameras: Cameras
    """Of the photographs that are trained on, at the size of the training, under numbers."""
    points: FloatArray
    """(P,3) sparse points, then those filled in, m."""
    colors: NDArray[np.uint8]
    """(P,3)."""
    num_filled: int
    logs: PointLogs
    """Brightness of the sparse points in the device's light."""
    models_light: bool
    """Whether light differs among its photographs, so that they are in a light of their own."""
    sky_rgb: FloatArray
    """(3,) median colour above the horizon, NaN where nothing is."""
    most_splats: int | None
    """Gaussians that its memory holds; None: no limit."""
    public_key: bytes = b""
    """X25519, 32 bytes, of this start alone; empty where gradients are not masked."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedShare:
    """A device's photographs, ready but for the light that all share."""

    task: DeviceTask
    scene: SfmScene
    views: TrainingViews
    """As they were taken."""
    lights: Lights | None
    start: ShareStart
    options: FitOptions


@dataclass(frozen=True, kw_only=True, eq=False)
class GroupStart:
    """The training that all begin."""

    initial: Splats
    group: Group
    camera_centers: FloatArray
    """(C,3) of all photographs; it stays at the root."""
    offsets: Mapping[str, FloatArray]
    """Log brightness (3,) of each device's light above that of all; empty where they agree."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Begun:
    """Where a training stands that a device is to join."""

    group: Group
    state: TrainState
    offsets: Mapping[str, FloatArray] = field(default_factory=dict)
    """As of a `GroupStart`."""
    antialiased: bool = False
    public_keys: Mapping[str, bytes] = field(default_factory=dict)
    """Of the devices whose sum this one's gradients are part of, where they are masked."""

    @property
    def splats(self) -> Splats:
        """The model as it stands."""
        arrays = {name: self.state.arrays[f"splats.{name}"] for name in TENSORS}
        return Splats(**arrays, antialiased=self.antialiased)

    @property
    def step(self) -> int:
        """Steps that were taken."""
        return int(self.state.numbers["step"])

    @property
    def layout(self) -> Layout:
        """The columns of its gradients."""
        return Replica(self.splats, self.group, FitOptions()).layout


def prepare_share(task: DeviceTask, views: TrainingViews, reporter: Reporter, machine: Machine = Machine()) -> PreparedShare:
    """Leave out what adds nothing, model the light, fill in points: what `prepare_training` does
    before it settles the size of a model.

    Args:
        task: the scene and the settings of one device.
        views: the photographs of the scene's cameras, in their order, at the training size.
        reporter: hears decisions and warnings.
        machine: memory and clock.

    Returns:
        What the device keeps, and in `start` what it sends.
    """
    require_shareable(task.train)
    config, statistics_bytes, most = task.train, STATISTICS_BUDGET_BYTES, None
    if task.memory_bytes is not None:
        plan = memory_plan(config, views.cameras, int(task.memory_bytes), machine.base_bytes, masked=views.weights is not None)
        statistics_bytes, most = plan.statistics_bytes, plan.max_num_splats
    scene, views, decisions = worth_training(task.scene, views, config)
    _decide(reporter, decisions)
    lit, lights, decisions = canonical_views(scene, views, config.light)
    _decide(reporter, decisions)
    _, filled, decisions = choose_for_share(replace(task, train=config), scene, lit, reporter, machine, statistics_bytes)
    _decide(reporter, decisions)
    start = ShareStart(
        cameras=number_cameras(lit.cameras, reporter.stage),
        points=np.concatenate([scene.points, filled.points]),
        colors=np.concatenate([scene.colors, filled.colors]),
        num_filled=len(filled.points),
        logs=point_logs(scene, lit),
        models_light=lights is not None,
        sky_rgb=sky_rgb_of(lit),
        most_splats=most,
    )
    options = fit_options(task.backend, reporter, machine, lambda: "")
    return PreparedShare(
        task=task, scene=scene, views=views, lights=lights, start=start, options=replace(options, statistics_bytes=statistics_bytes)
    )


def begin_group(starts: Mapping[str, ShareStart], plan: GroupTraining, train: TrainConfig, reporter: Reporter) -> GroupStart:
    """The training of all devices that sent a start, in the order of the plan.

    Raises:
        StageFailed: no device sent one.
        BadInput: too few points.
    """
    names = [name for name in plan.of_devices if name in starts]
    if not names:
        raise StageFailed("no device has sent what a training could begin with: look at their messages above.")
    require_shareable(train)
    sent = [starts[name] for name in names]
    cameras = concatenate_cameras([number_cameras(share.cameras, name) for name, share in zip(names, sent, strict=True)])
    config = replace(train, num_steps=plan.num_steps, max_epochs=None, max_num_splats=_most_splats(train, sent), cross_validate="none")
    config, decisions = fit_to_cameras(with_needle_width(config, cameras), cameras)
    _decide(reporter, decisions)
    reporter.decide(sky_decision(reporter.stage, sky_share(cameras), wanted=config.sky))
    initial = _first_gaussians(sent, cameras, config)
    reporter.decide(replace(extent_decision(cameras, initial, config.max_extent_per_distance), stage=reporter.stage))
    offsets, decision = _offsets(names, sent, train, reporter.stage)
    reporter.decide(decision)
    if plan.masked:
        reporter.decide(masks_decision(plan, reporter.stage))
    group = Group(
        config=config,
        num_photographs=len(cameras),
        views_per_step=plan.views_per_step,
        extent=working_extent(cameras, initial, config.max_extent_per_distance),
        overlaps=plan.overlaps,
        form=plan.form,
        masked=plan.masked,
    )
    if plan.masked and Replica(initial, group, FitOptions()).layout.with_radii:
        raise BadInput("radii on screen do not travel under masks: set density.prune_radius_px to none, or leave out --mask-gradients.")
    return GroupStart(initial=initial, group=group, camera_centers=cameras.centers, offsets=offsets)


def masks_decision(plan: GroupTraining, stage: str) -> Decision:
    """What masks hide where the fewest devices are summed."""
    count = plan.fewest_masked
    hides = "either of two devices needs only the sum" if count == 2 else f"the edge would need the help of {count - 2} others"
    return Decision(
        stage=stage,
        topic="masks of gradients",
        choice="devices mask what they send to their edge",
        figure=count,
        unit="devices at the edge that sums the fewest",
        reason=f"asked for; to learn one device's gradient, {hides}",
    )


def hold_share(prepared: PreparedShare, device: str, start: GroupStart, seat: Seat, masks: MaskKeys | None = None) -> Holder:
    """The device as a member of the group from its first step on; `masks` of one that is masked."""
    share = _share(prepared, start.offsets.get(device), seat)
    return Holder(Replica(start.initial, start.group, prepared.options, share), start.group, masks)


def join_share(prepared: PreparedShare, device: str, begin: Begun, seat: Seat, private: X25519PrivateKey | None = None) -> Holder:
    """The device as a member of a group where it stands; `private` is of the key that its start
    brought, where the group is masked. BadInput where a key of another device is none."""
    replica = Replica(begin.splats, begin.group, prepared.options, _share(prepared, begin.offsets.get(device), seat))
    replica.restore(begin.state)
    masks = None if private is None else MaskKeys.agree(device, private, begin.public_keys, seat.parent)
    return Holder(replica, begin.group, masks)


def _share(prepared: PreparedShare, offset: FloatArray | None, seat: Seat) -> Share:
    return Share(views=shared_light(prepared, offset), num_views=seat.num_views, first=seat.first)


def shared_light(prepared: PreparedShare, offset: FloatArray | None) -> TrainingViews:
    """The photographs in the light of all devices: in one cast, so that they are rounded once."""
    lights = prepared.lights
    if lights is None and offset is None:
        return prepared.views
    if lights is None:
        lights = Lights.canonical(prepared.views.cameras)
    shift = np.zeros(3) if offset is None else np.asarray(offset)
    return in_canonical_light(prepared.views, replace(lights, log_gains=lights.log_gains + shift))


def _most_splats(train: TrainConfig, sent: Sequence[ShareStart]) -> int:
    """A model of all devices' photographs may have as many Gaussians as their own would have
    together, within the memory of each."""
    return min([train.max_num_splats * len(sent), *(share.most_splats for share in sent if share.most_splats is not None)])


def _first_gaussians(sent: Sequence[ShareStart], cameras: Cameras, config: TrainConfig) -> Splats:
    """Sparse points of all devices and the filled-in ones away from them."""
    sparse = [slice(0, len(share.points) - share.num_filled) for share in sent]
    filled = [slice(len(share.points) - share.num_filled, None) for share in sent]
    points = np.concatenate([share.points[part] for share, part in zip(sent, sparse, strict=True)])
    colors = np.concatenate([share.colors[part] for share, part in zip(sent, sparse, strict=True)])
    # Neighbours have points in common.
    points, first = np.unique(points, axis=0, return_index=True)
    fill = AddedPoints(
        points=np.concatenate([share.points[part] for share, part in zip(sent, filled, strict=True)]),
        colors=np.concatenate([share.colors[part] for share, part in zip(sent, filled, strict=True)]),
    ).thin(room_to_fill(config.max_num_splats, len(points)))
    sky_colors = np.array([share.sky_rgb for share in sent])
    weights = np.array([len(share.cameras) for share in sent], float)[:, None] * np.isfinite(sky_colors)
    sky = np.where(weights.sum(0) > 0, (np.nan_to_num(sky_colors) * weights).sum(0) / np.maximum(weights.sum(0), 1), np.nan)
    return initial_gaussians(points, colors[first], fill, cameras, config, sky)


def _offsets(names: Sequence[str], sent: Sequence[ShareStart], train: TrainConfig, stage: str) -> tuple[dict[str, FloatArray], Decision]:
    offsets = light_offsets([share.logs for share in sent])
    wanted = train.light != "none" and offsets.counts and (any(share.models_light for share in sent) or offsets.is_worth_modelling)
    decision = Decision(
        stage=stage,
        topic="light of the devices",
        choice="devices train in one light" if wanted else "devices train in the light of each",
        figure=100 * offsets.spread,
        unit="% by which devices differ in brightness at common places",
        reason=offsets.reason,
        changes_nothing=not wanted,
    )
    return (dict(zip(names, offsets.offsets, strict=True)) if wanted else {}), decision


def _decide(reporter: Reporter, decisions: Sequence[Decision]) -> None:
    for decision in decisions:
        reporter.decide(replace(decision, stage=reporter.stage))


def check_start(start: ShareStart, num_dealt: int) -> str | None:
    """Why what a device sent cannot begin a training, one sentence, or None."""
    if not 0 < len(start.cameras) <= num_dealt:
        return f"it sends {len(start.cameras):,} cameras, where {num_dealt:,} photographs were dealt to it."
    count = len(start.points)
    if start.points.shape != (count, 3) or start.colors.shape != (count, 3) or not 0 <= start.num_filled <= count:
        return "its points and colours do not fit each other."
    if not np.isfinite(start.points).all() or not np.isfinite(start.cameras.cam_from_world).all():
        return "its points or cameras are not finite."
    return None
