"""A system whose profiles were made for other trainings, at the costs of the one that is planned.

All that plan by profiles go through here first (`radiant plan`, `run`, `replan`), so that machines
are compared in one training: its pixels, and the Gaussians that the profile nearest to it has for
so many photographs. Steps follow in `predictions.with_step_law`. Once per plan.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.plan.profiles.profile import Profile, ProfileKey, same_size
from radiant_core.plan.profiles.step_law import curve_through
from radiant_core.plan.profiles.training_scale import StepTime, TrainingSize, splats_at, step_time
from radiant_core.plan.system import Cloud, Device, Edge, System
from radiant_core.splats import SH_BASES
from radiant_core.train.config import Preset, TrainConfig, train_preset


@dataclass(frozen=True, kw_only=True)
class ScaledSystem:
    """A system at the costs of one training, and what is to be said of it before its plan."""

    system: System
    note: str | None = None


def scaled_to_training(system: System, train: TrainConfig, preset: Preset, num_cameras: int) -> ScaledSystem:
    """The system for a plan of so many cameras, with curves of this training in place of those of
    profiles that were made at other pixels, or with other Gaussians than the nearest one."""
    profiles = _profiles_of(system)
    if not profiles or not num_cameras:
        return ScaledSystem(system=system)
    system = replace(system, training=_key_of(train, preset))
    nearest = min(profiles.values(), key=lambda profile: _distance(profile, train, preset))
    others = {profile.name: profile for profile in profiles.values() if _is_other(profile, nearest, train, num_cameras)}
    if not others:
        return ScaledSystem(system=system)
    splats_of = splats_at(nearest, _splat_bytes(nearest, train), train.long_side_px, train.max_num_splats)
    size = TrainingSize(long_side_px=train.long_side_px, splats_of=splats_of)
    laws = {name: step_time(profile, _splat_bytes(profile, train)) for name, profile in others.items()}
    scaling = _Scaling(size=size, laws=laws, bytes_of=lambda counts: 4 * _floats(train.sh_degree) * splats_of(counts), most=num_cameras)
    edges = tuple(scaling.edge(edge) for edge in system.edges)
    return ScaledSystem(system=replace(system, edges=edges, cloud=scaling.cloud(system.cloud)), note=_note(others, nearest, train, preset))


@dataclass(frozen=True, kw_only=True)
class _Scaling:
    size: TrainingSize
    laws: dict[str, StepTime]
    bytes_of: Callable[[FloatArray], FloatArray]
    most: int

    def _law(self, profile: Profile | None) -> StepTime | None:
        return None if profile is None else self.laws.get(profile.name)

    def device(self, device: Device) -> Device:
        profile, law = device.profile, self._law(device.profile)
        if profile is None or law is None:
            return device
        # 1 / relative_speed, and what an upload's format makes of the bytes.
        slower = float(device.train_s(1)) / float(profile.train_s.curve(1))
        smaller = float(device.model_bytes(1)) / float(profile.model_bytes.curve(1))
        steps = profile.key.num_steps
        return replace(
            device,
            train_s=curve_through(lambda counts: slower * steps * law.seconds(self.size, counts), self.most),
            model_bytes=curve_through(lambda counts: smaller * self.bytes_of(counts), self.most),
        )

    def edge(self, edge: Edge) -> Edge:
        scaled = replace(edge, devices=tuple(map(self.device, edge.devices)))
        share = self._share(edge.profile)
        if share is None:
            return scaled
        return replace(scaled, aggregate_s=curve_through(lambda counts: edge.aggregate_s(counts) * share(counts), self.most))

    def cloud(self, cloud: Cloud) -> Cloud:
        share, merge_s = self._share(cloud.profile), cloud.merge_s
        if share is None or merge_s is None:
            return cloud
        return replace(cloud, merge_s=curve_through(lambda counts: merge_s(counts) * share(counts), self.most))

    def _share(self, profile: Profile | None) -> Callable[[FloatArray], FloatArray] | None:
        """Of the time of a step as the profile has it, what one of this training takes: joining is
        made of such steps."""
        law = self._law(profile)
        if profile is None or law is None:
            return None
        return lambda counts: law.seconds(self.size, counts) * profile.key.num_steps / profile.train_s.curve(counts)


def _profiles_of(system: System) -> dict[str, Profile]:
    machines = (*system.devices, *system.edges, system.cloud)
    return {machine.profile.name: machine.profile for machine in machines if machine.profile is not None}


def _distance(profile: Profile, train: TrainConfig, preset: Preset) -> tuple[bool, float, bool, str]:
    """How far a profile's training is from this one: preset, size, measured or not."""
    ratio = abs(float(np.log(profile.key.long_side_px / train.long_side_px)))
    return profile.key.preset != preset, ratio, profile.kind != "measured", profile.name


def _is_other(profile: Profile, nearest: Profile, train: TrainConfig, num_cameras: int) -> bool:
    key, nearest_key = profile.key, nearest.key
    is_alike = key.preset == nearest_key.preset and same_size(key.long_side_px, nearest_key.long_side_px)
    # With a limit that the profile's training did not have it takes fewer Gaussians, and less time.
    splats = float(profile.model_bytes.curve(num_cameras)) / _splat_bytes(profile, train)
    limited = key.max_num_splats != train.max_num_splats and splats > train.max_num_splats
    return limited or not (is_alike and same_size(key.long_side_px, train.long_side_px))


def _splat_bytes(profile: Profile, train: TrainConfig) -> float:
    """Bytes of a Gaussian of a profile's training; of this one's where its preset is not known."""
    is_preset = profile.key.preset in ("draft", "default", "standard", "paper")
    return 4 * _floats(train_preset(profile.key.preset).sh_degree if is_preset else train.sh_degree)


def _floats(sh_degree: int) -> float:
    return 11.0 + 3 * SH_BASES[sh_degree]


def _key_of(train: TrainConfig, preset: Preset) -> ProfileKey:
    return ProfileKey(preset=preset, num_steps=train.num_steps, long_side_px=train.long_side_px, max_num_splats=train.max_num_splats)


def _note(others: dict[str, Profile], nearest: Profile, train: TrainConfig, preset: Preset) -> str:
    named = "; ".join(f"{name}: {profile.key}" for name, profile in sorted(others.items()))
    training = _key_of(train, preset)
    splats = "" if nearest.name in others and len(others) == 1 else f", with as many Gaussians as {nearest.name} has"
    return f"Times of profiles made for other trainings ({named}) are scaled by pixels, steps and Gaussians to {training}{splats}."
