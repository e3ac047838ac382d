"""Where a plan leaves what its profiles hold for: training, number of cameras, measured figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.numerics import check_array
from radiant_core.plan.profiles.curve_fit import EXTRAPOLATION
from radiant_core.plan.profiles.profile import Profile, ProfileKey
from radiant_core.plan.system import System

_MAX_NAMES = 4


def profile_warnings(system: System, quotas: ArrayLike, training: ProfileKey) -> tuple[str, ...]:
    """One sentence per profile and reason, for cameras per device `quotas` (D,) in the system's
    order; none for machines without cameras and curves that a system file spells out."""
    quotas = check_array("quotas", quotas, (len(system.devices),), np.int64)
    users: dict[str, tuple[Profile, list[tuple[str, int]]]] = {}
    joiners: dict[str, tuple[Profile, list[tuple[str, int]]]] = {}
    for device, quota in zip(system.devices, quotas.tolist(), strict=True):
        if device.profile is not None and quota:
            users.setdefault(device.profile.name, (device.profile, []))[1].append((device.id, quota))
    sizes = np.cumsum([0, *(len(edge.devices) for edge in system.edges)])
    for index, edge in enumerate(system.edges):
        edge_quotas = quotas[sizes[index] : sizes[index + 1]]
        if edge.profile is not None and edge_quotas.sum():
            joiners.setdefault(edge.profile.name, (edge.profile, []))[1].append((edge.id, int(edge_quotas.sum())))
    warnings = [sentence for profile, counts in users.values() for sentence in _of_devices(profile, counts, training)]
    return (*warnings, *(sentence for profile, counts in joiners.values() for sentence in _of_edges(profile, counts, training)))


def _of_devices(profile: Profile, counts: Sequence[tuple[str, int]], training: ProfileKey) -> list[str]:
    names = _list([name for name, _ in counts], "device")
    sentences = _far([(profile.name, curve.largest_count) for curve in profile.device_curves], counts, "device", "times and sizes")
    if profile.kind == "estimate":
        sentences.append(f"the times of {names} are estimates for {profile.machine}, never measured: run `radiant machine profile` there.")
    if profile.measured_steps is not None and profile.measured_steps < profile.key.num_steps / 2:
        sentences.append(
            f"the times of {names}, profile {profile.name!r}, were measured over {profile.measured_steps:,} steps and multiplied up to "
            f"{profile.key.num_steps:,}: give `radiant machine profile` more --time for better ones."
        )
    if not profile.key.matches_training(training):
        sentences.append(
            f"the curves of {names}, profile {profile.name!r}, are of {profile.key}, this plan is for {training}: its times were scaled "
            "from those of another training, run `radiant machine profile` with these settings."
        )
    return sentences


def _of_edges(profile: Profile, counts: Sequence[tuple[str, int]], training: ProfileKey) -> list[str]:
    curves = [curve for curve in (profile.aggregate_s, profile.aggregate_alone_s) if curve is not None]
    sentences = _far([(profile.name, curve.largest_count) for curve in curves], counts, "edge", "time of aggregation")
    if profile.key.aggregate_preset != training.aggregate_preset:
        sentences.append(
            f"the curves of {_list([name for name, _ in counts], 'edge')}, profile {profile.name!r}, are of aggregation preset "
            f"{profile.key.aggregate_preset}, this plan is for {training.aggregate_preset}: its time of aggregation is another."
        )
    return sentences


def _far(ranges: Sequence[tuple[str, int]], counts: Sequence[tuple[str, int]], kind: str, figures: str) -> list[str]:
    name, largest = min(ranges, key=lambda item: item[1])
    far = [(owner, count) for owner, count in counts if count > EXTRAPOLATION * largest]
    if not far:
        return []
    return [
        f"{_list([owner for owner, _ in far], kind)} would get up to {max(count for _, count in far)} photographs, profile {name!r} was "
        f"made with {largest} at most: the predicted {figures} are extrapolated."
    ]


def _list(names: Sequence[str], kind: str) -> str:
    names_text = ", ".join(names[:_MAX_NAMES]) + (f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else "")
    return f"{kind}{'s' * (len(names) > 1)} {names_text}"
