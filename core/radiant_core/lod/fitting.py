"""A coarser level of a chunk, fitted to pictures of its finest. Once per chunk and level.

Merged Gaussians keep what the finest ones cover, but not what a renderer makes of it: it widens
each by 0.3 px, and what hides what changes where groups are. So all values of a level are fitted by
squared error to pictures of the finest level, from where the coarser one is for: its Gaussians are
a third of a pixel to 1.3 pixels wide, seen from above and obliquely. Nothing but the chunk's own
Gaussians goes in, so that a chunk stays a function of them. A level that pictures from other places
do not show to be nearer keeps its merged values, as do few Gaussians and what cannot be drawn.

Tried on the sample town: shares of 1, 0.6 and 0.15 of the learning rates are behind 0.3; twice the
epochs gain 0.3 dB; a coloured backdrop, which would tell holes from dark Gaussians, gains nothing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from radiant_core.cameras import Cameras
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
LEAST_WIDTHS_PER_PX, MOST_WIDTHS_PER_PX = 0.75, 3.0
"""How wide a pixel is, in widths of the finest Gaussians times 2 for each halving."""
MOST_TILTED, TILT_POWER = 0.8, 5
"""Views are tilted by this share of a right angle times u⁵, u even from 0 to 1: straight down, all
ground has one depth, and what hides what differs from all other directions."""


def fit_level(finest: Splats, level: Splats, halvings: int, report: Callable[[float], None] = lambda share: None) -> Splats:
    """The Gaussians `level`, which `finest` were halved to in so many steps, fitted to pictures of
    `finest`: as many in the same order, or `level` itself where that is nearer. `report` is called
    with the share of the steps done."""
    if len(level) < MIN_SPLATS:
        return level
    num_views = max(MIN_VIEWS, -(-PIXELS_PER_SPLAT * len(level) // int(np.prod(LENS.size_wh))))
    cameras = _cameras(finest, 2.0**halvings, num_views + NUM_CHECKED)
    fitted_to, checked = cameras.select(np.arange(num_views)), cameras.select(np.arange(num_views, len(cameras)))
    pictures = tuple(view.image for view in render_views(finest, fitted_to))
    if not all(np.isfinite(picture).all() for picture in pictures):
        return level
    config = TrainConfig(
        num_steps=NUM_EPOCHS * num_views,
        long_side_px=max(LENS.size_wh),
        sh_degree=level.sh_degree,
        ssim_weight=0.0,
        max_scale_per_distance=None,
        max_elongation=None,
        sky=False,
    )
    steps = Steps(means=RATE, quats=RATE, log_scales=RATE, logit_opacities=RATE, sh0=RATE, shN=RATE, end=END)
    options = FitOptions(steps=steps, report=lambda progress: report(progress.step / progress.num_steps))
    views = TrainingViews(cameras=fitted_to, images=tuple(np.rint(255 * picture).astype(np.uint8) for picture in pictures))
    fitted = fit_splats(level, views, config, options).splats
    return fitted if _squared_error(finest, fitted, checked) < _squared_error(finest, level, checked) else level


def _cameras(finest: Splats, coarser: float, count: int) -> Cameras:
    """Cameras at places of a level that is so much coarser, always the same for a chunk."""
    rng = np.random.default_rng(0)
    means, scales = finest.means.astype(np.float64), np.exp(finest.log_scales.astype(np.float64))
    px_m = (
        np.median(scales.prod(axis=1) ** (1 / 3))
        * coarser
        * np.geomspace(LEAST_WIDTHS_PER_PX, MOST_WIDTHS_PER_PX, count)[rng.permutation(count)]
    )
    turns, tilts = rng.uniform(0, 2 * np.pi, count), MOST_TILTED * np.pi / 2 * rng.uniform(0, 1, count) ** TILT_POWER
    towards = np.column_stack([np.sin(tilts) * np.cos(turns), np.sin(tilts) * np.sin(turns), np.cos(tilts)])
    aims = means[rng.integers(0, len(means), count)]
    away_m = np.maximum(px_m * LENS.K[0, 0], 1e-6 * (1 + np.abs(means).max()))
    return cameras_looking_at(aims + away_m[:, None] * towards, aims, LENS)


def _squared_error(finest: Splats, level: Splats, cameras: Cameras) -> float:
    pairs = zip(render_views(finest, cameras), render_views(level, cameras), strict=True)
    return float(np.mean([np.mean((full.image - coarse.image) ** 2) for full, coarse in pairs]))
