"""Training with masks: what lies under them is neither learnt nor started from nor scored."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from radiant_core.aggregate.synthetic_views import synthetic_views
from radiant_core.frames import Frame
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.checkpoint import training_key
from radiant_core.train.config import train_preset
from radiant_core.train.densify.policies import Adc, NoDensification
from radiant_core.train.fill_in import fill_in_points
from radiant_core.train.initialize import first_splats
from radiant_core.train.native_loss import TargetStatistics, target_loss
from radiant_core.train.trainer import FitOptions, fit_splats
from radiant_core.train.validation import validation_psnr_db
from radiant_core.train.view_loss import match_masked
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

CAMERAS = cameras_above([(x, y) for x in (-2.0, 0.0, 2.0) for y in (-1.5, 1.5)])
CONFIG = replace(train_preset("draft"), num_steps=60, sh_degree=0, density=NoDensification())
USED = np.full((36, 48), 255, np.uint8)
USED[8:24, 10:30] = 0


def clean() -> TrainingViews:
    return replace(synthetic_views(ground_splats(), CAMERAS), weights=None)


def with_passer_by(value: int, masked: bool) -> TrainingViews:
    """Something of one grey stands in the same part of every photograph."""
    images = tuple(np.where(USED[..., None] > 0, image, np.uint8(value)) for image in clean().images)
    return replace(clean(), images=images, weights=(USED,) * len(CAMERAS) if masked else None)


def grey_start() -> Splats:
    truth = ground_splats()
    return replace(truth, sh0=np.zeros_like(truth.sh0), logit_opacities=truth.logit_opacities * 0 - 2)


def test_what_is_masked_is_not_learnt() -> None:
    results = {masked: fit_splats(grey_start(), with_passer_by(0, masked), CONFIG).splats for masked in (True, False)}
    scores = {masked: validation_psnr_db(splats, clean(), "auto") for masked, splats in results.items()}
    best = validation_psnr_db(fit_splats(grey_start(), clean(), CONFIG).splats, clean(), "auto")
    assert scores[True] > scores[False] + 3, scores
    # Each place is seen outside the mask by one camera or another.
    assert scores[True] > best - 2, (scores, best)


def test_with_l1_alone_what_stands_under_the_mask_changes_no_bit() -> None:
    config = replace(CONFIG, num_steps=12, ssim_weight=0.0)
    black, white = (fit_splats(grey_start(), with_passer_by(value, masked=True), config).splats for value in (0, 255))
    for name, array in black.arrays().items():
        np.testing.assert_array_equal(array, white.arrays()[name])


def test_no_window_of_ssim_carries_an_error_out_of_the_mask() -> None:
    target = torch.rand(36, 48, 3, generator=torch.Generator().manual_seed(0))
    weights = torch.from_numpy(USED / 255).float()
    image = torch.where(weights[..., None] > 0, target, 1 - target).requires_grad_()
    loss = target_loss(match_masked(image, target, weights), TargetStatistics.of(target), weights, 0.2)
    loss.backward()
    assert image.grad is not None
    assert float(loss.detach()) == pytest.approx(0, abs=1e-6) and (image.grad[weights == 0] == 0).all()
    plain = image.detach().clone().requires_grad_()
    target_loss(plain, TargetStatistics.of(target), weights, 0.2).backward()
    # What the test is about: without agreement the mask's rim is pulled towards what it hides.
    assert plain.grad is not None and (plain.grad[weights == 0] != 0).any()


def test_a_photograph_that_is_masked_out_wholly_moves_nothing() -> None:
    views = replace(clean().select([0, 1]), weights=(np.zeros_like(USED), np.zeros_like(USED)))
    start = grey_start()
    result = fit_splats(start, views, replace(CONFIG, num_steps=4, max_scale_per_distance=None))
    np.testing.assert_array_equal(result.splats.sh0, start.sh0)
    assert result.last_loss == 0 and result.num_rolled_back == 0


def test_half_size_keeps_the_used_share_of_each_pixel() -> None:
    half = with_passer_by(0, masked=True).scaled(0.5)
    assert half.weights is not None and half.weights[0].shape == half.images[0].shape[:2] == (18, 24)
    np.testing.assert_array_equal(half.weights[0], USED.reshape(18, 2, 24, 2).mean(axis=(1, 3)))


def test_validation_scores_what_is_used() -> None:
    truth = ground_splats()
    assert validation_psnr_db(truth, with_passer_by(0, masked=True), "auto") > 50
    assert validation_psnr_db(truth, with_passer_by(0, masked=False), "auto") < 20


def flat_scene() -> tuple[SfmScene, TrainingViews]:
    """Red photographs of flat ground, in whose blue upper left quarter something stands, with
    points about the middle."""
    cameras = cameras_above([(0.0, 0.0), (0.5, 0.0)], size_wh=(80, 60))
    points = np.column_stack([np.random.default_rng(0).uniform(-0.5, 0.5, (60, 2)), np.zeros(60)])
    frame = Frame(kind="metric", origin_lat_lon_alt=np.zeros(3))
    observations = np.array([(point, camera) for point in range(60) for camera in (0, 1)])
    scene = SfmScene(cameras=cameras, points=points, colors=np.zeros((60, 3), np.uint8), observations=observations, frame=frame)
    image, used = np.full((60, 80, 3), [255, 0, 0], np.uint8), np.full((60, 80), 255, np.uint8)
    image[:31, :41], used[:31, :41] = [0, 0, 255], 0
    return scene, TrainingViews(cameras=cameras, images=(image, image), weights=(used, used))


def test_fill_in_takes_neither_places_nor_colours_from_under_a_mask() -> None:
    scene, views = flat_scene()
    added, whole = fill_in_points(scene, views), fill_in_points(scene, replace(views, weights=None))
    assert 50 < len(added.points) < len(whole.points)
    np.testing.assert_array_equal(added.colors, np.tile([255, 0, 0], (len(added.points), 1)))
    assert (whole.colors[:, 2] > 200).any()
    splats, _ = first_splats(scene, views, train_preset("draft"))
    assert all(np.isfinite(array).all() for array in splats.arrays().values())


def test_observations_under_a_mask_are_not_compared() -> None:
    scene, views = flat_scene()
    assert views.weights is not None
    rows, pixels = views.observed_pixels(scene)
    hidden = views.weights[0][tuple(scene.observed_pixels(views.cameras)[1].T[::-1])] == 0
    assert hidden.any() and len(rows) == (~hidden).sum()
    assert (views.weights[0][pixels[:, 1], pixels[:, 0]] == 255).all()


def test_other_masks_are_another_training() -> None:
    views, options = with_passer_by(0, masked=True), FitOptions()
    assert views.weights is not None
    moved = replace(views, weights=(np.roll(USED, 1, axis=1), *views.weights[1:]))
    keys = {training_key(grey_start(), each, CONFIG, options) for each in (views, moved, replace(views, weights=None))}
    assert len(keys) == 3


def test_renders_stay_finite_where_every_photograph_is_masked() -> None:
    views = replace(clean(), weights=(np.zeros_like(USED),) * len(CAMERAS))
    result = fit_splats(grey_start(), views, replace(CONFIG, num_steps=8, density=Adc(kind="planned", every=2), max_num_splats=400))
    assert all(np.isfinite(view.image).all() for view in render_views(result.splats, CAMERAS.select([0])))
