"""How well ground control or accurate positions fix a scale: the formula, what counts, and the truth of the town."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.frames import geodetic_from_enu
from radiant_core.geometry.align import fit_sim3
from radiant_core.sfm.control.place import survey_record
from radiant_core.sfm.control.quality import PointQuality
from radiant_core.sfm.control.scale import scale_by_points, scale_by_positions
from radiant_core.sfm.control.survey import adjust_to_survey
from tests.core.sfm.control.surveyed_town import TRUE_ORIGIN, control, found_model, photographs
from tests.core.sfm.control.test_survey import true_centers

PLACES_M = np.array([[0.0, 0, 0], [100, 0, 0], [0, 100, 0], [100, 100, 0]])
SPREAD_M = np.sqrt(4 * 5000.0)
SIGMAS_M = np.full(3, 0.02)


def point(off_m: float, *, is_check: bool = False, counts: bool = True) -> PointQuality:
    triple = (off_m, off_m, off_m)
    return PointQuality(
        name="p", is_check=is_check, num_images=3, residual_m=triple, expected_m=triple, residual_px=0.3, num_counting=3, counts=counts
    )


def test_a_scale_is_as_sure_as_what_points_are_off_by_over_their_spread() -> None:
    assert scale_by_points([point(0.05)] * 4, PLACES_M, SIGMAS_M) == pytest.approx(0.05 / SPREAD_M)
    # A point that is pulled to where it was surveyed is off by nothing; the survey is not that good.
    assert scale_by_points([point(0.0)] * 4, PLACES_M, SIGMAS_M) == pytest.approx(0.02 / SPREAD_M)
    checks = [point(0.3, is_check=True)] * 4
    both = np.sqrt((0.05**2 + 0.3**2) / 2)
    assert scale_by_points([*[point(0.05)] * 4, *checks], PLACES_M, SIGMAS_M) == pytest.approx(both / SPREAD_M)


def test_what_does_not_count_fixes_nothing() -> None:
    left = [point(0.05), point(0.05), point(9.0, counts=False), point(9.0, counts=False)]
    assert scale_by_points(left, PLACES_M, SIGMAS_M) == pytest.approx(0.05 / np.sqrt(2 * 50.0**2))
    assert scale_by_points([point(1.0, counts=False)] * 4, PLACES_M, SIGMAS_M) is None
    assert scale_by_points([], np.zeros((0, 3)), SIGMAS_M) is None
    assert scale_by_points([point(0.05)], PLACES_M[:1], SIGMAS_M) is None
    assert scale_by_positions(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3))) is None


@pytest.mark.parametrize("by", ["control", "a local list", "positions"])
def test_the_scale_of_the_town_is_off_by_no_more_than_is_said(by: str) -> None:
    model, truth, rng = found_model(), true_centers(), np.random.default_rng(3)
    photos, points = photographs(model), control()
    if by == "positions":
        placed = [tuple(geodetic_from_enu((truth[p.name] + rng.normal(scale=0.03, size=3))[None], TRUE_ORIGIN)[0]) for p in photos]
        photos = tuple(replace(photo, lat_lon_alt=place, position_sigma_m=(0.03,) * 3) for photo, place in zip(photos, placed, strict=True))
    if by == "a local list":
        points = replace(points, origin_lat_lon_alt=None, system="LOCAL")
    surveyed = adjust_to_survey(model, photos, None if by == "positions" else points, lambda progress: None)
    assert surveyed is not None and surveyed.scale_sigma is not None
    images = list(model.images.values())
    fit = fit_sim3([image.projection_center() for image in images], [truth[image.name] for image in images])
    # Five points of 2 cm about 50 m apart, or sixty positions of 3 cm: some 0.1 to 0.4 per mille.
    assert 2e-5 < surveyed.scale_sigma < 6e-4
    assert abs(np.log(fit.scale)) < 3 * surveyed.scale_sigma
    assert survey_record(surveyed)["scale_sigma"] == surveyed.scale_sigma
