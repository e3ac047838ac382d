"""The strip from above shows places, heights, colours and counts of a made-up model where they are;
far origins, poison, huge strips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.evaluate.border_strip import BorderStrip, render_border_strip
from radiant_core.splats import SH_C0, Splats
from tests.core.scenes import ground_splats

ENDS = np.array([[-3.0, -1.0], [3.0, 1.0]])


def strip_of(splats: Splats, ends: np.ndarray = ENDS, half_width_m: float = 2.0) -> BorderStrip:
    return render_border_strip(splats, ends, half_width_m=half_width_m, px_m=0.05, backend="native")


def marker(place_m: tuple[float, float, float], color: tuple[float, float, float], sigma_m: float = 0.08) -> Splats:
    return Splats(
        means=np.array([place_m]),
        quats=np.array([[1.0, 0, 0, 0]]),
        log_scales=np.full((1, 3), np.log(sigma_m)),
        logit_opacities=np.array([6.0]),
        sh0=((np.array(color) - 0.5) / SH_C0)[None, None],
        shN=np.zeros((1, 0, 3)),
    )


@pytest.mark.parametrize("place", [(0.0, 0.0), (2.0, 1.0), (-2.0, 0.8)])
def test_a_marker_lies_at_its_place_and_height(place: tuple[float, float]) -> None:
    strip = strip_of(marker((*place, 7.0), (1.0, 0.2, 0.1)))
    along = (ENDS[1] - ENDS[0]) / np.linalg.norm(ENDS[1] - ENDS[0])
    s, t = place @ along, place @ np.array([-along[1], along[0]])
    row, column = np.unravel_index(strip.alpha.argmax(), strip.alpha.shape)
    # The left of the border is in the upper rows.
    assert row == pytest.approx(40 - t / 0.05 - 0.5, abs=0.51)
    assert column == pytest.approx(strip.alpha.shape[1] / 2 + s / 0.05 - 0.5, abs=0.51)
    # float32 depths from the altitude of 630 m keep 6e-5 m.
    assert strip.height_m[row, column] == pytest.approx(7.0, abs=1e-3)
    assert np.isnan(strip.height_m[0, 0]) or strip.alpha[0, 0] > 0
    assert strip.density.sum() * 0.05**2 == pytest.approx(1 / (1 + np.exp(-6.0)))
    # α is capped at 0.999.
    np.testing.assert_allclose(strip.image[row, column], strip.alpha[row, column] * np.array([1.0, 0.2, 0.1]), atol=2e-3)


def test_the_other_direction_is_the_strip_turned_round() -> None:
    splats = ground_splats(800)
    there, back = strip_of(splats), strip_of(splats, ENDS[::-1])
    # Rays differ by 1/100 of what stands out of the ground: 0.6 m at the ends move by a twentieth
    # of a pixel.
    np.testing.assert_allclose(there.image, back.image[::-1, ::-1], atol=2e-3)


def test_an_origin_far_away_changes_nothing() -> None:
    # 65,536 m and 1/128 m steps: float32 holds both exactly, so only our own arithmetic could lose
    # digits.
    splats = ground_splats(800)
    near = replace(splats, means=np.round(splats.means * 128) / 128)
    shift = np.array([65536.0, -65536.0, 0.0])
    np.testing.assert_array_equal(strip_of(near).image, strip_of(replace(near, means=near.means + shift), ENDS + shift[:2]).image)


def test_what_hangs_in_the_air_does_not_hide_the_ground() -> None:
    from radiant_core.splats import concatenate_splats

    ground = ground_splats(800)
    sky = marker((0.0, 0.0, 300.0), (0.0, 0.0, 1.0), sigma_m=60.0)
    # The middle height moves by one place in the order of 800, and rounding with it.
    np.testing.assert_allclose(strip_of(ground).image, strip_of(concatenate_splats([ground, sky])).image, atol=1e-3)


def test_a_border_outside_the_model_is_empty() -> None:
    strip = strip_of(ground_splats(300), ENDS + 1e6)
    assert strip.alpha.max() == 0
    assert np.isnan(strip.height_m).all()
    assert strip.density.sum() == 0


@pytest.mark.parametrize(
    ("ends", "half_width_m", "said"),
    [
        (np.zeros((2, 2)), 2.0, "strip of"),
        (np.array([[0.0, 0.0], [1e6, 0.0]]), 2.0, "20 million"),
        (np.array([[0.0, np.nan], [1.0, 0.0]]), 2.0, "not finite"),
        (ENDS, 0.01, "half_width_m"),
        (ENDS, np.inf, "half_width_m"),
    ],
)
def test_bad_borders_are_refused(ends: np.ndarray, half_width_m: float, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        strip_of(ground_splats(100), ends, half_width_m)
