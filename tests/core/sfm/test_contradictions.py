"""A length, a north and an up that differ from the photographs' GPS: what is noise, what is said, what stops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.photos.listing import Photograph
from radiant_core.sfm.gps_outliers import GpsOutliers
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.sfm.world_frame.world import PlacedScene, scene_in_world
from tests.core.sfm.test_world import flight, grid, ground, in_any_frame, photographs_at

NOISE_M = 0.5


def site(noise_m: float = NOISE_M) -> tuple[ColmapModel, tuple[Photograph, ...], np.ndarray]:
    """A flight at 40 m with GPS, and the true centres."""
    rng = np.random.default_rng(11)
    positions_m = grid(rng, 40)
    cameras, points = flight(positions_m, rng, pitch_deg=60.0), ground(rng)
    photos = photographs_at(cameras.names, positions_m + rng.normal(scale=noise_m, size=(40, 3)))
    return in_any_frame(cameras, points, rng), photos, positions_m


def placed(**fields: Any) -> PlacedScene:
    model, photos, _ = site()
    return scene_in_world(model, photos, 0, Placement(**fields))


def height_by_gps() -> float:
    scene = placed().scene
    return float(np.median(scene.cameras.centers[scene.observations[:, 1], 2] - scene.points[scene.observations[:, 0], 2]))


@pytest.mark.parametrize(
    ("times", "said"),
    [(1.0, None), (1.02, None), (1.12, "is taken, which makes the scene 1.1"), (0.9, "is taken"), (2.0, "stop"), (0.5, "stop")],
)
def test_a_length_is_compared_with_gps(times: float, said: str | None) -> None:
    height_m = times * height_by_gps()
    apart_m = float(np.linalg.norm(np.subtract(*placed().scene.cameras.centers[:2])))
    for fields in ({"height_m": height_m}, {"distance": f"000.jpg,001.jpg,{times * apart_m}"}):
        if said == "stop":
            with pytest.raises(BadInput, match=r"contradict each other: by GPS, whose scale is known to .* with --contradictions warn"):
                placed(**fields)
            found = placed(**fields, contradictions="warn")
            assert any("contradict each other" in warning for warning in found.doubts)
            continue
        found = placed(**fields)
        assert (found.warnings == ()) == (said is None)
        assert said is None or said in found.warnings[0]


def test_a_height_in_feet_is_named() -> None:
    with pytest.raises(BadInput, match="the figure may be in feet"):
        placed(height_m=height_by_gps() / 0.3048)


def heading_deg() -> float:
    looks = placed().scene.cameras.cam_from_world[0, 2, :2]
    return float(np.degrees(np.arctan2(looks[0], looks[1])))


@pytest.mark.parametrize(("off_deg", "stops"), [(0, False), (7, False), (-7, False), (25, True), (180, True), (-90, True)])
def test_north_that_agrees_with_gps_is_no_reason_to_stop(off_deg: float, stops: bool) -> None:
    north = f"000.jpg,{(heading_deg() + off_deg) % 360}"
    if stops:
        with pytest.raises(BadInput, match=rf"the photograph looks to {heading_deg() % 360:.0f}°, {abs(off_deg)}° away"):
            placed(north=north)
        turned = placed(north=north, contradictions="warn").scene.cameras.cam_from_world[0, 2, :2]
        miss_deg = (np.degrees(np.arctan2(turned[0], turned[1])) - heading_deg() - off_deg + 180) % 360 - 180
        assert abs(miss_deg) < 1e-6
        return
    found = placed(north=north)
    np.testing.assert_allclose(found.scene.cameras.centers, placed().scene.cameras.centers)
    assert any(decision.choice == "north by GPS, with which --north agrees" for decision in found.decisions)


def test_up_that_gps_has_elsewhere_is_said_and_taken() -> None:
    model, photos, _ = site()
    up = scene_in_world(model, photos, 0).world_from_model.rotation
    leaning = up.T @ np.array([np.sin(np.radians(40.0)), 0.0, np.cos(np.radians(40.0))])
    found = scene_in_world(model, photos, 0, Placement(up=",".join(str(value) for value in leaning)))
    assert any("puts up 40° away from where the photographs' GPS has it" in warning for warning in found.doubts)
    straight = scene_in_world(model, photos, 0, Placement(up=",".join(str(value) for value in up[2])))
    assert straight.doubts == ()


def test_positions_that_count_are_counted_and_the_others_named() -> None:
    model, photos, positions_m = site()
    told_m = positions_m.copy()
    told_m[:5] += (0.0, 300.0, 0.0)
    names = tuple(photo.name for photo in photos)
    count = scene_in_world(model, photographs_at(names, told_m), 0).positions
    assert count is not None and (count.num_positions, count.num_counting) == (40, 35)
    assert {name for name, _ in count.left_out} == set(names[:5]) and all(
        away_m == pytest.approx(300, abs=1) for _, away_m in count.left_out
    )


def test_three_positions_say_that_nothing_checks_them() -> None:
    model, photos, positions_m = site()
    told_m = np.where(np.arange(40)[:, None] < 3, positions_m, np.nan)
    found = scene_in_world(model, photographs_at(tuple(photo.name for photo in photos), told_m), 0)
    if found.scene.frame.kind == "metric":
        assert any("rest on 3 GPS positions of 40 photographs" in warning for warning in found.doubts)
    assert found.positions is not None and found.positions.num_positions == 3


@pytest.mark.parametrize(("away_m", "blames_gps"), [((23.0, 21.0), False), ((500.0, 400.0), False), ((2.1e6, 2.0e6), True)])
def test_gps_is_blamed_only_where_nothing_else_can_be_wrong(away_m: tuple[float, ...], blames_gps: bool) -> None:
    (said,) = GpsOutliers(names=("a.jpg", "b.jpg"), away_m=away_m, num_gps=12, extent_m=60.0).warning()
    assert said.startswith("the GPS positions of 2 of 12") == blames_gps
    assert ("photographs are placed wrongly" in said) != blames_gps and "(a.jpg, b.jpg)" in said


@pytest.mark.parametrize(("lean_deg", "stops"), [(40.0, False), (55.0, False), (88.0, True), (180.0, True)])
def test_up_that_turns_ground_into_walls_stops(lean_deg: float, stops: bool) -> None:
    model, photos, _ = site()
    up = scene_in_world(model, photos, 0).world_from_model.rotation
    leaning = up.T @ np.array([np.sin(np.radians(lean_deg)), 0.0, np.cos(np.radians(lean_deg))])
    fields = {"up": ",".join(str(value) for value in leaning)}
    if stops:
        with pytest.raises(
            BadInput, match=rf"--up .* puts up {lean_deg:.0f}° away .* Correct --up, .*; with --contradictions warn --up is taken"
        ):
            scene_in_world(model, photos, 0, Placement(**fields))
    found = scene_in_world(model, photos, 0, Placement(**fields, contradictions="warn"))
    assert any(f"puts up {lean_deg:.0f}° away from where the photographs' GPS has it" in warning for warning in found.doubts)


def test_altitudes_that_drift_are_not_held_against_what_is_said_of_up() -> None:
    """As in caliterra's photographs, whose altitudes would tilt the scene by 43°."""
    model, photos, positions_m = site()
    drifting = photographs_at(tuple(photo.name for photo in photos), positions_m + np.outer(0.9 * positions_m[:, 0], [0.0, 0.0, 1.0]))
    straight = ",".join(str(value) for value in scene_in_world(model, photos, 0).world_from_model.rotation[2])
    assert scene_in_world(model, drifting, 0, Placement(up=straight)).doubts == ()
    assert scene_in_world(model, drifting, 0, Placement(up="ground")).doubts == ()


@pytest.mark.parametrize(
    ("far_m", "num_gps", "in_doubt"),
    [((23.0, 21.0), 12, True), ((23.0, 21.0), 40, False), ((2.1e6, 2.0e6), 12, False), ((), 12, False)],
)
def test_many_photographs_that_may_be_placed_wrongly_put_the_scene_in_doubt(far_m: tuple[float, ...], num_gps: int, in_doubt: bool) -> None:
    """The word for quality is no "good" beside "or the photographs are placed wrongly"."""
    outliers = GpsOutliers(names=tuple("ab"[: len(far_m)]), away_m=far_m, num_gps=num_gps, extent_m=60.0)
    assert outliers.doubt() == (outliers.warning() if in_doubt else ())
