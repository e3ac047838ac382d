"""What each Gaussian shows: in total the opaque pixels; what lies behind a wall shows nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.methods.arms import select_strongest
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.shown_pixels import count_shown_pixels
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats


def _cloud(count: int = 200, seed: int = 0) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats(
        means=rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        quats=rng.standard_normal((count, 4)).astype(np.float32),
        log_scales=rng.uniform(-3, -1.5, (count, 3)).astype(np.float32),
        logit_opacities=rng.uniform(-2, 3, count).astype(np.float32),
        sh0=rng.uniform(-3, 3, (count, 1, 3)).astype(np.float32),  # some are clamped to black
        shN=np.zeros((count, 3, 3), np.float32),
    )


def _cameras() -> Cameras:
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 2, 3] = [4.0, 6.0]
    K = [[60.0, 0, 24], [0, 60, 16], [0, 0, 1]]
    return Cameras(names=("near", "far"), Ks=np.tile(K, (2, 1, 1)), cam_from_world=poses, sizes_wh=np.tile([48, 32], (2, 1)))


def test_all_gaussians_together_show_what_is_opaque() -> None:
    shown = count_shown_pixels(_cloud(), _cameras())
    assert shown.min() >= 0
    # float32 sums of 3,000 pixels in another order
    assert shown.sum() == pytest.approx(sum(view.alpha.sum() for view in render_views(_cloud(), _cameras())), rel=1e-4)


def test_what_a_wall_hides_goes_first() -> None:
    cloud = _cloud()
    wall = replace(
        cloud.select([0]),
        means=np.array([[0, 0, -1.5]], np.float32),
        log_scales=np.array([[2, 2, -3]], np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        logit_opacities=np.array([8], np.float32),
    )
    both = replace(cloud, **{name: np.concatenate([array, wall.arrays()[name]]) for name, array in cloud.arrays().items()})
    left = select_strongest(both, _cameras(), 1)
    assert np.array_equal(left.means, wall.means)
    assert select_strongest(both, _cameras(), 500) is both
    with pytest.raises(BadInput, match="expected at least 1"):
        select_strongest(both, _cameras(), 0)
