"""The prediction of errors: rising in both, calibrated on photographs that took no part."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import spearmanr

from radiant_core.errors import BadInput
from radiant_core.next_flight.predicted_error import (
    LEAST_WEIGHT,
    ErrorSamples,
    TrainingErrors,
    error_samples,
    errors_in_views,
    fit_errors,
    mean_errors_db,
    rank_correlation,
)
from radiant_core.next_flight.sightings import Sighting
from radiant_core.render.rendered_view import render_views
from tests.core.scenes import cameras_above, ground_splats


def made_up(count: int = 3000, *, noise_db: float = 1.0, num_photographs: int = 6) -> ErrorSamples:
    rng = np.random.default_rng(0)
    train_db, score = rng.uniform(18, 30, count), rng.uniform(0, 10, count)
    held_db = 0.8 * train_db + 2.0 * np.sqrt(score) + rng.normal(0, noise_db, count)
    photograph = rng.integers(0, num_photographs, count)
    return ErrorSamples(rows=np.arange(count), photograph=photograph, held_db=held_db, train_db=train_db, score=score)


def test_a_law_that_rises_in_both_is_recovered() -> None:
    samples = made_up()
    model = fit_errors(samples)
    truth = 0.8 * samples.train_db + 2.0 * np.sqrt(samples.score)
    # Noise of 1 dB over 3,000 samples in steps of some fifty: a few tenths of a dB.
    assert np.abs(model.predict(samples.train_db, samples.score) - truth).mean() < 0.3
    assert (np.diff(model.by_training.values) >= 0).all()
    assert (np.diff(model.by_score.values) >= 0).all()
    assert model.rank is not None and model.rank > 0.9
    assert model.num_cells == 3000
    assert model.num_photographs == 6


def test_of_cells_called_good_as_many_are() -> None:
    model = fit_errors(made_up())
    # Nine of ten; four σ of a share of 3,000 samples.
    assert model.good == pytest.approx(0.9, abs=4 * np.sqrt(0.09 / 3000))
    # The 10 % quantile of noise of 1 dB.
    assert model.margin_db == pytest.approx(1.28, abs=0.15)


def test_ranks_are_of_cells_over_the_photographs_that_show_them() -> None:
    """Noise of single looks, which hides the rank of samples, leaves that of cells."""
    alone, often = made_up(noise_db=6.0), made_up(noise_db=6.0)
    # Twenty looks at each of 150 cells.
    first = np.arange(3000) % 150
    truth = 0.8 * often.train_db[first] + 2.0 * np.sqrt(often.score[first])
    held_db = truth + np.random.default_rng(1).normal(0, 6.0, 3000)
    looks = ErrorSamples(
        rows=first, photograph=np.arange(3000) // 150 % 20, held_db=held_db, train_db=often.train_db[first], score=often.score[first]
    )
    few, many = fit_errors(alone).rank, fit_errors(looks).rank
    assert few is not None and many is not None and few < 0.6 < 0.8 < many


def test_one_colour_map_of_a_photograph_is_no_error_of_the_model() -> None:
    splats, cameras = ground_splats(), cameras_above([(0.0, 0.0)])
    view = next(iter(render_views(splats, cameras)))
    darker = (0.7 * view.image * 255).round().astype(np.uint8)
    ones = np.ones(1, np.float32)
    sighting = Sighting(
        rows=np.array([0]), pixels=np.array([[20.5, 10.5]], np.float32), gsd=ones, toward=np.zeros((1, 3), np.float32), facing=ones
    )
    (errors,) = errors_in_views(splats, cameras, lambda _: darker, [sighting], 1.0)
    assert errors[0] <= (1.5 / 255) ** 2
    with pytest.raises(ValueError, match="of pixels beyond a picture of"):
        list(errors_in_views(splats, cameras.scaled(24), lambda _: darker[::2, ::2], [sighting.scaled(np.array([2.0, 2.0]))], 1.0))


def test_one_photograph_gives_no_margin_and_too_few_cells_no_prediction() -> None:
    one = fit_errors(made_up(num_photographs=1))
    assert one.margin_db is None and one.rank is None
    with pytest.raises(BadInput, match="hold more photographs out"):
        fit_errors(made_up(50))


def test_what_a_mask_leaves_out_is_no_error_of_the_model() -> None:
    """A white lorry in the left half of a photograph, masked: no error beside it, none known there,
    and the colour map is not fitted to it."""
    splats, cameras = ground_splats(), cameras_above([(0.0, 0.0)])
    image = (next(iter(render_views(splats, cameras))).image * 255).round().astype(np.uint8)
    height, width = image.shape[:2]
    image[:, : width // 2] = 255
    weights = np.full((height, width), 255, np.uint8)
    weights[:, : width // 2] = 0
    pixels = np.array([[width / 4, height / 2], [width / 2 + 1, height / 2]], np.float32)
    ones = np.ones(2, np.float32)
    sighting = Sighting(rows=np.array([0, 1]), pixels=pixels, gsd=ones, toward=np.zeros((2, 3), np.float32), facing=ones)
    (plain,) = errors_in_views(splats, cameras, lambda _: image, [sighting], 5.0)
    (masked,) = errors_in_views(splats, cameras, lambda _: image, [sighting], 5.0, [weights])
    assert np.isnan(masked[0]) and masked[1] <= (1.5 / 255) ** 2 < plain[1]
    (nothing,) = errors_in_views(splats, cameras, lambda _: image, [sighting], 5.0, [np.zeros_like(weights)])
    assert np.isnan(nothing).all()
    assert np.isnan(mean_errors_db(2, [sighting], [masked])[0])


def test_equal_errors_everywhere_have_no_rank() -> None:
    count = 500
    flat = ErrorSamples(
        rows=np.arange(count), photograph=np.arange(count) % 3, held_db=np.full(count, 20.0), train_db=np.full(count, 25.0),
        score=np.zeros(count),
    )  # fmt: skip
    assert fit_errors(flat).rank is None


def test_equal_errors_share_their_rank_as_in_scipy() -> None:
    rng = np.random.default_rng(3)
    # Two digits: hundreds of equal values.
    a, b = rng.normal(size=2000).round(1), rng.normal(size=2000).round(1)
    b[:1000] = a[:1000]
    assert rank_correlation(a, b) == pytest.approx(float(spearmanr(a, b)[0]), abs=1e-12)


def look(rows: list[int], toward: list[tuple[float, float, float]], gsd: float) -> Sighting:
    count = len(rows)
    unit = np.array(toward, np.float32) / np.linalg.norm(toward, axis=1, keepdims=True).astype(np.float32)
    ones = np.ones(count, np.float32)
    return Sighting(rows=np.array(rows), pixels=np.ones((count, 2), np.float32), gsd=gsd * ones, toward=unit, facing=ones)


def test_a_typical_error_is_not_that_of_the_worst_photograph() -> None:
    """Three photographs of 20, 30 and 40 dB, and a facet that one of them shows behind a mask."""
    squared = (1e-2, 1e-3, 1e-4)
    seen = look([0, 2], [(0, 0, 1)] * 2, 1.0)
    errors = [np.array([error, np.nan if index else error]) for index, error in enumerate(squared)]
    train = TrainingErrors(3, [seen] * 3, errors)
    np.testing.assert_allclose(train.typical_db(), [30.0, np.nan, 20.0], rtol=1e-12)
    # Alike all three count the same, whatever the order of the facets.
    np.testing.assert_allclose(train.seen_alike_db(look([2, 1, 0], [(0, 0, 1)] * 3, 1.0)), [20.0, np.nan, 30.0], rtol=1e-12)
    # The mean of the squares is 3.7e-3.
    assert mean_errors_db(3, [seen] * 3, errors)[0] == pytest.approx(24.32, abs=0.01)


def test_photographs_that_see_a_facet_alike_count_most() -> None:
    """20 dB from above, 30 dB from 20° aside, 40 dB from above at e times the GSD."""
    aside = (np.sin(np.radians(20)), 0.0, np.cos(np.radians(20)))
    seen = [look([0], [(0, 0, 1)], 1.0), look([0], [aside], 1.0), look([0], [(0, 0, 1)], float(np.e))]
    train = TrainingErrors(1, seen, [np.array([error]) for error in (1e-2, 1e-3, 1e-4)])
    weights = LEAST_WEIGHT + np.exp(-np.array([0.0, 1.0, 4.0]))
    expected = (weights * [20.0, 30.0, 40.0]).sum() / weights.sum()
    # float32 directions.
    assert train.seen_alike_db(look([0], [(0, 0, 1)], 1.0))[0] == pytest.approx(expected, abs=1e-4)


def test_oblique_photographs_are_judged_by_oblique_ones() -> None:
    """Cells as good from above as they are poor from aside: the mean of all tells nothing."""
    rng, count = np.random.default_rng(0), 600
    quality_db = rng.uniform(-6, 6, count)
    rows, above, aside = list(range(count)), [(0.0, 0.0, 1.0)] * count, [(1.0, 0.0, 0.5)] * count
    squared = {1: 10 ** (-(25 + quality_db) / 10), -1: 10 ** (-(25 - quality_db) / 10)}
    seen = [look(rows, above, 1.0), look(rows, aside, 1.0)]
    train = TrainingErrors(count, seen, [squared[1], squared[-1]])
    held = [look(rows[:300], above[:300], 1.0), look(rows[300:], aside[300:], 1.0)] * 2
    errors = [squared[1][:300], squared[-1][300:]] * 2
    rank = fit_errors(error_samples(train, np.zeros(count), held, errors)).rank
    assert np.ptp(train.typical_db()) < 1e-9
    assert rank is not None and rank > 0.95


def test_a_smaller_picture_shows_the_same_facets_by_wider_pixels() -> None:
    cameras = cameras_above([(0.0, 0.0)])
    ones = np.ones(2, np.float32)
    pixels = np.array([[20.5, 10.5], [3.0, 4.0]], np.float32)
    sighting = Sighting(rows=np.array([0, 1]), pixels=pixels, gsd=2 * ones, toward=np.zeros((2, 3), np.float32), facing=ones)
    small = cameras.scaled(int(cameras.sizes_wh.max()) // 2)
    shares = (small.sizes_wh / cameras.sizes_wh)[0]
    seen = sighting.scaled(shares)
    np.testing.assert_allclose(seen.pixels, pixels * shares, rtol=1e-6)
    # z / f, and f is scaled as the width.
    np.testing.assert_allclose(seen.gsd, 2 * cameras.Ks[0, 0, 0] / small.Ks[0, 0, 0], rtol=1e-6)
    np.testing.assert_array_equal(seen.rows, sighting.rows)


def test_what_nothing_shows_has_no_prediction() -> None:
    model = fit_errors(made_up())
    assert np.isnan(model.predict(np.array([np.nan]), np.array([1.0]))).all()


def test_errors_are_those_about_the_pixel() -> None:
    splats = ground_splats()
    cameras = cameras_above([(0.0, 0.0)])
    view = next(iter(render_views(splats, cameras)))
    image = view.image_bytes.copy()
    image[10, 20] = (image[10, 20].astype(int) + 100) % 256
    pixels = np.array([[20.5, 10.5], [5.5, 5.5]], np.float32)
    ones = np.ones(2, np.float32)
    sighting = Sighting(rows=np.array([3, 7]), pixels=pixels, gsd=ones, toward=np.zeros((2, 3), np.float32), facing=ones)
    (errors,) = errors_in_views(splats, cameras, lambda _: image, [sighting], 1.0)
    assert errors[0] == pytest.approx(np.square(view.image[10, 20] - image[10, 20] / 255).mean(), rel=0.05)
    # Half a level of rounding at most.
    assert errors[1] <= (0.5 / 255) ** 2 * 1.01
    means = mean_errors_db(9, [sighting], [errors])
    assert np.isnan(means[[0, 1, 2, 4]]).all()
    assert means[3] == pytest.approx(-10 * np.log10(errors[0]))
