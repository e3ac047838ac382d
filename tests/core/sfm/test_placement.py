"""A user's up and length: obeyed, before GPS too, and refused in one sentence if impossible."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.reconstruct import reconstruct, scene_from_colmap
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.sfm.world_frame.world import scene_in_world
from tests.core.sfm.test_world import flight, grid, ground, in_any_frame, in_world, metres_of, photographs_at

NAMES = ("000.jpg", "001.jpg")


def site(seed: int = 0, pitch_deg: float = 75.0) -> tuple[Cameras, FloatArray]:
    rng = np.random.default_rng(seed)
    return flight(grid(rng), rng, pitch_deg), ground(rng)


def apart(cameras: Cameras) -> float:
    return float(np.linalg.norm(cameras.centers[0] - cameras.centers[1]))


def test_a_known_distance_makes_the_scene_metric_without_a_place() -> None:
    cameras, points = site()
    model, photos = in_any_frame(cameras, points, np.random.default_rng(1)), photographs_at(cameras.names, None)
    scene, decisions, warnings = in_world(model, photos, Placement(distance=f"000.jpg,001.jpg,{apart(cameras)}"))
    assert (scene.frame.kind, scene.frame.unit) == ("scaled", "m")
    assert not any("arbitrary" in warning for warning in warnings)
    true_m, made_m = (np.linalg.norm(each.centers[:, None] - each.centers[None], axis=2) for each in (cameras, scene.cameras))
    np.testing.assert_allclose(made_m, true_m, atol=1e-6)
    assert [decision.topic for decision in decisions if decision.forced] == ["scale"]


def test_a_known_height_is_that_over_the_ground_the_cameras_see() -> None:
    cameras, points = site()
    scene, _, _ = in_world(
        in_any_frame(cameras, points, np.random.default_rng(1)), photographs_at(cameras.names, None), Placement(height_m=40.0)
    )
    assert scene.frame.kind == "scaled"
    heights_m = scene.cameras.centers[scene.observations[:, 1], 2] - scene.points[scene.observations[:, 0], 2]
    assert np.median(heights_m) == pytest.approx(40.0)


def test_a_known_distance_goes_before_the_scale_of_gps_and_leaves_its_place() -> None:
    cameras, points = site()
    photos = photographs_at(cameras.names, cameras.centers)
    model = in_any_frame(cameras, points, np.random.default_rng(1))
    by_gps, _, _ = in_world(model, photos)
    scene, _, _ = in_world(model, photos, Placement(distance=f"000.jpg, 001.jpg, {2 * apart(cameras)}", contradictions="warn"))
    assert scene.frame.kind == "metric"
    # 1e-3: the made-up GPS takes degrees for metres with a factor that is off by less.
    assert apart(scene.cameras) == pytest.approx(2 * apart(cameras))
    np.testing.assert_allclose(scene.cameras.centers.mean(axis=0), by_gps.cameras.centers.mean(axis=0), atol=1e-6)


@pytest.mark.parametrize("up", ["ground", "level", "down", "x,y,z", "photograph"])
def test_each_way_to_say_up_is_obeyed(up: str) -> None:
    cameras, points = site(pitch_deg={"down": 90.0, "photograph": 0.0}.get(up, 60.0))
    model = in_any_frame(cameras, points, np.random.default_rng(2))
    if up == "photograph":
        placement = Placement(up="000.jpg")
    elif up == "x,y,z":
        true_up = in_world(model, photographs_at(cameras.names, cameras.centers))
        turn = scene_in_world(model, photographs_at(cameras.names, cameras.centers), 0).world_from_model.rotation
        placement = Placement(up=",".join(str(7 * value) for value in turn[2]))
        assert true_up[0].frame.kind == "metric"
    else:
        placement = Placement(up=up)
    scene, decisions, warnings = in_world(model, photographs_at(cameras.names, None), placement)
    spread = np.ptp(scene.cameras.centers[:, 2]) / np.ptp(scene.cameras.centers[:, 0])
    # Heights of 38 to 42 m on a site of 100 m; 2°: the level of the ground is known to that with
    # houses on it.
    assert spread < 4 / 90 + np.tan(np.radians(2.0))
    assert scene.cameras.centers[:, 2].mean() > scene.points[:, 2].mean()
    forced = next(decision for decision in decisions if decision.topic == "up")
    assert forced.forced and len(warnings) == 1


def test_up_that_was_asked_for_goes_before_gps_which_keeps_scale_and_place() -> None:
    rng = np.random.default_rng(3)
    positions_m = grid(rng, 60)
    # Altitudes that climb by 1 m in 12: a lean of 5° that looks like GPS without a fault.
    told_m = positions_m + np.outer(positions_m[:, 0], [0, 0, 1 / 12])
    cameras, points = flight(positions_m, rng), ground(rng)
    photos = photographs_at(cameras.names, told_m)
    model = in_any_frame(cameras, points, rng)
    by_gps, _, _ = in_world(model, photos)
    scene, decisions, warnings = in_world(model, photos, Placement(up="ground"))
    assert np.ptp(by_gps.cameras.centers[:, 2]) > 8.0 > 6.0 > np.ptp(scene.cameras.centers[:, 2])
    assert scene.frame.kind == "metric" and warnings == ()
    assert decisions[-1].forced and "up as asked for" in decisions[-1].choice
    expected_m = metres_of(photos, scene.frame.origin_lat_lon_alt)
    # 0.5 m: a lean of 5° shortens a site of 100 m by 0.4 m.
    assert np.abs(scene.cameras.centers - expected_m)[:, :2].max() < 0.5


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"distance": "a.jpg,3"}, "PHOTO,PHOTO,METRES"),
        ({"distance": "a.jpg,b.jpg,-3"}, "above 0"),
        ({"distance": "a.jpg,b.jpg,nan"}, "above 0"),
        ({"height_m": 0.0}, "above 0"),
        ({"height_m": float("nan")}, "above 0"),
        ({"height_m": 3.0, "distance": "a.jpg,b.jpg,3"}, "keep one"),
        ({"up": "0,0,0"}, "no direction"),
        ({"up": "nan,0,1"}, "no direction"),
    ],
)
def test_what_makes_no_sense_by_itself_is_refused(fields: dict, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        Placement(**fields)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"up": "upwards"}, "expected auto, ground, level, down"),
        ({"up": "0,0,1"}, "photographs have none yet"),
        ({"distance": "000.jpg,x.jpg,3"}, "'x.jpg'"),
        ({"distance": "000.jpg,000.jpg,3"}, "twice"),
    ],
)
def test_names_that_are_not_there_are_refused_before_hours_of_work(fields: dict, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        Placement(**fields).check_names(NAMES, of_model=False)


@pytest.mark.parametrize("fields", [{"up": "z,2.jpg"}, {"distance": "000.jpg,z,2.jpg,3"}, {"distance": "z,2.jpg, 000.jpg,3"}])
def test_the_name_of_a_copy_is_refused_with_the_one_that_stays(fields: dict, hamlet: Path, tmp_path: Path) -> None:
    for path in sorted((hamlet / "images").iterdir())[:3]:
        shutil.copy(path, tmp_path)
    first = min(path.name for path in tmp_path.iterdir())
    shutil.copy(tmp_path / first, tmp_path / "z,2.jpg")
    with pytest.raises(BadInput, match=f"'z,2.jpg'.* is a copy of {first}: name that one"):
        reconstruct(tmp_path, tmp_path / "work", SfmConfig(), lambda progress: None, placement=Placement(**fields))


def test_the_name_of_a_copy_in_a_model_is_refused_with_the_one_that_stays(hamlet: Path, tmp_path: Path) -> None:
    shutil.copytree(hamlet / "images", tmp_path / "images")
    first, second = sorted(path.name for path in (tmp_path / "images").iterdir())[:2]
    shutil.copy(tmp_path / "images" / first, tmp_path / "images" / second)
    with pytest.raises(BadInput, match=f"is a copy of {first}: name that one"):
        scene_from_colmap(hamlet / "known", tmp_path / "images", tmp_path / "w", lambda progress: None, placement=Placement(up=second))


def test_names_may_hold_commas_and_a_model_takes_a_direction() -> None:
    Placement(distance="a,1.jpg,b,2.jpg,3", up="0,0,1").check_names(("a,1.jpg", "b,2.jpg"), of_model=True)


def test_photographs_that_look_to_all_sides_or_lie_in_one_place_fix_nothing() -> None:
    cameras, points = site(pitch_deg=0.0)
    around = Cameras(
        names=cameras.names[:2],
        Ks=cameras.Ks[:2],
        cam_from_world=np.stack([np.eye(4), np.diag([-1.0, 1, -1, 1])]),
        sizes_wh=cameras.sizes_wh[:2],
    )
    with pytest.raises(BadInput, match="look to all sides"):
        Placement(up="down").given_up(around, points, 0)
    with pytest.raises(BadInput, match="at one place"):
        Placement(distance="000.jpg,001.jpg,3").scale(around, points, np.zeros((0, 2), np.int64))
    with pytest.raises(BadInput, match="not above"):
        Placement(height_m=3.0).scale(around, points, np.zeros((0, 2), np.int64))


def test_north_is_where_a_photograph_looks() -> None:
    cameras, points = site(pitch_deg=30.0)
    model, photos = in_any_frame(cameras, points, np.random.default_rng(1)), photographs_at(cameras.names, None)
    looks = cameras.cam_from_world[0, 2, :2]
    heading_deg = float(np.degrees(np.arctan2(looks[0], looks[1])))
    placement = Placement(distance=f"000.jpg,001.jpg,{apart(cameras)}", north=f"000.jpg,{heading_deg:.9f}")
    scene, decisions, _ = in_world(model, photos, placement)
    assert "north" in [decision.topic for decision in decisions if decision.forced]
    turned = scene.cameras.cam_from_world[0, 2, :2]
    assert np.degrees(np.arctan2(turned[0], turned[1])) == pytest.approx(heading_deg, abs=1e-6)
    # Up is estimated, so directions agree to its error and not to rounding.
    between = (np.diff(cameras.centers, axis=0), np.diff(scene.cameras.centers, axis=0))
    assert np.abs(between[0][:, :2] - between[1][:, :2]).max() < 0.1 * np.abs(between[0]).max()


def test_north_beside_gps_and_of_nothing_is_refused() -> None:
    cameras, points = site()
    model = in_any_frame(cameras, points, np.random.default_rng(1))
    with pytest.raises(BadInput, match="GPS says where north is"):
        in_world(model, photographs_at(cameras.names, cameras.centers), Placement(north="000.jpg,10"))
    with pytest.raises(BadInput, match=r"--north names 'lost\.jpg'"):
        in_world(model, photographs_at(cameras.names, None), Placement(north="lost.jpg,10"))
    for text in ("000.jpg", "000.jpg,north", ",10", "000.jpg,nan", "000.jpg,721"):
        with pytest.raises(BadInput, match="--north is"):
            Placement(north=text)
