"""The picture of a border: the strip is there, a found seam is red, a figure that could not be taken is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radiant_core.evaluate.border_strip import BorderStrip
from radiant_core.evaluate.step_detector import PARALLELS_M, QUANTITIES, THRESHOLDS, BorderSteps
from radiant_viewer.charts.border_chart import border_picture


def made_up_steps(height_response: float) -> BorderSteps:
    rng = np.random.default_rng(0)
    image = np.zeros((40, 120, 3), np.float32)
    image[:20] = (0.1, 0.8, 0.2)
    image[20:] = (0.8, 0.1, 0.9)
    responses = {quantity: rng.uniform(-1, 1, 1 + len(PARALLELS_M)) for quantity in QUANTITIES}
    responses["height"][0] = height_response
    strip = BorderStrip(
        image=image,
        alpha=np.ones((40, 120), np.float32),
        height_m=np.zeros((40, 120)),
        density=np.zeros((40, 120)),
        px_m=0.1,
        ends=np.array([[0.0, 0.0], [12.0, 0.0]]),
    )
    return BorderSteps(steps=dict.fromkeys(QUANTITIES, 0.01), scatters=dict.fromkeys(QUANTITIES, 0.02), responses=responses, strip=strip)


def near(picture: np.ndarray, rgb: tuple[int, int, int]) -> np.ndarray:
    return np.abs(picture.astype(int) - rgb).max(axis=2) < 12


def test_the_strip_lies_left_side_up_and_a_seam_is_red() -> None:
    quiet, loud = (border_picture(made_up_steps(response), "Border") for response in (0.5, 2 * THRESHOLDS["height"]))
    left, right = near(quiet, (26, 204, 51)), near(quiet, (204, 26, 230))
    assert left.sum() > 10_000 and right.sum() > 10_000
    assert np.nonzero(left)[0].max() <= np.nonzero(right)[0].min() + 2
    vermillion = (213, 94, 0)
    assert near(loud, vermillion).sum() > 100
    assert not near(quiet, vermillion).any()


def test_what_could_not_be_taken_is_drawn_empty() -> None:
    steps = made_up_steps(0.5)
    nothing = {quantity: np.full(1 + len(PARALLELS_M), np.nan) for quantity in QUANTITIES}
    picture = border_picture(replace(steps, steps=dict.fromkeys(QUANTITIES, np.nan), responses=nothing), "Border")
    assert not near(picture, (0, 114, 178)).any()
