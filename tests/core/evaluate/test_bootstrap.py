"""The paired bootstrap: how often its bounds hold, against scipy, and input without information."""

from __future__ import annotations

import time

import numpy as np
import pytest
import scipy.stats

from radiant_core.errors import BadInput
from radiant_core.evaluate.bootstrap import PairedDifference, paired_bootstrap


def made_up(rng: np.random.Generator, shape: tuple[int, int], of_seed: float, of_image: float, of_both: float) -> np.ndarray:
    """Differences with mean 0 and these standard deviations."""
    seeds, images = shape
    return of_seed * rng.normal(size=(seeds, 1)) + of_image * rng.normal(size=images) + of_both * rng.normal(size=shape)


def coverage(shape: tuple[int, int], spreads: tuple[float, float, float], repeats: int, num_draws: int) -> tuple[float, float, float]:
    """How often the true difference, 0.3, is between the bounds, above and below one."""
    rng = np.random.default_rng(7)
    held = np.zeros(3)
    for seed in range(repeats):
        other = rng.normal(30, 5, size=shape)
        found = paired_bootstrap(other + 0.3 + made_up(rng, shape, *spreads), other, num_draws=num_draws, seed=seed)
        held += [found.low <= 0.3 <= found.high, found.at_least <= 0.3, found.at_most >= 0.3]
    return tuple(held / repeats)


@pytest.mark.parametrize(
    ("shape", "spreads"),
    [((3, 10), (0, 1, 0.3)), ((3, 10), (1, 0, 0.1)), ((1, 12), (0, 1, 0)), ((5, 30), (1, 1, 1))],
    ids=["images differ", "seeds differ", "one seed", "both differ"],
)
def test_bounds_hold_about_as_often_as_they_say(shape: tuple[int, int], spreads: tuple[float, float, float]) -> None:
    # 300 repeats of a share of 0.95 scatter by 0.0126; three of these on either side, and residuals
    # are counted twice.
    for share in coverage(shape, spreads, repeats=300, num_draws=600):
        assert 0.91 <= share <= 0.995


def test_with_one_seed_it_is_scipys_bootstrap_widened_for_few_images() -> None:
    difference = np.random.default_rng(3).gamma(2.0, size=12)
    found = paired_bootstrap(difference[None] + 25.0, np.full((1, 12), 25.0), num_draws=50_000)
    reference = scipy.stats.bootstrap((difference,), np.mean, n_resamples=50_000, method="percentile", rng=np.random.default_rng(1))
    widening = np.sqrt(12 / 11) * scipy.stats.t.ppf(0.975, 11) / scipy.stats.norm.ppf(0.975)
    mean = difference.mean()
    assert found.mean == pytest.approx(mean, abs=1e-12) and found.degrees_of_freedom == pytest.approx(11)
    # Quantiles of 50,000 draws scatter by about 1 % of a standard error (0.4).
    for bound, plain in ((found.low, reference.confidence_interval.low), (found.high, reference.confidence_interval.high)):
        assert bound == pytest.approx(mean + widening * (plain - mean), abs=0.02)


def test_scenes_count_alike_whatever_their_number_of_images() -> None:
    small, large = np.full((3, 4), 1.0), np.full((2, 40), 2.0)
    found = paired_bootstrap([small, large], [np.zeros((3, 4)), np.zeros((2, 40))])
    assert (found.mean, found.low, found.high) == (1.5, 1.5, 1.5)
    assert (found.num_scenes, found.num_images, found.num_seeds) == (2, 44, 2)


def test_what_is_common_to_both_methods_does_not_matter() -> None:
    rng = np.random.default_rng(4)
    difference, common = made_up(rng, (3, 10), 0.1, 0.5, 0.1), rng.normal(28, 6, size=(3, 10))
    with_it, without = paired_bootstrap(common + difference, common), paired_bootstrap(difference, np.zeros((3, 10)))
    assert [with_it.low, with_it.high] == pytest.approx([without.low, without.high], abs=1e-9)


def test_bounds_are_ordered_repeat_exactly_and_change_sides_with_the_methods() -> None:
    rng = np.random.default_rng(5)
    a, b = rng.normal(30, 1, size=(2, 3, 10))
    found = paired_bootstrap(a, b)
    assert found == paired_bootstrap(a, b) != paired_bootstrap(a, b, seed=1)
    assert found.low < found.at_least < found.mean < found.at_most < found.high
    assert paired_bootstrap(b, a).low == pytest.approx(-found.high, abs=0.05)
    wider = paired_bootstrap(a, b, confidence=0.99)
    assert wider.low < found.low and wider.high > found.high


def test_ten_thousand_draws_take_a_moment() -> None:
    a = np.random.default_rng(6).normal(size=(3, 10))
    best_s = np.inf
    for _ in range(5):
        start_s = time.process_time()
        paired_bootstrap(a, np.zeros((3, 10)), num_draws=10_000)
        best_s = min(best_s, time.process_time() - start_s)
    assert best_s < 0.2


def test_equal_methods_differ_by_exactly_nothing() -> None:
    a = np.random.default_rng(8).normal(30, 3, size=(3, 10))
    found = paired_bootstrap(a, a)
    assert (found.mean, found.low, found.high, found.at_least, found.at_most) == (0.0,) * 5
    assert found.degrees_of_freedom == np.inf
    always = paired_bootstrap(a * 0 + 0.1, a * 0)
    assert always.mean == always.low == always.high == 0.1


def test_huge_and_tiny_differences_keep_their_digits() -> None:
    d = made_up(np.random.default_rng(9), (3, 8), 1, 1, 1)
    expected = paired_bootstrap(d, np.zeros((3, 8)))
    for scale in (1e-60, 1e60):
        found = paired_bootstrap(scale * d, np.zeros((3, 8)))
        assert isinstance(found, PairedDifference)
        assert [found.low / scale, found.high / scale] == pytest.approx([expected.low, expected.high], rel=1e-9)


FINE = np.ones((3, 10))


@pytest.mark.parametrize(
    ("a", "b", "options", "told"),
    [
        (FINE, FINE[:2], {}, "same seeds on the same images"),
        ([FINE, FINE], [FINE], {}, "same seeds on the same images"),
        (FINE[:, :1], FINE[:, :1], {}, "3 seeds and 1 images"),
        (FINE[:0], FINE[:0], {}, "0 seeds"),
        (FINE * np.nan, FINE, {}, "not finite"),
        (FINE, np.where(np.eye(3, 10), np.inf, 1), {}, "not finite"),
        (FINE * 1e308, FINE * -1e308, {}, "not finite"),
        (FINE * 1e200, FINE, {}, "expected figures of images"),
        (FINE[0], FINE[0], {}, "shape"),
        ([], [], {}, "one per scene"),
        ("figures", FINE, {}, "one per scene"),
        (FINE, FINE, {"confidence": 95}, "confidence"),
        (FINE, FINE, {"confidence": float("nan")}, "confidence"),
        (FINE, FINE, {"num_draws": 10}, "num_draws"),
    ],
)
def test_poison_is_bad_input(a: object, b: object, options: dict, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        paired_bootstrap(a, b, **options)
