"""Whether the statistics by which a default switches its helpers predict what these gain. Once per
matrix of kinds of scenes.

    on   right where the default is better with the helper than without it
    off  right where the default is better than with the helper forced on

A verdict is sure where the bounds over seeds and images exclude 0, and else of that sign in the
mean; a helper that changes no step says nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from radiant_core.evaluate.bootstrap import PairedDifference
from radiant_core.light.solve import lights_from_tracks
from radiant_core.scene import SfmScene
from radiant_core.train.extent import camera_extent, viewing_distance
from radiant_core.train.fill_in import contradicted_share, fill_in_points
from radiant_core.train.initialize import sky_share
from radiant_core.train.views import TrainingViews
from radiant_core.train.worth import relative_sharpness

STATISTICS: Mapping[str, tuple[str, ...]] = {
    "fill-in points": ("contradicted %", "seen through %"),
    "light": ("spread %", "evenness"),
    "sky": ("above the horizon %",),
    "limit of extent": ("extent over distance",),
    "skipped images": ("least sharp %",),
    "few: left out at random": ("photographs",),
    "few: more Gaussians": ("photographs",),
}
"""What decides about a helper."""
FORCED: Mapping[str, str] = {
    "fill-in points": "fill-in points always",
    "light": "light always",
    "few: left out at random": "left out at random always",
}
"""The arm that forces a helper on, where one does."""
Verdict = Literal["right", "rather right", "rather wrong", "wrong"]


def statistics_of(scene: SfmScene, views: TrainingViews) -> dict[str, float]:
    """Every statistic by name, of the photographs that are trained on; those that say nothing are
    left out."""
    filled, lights, sharpness = fill_in_points(scene, views), lights_from_tracks(scene, views), relative_sharpness(scene, views)
    distance = viewing_distance(views.cameras, scene.points)
    statistics = {
        "contradicted %": 100 * contradicted_share(filled, views),
        "seen through %": 100 * filled.seen_through_share,
        "spread %": 100 * lights.spread,
        "evenness": lights.evenness,
        "above the horizon %": 100 * sky_share(views.cameras),
        "extent over distance": camera_extent(views.cameras) / (distance or np.inf),
        "least sharp %": 100 * float(np.nanmin(sharpness)) if np.isfinite(sharpness).any() else np.nan,
        "photographs": float(len(views)),
    }
    return {name: float(value) for name, value in statistics.items() if np.isfinite(value)}


@dataclass(frozen=True, kw_only=True)
class Case:
    """A helper that changes the steps of a training on one scene."""

    helper: str
    scene: str
    is_on: bool
    """Whether the default has it."""
    gain: PairedDifference
    """With the helper less without it, whatever the default decides, in dB."""
    statistics: Mapping[str, float]

    @property
    def verdict(self) -> Verdict:
        """How well the default decided."""
        gain = self.gain
        low, mean, high = (gain.low, gain.mean, gain.high) if self.is_on else (-gain.high, -gain.mean, -gain.low)
        if low > 0 or high < 0:
            return "right" if low > 0 else "wrong"
        return "rather right" if mean >= 0 else "rather wrong"


def statistics_tables(cases: Sequence[Case]) -> list[str]:
    """A line for each helper, then one for each helper and scene."""
    verdicts: tuple[Verdict, ...] = ("right", "rather right", "rather wrong", "wrong")
    lines = [_line("helper", "by", "decided", "scenes", *verdicts, "gain"), "|---" * 9 + "|"]
    for helper, names in STATISTICS.items():
        for is_on in (True, False):
            if some := [case for case in cases if case.helper == helper and case.is_on == is_on]:
                counts = [str(sum(case.verdict == verdict for case in some)) for verdict in verdicts]
                mean = float(np.mean([case.gain.mean for case in some]))
                lines.append(_line(helper, ", ".join(names), "on" if is_on else "off", str(len(some)), *counts, f"{mean:+.2f}"))
    lines += ["", _line("helper", "scene", "statistics", "decided", "gain", "verdict"), "|---" * 6 + "|"]
    for case in sorted(cases, key=lambda case: (list(STATISTICS).index(case.helper), case.scene)):
        texts = [f"{case.statistics[name]:.3g} {name}" for name in STATISTICS[case.helper] if name in case.statistics]
        bounds = f"{case.gain.mean:+.2f} ({case.gain.low:+.2f} … {case.gain.high:+.2f})"
        lines.append(_line(case.helper, case.scene, ", ".join(texts), "on" if case.is_on else "off", bounds, case.verdict))
    return lines


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"
