"""Ground control and RTK on the sample town, whose truth is known: errors of check points, what was expected, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic, geodetic_from_enu
from radiant_core.io.colmap.model import read_model
from radiant_core.sfm.control.bundle import bundle_of, write_back
from radiant_core.sfm.control.counting import require_counting
from radiant_core.sfm.control.intersect import intersect_rays, refine_points
from radiant_core.sfm.control.place import survey_record
from radiant_core.sfm.control.quality import PointQuality
from radiant_core.sfm.control.survey import Surveyed, adjust_to_survey
from tests.core.sfm.control.surveyed_town import TOWN, TRUE_ORIGIN, control, found_model, photographs
from tests.seeds import for_seeds


def true_centers() -> dict[str, np.ndarray]:
    return {image.name: -image.cam_from_world[:3, :3].T @ image.cam_from_world[:3, 3] for image in read_model(TOWN / "known").images}


def center_errors_m(model, surveyed: Surveyed) -> np.ndarray:
    """Distances of adjusted camera centres from the truth, in its frame (C,)."""
    truth = true_centers()
    lat_lon_alt = geodetic_from_enu([image.projection_center() for image in model.images.values()], surveyed.frame.origin_lat_lon_alt)
    found = enu_from_geodetic(lat_lon_alt, TRUE_ORIGIN)
    return np.linalg.norm(found - np.array([truth[image.name] for image in model.images.values()]), axis=1)


@for_seeds(2)
def test_check_points_of_the_town_are_off_by_what_was_expected(seed: int) -> None:
    model = found_model(seed)
    surveyed = adjust_to_survey(model, photographs(model), control(seed), lambda progress: None)
    assert surveyed is not None and surveyed.check is not None and surveyed.control is not None
    assert (surveyed.control.num_points, surveyed.check.num_points) == (5, 10)
    # 2 cm of noise in control and check points, 0.3 px in marks; 30 residuals scatter by 13 %, so
    # one draw may lie 30 % off where the σ is right.
    assert surveyed.check.rms_axis_m < 0.038
    assert 0.7 < surveyed.check.rms_axis_m / surveyed.check.expected_axis_m < 1.35
    assert surveyed.tie_sigma_px == pytest.approx(0.3, rel=0.15) and surveyed.mark_sigma_px == pytest.approx(0.3, rel=0.15)
    # A centre is known less well than the ground: it may slide along where its photograph looks.
    assert np.median(center_errors_m(model, surveyed)) < 0.15
    assert surveyed.warnings == ()


@pytest.mark.stress
def test_the_sigma_is_right_over_many_draws() -> None:
    squares, expected = [], []
    for seed in range(8):
        model = found_model(seed)
        surveyed = adjust_to_survey(model, photographs(model), control(seed), lambda progress: None)
        assert surveyed is not None and surveyed.check is not None
        squares.append(surveyed.check.rms_axis_m**2)
        expected.append(surveyed.check.expected_axis_m**2)
    # 240 residuals: their RMS scatters by 5 %, and 12 % would be more than twice that.
    assert np.sqrt(np.mean(squares) / np.mean(expected)) == pytest.approx(1.0, abs=0.12)
    assert np.sqrt(np.mean(squares)) < 0.03


def test_the_bowl_is_taken_out_and_ties_still_fit() -> None:
    model = found_model(noise_px=0.0)
    surveyed = adjust_to_survey(model, photographs(model), control(noise_m=0.0, noise_px=0.0, sigma_m=0.001), lambda progress: None)
    assert surveyed is not None and surveyed.check is not None
    # Coordinates in the list are rounded to 0.1 mm, pixels of ties and marks to 0.01 px.
    assert surveyed.check.rms_axis_m < 0.002
    assert center_errors_m(model, surveyed).max() < 0.01
    assert model.compute_mean_reprojection_error() < 0.05


def test_positions_of_known_accuracy_place_the_scene_alone() -> None:
    # All points: only many ties hold photographs together better than a receiver alone.
    model, truth, rng = found_model(kept_every=1), true_centers(), np.random.default_rng(5)
    photos = tuple(
        replace(
            photo,
            lat_lon_alt=tuple(geodetic_from_enu((truth[photo.name] + rng.normal(scale=0.03, size=3))[None], TRUE_ORIGIN)[0]),
            position_sigma_m=(0.03, 0.03, 0.03),
        )
        for photo in photographs(model)
    )
    surveyed = adjust_to_survey(model, photos, None, lambda progress: None)
    assert surveyed is not None and surveyed.num_positions == 60
    assert surveyed.positions_rms_m == pytest.approx(0.03, rel=0.2)
    errors_m = center_errors_m(model, surveyed)
    assert np.sqrt(np.mean(errors_m**2)) < 0.03 * np.sqrt(3), "better than a receiver alone: all photographs hold together"
    alone = adjust_to_survey(found_model(), tuple(replace(photo, position_sigma_m=None) for photo in photos), None, lambda progress: None)
    assert alone is None, "positions of unknown accuracy are not adjusted to"


def test_positions_that_count_from_another_datum_do_not_bend_the_scene() -> None:
    model, truth, rng = found_model(), true_centers(), np.random.default_rng(5)
    shift = np.array([0.4, -0.3, 47.2])
    photos = tuple(
        replace(
            photo,
            lat_lon_alt=tuple(geodetic_from_enu((truth[photo.name] + shift + rng.normal(scale=0.03, size=3))[None], TRUE_ORIGIN)[0]),
            position_sigma_m=(0.03, 0.03, 0.03),
        )
        for photo in photographs(model)
    )
    surveyed = adjust_to_survey(model, photos, control(), lambda progress: None)
    assert surveyed is not None and surveyed.check is not None
    np.testing.assert_allclose(surveyed.shift_m, shift, atol=0.05)
    assert surveyed.check.rms_axis_m < 0.03


def test_a_wrong_coordinate_is_named_and_does_not_bend_the_scene() -> None:
    right = control(num_control=7)
    wrong = replace(right, places_m=right.places_m + np.eye(len(right.names))[:, [6]] * np.array([1.5, 0.0, 0.0]))
    model = found_model()
    surveyed = adjust_to_survey(model, photographs(model), wrong, lambda progress: None)
    assert surveyed is not None and surveyed.check is not None
    assert len(surveyed.warnings) == 1 and "'gcp-7' is 1." in surveyed.warnings[0]
    assert surveyed.check.rms_axis_m < 0.06


def test_a_site_without_a_place_gets_metres_and_up_from_three_points() -> None:
    placed = control(num_control=3, num_check=4)
    local = replace(placed, origin_lat_lon_alt=None, system="LOCAL")
    model = found_model()
    surveyed = adjust_to_survey(model, photographs(model), local, lambda progress: None)
    assert surveyed is not None and surveyed.check is not None
    assert surveyed.frame.kind == "scaled" and surveyed.check.rms_axis_m < 0.06
    record = survey_record(surveyed)
    assert record["check"]["num_points"] == 4 and len(record["points"]) == 7


def test_what_does_not_fix_a_scene_is_refused() -> None:
    for wrong, said in (
        (replace(control(), is_check=np.ones(15, bool)), "kept out for checking, and no positions of known accuracy"),
        (replace(control(), mark_images=("nowhere.jpg",) * len(control().mark_images)), "is in a photograph that was placed"),
        (replace(control(), places_m=control().places_m * [1.0, 0.0, 0.0]), "lie on a line"),
    ):
        model = found_model()
        with pytest.raises(BadInput, match=said):
            adjust_to_survey(model, photographs(model), wrong, lambda progress: None)


def test_derivatives_are_what_small_moves_do() -> None:
    bundle, ties = bundle_of(found_model())
    rng = np.random.default_rng(0)
    turns, shifts, lens = (1e-5 * rng.normal(size=shape) for shape in ((60, 3), (60, 3), (1, bundle.most_free)))
    moves = 1e-5 * rng.normal(size=bundle.points.shape)
    pixels, by_pose, by_lens, by_point = bundle.derivatives(ties.images, bundle.points[ties.points])
    moved = bundle.moved(turns, shifts, lens, bundle.points + moves)
    linear = (
        np.einsum("kij,kj->ki", by_pose, np.hstack([turns, shifts])[ties.images])
        + np.einsum("kij,kj->ki", by_lens, lens[bundle.lens_of_image[ties.images]])
        + np.einsum("kij,kj->ki", by_point, moves[ties.points])
    )
    # 1e-4 of the move: what is left is its square.
    real = moved.project(ties.images, moved.points[ties.points]) - pixels
    assert np.abs(real - linear).max() < 1e-4 * np.abs(real).max() + 1e-8


def test_a_bundle_comes_back_as_it_was_written() -> None:
    model = found_model()
    bundle, _ = bundle_of(model)
    shifted = bundle.moved(np.full((60, 3), 1e-3), np.full((60, 3), 0.5), np.zeros((1, bundle.most_free)), bundle.points + 1.0)
    write_back(shifted, model)
    again, _ = bundle_of(model)
    np.testing.assert_allclose(again.centers, shifted.centers, atol=1e-9)
    np.testing.assert_allclose(again.points, shifted.points, atol=1e-12)


def test_rays_meet_where_points_are() -> None:
    model = found_model(noise_px=0.0)
    bundle, ties = bundle_of(model)
    # The bowl moved cameras and not points: what they see now meets elsewhere, nearby.
    clean, _ = bundle_of(model)
    own = ties.at(np.isin(ties.points, np.arange(50)))
    pixels = bundle.project(own.images, bundle.points[own.points])
    exact = replace(own, pixels=pixels)
    found = intersect_rays(clean, exact, 50)
    assert np.nanmax(np.abs(found - bundle.points[:50])) < 1e-6
    np.testing.assert_allclose(refine_points(clean, exact, bundle.points[:50] + 0.01), bundle.points[:50], atol=1e-6)
    assert np.isnan(intersect_rays(clean, exact.at(np.arange(1)), 1)).all(), "one ray fixes no point"


def test_a_list_without_check_points_says_of_its_control_alone() -> None:
    model = found_model()
    surveyed = adjust_to_survey(model, photographs(model), control(num_check=0), lambda progress: None)
    assert surveyed is not None and surveyed.check is None and surveyed.control is not None
    assert (surveyed.control.num_points, surveyed.control.num_counting) == (5, 5)
    assert survey_record(surveyed)["check"] is None


def test_points_may_be_checks_alone_where_positions_of_known_accuracy_place_the_scene() -> None:
    model, truth = found_model(), true_centers()
    photos = tuple(
        replace(
            photo,
            lat_lon_alt=tuple(geodetic_from_enu(truth[photo.name][None], TRUE_ORIGIN)[0]),
            position_sigma_m=(0.03, 0.03, 0.03),
        )
        for photo in photographs(model)
    )
    checks = replace(control(), is_check=np.ones(15, bool))
    surveyed = adjust_to_survey(model, photos, checks, lambda progress: None)
    assert surveyed is not None and surveyed.control is None and surveyed.check is not None
    assert surveyed.check.num_points == 15 and surveyed.check.rms_axis_m < 0.1


@pytest.mark.parametrize("num_wrong", [1, 3])
def test_marks_that_lost_their_weight_do_not_count(num_wrong: int) -> None:
    """Without a count such a point reads 0 mm: it stays where it was surveyed."""
    right = control(num_check=0)
    wrong = right.mark_points < num_wrong
    pixels = np.where(wrong[:, None], right.mark_pixels[:, ::-1] * 0.8 + 60, right.mark_pixels)
    model = found_model()
    if num_wrong > 2:
        with pytest.raises(BadInput, match=r"ground control does not fit the photographs: \d of 5 points count"):
            adjust_to_survey(model, photographs(model), replace(right, mark_pixels=pixels), lambda progress: None)
        return
    surveyed = adjust_to_survey(model, photographs(model), replace(right, mark_pixels=pixels), lambda progress: None)
    assert surveyed is not None and surveyed.control is not None
    assert (surveyed.control.num_counting, surveyed.control.num_points) == (4, 5)
    assert not surveyed.points[0].counts and any("gcp-1" in warning for warning in surveyed.warnings)


@pytest.mark.parametrize(
    ("counting", "total", "checked", "said"),
    [
        (3, 5, False, "3 of 5 points count, expected half of them and 4 or more, for any 3 nearly fit .p3: 0 of 4 marks fit; p4"),
        (3, 4, False, "3 of 4 points count, expected half of them and 4 or more"),
        (2, 3, True, "2 of 3 points count, expected half of them and 3 or more"),
        (4, 9, True, "4 of 9 points count, expected half of them and 3 or more"),
        (3, 5, True, None),
        (3, 3, False, None),
        (4, 5, False, None),
    ],
)
def test_three_that_are_left_have_to_be_checked_by_others(counting: int, total: int, checked: bool, said: str | None) -> None:
    """Any three nearly fit: without a fourth, or check points, nobody knows which of the others were wrong."""
    triple = (0.01, 0.01, 0.01)
    points = tuple(
        PointQuality(
            name=f"p{row}", is_check=False, num_images=4, residual_m=triple, expected_m=triple, residual_px=0.3,
            num_counting=4 * (row < counting), counts=row < counting,
        )
        for row in range(total)
    )  # fmt: skip
    if said is None:
        require_counting(points, np.full(3, 0.02), 100.0, checked=checked)
        return
    with pytest.raises(BadInput, match=said):
        require_counting(points, np.full(3, 0.02), 100.0, checked=checked)


def test_control_that_is_worse_than_was_said_puts_the_frame_in_doubt() -> None:
    """Two of five off by metres pull all of them: each is within four times what is usual, and all of it is bad."""
    right = control(num_control=5)
    places_m = right.places_m.copy()
    places_m[np.flatnonzero(~right.is_check)[:2]] += [[2.0, -1.5, 3.0], [-2.5, 1.0, -2.0]]
    model = found_model()
    surveyed = adjust_to_survey(model, photographs(model), replace(right, places_m=places_m), lambda progress: None)
    assert surveyed is not None
    assert any("ground control misses the photographs by" in doubt and "than ± 0.02 m" in doubt for doubt in surveyed.doubts)
    model = found_model()
    surveyed = adjust_to_survey(model, photographs(model), right, lambda progress: None)
    assert surveyed is not None and surveyed.doubts == ()
