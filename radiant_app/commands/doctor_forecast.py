"""What a run of so many photographs will take on this machine, by curves of `radiant profile`.

A run without options: two edges with two devices each, `num_workers` processes at a time.

    sfm(N) + ⌈4 / W⌉ (G + F) + ⌈2 / W⌉ F_m(N/2) + merge(N)
    + rounds (⌈4 / W⌉ r + G / 2) + (rounds + 1) / 2 · ⌈2 / W⌉ G

seconds, with W workers, G and F of N/4 photographs and r what `plan.timeline.refining` says of a
device's round. Few photographs are one device's, whose model nobody joins or refines:

    sfm(N) + G(N) + F(N) + F_m(N) of one device

Scoring and the report come on top. Once per call.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from radiant_app.config.run_config import ExecutionOptions
from radiant_app.files.profile_file import load_profile
from radiant_app.run.few_photographs import num_devices_worth
from radiant_app.run.predictions import joining_shares, planned_training, refining_law_of
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.plan.profiles.curve_fit import FittedCurve
from radiant_core.plan.profiles.profile import Profile
from radiant_core.plan.timeline.refining import AT_CLOUD, AT_EDGE, AT_EDGE_LATER, predict_round
from radiant_core.train.config import TrainConfig
from radiant_core.train.memory import most_cameras
from radiant_core.train.needs import Overrides

NUM_DEVICES, NUM_EDGES = 4, 2
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
    most_photographs: int | None = None
    """The most photographs of a device that memory holds; None where all fit."""

    @property
    def text(self) -> str:
        """The forecast in one line."""
        parts = ", ".join(f"{stage} {duration_text(seconds)}" for stage, seconds in self.parts_s.items())
        doubts = [f"unknown: {', '.join(self.unknown)}"] if self.unknown else []
        doubts += [f"extrapolated: {', '.join(self.extrapolated)}"] if self.extrapolated else []
        doubts += ["scoring comes on top"]
        total = duration_text(sum(self.parts_s.values()))
        return f"about {total} ({parts}; {'; '.join(doubts)}); {self.key}; by the curves of {self.machine}"


def forecast(num_photographs: int, profile: Path, free_bytes: int) -> Forecast:
    """Predict a run without options from a curve file; BadInput for a file that is none."""
    curves = load_profile(profile)
    workers = min(NUM_DEVICES, ExecutionOptions().num_workers)
    train = planned_training("default", Overrides())
    # Every eighth is held out of training.
    if alone := num_devices_worth(num_photographs - math.ceil(num_photographs / 8), NUM_DEVICES) == 1:
        stages = list(_stages_of_one(curves, num_photographs))
    else:
        stages = list(_stages(curves, train, num_photographs, workers))
    each = num_photographs if alone else math.ceil(num_photographs / NUM_DEVICES)
    most = most_cameras(train, free_bytes / (1 if alone else workers), lambda count: float(train.max_num_splats), each)
    return Forecast(
        num_photographs=num_photographs,
        parts_s={stage: seconds for stage, seconds, _ in stages if seconds is not None},
        unknown=tuple(stage for stage, seconds, _ in stages if seconds is None),
        extrapolated=tuple(stage for stage, _, far in stages if far),
        machine=curves.machine,
        key=str(curves.key),
        most_photographs=most if most < each else None,
    )


def _stages(curves: Profile, train: TrainConfig, num_photographs: int, workers: int) -> Iterator[Stage]:
    per_device, per_edge = (math.ceil(num_photographs / parts) for parts in (NUM_DEVICES, NUM_EDGES))
    at_edges, at_cloud = joining_shares(train, AggregateConfig(), num_photographs, NUM_DEVICES)
    share_of = {"edges": at_edges, "cloud": at_cloud}
    waves_of = {"devices": math.ceil(NUM_DEVICES / workers), "edges": math.ceil(NUM_EDGES / workers)}
    for stage, fits, count in (
        ("structure from motion", (curves.sfm_s,), num_photographs),
        ("devices", (curves.init_s, curves.train_s), per_device),
        ("edges", (curves.aggregate_s,), per_edge),
        ("cloud", (curves.merge_s,), num_photographs),
    ):
        yield _stage(stage, fits, count, share_of.get(stage, 1.0) * waves_of.get(stage, 1))
    law = refining_law_of(train, AggregateConfig(), num_photographs, NUM_DEVICES)
    beside_s, trained_s = (float(fit.curve(per_device)) for fit in (curves.init_s, curves.train_s))
    device_s = predict_round(law, beside_s=beside_s, train_s=trained_s, num_photographs=per_device)
    at_edges = waves_of["edges"] * (AT_EDGE + (law.num_rounds - 1) * AT_EDGE_LATER)
    beside_rounds = at_edges + law.num_rounds * AT_CLOUD
    yield "refining", law.num_rounds * waves_of["devices"] * device_s + beside_rounds * beside_s, False


def _stages_of_one(curves: Profile, num_photographs: int) -> Iterator[Stage]:
    yield _stage("structure from motion", (curves.sfm_s,), num_photographs)
    yield _stage("device", (curves.init_s, curves.train_s), num_photographs)
    yield _stage("edge", (curves.aggregate_alone_s,), num_photographs)


def _stage(name: str, fits: Sequence[FittedCurve | None], count: int, factor: float = 1.0) -> Stage:
    known = [fit for fit in fits if fit is not None]
    if len(known) < len(fits):
        return name, None, False
    return name, factor * sum(float(fit.curve(count)) for fit in known), any(count > FAR * fit.largest_count for fit in known)


def duration_text(seconds: float) -> str:
    """Seconds for a person: 40 s, 12 min, 3.5 h."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
