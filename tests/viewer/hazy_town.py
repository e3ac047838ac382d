"""The made-up town in a haze: wide red Gaussians around, above and below it, as trainings leave them there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radiant_core.splats import SH_C0, Splats, concatenate_splats
from tests.viewer.made_up_run import HALF_WH, Town

HAZE = np.array([255, 40, 0])
NUM_HAZE = 600


def hazy(town: Town) -> Town:
    """The town with its haze after it: outside of the regions, high over them, and wide at their rim."""
    rng = np.random.default_rng(8)
    angle, away = rng.uniform(0, 2 * np.pi, NUM_HAZE), rng.uniform(1.3, 3.0, NUM_HAZE)
    places = np.column_stack([HALF_WH[0] * away * np.cos(angle), HALF_WH[0] * away * np.sin(angle), rng.uniform(-40, 80, NUM_HAZE)])
    places[::3, :2], places[::3, 2] = places[::3, :2] / 4, rng.uniform(30, 90, len(places[::3]))
    places[1::9] = np.column_stack(
        [np.full(len(places[1::9]), HALF_WH[0] - 1), rng.uniform(-60, 60, len(places[1::9])), np.zeros(len(places[1::9]))]
    )
    haze = Splats(
        means=places.astype(np.float32),
        quats=np.tile(np.array([1.0, 0, 0, 0], np.float32), (NUM_HAZE, 1)),
        log_scales=np.full((NUM_HAZE, 3), np.log(9.0), np.float32),
        logit_opacities=np.full(NUM_HAZE, 1.0, np.float32),
        sh0=np.tile(((HAZE / 255 - 0.5) / SH_C0).astype(np.float32), (NUM_HAZE, 1, 1)),
        shN=np.zeros((NUM_HAZE, 0, 3), np.float32),
    )
    return replace(town, splats=concatenate_splats([town.splats, haze]))


def haze_share(image: np.ndarray) -> float:
    """Which share of the pixels (H,W,3) is at least half red."""
    red, green, blue = np.moveaxis(image.astype(int), -1, 0)
    return float(((red - np.maximum(green, blue)) > 60).mean())
