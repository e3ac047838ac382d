"""A coarser level of a chunk, fitted to pictures of its finest. Once per chunk and level.

Merged Gaussians keep what the finest ones cover, but not what a renderer makes of it: it widens
each by 0.3 px, and what hides what changes where groups are. So all values of a level are fitted by
squared error to pictures of the finest level, from where the coarser one is for: its Gaussians are
a third of a pixel to 1.3 pixels wide, seen from above and obliquely. Nothing but the chunk's own
Gaussians goes in, and no other renderer than ours, so that a chunk stays a function of them. A
level that pictures from other places do not show to be nearer keeps its merged values, as do few
Gaussians and what cannot be drawn or trained.

Tried on the sample town: shares of 1, 0.6 and 0.15 of the learning rates are behind 0.3; twice the
epochs gain 0.3 dB; a coloured backdrop, which would tell holes from dark Gaussians, gains nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput, StageFailed
from radiant_core.render.rendered_view import render_views
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.trainer import FitOptions, Steps, fit_splats
from radiant_core.train.views import TrainingViews

LENS = Lens(size_wh=(320, 240))
MIN_SPLATS = 64
MIN_VIEWS, PIXELS_PER_SPLAT = 64, 300
"""So many views, and more where a Gaussian of the level would get fewer pixels of all of them."""
NUM_CHECKED, NUM_EPOCHS = 6, 8
RATE, END = 0.3, 0.1
"""Share of a training's learning rates, and of that at the end."""
LEAST_WIDTHS_PER_PX, MOST_WIDTHS_PER_PX = 0.4, 1.6
"""How wide a pixel is, in widths of the finest Gaussians (of both their longer axes) times 2 for
each halving."""
MOST_TILTED, TILT_POWER = 0.8, 5
"""Views are tilted by this share of a right angle times u⁵, u even from 0 to 1: straight down, all
ground has one depth, and what hides what differs from all other directions."""
DRAWN_SHARE = 0.15
"""Of the work, pictures of the finest level."""
STATISTICS_BYTES = 64 << 20
STEP_S, STEP_S_PER_SPLAT = 0.011, 1.6e-7
"""Processor time of a step, and of each Gaussian of the chunk: from 11 ms with 1,000 Gaussians over
32 ms with 110,000 to 58 ms with 316,000, on two shared AMD EPYC cores with other work."""


def fit_level(
    finest: Splats, level: Splats, halvings: int, report: Callable[[float], None] = lambda share: None, *, from_above: bool = True
) -> Splats:
    """A coarser level of a chunk, nearer to its finest.

    Args:
        finest: the Gaussians of the chunk.
        level: what they were halved to.
        halvings: in so many steps.
        report: called with the share of the work done.
        from_above: z is up, and the chunk is seen from above; else from all directions.

    Returns:
        As many Gaussians in the same order, or `level` itself where that is nearer.
    """
    if len(level) < MIN_SPLATS:
        return level
    try:
        return _fitted(finest, level, _cameras(finest, 2.0**halvings, _num_views(len(level)) + NUM_CHECKED, from_above), report)
    except (StageFailed, BadInput):
        # Sizes or colours near the ends of float32, which no picture or training takes.
        return level


def fitting_s(count: int, num_levels: int, num_chunks: int) -> float:
    """About how many processor seconds it takes to fit the coarser levels of so many Gaussians."""
    splats_per_chunk = count / max(num_chunks, 1)
    steps = NUM_EPOCHS * sum(_num_views(int(splats_per_chunk / 2**halvings)) for halvings in range(1, num_levels))
    return num_chunks * steps * (STEP_S + STEP_S_PER_SPLAT * splats_per_chunk)


def _num_views(count: int) -> int:
    return max(MIN_VIEWS, -(-PIXELS_PER_SPLAT * count // int(np.prod(LENS.size_wh))))


def _fitted(finest: Splats, level: Splats, cameras: Cameras, report: Callable[[float], None]) -> Splats:
    num_views = len(cameras) - NUM_CHECKED
    fitted_to, checked = cameras.select(np.arange(num_views)), cameras.select(np.arange(num_views, len(cameras)))
    pictures: list[NDArray[np.uint8]] = []
    for view in render_views(finest, fitted_to, "native"):
        pictures.append(np.rint(255 * view.image).astype(np.uint8))
        report(DRAWN_SHARE * len(pictures) / num_views)
    config = TrainConfig(
        num_steps=NUM_EPOCHS * num_views,
        long_side_px=max(LENS.size_wh),
        sh_degree=level.sh_degree,
        ssim_weight=0.0,
        max_scale_per_distance=None,
        max_elongation=None,
        max_extent_per_distance=None,
        sky=False,
    )
    options = FitOptions(
        steps=Steps(means=RATE, quats=RATE, log_scales=RATE, logit_opacities=RATE, sh0=RATE, shN=RATE, end=END),
        backend="native",
        report=lambda progress: report(DRAWN_SHARE + (1 - DRAWN_SHARE) * progress.step / progress.num_steps),
        statistics_bytes=STATISTICS_BYTES,
    )
    fitted = fit_splats(level, TrainingViews(cameras=fitted_to, images=tuple(pictures)), config, options).splats
    return fitted if _error(finest, fitted, checked) < _error(finest, level, checked) else level


def _cameras(finest: Splats, coarser: float, count: int, from_above: bool) -> Cameras:
    """Cameras at places of a level that is so much coarser, always the same for a chunk."""
    rng = np.random.default_rng(0)
    means = finest.means.astype(np.float64)
    width = np.exp(min(float(np.median(np.sort(finest.log_scales.astype(np.float64), axis=1)[:, 1:].mean(axis=1))), 100.0))
    widths_per_px = rng.permutation(np.geomspace(LEAST_WIDTHS_PER_PX, MOST_WIDTHS_PER_PX, count))
    turns, heights = rng.uniform(0, 2 * np.pi, count), rng.uniform(0, 1, count)
    tilts = MOST_TILTED * np.pi / 2 * heights**TILT_POWER if from_above else np.arccos(2 * heights - 1)
    towards = np.column_stack([np.sin(tilts) * np.cos(turns), np.sin(tilts) * np.sin(turns), np.cos(tilts)])
    aims = means[rng.integers(0, len(means), count)]
    away_m = np.maximum(width * coarser * widths_per_px * LENS.K[0, 0], 1e-6 * (1 + np.abs(means).max()))
    return cameras_looking_at(aims + away_m[:, None] * towards, aims, LENS)


def _error(finest: Splats, level: Splats, cameras: Cameras) -> float:
    """Mean logarithm of the squared error: each picture counts alike."""
    pairs = zip(render_views(finest, cameras, "native"), render_views(level, cameras, "native"), strict=True)
    return float(np.mean([np.log(np.mean((full.image - coarse.image) ** 2) + 1e-12) for full, coarse in pairs]))
