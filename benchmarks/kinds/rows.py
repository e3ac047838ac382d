"""Rows of the benchmark of kinds of scenes, and what helpers gain by them. Once per matrix.

gain of a helper = PSNR of the preset − PSNR without it, paired over seeds and images
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.kinds.statistics import FORCED, STATISTICS, Case
from radiant_core.evaluate.bootstrap import PairedDifference, paired_bootstrap
from radiant_core.numerics import FloatArray
from radiant_core.train.config import train_preset, without_mean
from radiant_core.train.needs import PIXELS_PER_SPLAT

HELPERS: Mapping[str, Mapping[str, Any]] = {
    "fill-in points": {"fill_in": False},
    "light": {"light": "none"},
    "sky": {"sky": False},
    "limit of extent": {"max_extent_per_distance": None},
    "limit of sizes": {"max_scale_per_distance": None},
    "limit of needles": {"max_elongation": None},
    "skipped images": {"skip_images": "none"},
    "few: left out at random": {"drop_gaussians": "none"},
    "few: more Gaussians": {"density.pixels_per_splat": PIXELS_PER_SPLAT},
    "thinned after growth": {"density.thin_to": 1.0},
    "settling rates": {"settle_epochs": None},
    "mean of the last steps": without_mean(train_preset("default")),
    "small pictures first": {"start_scale": 1.0},
}
"""Each helper of the preset, and the settings that switch it off."""
ADDED: Mapping[str, Mapping[str, Any]] = {
    "dense points": {"dense_points": "always"},
    "fill-in points always": {"fill_in": True},
    "light always": {"light": "always"},
    "left out at random always": {"drop_gaussians": "always"},
}
"""What the preset does not do, or where it decides against it, and the settings that force it."""
DEFAULT, PLAIN, PLAIN_LONGER = "default", "plain", "plain, equal time"


@dataclass(frozen=True, kw_only=True)
class KindRow:
    """One trained model. Per held-out image psnr_db and, after a correction of colours,
    psnr_cc_db."""

    kind: str
    num_photographs: int
    arm: str
    """A helper that is changed, `DEFAULT`, `PLAIN` or `PLAIN_LONGER`."""
    seed: int
    cpu_s: float
    """Preparing and training, in which trials count."""
    num_steps: int
    num_gaussians: int
    psnr_db: tuple[float, ...]
    psnr_cc_db: tuple[float, ...]
    split: int = 0
    """Which eighth of the photographs is held out."""
    steps: str = ""
    """Hash of all that decides the bits of its steps."""
    choices: Mapping[str, str] = field(default_factory=dict)
    """What was decided, by topic."""
    chosen: Mapping[str, Any] = field(default_factory=dict)
    """The values of settings that were "auto"."""
    statistics: Mapping[str, float] = field(default_factory=dict)
    """Of the default's photographs, by name (`statistics.py`)."""

    @property
    def scene(self) -> str:
        """Kind and number."""
        return f"{self.kind}-{self.num_photographs}"


@dataclass(frozen=True, kw_only=True)
class Gain:
    """What a helper gains on one scene, or the default over plain and over plain in equal time."""

    kind: str
    num_photographs: int
    helper: str
    psnr_db: PairedDifference
    psnr_cc_db: PairedDifference
    cpu_s: float
    """CPU seconds that it costs."""
    acts: bool
    """Whether any step of a training differs by it."""


def gains_of(rows: Sequence[KindRow]) -> list[Gain]:
    """What every helper gains on every scene whose default was measured with the same seeds."""
    return [
        Gain(
            kind=pair.with_it[0].kind,
            num_photographs=pair.with_it[0].num_photographs,
            helper=pair.helper,
            psnr_db=difference_of([pair], "psnr_db"),
            psnr_cc_db=difference_of([pair], "psnr_cc_db"),
            cpu_s=float(np.mean([a.cpu_s - b.cpu_s for a, b in zip(pair.with_it, pair.without, strict=True)])),
            acts=pair.acts,
        )
        for pair in pairs_of(rows)
    ]


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Rows of one scene with a helper and without it, seed by seed and split by split."""

    helper: str
    with_it: list[KindRow]
    without: list[KindRow]

    @property
    def acts(self) -> bool:
        """Whether any step differs."""
        return any(a.steps != b.steps for a, b in zip(self.with_it, self.without, strict=True))


def pairs_of(rows: Sequence[KindRow]) -> Iterator[Pair]:
    """The default and every other arm that was measured on the same scene with the same seeds and
    splits; a split that some of these seeds lack is left out."""
    groups: dict[tuple[str, str], dict[tuple[int, int], KindRow]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.arm), {})[row.seed, row.split] = row
    for (scene, arm), measured in groups.items():
        default = groups.get((scene, DEFAULT), {})
        common = measured.keys() & default.keys()
        seeds = {seed for seed, _ in common}
        jobs = sorted((seed, split) for seed, split in common if all((other_seed, split) in common for other_seed in seeds))
        if arm != DEFAULT and jobs:
            sides = [default[job] for job in jobs], [measured[job] for job in jobs]
            with_it, without = sides[::-1] if arm in ADDED else sides
            yield Pair(helper=arm, with_it=with_it, without=without)


def difference_of(pairs: Sequence[Pair], figure: str) -> PairedDifference:
    """Mean and bounds over scenes, each with equal weight."""
    a, b = ([_by_seed_and_image(getattr(pair, side), figure) for pair in pairs] for side in ("with_it", "without"))
    return paired_bootstrap(a, b)


def _by_seed_and_image(rows: Sequence[KindRow], figure: str) -> FloatArray:
    """A figure (S,I) per seed, over the held-out images of all splits one after the other."""
    of_seeds = [[getattr(row, figure) for row in rows if row.seed == seed] for seed in sorted({row.seed for row in rows})]
    return np.array([np.concatenate(of_splits) for of_splits in of_seeds], np.float64)


def differences_over_scenes(rows: Sequence[KindRow]) -> dict[str, PairedDifference]:
    """What every helper gains over all scenes, each with equal weight, by its name."""
    return {helper: difference_of(pairs, "psnr_db") for helper, pairs in pairs_by_helper(rows).items()}


def pairs_by_helper(rows: Sequence[KindRow]) -> dict[str, list[Pair]]:
    """The pairs of all scenes by the helper."""
    pairs: dict[str, list[Pair]] = {}
    for pair in pairs_of(rows):
        pairs.setdefault(pair.helper, []).append(pair)
    return pairs


def cases_of(rows: Sequence[KindRow]) -> list[Case]:
    """The helpers that change a training, as the default decides about them by a statistic."""
    of_forced = {arm: helper for helper, arm in FORCED.items()}
    return [
        Case(
            helper=of_forced.get(pair.helper, pair.helper),
            scene=pair.with_it[0].scene,
            is_on=pair.helper not in of_forced,
            gain=difference_of([pair], "psnr_db"),
            statistics=(pair.without if pair.helper in of_forced else pair.with_it)[0].statistics,
        )
        for pair in pairs_of(rows)
        if pair.acts and of_forced.get(pair.helper, pair.helper) in STATISTICS
    ]
