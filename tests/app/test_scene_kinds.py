"""Kinds of scenes that the generator makes beside flights: rooms, fronts of houses, clouds, two cameras, shaken photographs.

Pictures have 96 x 72 px; the laws of every flight are in `test_sample_scenes.py`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from PIL import Image
from scipy.spatial import KDTree

import generate
from radiant_core.errors import BadInput
from scenegen.config import SceneConfig
from scenegen.facade import HOUSE_M, NUM_HOUSES
from scenegen.flight import SECOND_CAMERA_EV, plan_flight
from scenegen.raycast import Photographer, project
from scenegen.room import LAMP_STRENGTH, LAMPS_M, ROOM_M, WINDOW_X_M, WINDOW_Z_M, lamp_light

SMALL = SceneConfig(num_cameras=9, extent_m=(24.0, 16.0), width_px=96, height_px=72, num_known_points=300, samples_per_axis=1)


def test_in_a_room_every_ray_ends_at_a_wall_but_those_through_the_window() -> None:
    config = replace(SMALL, flight="room", num_cameras=16)
    room = Photographer(config)
    num_sky = 0
    for shot in plan_flight(config):
        assert (np.abs(shot.center_m[:2]) < ROOM_M[:2] / 4).all() and 1.2 < shot.center_m[2] < 1.9
        depth = room.depth(shot)
        assert depth[np.isfinite(depth)].max() < np.linalg.norm(ROOM_M)
        rows, columns = np.nonzero(np.isinf(depth))
        rays = np.column_stack([columns + 0.5 - 48, rows + 0.5 - 36, np.full(len(rows), config.focal_px)]) @ shot.cam_from_world[:3, :3]
        # Where such a ray passes the northern wall it is within the window.
        at = shot.center_m + rays * ((ROOM_M[1] / 2 - shot.center_m[1]) / rays[:, 1])[:, None]
        assert (rays[:, 1] > 0).all() and (at[:, 0] > WINDOW_X_M[0] - 0.01).all() and (at[:, 0] < WINDOW_X_M[1] + 0.01).all()
        assert (at[:, 2] > WINDOW_Z_M[0] - 0.01).all() and (at[:, 2] < WINDOW_Z_M[1] + 0.01).all()
        num_sky += len(rows)
    assert 0.005 < num_sky / (16 * config.width_px * config.height_px) < 0.2


def test_lamps_light_a_room_by_the_distance_and_what_stands_before_them_throws_shadows(monkeypatch: pytest.MonkeyPatch) -> None:
    below = np.array([[*LAMPS_M[0, :2], LAMPS_M[0, 2] - away_m] for away_m in (1.0, 2.0)], np.float32)
    light = next(lamp_light(below, np.tile(np.array([0, 0, 1], np.float32), (2, 1))))[1]
    np.testing.assert_allclose(light[0], LAMP_STRENGTH, rtol=1e-6)
    np.testing.assert_allclose(light[0] / light[1], 4.0, rtol=1e-6)
    room, down = Photographer(replace(SMALL, flight="room")), np.array([[0.0, 0.0, -1.0]] * 2, np.float32)
    # Under the middle of the table, and on the free floor.
    places = np.array([[-0.3, -0.2, 0.6], [-1.6, -2.0, 0.6]], np.float32)
    lit = room.radiance_along(places, down)
    monkeypatch.setattr("scenegen.raycast.lamp_light", lambda points, normals: iter(()))
    dark = room.radiance_along(places, down)
    np.testing.assert_array_equal(lit[0], dark[0])
    assert (lit[1] > 1.5 * dark[1]).all()


def test_a_facade_is_seen_from_the_street_alone_and_the_sky_above_it() -> None:
    config = replace(SMALL, flight="facade")
    shots, houses = plan_flight(config), Photographer(config)
    for shot in shots:
        x, y, _ = shot.center_m
        assert abs(x) < NUM_HOUSES * HOUSE_M[0] / 2 and -14.0 < y < -12.0
        # Within 30 degrees of straight ahead, in plan.
        assert shot.cam_from_world[2, 1] / np.hypot(*shot.cam_from_world[2, :2]) > np.cos(np.deg2rad(30))
    depth = np.stack([houses.depth(shot) for shot in shots])
    assert 0.02 < np.isinf(depth).mean() < 0.6
    # The front's middle, which a balcony or a window is at most 1.5 m before.
    ahead = houses.depth_at(shots[0], np.array([[48.0, 36.0]]))
    assert 10.0 < ahead[0] < 20.0


def test_clouds_take_sun_by_place_and_time_and_no_more_than_their_share() -> None:
    clear, cloudy = (replace(SMALL, cloud_shadow=share, extent_m=(90.0, 60.0)) for share in (0.0, 0.6))
    shot = plan_flight(clear)[0]
    town = Photographer(clear)
    under = town.with_config(cloudy)
    pixels = np.random.default_rng(0).uniform((0, 0), (96, 72), (3000, 2))
    ratios = []
    for time_s in (0.0, 60.0):
        now = replace(shot, time_s=time_s)
        without, with_clouds = (each._radiance(now, pixels).sum(axis=1) for each in (town, under))
        ratios.append(with_clouds / without)
        # Ambient light stays, so the whole is at most 0.6 less.
        assert ratios[-1].max() <= 1.00001 and ratios[-1].min() > 0.4
    assert np.ptp(ratios[0]) > 0.1 and np.abs(ratios[0] - ratios[1]).mean() > 0.02


def test_two_cameras_take_turns_and_the_known_model_has_both(tmp_path: Path) -> None:
    config = replace(SMALL, num_lenses=2)
    generate.generate(config, tmp_path / "scene")
    model = pycolmap.Reconstruction(str(tmp_path / "scene" / "known"))
    model.update_point_3d_errors()
    # As with one camera: pixels to 0.01 px, points to 0.1 mm.
    assert model.num_cameras() == 2 and model.compute_mean_reprojection_error() < 0.01
    assert [image.camera_id for _, image in sorted(model.images.items())] == [1, 1, 1, 2, 2, 2, 1, 1, 1]
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        with Image.open(tmp_path / "scene" / "images" / image.name) as photograph:
            assert photograph.size == (camera.width, camera.height)
    first, second = model.cameras[1], model.cameras[2]
    assert second.width < first.width and second.params[0] / second.width == pytest.approx(1.5 * first.params[0] / first.width)
    assert {round(shot.exposure_ev, 6) for shot in plan_flight(config)} == {0.0, SECOND_CAMERA_EV}


def test_shaken_photographs_are_blurred_and_the_others_stay_as_they_are() -> None:
    config = replace(SMALL, num_cameras=10, shaken_share=0.3)
    sharp, shaken, town = plan_flight(replace(config, shaken_share=0.0)), plan_flight(config), Photographer(config)
    moved = [shot.shake_px != (0.0, 0.0) for shot in shaken]
    assert sum(moved) == 3
    for before, after, is_moved in zip(sharp, shaken, moved, strict=True):
        assert np.array_equal(before.cam_from_world, after.cam_from_world)
        assert 0.9 < np.hypot(*after.shake_px) < 2.0 if is_moved else after.shake_px == before.shake_px == (0.0, 0.0)
    number = moved.index(True)
    gradients = [np.abs(np.diff(town.photograph(shots[number], 0).astype(float), axis=1)).mean() for shots in (sharp, shaken)]
    assert gradients[1] < 0.9 * gradients[0]


def test_textured_points_lie_where_photographs_have_contrast(tmp_path: Path) -> None:
    config = replace(SMALL, flight="room", num_cameras=40, num_known_points=800)
    spread = {}
    for name, own in (("even", config), ("textured", replace(config, textured_points=True))):
        generate.generate(own, tmp_path / name)
        points = np.array([point.xyz for point in pycolmap.Reconstruction(str(tmp_path / name / "known")).points3D.values()])
        assert len(points) > 60
        # The bare southern wall east of its picture and above the sofa.
        bare = (points[:, 1] < -2.55) & (points[:, 0] > 0.0) & (points[:, 0] < 3.2) & (points[:, 2] > 1.2)
        spread[name] = bare.mean()
    assert spread["textured"] < 0.5 * spread["even"]


def test_what_does_not_go_together_is_refused() -> None:
    with pytest.raises(BadInput, match="no sun shines on the flight room"):
        SceneConfig(flight="room", cloud_shadow=0.5)
    with pytest.raises(BadInput, match="off_path is for one camera"):
        SceneConfig(num_lenses=2, off_path=4)
    with pytest.raises(BadInput, match="num_lenses is 3; give a number from 1 to 2"):
        SceneConfig(num_lenses=3)


def test_photographs_of_a_room_agree_where_they_see_the_same() -> None:
    config = replace(SMALL, flight="room", num_cameras=24, width_px=128, height_px=96)
    room, shots = Photographer(config), plan_flight(config)
    directions = np.array([shot.cam_from_world[2, :3] for shot in shots])
    number = KDTree(directions[1:]).query(directions[0])[1] + 1
    x, y = np.meshgrid(np.arange(128) + 0.5, np.arange(96) + 0.5)
    pixels = np.column_stack([x.ravel(), y.ravel()])
    depth = room.depth_at(shots[0], pixels)
    met = np.isfinite(depth)
    rays = np.column_stack([(pixels - (64, 48)) / config.focal_px, np.ones(len(pixels))]) @ shots[0].cam_from_world[:3, :3]
    points = shots[0].center_m + rays[met] * depth[met, None]
    there, far = project(config, shots[number], points)
    inside = np.all((there > 1) & (there < (127, 95)), axis=1)
    same = np.abs(room.depth_at(shots[number], there[inside]) - far[inside]) < 0.002
    assert same.sum() > 300
    mine, theirs = room.color_at(shots[0], pixels[met][inside][same]), room.color_at(shots[number], there[inside][same])
    assert np.median(np.abs(mine.astype(float) - theirs)) <= 4.0
