"""What a run of so many photographs will take on this machine, by curves of `radiant machine
profile`.

A run without options is one device's, whose model nobody joins or refines:

    sfm(N) + G(N) + F(N) + F_m(N) of one device

Where memory does not hold a training of all N photographs, it is that of D devices on E edges, W
processes at a time (`run.this_machine`), and takes, in seconds,

    sfm(N) + ⌈D / W⌉ (G + F) + ⌈E / W⌉ F_m(N/E) + merge(N)
    + rounds (⌈D / W⌉ r + G / 2) + (rounds + 1) / 2 · ⌈E / W⌉ G

with G and F of N/D photographs and r what `plan.timeline.refining` says of a device's round.

A training other than that of the curves takes them times the share of its steps, pixels and
Gaussians (`training_factor`). Scoring and the report come on top. Once per call.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radiant_app.config.run_config import ExecutionOptions
from radiant_app.files.profile_file import load_profile
from radiant_app.run.predictions import joining_shares, planned_training, refining_law_of, training_key_of
from radiant_app.run.this_machine import Division, divided
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.plan.profiles.curve_fit import FittedCurve
from radiant_core.plan.profiles.profile import Profile
from radiant_core.plan.profiles.training_scale import TrainingSize, splats_at, step_time
from radiant_core.plan.timeline.refining import AT_CLOUD, AT_EDGE, AT_EDGE_LATER, predict_round
from radiant_core.splats import SH_BASES
from radiant_core.train.config import TrainConfig
from radiant_core.train.memory import training_memory
from radiant_core.train.needs import Overrides

FAR = 2.0
"""A curve is extrapolated beyond so many times the photographs it was measured with."""
Stage = tuple[str, float | None, bool]
"""Its name, its seconds (None: no curve) and whether they are extrapolated."""


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """The time and the memory of a run on one machine."""

    num_photographs: int
    parts_s: dict[str, float]
    """Seconds by stage, in order."""
    unknown: tuple[str, ...]
    """Stages without a curve."""
    extrapolated: tuple[str, ...]
    """Stages whose curves were measured with far fewer photographs."""
    machine: str
    key: str
    """The training that the times hold for."""
    shortage: str | None = None
    """What to do where memory holds no training, however photographs are divided; None: it does."""
    division: Division

    @property
    def text(self) -> str:
        """The forecast in one line."""
        parts = ", ".join(f"{stage} {duration_text(seconds)}" for stage, seconds in self.parts_s.items())
        doubts = [f"unknown: {', '.join(self.unknown)}"] if self.unknown else []
        doubts += [f"extrapolated: {', '.join(self.extrapolated)}"] if self.extrapolated else []
        doubts += ["scoring comes on top"]
        total = duration_text(sum(self.parts_s.values()))
        return f"about {total} ({parts}; {'; '.join(doubts)}); {self.key}; by the curves of {self.machine}"


def forecast(num_photographs: int, profile: Path, free_bytes: int, training: TrainConfig | None = None) -> Forecast:
    """Predict a run on this machine from a curve file; BadInput for a file that is none.

    Args:
        num_photographs: those of the source.
        profile: the curve file.
        free_bytes: memory of this machine.
        training: that of the run; None: of a run without options, for which the curves hold.
    """
    curves = load_profile(profile)
    train = training or planned_training("default", Overrides())
    # Every eighth is held out of training.
    num_trained = num_photographs - math.ceil(num_photographs / 8)
    division = divided(lambda count: training_memory(train, count), num_trained, free_bytes)
    alone = division.num_devices == 1
    per_device = math.ceil(num_photographs / division.num_devices)
    factor = 1.0 if training is None else training_factor(curves, train, per_device)
    stages = list(_stages_of_one(curves, num_photographs, factor) if alone else _stages(curves, train, num_photographs, division, factor))
    return Forecast(
        num_photographs=num_photographs,
        parts_s={stage: seconds for stage, seconds, _ in stages if seconds is not None},
        unknown=tuple(stage for stage, seconds, _ in stages if seconds is None),
        extrapolated=tuple(stage for stage, _, far in stages if far),
        machine=curves.machine,
        key=str(curves.key if training is None else training_key_of(train, "default")),
        shortage=division.warning,
        division=division,
    )


def training_factor(curves: Profile, train: TrainConfig, num_photographs: int) -> float:
    """How many times the seconds of the curves' training one of other steps, pixels and Gaussians
    takes with so many photographs, by the law of a step that the curves follow."""
    splat_bytes = 4 * (11 + 3 * SH_BASES[train.sh_degree])
    law, counts = step_time(curves, splat_bytes), np.array([max(num_photographs, 1)], np.float64)

    def seconds(num_steps: int, long_side_px: int, max_num_splats: int | None) -> float:
        size = TrainingSize(long_side_px=long_side_px, splats_of=splats_at(curves, splat_bytes, long_side_px, max_num_splats))
        return num_steps * float(law.seconds(size, counts)[0])

    key = curves.key
    measured_s = seconds(key.num_steps, key.long_side_px, key.max_num_splats)
    return seconds(train.num_steps, train.long_side_px, train.max_num_splats) / measured_s


def _stages(curves: Profile, train: TrainConfig, num_photographs: int, division: Division, factor: float) -> Iterator[Stage]:
    num_devices, num_edges = division.num_devices, len(division.system.edges)
    workers = min(num_devices, division.at_once, ExecutionOptions().num_workers)
    per_device, per_edge = (math.ceil(num_photographs / parts) for parts in (num_devices, num_edges))
    at_edges, at_cloud = joining_shares(train, AggregateConfig(), num_photographs, num_devices)
    share_of = {"edges": at_edges, "cloud": at_cloud}
    waves_of = {"devices": math.ceil(num_devices / workers), "edges": math.ceil(num_edges / workers)}
    yield _stage("structure from motion", (curves.sfm_s,), num_photographs)
    yield _training_stage("devices", curves, per_device, factor, waves_of["devices"])
    for stage, fits, count in (("edges", (curves.aggregate_s,), per_edge), ("cloud", (curves.merge_s,), num_photographs)):
        yield _stage(stage, fits, count, share_of[stage] * waves_of.get(stage, 1))
    law = refining_law_of(train, AggregateConfig(), num_photographs, num_devices)
    beside_s, trained_s = (float(fit.curve(per_device)) for fit in (curves.init_s, curves.train_s))
    device_s = predict_round(law, beside_s=beside_s, train_s=factor * trained_s, num_photographs=per_device)
    at_edges = waves_of["edges"] * (AT_EDGE + (law.num_rounds - 1) * AT_EDGE_LATER)
    beside_rounds = at_edges + law.num_rounds * AT_CLOUD
    yield "refining", law.num_rounds * waves_of["devices"] * device_s + beside_rounds * beside_s, False


def _stages_of_one(curves: Profile, num_photographs: int, factor: float) -> Iterator[Stage]:
    yield _stage("structure from motion", (curves.sfm_s,), num_photographs)
    yield _training_stage("device", curves, num_photographs, factor)
    yield _stage("edge", (curves.aggregate_alone_s,), num_photographs)


def _training_stage(name: str, curves: Profile, count: int, factor: float, waves: int = 1) -> Stage:
    seconds = float(curves.init_s.curve(count)) + factor * float(curves.train_s.curve(count))
    return name, waves * seconds, any(count > FAR * fit.largest_count for fit in (curves.init_s, curves.train_s))


def _stage(name: str, fits: Sequence[FittedCurve | None], count: int, factor: float = 1.0) -> Stage:
    known_fits = [fit for fit in fits if fit is not None]
    if len(known_fits) < len(fits):
        return name, None, False
    return name, factor * sum(float(fit.curve(count)) for fit in known_fits), any(count > FAR * fit.largest_count for fit in known_fits)


def duration_text(seconds: float) -> str:
    """Seconds for a person: 40 s, 12 min, 3.5 h."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
