"""World frames: similarities form a group, and east-north-up agrees with COLMAP's."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3, enu_from_geodetic, geodetic_from_enu
from radiant_core.numerics import rotmats_from_quats


def random_sim3(seed: int) -> Sim3:
    rng = np.random.default_rng(seed)
    rotation = rotmats_from_quats(rng.normal(size=(1, 4)))[0]
    return Sim3(scale=float(np.exp(rng.normal())), rotation=rotation, translation=rng.normal(size=3) * 10)


def random_poses(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = rotmats_from_quats(rng.normal(size=(count, 4)))
    poses[:, :3, 3] = rng.normal(size=(count, 3))
    return poses


@pytest.mark.parametrize("seed", range(5))
def test_the_inverse_undoes_points_and_poses(seed: int) -> None:
    sim3, points = random_sim3(seed), np.random.default_rng(seed).normal(size=(20, 3))
    poses = random_poses(4, seed)
    # float64 with coordinates of some 100 m: 1e-14 relative.
    np.testing.assert_allclose(sim3.inverse().apply(sim3.apply(points)), points, atol=1e-12)
    np.testing.assert_allclose(sim3.apply(sim3.inverse().apply(points)), points, atol=1e-12)
    np.testing.assert_allclose(sim3.inverse().apply_to_poses(sim3.apply_to_poses(poses)), poses, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_moved_cameras_see_moved_points_in_the_same_direction(seed: int) -> None:
    sim3, poses = random_sim3(seed), random_poses(4, seed)
    points = np.random.default_rng(seed).normal(size=(20, 3))
    before = points @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
    moved = sim3.apply_to_poses(poses)
    after = sim3.apply(points) @ moved[:, :3, :3].transpose(0, 2, 1) + moved[:, None, :3, 3]
    np.testing.assert_allclose(after, sim3.scale * before, atol=1e-12)


def test_two_similarities_in_turn_are_one() -> None:
    a, b = random_sim3(1), random_sim3(2)
    both = Sim3(scale=a.scale * b.scale, rotation=a.rotation @ b.rotation, translation=a.apply(b.translation[None])[0])
    points, poses = np.random.default_rng(0).normal(size=(20, 3)), random_poses(3, 0)
    np.testing.assert_allclose(a.apply(b.apply(points)), both.apply(points), atol=1e-12)
    np.testing.assert_allclose(a.apply_to_poses(b.apply_to_poses(poses)), both.apply_to_poses(poses), atol=1e-12)


def test_empty_sets_stay_empty() -> None:
    assert random_sim3(0).apply(np.zeros((0, 3))).shape == (0, 3)
    assert random_sim3(0).apply_to_poses(np.zeros((0, 4, 4))).shape == (0, 4, 4)


@pytest.mark.parametrize(
    "wrong",
    [
        {"scale": 0.0},
        {"scale": -1.0},
        {"scale": np.nan},
        {"scale": np.inf},
        {"rotation": 2 * np.eye(3)},
        {"rotation": np.diag([1.0, 1.0, -1.0])},
        {"rotation": np.full((3, 3), 1e200)},
        {"rotation": np.eye(4)},
        {"translation": [0, np.nan, 0]},
    ],
)
def test_what_is_no_similarity_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        Sim3(**{"scale": 1.0, "rotation": np.eye(3), "translation": np.zeros(3), **wrong})


@pytest.mark.parametrize("origin", [(50.83, -0.14, 20.0), (-33.9, 151.2, 0.0), (0.0, 180.0, 5000.0), (89.9, 10.0, -400.0)])
def test_east_north_up_agrees_with_colmap(origin: tuple[float, float, float]) -> None:
    import pycolmap

    rng = np.random.default_rng(3)
    spread = rng.uniform(-1, 1, (50, 3)) * [0.05, 0.05, 500.0]
    positions = np.array(origin) + spread
    positions[:, 1] = (positions[:, 1] + 180) % 360 - 180
    transform = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84)
    expected_m = transform.ellipsoid_to_enu(positions, *origin)
    # Geocentric coordinates of 6.4e6 m carry 1e-9 m each in float64.
    np.testing.assert_allclose(enu_from_geodetic(positions, origin), expected_m, atol=1e-7)


def test_one_hundredth_of_a_degree_north_at_45_degrees_is_1111_m() -> None:
    # The meridian's radius of curvature at 45° is 6,367,382 m (WGS84), times 0.01° in radians =
    # 1111.32 m.
    ends = enu_from_geodetic([[44.995, 7.0, 0.0], [45.005, 7.0, 0.0]], [45.0, 7.0, 0.0])
    assert ends[1, 1] - ends[0, 1] == pytest.approx(1111.32, abs=0.01)


def test_the_origin_is_zero_and_up_is_altitude() -> None:
    origin = np.array([12.0, 77.0, 900.0])
    above = enu_from_geodetic([origin, origin + np.array([0.0, 0.0, 25.0])], origin)
    # 1e-9 m rounding of geocentric coordinates.
    np.testing.assert_allclose(above, [[0, 0, 0], [0, 0, 25]], atol=1e-8)


@pytest.mark.parametrize("position", [[91, 0, 0], [0, 181, 0], [np.nan, 0, 0], [500000, 5700000, 0]])
def test_positions_off_the_globe_are_refused(position: list[float]) -> None:
    with pytest.raises(BadInput):
        enu_from_geodetic([position], [0, 0, 0])


def test_a_frame_names_its_unit_and_refuses_what_it_does_not_know() -> None:
    assert Frame(kind="metric", origin_lat_lon_alt=np.zeros(3)).unit == "m"
    assert Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)).unit == "units"
    for wrong in ({"kind": "utm"}, {"residual_m": np.nan}, {"residual_m": -1.0}, {"origin_lat_lon_alt": np.zeros(2)}):
        with pytest.raises(BadInput):
            Frame(**{"kind": "metric", "origin_lat_lon_alt": np.zeros(3), **wrong})


ORIGINS = [(47.37, 8.54, 430.0), (0.0, 180.0, 0.0), (1e-9, -180.0, -400.0), (-89.99, 12.0, 3000.0), (90.0, 0.0, 0.0)]


@pytest.mark.parametrize("origin", ORIGINS)
@pytest.mark.parametrize("reach_m", [1.0, 100e3, 5000e3])
def test_metres_to_degrees_and_back_are_the_same_metres(origin: tuple[float, float, float], reach_m: float) -> None:
    positions = np.random.default_rng(6).uniform(-1, 1, (2000, 3)) * [reach_m, reach_m, 10e3]
    there = geodetic_from_enu(positions, origin)
    assert (np.abs(there[:, 0]) <= 90).all() and (np.abs(there[:, 1]) <= 180).all()
    # Geocentric coordinates of up to 1e7 m carry 2e-9 m each in float64; the contract is 1 mm over
    # 100 km.
    np.testing.assert_allclose(enu_from_geodetic(there, origin), positions, atol=1e-7)


def enu_in_fifty_digits(position: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """East, north, up anew in mpmath: geocentric differences projected on the three directions."""
    with mpmath.workdps(50):
        a, f = mpmath.mpf(6378137), 1 / mpmath.mpf("298.257223563")

        def geocentric(lat_lon_alt: np.ndarray) -> list[Any]:
            lat, lon, alt = (
                mpmath.radians(mpmath.mpf(lat_lon_alt[0])),
                mpmath.radians(mpmath.mpf(lat_lon_alt[1])),
                mpmath.mpf(lat_lon_alt[2]),
            )
            b = a * (1 - f)
            n = a**2 / mpmath.sqrt((a * mpmath.cos(lat)) ** 2 + (b * mpmath.sin(lat)) ** 2)
            across = (n + alt) * mpmath.cos(lat)
            return [across * mpmath.cos(lon), across * mpmath.sin(lon), (n * (b / a) ** 2 + alt) * mpmath.sin(lat)]

        x, y, z = (there - here for there, here in zip(geocentric(position), geocentric(origin), strict=True))
        lat, lon = mpmath.radians(mpmath.mpf(origin[0])), mpmath.radians(mpmath.mpf(origin[1]))
        outwards = x * mpmath.cos(lon) + y * mpmath.sin(lon)
        north = z * mpmath.cos(lat) - outwards * mpmath.sin(lat)
        return np.array(
            [float(y * mpmath.cos(lon) - x * mpmath.sin(lon)), float(north), float(outwards * mpmath.cos(lat) + z * mpmath.sin(lat))]
        )


@pytest.mark.parametrize("origin", ORIGINS)
def test_degrees_of_metres_agree_with_fifty_digits(origin: tuple[float, float, float]) -> None:
    positions = np.random.default_rng(7).uniform(-1, 1, (20, 3)) * [100e3, 100e3, 5e3]
    there = geodetic_from_enu(positions, origin)
    exact = np.array([enu_in_fifty_digits(row, np.array(origin)) for row in there])
    # A last digit of 180° is 3e-14°, 3 nm on the ground.
    np.testing.assert_allclose(exact, positions, atol=2e-8)


@pytest.mark.parametrize(
    ("position", "origin"),
    [
        ([np.nan, 0, 0], [0, 0, 0]),
        ([0, 0, 0], [91, 0, 0]),
        ([0, 0, -6.3e6], [10, 0, 0]),
        ([1e9, 0, 0], [0, 0, 0]),
        ([1e300, 0, 0], [0, 0, 0]),
        ([0, 0, 0], [0, 0, 1e300]),
    ],
)
def test_metres_that_have_no_latitude_are_refused(position: list[float], origin: list[float]) -> None:
    with pytest.raises(BadInput):
        geodetic_from_enu([position], origin)


def test_no_metres_are_no_degrees() -> None:
    assert geodetic_from_enu(np.zeros((0, 3)), [0, 0, 0]).shape == (0, 3)
