"""Haze: cover and depth against the truth, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.haze import haze_mask, haze_share
from radiant_core.errors import BadInput


def test_thin_cover_and_wrong_depth_are_haze_and_the_sky_is_not() -> None:
    true = np.array([[10.0, 10.0, 10.0, 10.0, np.inf]])
    alpha = np.array([[1.0, 0.49, 1.0, 0.5, 0.0]])
    depth = np.array([[10.9, 10.0, 8.9, 11.0, 3.0]])
    np.testing.assert_array_equal(haze_mask(alpha, depth, true), [[False, True, True, False, False]])
    assert haze_share(haze_mask(alpha, depth, true), true) == 0.5


def test_a_pixel_counts_once_the_surface_is_seen() -> None:
    true = np.array([[5.0, 5.0], [5.0, np.inf]])
    haze = haze_mask(np.ones((2, 2)), np.array([[5.0, 9.0], [9.0, 9.0]]), true)
    assert haze_share(haze, true, np.array([[True, True], [False, True]])) == 0.5
    assert haze_share(haze, true, np.zeros((2, 2), bool)) is None
    assert haze_share(haze, np.full((2, 2), np.inf)) is None


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf, 1e308])
def test_depth_that_is_no_number_is_haze(poison: float) -> None:
    assert haze_mask(np.ones((1, 1)), np.full((1, 1), poison), np.full((1, 1), 2.0)).all()
    assert haze_mask(np.full((1, 1), np.nan), np.full((1, 1), 2.0), np.full((1, 1), 2.0)).all()


def test_what_is_no_truth_is_refused() -> None:
    good = np.ones((2, 2))
    for wrong in (np.nan, 0.0, -1.0, -np.inf):
        with pytest.raises(BadInput, match="true depth"):
            haze_mask(good, good, np.full((2, 2), wrong))
    with pytest.raises(BadInput, match="one size"):
        haze_mask(good, good, np.ones((2, 3)))
    with pytest.raises(BadInput, match="one size"):
        haze_mask(np.ones(4), np.ones(4), np.ones(4))
    with pytest.raises(BadInput, match="one size"):
        haze_share(good > 0, np.ones((2, 3)))


def test_an_empty_picture_has_no_share() -> None:
    nothing = np.zeros((0, 4))
    assert haze_share(haze_mask(nothing, nothing, nothing), nothing) is None
