"""A device's frame from its photographs' GPS: right, with an honest uncertainty, or refused."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3, enu_from_geodetic
from radiant_core.scene import SfmScene
from radiant_core.sfm.world_frame.device_frame import DeviceFrame, RefusedFrame, device_frame
from tests.core.sfm.test_world import ORIGIN, flight, grid, ground, photographs_at


def gps_of(names: tuple[str, ...], positions_m: np.ndarray) -> dict[str, tuple[float, float, float]]:
    return {photo.name: photo.lat_lon_alt for photo in photographs_at(names, positions_m) if photo.lat_lon_alt is not None}


def exact_m(names: tuple[str, ...], positions_m: np.ndarray) -> np.ndarray:
    """The GPS of `positions_m` in metres about ORIGIN, by approximate degrees per metre."""
    gps = gps_of(names, positions_m)
    return enu_from_geodetic([gps[name] for name in names], ORIGIN)


def own_frame(cameras: Cameras, points: np.ndarray, rng: np.random.Generator) -> tuple[SfmScene, Sim3]:
    """The scene in a frame of its own, and the similarity that puts it there."""
    rotation = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    move = Sim3(scale=0.07, rotation=rotation, translation=rng.normal(scale=3, size=3))
    turned = Cameras(
        names=cameras.names, Ks=cameras.Ks, cam_from_world=move.apply_to_poses(cameras.cam_from_world), sizes_wh=cameras.sizes_wh
    )
    scene = SfmScene(
        cameras=turned,
        points=move.apply(points),
        colors=np.zeros((len(points), 3), np.uint8),
        observations=np.zeros((0, 2), np.int64),
        frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)),
    )
    return scene, move


def device_at(positions_m: np.ndarray, rng: np.random.Generator) -> tuple[SfmScene, Sim3, np.ndarray]:
    names = tuple(f"{index:03d}.jpg" for index in range(len(positions_m)))
    true_m = exact_m(names, positions_m)
    scene, move = own_frame(flight(true_m, rng), ground(rng), rng)
    return scene, move, true_m


def fixed(scene: SfmScene, gps: dict[str, tuple[float, float, float]], seed: int = 0) -> DeviceFrame:
    frame = device_frame(scene, gps, ORIGIN, seed)
    assert isinstance(frame, DeviceFrame), frame
    return frame


@pytest.mark.parametrize("seed", range(3))
def test_exact_gps_gives_the_frame_back_about_the_common_origin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # The common origin need not be the device's.
    positions_m = grid(rng) + np.array([300.0, -200, 0])
    scene, _, true_m = device_at(positions_m, rng)
    frame = fixed(scene, gps_of(scene.cameras.names, positions_m))
    # 1e-6 m: positions went through degrees (1e-9 m) and a fit of exact pairs.
    assert np.abs(frame.scene.cameras.centers - true_m).max() < 1e-6
    assert frame.scene.frame.kind == "metric" and (frame.scene.frame.origin_lat_lon_alt == ORIGIN).all()
    assert frame.up_source == "GPS" and frame.num_inliers == 30
    assert frame.uncertainty.scale < 1e-3


@pytest.mark.parametrize(("count", "noise_m"), [(12, 1.0), (40, 3.0)])
def test_the_predicted_uncertainty_is_what_fifty_noisy_devices_show(count: int, noise_m: float) -> None:
    rng = np.random.default_rng(count)
    shape = grid(rng, count)
    errors, predicted = [], []
    for seed in range(50):
        scene, move, true_m = device_at(shape, rng)
        told_m = shape + rng.normal(scale=noise_m, size=shape.shape)
        frame = fixed(scene, gps_of(scene.cameras.names, told_m), seed)
        middle, fit = true_m.mean(axis=0), frame.common_from_device
        turn = Rotation.from_matrix(fit.rotation @ move.rotation).as_rotvec()
        # The axis known worst is the line that fits the positions best.
        axis = np.linalg.svd(true_m - middle)[2][0]
        errors.append([*(fit.apply(move.apply(middle[None]))[0] - middle), turn @ axis, np.log(fit.scale * move.scale)])
        u = frame.uncertainty
        predicted.append([u.position_m, u.rotation_rad, u.scale])
    rms = np.sqrt(np.square(errors).mean(axis=0))
    shown = np.array([np.sqrt(np.mean(rms[:3] ** 2)), rms[3], rms[4]])
    ratio = np.sqrt(np.square(predicted).mean(axis=0)) / shown
    # 1.5 either way; a standard deviation of 50 samples is itself known to 10 %.
    assert (ratio > 1 / 1.5).all() and (ratio < 1.5).all(), ratio.round(2)


def test_lost_positions_do_not_move_the_frame() -> None:
    rng = np.random.default_rng(5)
    positions_m = grid(rng)
    scene, _, true_m = device_at(positions_m, rng)
    told_m = positions_m + rng.normal(scale=0.3, size=positions_m.shape)
    told_m[:6] += (400, 0, 50)
    frame = fixed(scene, gps_of(scene.cameras.names, told_m))
    assert frame.num_inliers <= 24
    assert np.abs(frame.scene.cameras.centers - true_m).max() < 1.0


def test_a_flight_line_takes_up_from_the_scene_and_says_how_uncertain_that_is() -> None:
    rng = np.random.default_rng(4)
    positions_m = np.column_stack([np.linspace(-50, 50, 25), np.linspace(-20, 20, 25), np.full(25, 40.0)])
    scene, _, true_m = device_at(positions_m, rng)
    told_m = positions_m + rng.normal(scale=0.3, size=(25, 3))
    frame = fixed(scene, gps_of(scene.cameras.names, told_m))
    assert "ground plane" in frame.up_source and "level cameras" in frame.up_source
    tilt = np.arccos(frame.common_from_device.rotation[2] @ device_up(scene, true_m))
    assert np.radians(1.0) <= frame.uncertainty.rotation_rad and tilt < 2 * frame.uncertainty.rotation_rad


def device_up(scene: SfmScene, true_m: np.ndarray) -> np.ndarray:
    """Up in the device's own frame, from how its cameras were made level over `true_m`."""
    level = scene.cameras.cam_from_world[:, 0, :3]
    up = np.linalg.eigh(level.T @ level)[1][:, 0]
    towards = -scene.cameras.cam_from_world[:, 2, :3].mean(axis=0)
    return up if up @ towards > 0 else -up


@pytest.mark.parametrize(
    ("case", "told"),
    [
        ("none", "only 0 of its 30 placed photographs have GPS"),
        ("three", "only 3 of its 30"),
        ("all alike", "all the same|miss its cameras|do not differ|fix its scale"),
        ("nonsense", "miss its cameras by|fix its scale to"),
        ("above each other", "fix its scale|do not differ|miss its cameras"),
        ("too rough", "miss its cameras by|fix its scale to"),
    ],
)
def test_ambiguous_gps_is_refused_with_its_figures(case: str, told: str) -> None:
    rng = np.random.default_rng(6)
    positions_m = grid(rng)
    scene, _, _ = device_at(positions_m, rng)
    readings_m = {
        "none": np.full((30, 3), np.nan),
        "three": np.where(np.arange(30)[:, None] < 3, positions_m, np.nan),
        "all alike": np.full((30, 3), 5.0),
        "nonsense": rng.normal(scale=80, size=(30, 3)),
        "above each other": np.outer(np.linspace(0, 80, 30), [0, 0, 1.0]),
        "too rough": positions_m * (0.05, 0.05, 1) + rng.normal(scale=30, size=(30, 3)),
    }[case]
    frame = device_frame(scene, gps_of(scene.cameras.names, readings_m), ORIGIN, 0)
    assert isinstance(frame, RefusedFrame)
    assert re.search(told, frame.reason), frame.reason
    assert frame.reason.endswith(".") and "\n" not in frame.reason


def test_altitudes_that_drift_do_not_tilt_the_device() -> None:
    rng = np.random.default_rng(5)
    positions_m = grid(rng, 60)
    told_m = positions_m + rng.normal(scale=1.0, size=(60, 3)) + np.outer(positions_m[:, 0], [0, 0, 1.0])
    scene, _, _ = device_at(positions_m, rng)
    frame = device_frame(scene, gps_of(scene.cameras.names, told_m), ORIGIN, 0)
    if isinstance(frame, DeviceFrame):
        assert frame.up_source != "GPS" and np.ptp(frame.scene.cameras.centers[:, 2]) < 10.0
    else:
        assert "per axis" in frame.reason


def test_poison_and_places_off_the_globe_are_refused() -> None:
    rng = np.random.default_rng(7)
    scene, _, _ = device_at(grid(rng), rng)
    gps = gps_of(scene.cameras.names, grid(rng))
    first = scene.cameras.names[0]
    for bad in ((np.nan, 0.0, 0.0), (46.0, np.inf, 0.0), (99.0, 0.0, 0.0)):
        with pytest.raises(BadInput):
            device_frame(scene, {**gps, first: bad}, ORIGIN, 0)


def test_photographs_of_another_country_are_refused_as_another_scene() -> None:
    rng = np.random.default_rng(0)
    scene, _, true_m = device_at(grid(rng), rng)
    gps = {name: (lat + 5, lon, alt) for name, (lat, lon, alt) in gps_of(scene.cameras.names, true_m).items()}
    frame = device_frame(scene, gps, ORIGIN)
    assert isinstance(frame, RefusedFrame) and re.search(r"lie 55\d km .* more than 300 km: run it as a scene of its own", frame.reason)
