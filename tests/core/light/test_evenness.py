"""Gains that explain whole pictures are exposures; those that do not are something else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.light.evenness import MIN_OBSERVATIONS, evenness, parts_of
from radiant_core.light.solve import Observations, solve_lights
from radiant_core.regimes import LIGHT_EVENNESS
from tests.core.light.test_solve import CAMERAS, NUM_VIEWS, planted


def observed_in_parts(rng: np.random.Generator, noise: float, by_part: float) -> Observations:
    """Exposures of 0.2, noise of each observation, and brightness that differs by `by_part` from
    part to part of each picture."""
    observed, _ = planted(rng, num_places=4_000, noise=noise)
    part = rng.integers(0, 9, len(observed.view))
    shades = rng.normal(0, by_part, (NUM_VIEWS, 9))
    return replace(observed, logs=observed.logs + shades[observed.view, part][:, None], part=part)


@pytest.mark.parametrize(("noise", "by_part", "is_exposure"), [(0.0, 0.0, True), (0.3, 0.0, True), (0.05, 0.03, True), (0.05, 0.4, False)])
def test_gains_are_exposures_where_they_explain_all_parts(noise: float, by_part: float, is_exposure: bool) -> None:
    """Noise of places alone, however large, is no reason to doubt gains; shades are."""
    lights = solve_lights(observed_in_parts(np.random.default_rng(5), noise, by_part), CAMERAS)
    assert lights.spread > 0.1
    assert (lights.evenness >= LIGHT_EVENNESS) == is_exposure == lights.is_worth_modelling


def test_the_ratio_is_that_of_the_planted_spreads() -> None:
    """Gains of 0.2 over shades of 0.1, less their mean over a picture, which counts as gain, and the
    fifth of each that is the mean of its place."""
    lights = solve_lights(observed_in_parts(np.random.default_rng(6), 0.0, 0.1), CAMERAS)
    assert lights.evenness == pytest.approx(lights.spread / (0.8 * 0.1 * np.sqrt(8 / 9)), rel=0.1)


def test_too_few_observations_or_none_tell_nothing() -> None:
    few = np.arange(MIN_OBSERVATIONS - 1)
    assert evenness(0.1, np.ones(len(few)), np.zeros(len(few), np.int64), np.zeros(len(few), np.int64)) == np.inf
    assert evenness(0.1, np.full(50, np.nan), np.zeros(50, np.int64), np.zeros(50, np.int64)) == np.inf
    assert evenness(0.1, np.zeros(50), np.zeros(50, np.int64), np.zeros(50, np.int64)) == np.inf


def test_parts_count_rows_of_three_to_the_very_edge() -> None:
    pixels = np.array([[0, 0], [299, 0], [150, 100], [299, 199], [100, 66], [99, 67]])
    assert parts_of(pixels, np.tile([300, 200], (6, 1))).tolist() == [0, 2, 4, 8, 1, 3]
