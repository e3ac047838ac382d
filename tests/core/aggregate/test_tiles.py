"""Retraining by tiles: what a tile takes, what it leaves as it is, and that little is lost by it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from radiant_core.aggregate import tiles
from radiant_core.aggregate.config import Join, JoinMethod
from radiant_core.aggregate.join import join_models, teacher_views
from radiant_core.aggregate.retrain import Retrained, retrain
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.aggregate.tiles import MARGIN_PX, MIN_SIDE_PX, crop_cameras, most_fitted, retrain_by_tiles, tile_labels, tiles_of
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.geometry.coverage import reached_by
from radiant_core.plan.regions.claims import claims_of_cells
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.extent import camera_extent, working_extent
from radiant_core.train.results import TrainProgress
from radiant_core.train.stored_images import Window
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

GROUND = ground_splats(2500, half_side_m=8.0)
CAMERAS = cameras_above([(x, y) for x in (-5.0, -2.0, 1.0, 4.0) for y in (-5.0, -2.0, 1.0, 4.0)], size_wh=(96, 72))
TRAIN = replace(train_preset("draft"), long_side_px=96, max_num_splats=10_000)
AGGREGATE = Join(epochs=4)
NATIVE = FitOptions(backend="native")


def worse(seed: int = 3) -> Splats:
    """The ground with colours and places that are off."""
    rng = np.random.default_rng(seed)
    return replace(
        GROUND,
        sh0=GROUND.sh0 + rng.normal(scale=0.4, size=GROUND.sh0.shape).astype(np.float32),
        means=GROUND.means + rng.normal(scale=0.03, size=GROUND.means.shape).astype(np.float32),
    )


def views() -> TrainingViews:
    return teacher_views([Teacher(splats=GROUND, cameras=CAMERAS)], 96)


def mean_db(splats: Splats) -> float:
    shown = zip(render_views(splats, CAMERAS), render_views(GROUND, CAMERAS), strict=True)
    return float(np.mean([psnr_db(one.image, other.image) for one, other in shown]))


def whole(made: Retrained, given: Splats) -> Splats:
    """The fitted Gaussians and those that kept their bits."""
    return concatenate_splats([made.splats, given.select(~made.reached)])


@pytest.mark.parametrize(("count", "num_tiles"), [(1000, 8), (1001, 16), (7, 8), (1, 4), (0, 2), (5, 1)])
def test_labels_divide_gaussians_evenly(count: int, num_tiles: int) -> None:
    means = np.random.default_rng(0).normal(size=(count, 3)) * [9, 3, 1]
    sizes = np.bincount(tile_labels(means, num_tiles), minlength=num_tiles)
    # Each halving leaves one more on a side at most.
    assert len(sizes) == num_tiles and sizes.sum() == count and np.ptp(sizes) <= 1


def test_tiles_are_boxes_halved_across_their_longer_side() -> None:
    labels = tile_labels(GROUND.means * np.float32([3, 1, 1]), 2)
    assert GROUND.means[labels == 0, 0].max() <= GROUND.means[labels == 1, 0].min()
    same = np.zeros((9, 3))
    assert np.ptp(np.bincount(tile_labels(same, 4), minlength=4)) <= 1, "places that are all one"


@pytest.mark.parametrize("window", [(0, 72, 0, 96), (10, 60, 20, 90), (0, 34, 60, 96), (37, 70, 11, 44)])
def test_a_cropped_camera_shows_the_window_of_the_whole_picture(window: Window) -> None:
    top, bottom, left, right = window
    camera = CAMERAS.select([5])
    (full,) = render_views(GROUND, camera, "native")
    (part,) = render_views(GROUND, crop_cameras(camera, [window]), "native")
    assert part.image.shape == (bottom - top, right - left, 3)
    # What lies outside a picture is projected as if nearer to it (as in 3DGS), so that Gaussians
    # which reach in from beyond differ in shape: 0.007 measured at the rim, two steps of 8 bits.
    for ours, whole_one in ((part.image, full.image), (part.alpha, full.alpha)):
        np.testing.assert_allclose(ours, whole_one[top:bottom, left:right], atol=0.01)
    # As far within as the margin of a tile, sums are rounded otherwise where blocks begin
    # elsewhere, no more.
    rows, columns = slice(top + MARGIN_PX, bottom - MARGIN_PX), slice(left + MARGIN_PX, right - MARGIN_PX)
    inner = part.image[MARGIN_PX : bottom - top - MARGIN_PX, MARGIN_PX : right - left - MARGIN_PX]
    np.testing.assert_allclose(inner, full.image[rows, columns], atol=2e-6)


def test_a_tiles_views_show_it_whole_with_a_margin_and_leave_out_the_rest() -> None:
    shown = views()
    for tile in tiles_of(GROUND.means, CAMERAS, 4):
        own = tile.views(shown)
        assert 0 < len(own) < len(shown) and [image.shape[:2] for image in own.images] == [
            (bottom - top, right - left) for top, bottom, left, right in tile.windows
        ]
        for row, (top, bottom, left, right), image in zip(tile.rows, tile.windows, own.images, strict=True):
            np.testing.assert_array_equal(image, shown.images[row][top:bottom, left:right])
            assert min(bottom - top, right - left) >= MIN_SIDE_PX
        seen, cropped = CAMERAS.select(np.array(tile.rows)), own.cameras
        means = GROUND.means[tile.fitted]
        for index in range(len(own)):
            assert (cropped.select([index]).any_sees(means) == seen.select([index]).any_sees(means)).all()


def test_what_tiles_take_falls_with_their_number() -> None:
    counts = [most_fitted(GROUND, CAMERAS, tiles_of(GROUND.means, CAMERAS, num)) for num in (1, 2, 4, 16)]
    assert counts[0] <= len(GROUND) and all(more > fewer for more, fewer in pairwise(counts)), counts


def test_what_is_held_and_what_no_view_reaches_keeps_its_bits() -> None:
    given = worse()
    own = given.means[:, 0] < 0
    far = replace(given.select(np.arange(40)), means=given.means[:40] + np.float32([500, 0, 0]))
    moving, held = concatenate_splats([given.select(own), far]), given.select(~own)
    before = {name: array.copy() for name, array in held.arrays().items()}
    made = retrain(moving, views(), TRAIN, AGGREGATE, NATIVE, frozen=held)
    assert not made.reached[-40:].any() and made.reached[:-40].sum() >= len(made.splats) > 0.9 * own.sum()
    for name, array in held.arrays().items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)
    assert not np.isin(held.means[:, 0], made.splats.means[:, 0]).any(), "held ones are not in the result"
    tiles = retrain_by_tiles(concatenate_splats([given, far]), views(), TRAIN, AGGREGATE, NATIVE, 4)
    assert not tiles.reached[-40:].any() and tiles.reached[:-40].mean() > 0.9


def test_one_tile_is_all_at_once_to_the_bit() -> None:
    one, same = retrain_by_tiles(worse(), views(), TRAIN, AGGREGATE, NATIVE, 1), retrain(worse(), views(), TRAIN, AGGREGATE, NATIVE)
    for name, array in one.splats.arrays().items():
        np.testing.assert_array_equal(array, same.splats.arrays()[name], err_msg=name)


def test_tiles_gain_most_of_what_all_at_once_gain() -> None:
    """From a start 12 dB below, on views of which the margin is a third: 37.1 dB at once, 35.1 by two
    tiles and 33.5 by four. Models that are joined begin near the end (`TILES_COST`)."""
    given, config = worse(), replace(AGGREGATE, epochs=8)
    before_db = mean_db(given)
    made = {num: retrain_by_tiles(given, views(), TRAIN, config, NATIVE, num) for num in (1, 2, 4)}
    gains_db = {num: mean_db(whole(one, given)) - before_db for num, one in made.items()}
    assert gains_db[1] > 10 and gains_db[2] > 0.75 * gains_db[1] and gains_db[4] > 0.65 * gains_db[1], gains_db
    assert made[4].trained.num_steps > made[2].trained.num_steps > made[1].trained.num_steps


def test_two_runs_by_tiles_give_the_same_bits() -> None:
    first, second = (retrain_by_tiles(worse(), views(), TRAIN, replace(AGGREGATE, epochs=1), NATIVE, 4) for _ in range(2))
    np.testing.assert_array_equal(first.reached, second.reached)
    for name, array in first.splats.arrays().items():
        np.testing.assert_array_equal(array, second.splats.arrays()[name], err_msg=name)


def test_progress_of_the_last_tile_ends_at_its_total() -> None:
    heard: list[TrainProgress] = []
    retrain_by_tiles(worse(), views(), TRAIN, replace(AGGREGATE, epochs=1), replace(NATIVE, report=heard.append, report_every_s=0), 4)
    assert heard[-1].step == heard[-1].num_steps and all(progress.step <= progress.num_steps for progress in heard)


def test_a_tile_that_no_view_shows_stays_and_the_others_are_fitted() -> None:
    given = worse()
    west = CAMERAS.select(CAMERAS.centers[:, 0] < -4)
    shown = teacher_views([Teacher(splats=GROUND, cameras=west)], 96)
    tiles = tiles_of(given.means, west, 4)
    assert {len(tile.rows) == 0 for tile in tiles} == {True, False}
    made = retrain_by_tiles(given, shown, TRAIN, replace(AGGREGATE, epochs=1), NATIVE, 4)
    unseen = ~reached_by(given, west)
    assert unseen.any() and not made.reached[unseen].any() and made.reached.any()


@pytest.mark.parametrize("count", [0, 1, 3])
def test_fewer_gaussians_than_tiles_make_empty_ones(count: int) -> None:
    given = replace(GROUND.select(np.arange(count)), means=np.zeros((count, 3), np.float32))
    made = retrain_by_tiles(given, views(), TRAIN, replace(AGGREGATE, epochs=1), NATIVE, 4)
    assert made.reached.all() and len(made.splats) == count and (made.trained.num_steps > 0) == (count > 0)
    assert most_fitted(given, CAMERAS, tiles_of(given.means, CAMERAS, 4)) == count


def test_where_no_view_shows_any_tile_nothing_is_fitted_and_the_join_is_a_cut() -> None:
    small = cameras_above([(-2, -1), (-2, 1), (2, -1), (2, 1)], size_wh=(30, 20))
    ground = ground_splats()
    made = retrain_by_tiles(ground, teacher_views([Teacher(splats=ground, cameras=small)], 30), TRAIN, AGGREGATE, NATIVE, 2)
    assert not made.reached.any() and not len(made.splats) and made.trained.num_steps == 0
    teachers = [Teacher(splats=ground_splats(seed=seed), cameras=small.select([2 * seed, 2 * seed + 1])) for seed in (0, 1)]
    claims = claims_of_cells(np.array([[-2.0, 0.0], [2.0, 0.0]]), np.zeros(2))
    joined = join_models(teachers, replace(TRAIN, long_side_px=30), AGGREGATE, NATIVE, claims, num_tiles=2)
    assert joined.trained.num_steps == 0 and 0 < len(joined.splats) < joined.num_given


def test_centres_of_a_tile_move_in_the_units_of_all_views(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[FitOptions] = []

    def hear(moving: Splats, shown: TrainingViews, train: TrainConfig, aggregate: Join, options: FitOptions, **more: Any) -> Retrained:
        heard.append(options)
        return retrain(moving, shown, train, aggregate, options, **more)

    monkeypatch.setattr(tiles, "retrain", hear)
    shown, given = views(), worse()
    methods: tuple[tuple[JoinMethod, float | None], ...] = (("fade", 0.5), ("paper", None))
    for method, limit in methods:
        heard.clear()
        train = replace(TRAIN, max_extent_per_distance=0.5)
        retrain_by_tiles(given, shown, train, Join(method=method, epochs=1), NATIVE, 4)
        expected = working_extent(shown.cameras, given.select(reached_by(given, shown.cameras)), limit)
        assert len(heard) > 1 and {options.extent for options in heard} == {expected}
        assert (expected < camera_extent(shown.cameras)) == (limit is not None)
