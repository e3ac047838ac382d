"""Worlds of alignments: whatever they are, the way back is exact and the scene is in metres, z up, near its origin."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.frames import ecef_from_local, geodetic_from_enu
from radiant_core.georef.crs import parse_crs
from radiant_core.georef.given_world import place_world
from radiant_core.io.poses.pose_file import GivenWorld

ORIGIN = (47.37, 8.54, 430.0)
CENTERS = np.array([[0.0, 0, 30], [40, 5, 31], [20, 30, 29], [5, 60, 33]])


def ecef(origin: np.ndarray, points: np.ndarray) -> np.ndarray:
    move = ecef_from_local(origin)
    return points @ move[:3, :3].T + move[:3, 3]


@pytest.mark.parametrize("away_m", [0.0, 9e3, 5e4])
def test_places_about_an_origin_stay_near_it_and_move_rigidly_from_farther_out(away_m: float) -> None:
    centers = CENTERS + np.array([away_m, -away_m / 2, 0])
    move, frame = place_world(GivenWorld(kind="enu", origin_lat_lon_alt=ORIGIN), centers)
    assert frame is not None and frame.kind == "metric"
    scene = move.inverse().apply(centers)
    assert (scene == centers).all() == (away_m < 1e4) and np.abs(scene).max() < 1e4
    # 1e-6 m: float64 at the earth's radius.
    assert np.abs(ecef(frame.origin_lat_lon_alt, scene) - ecef(np.array(ORIGIN), centers)).max() < 1e-6


def test_geocentric_places_become_east_north_up() -> None:
    centers = ecef(np.array(ORIGIN), CENTERS)
    move, frame = place_world(GivenWorld(kind="ecef"), centers)
    assert frame is not None
    scene = move.inverse().apply(centers)
    assert np.abs(ecef(frame.origin_lat_lon_alt, scene) - centers).max() < 1e-6
    # Turned by the earth's curve over 30 m: heights differ as before.
    assert np.abs(np.diff(scene[:, 2]) - np.diff(CENTERS[:, 2])).max() < 1e-3
    with pytest.raises(BadInput, match=r"geocentric .ECEF., and its photographs lie"):
        place_world(GivenWorld(kind="ecef"), CENTERS)


@pytest.mark.parametrize("crs", ["EPSG:25832", "EPSG:32632", "EPSG:2056"])
def test_places_on_a_map_become_the_nearest_similarity(crs: str) -> None:
    system = parse_crs(crs)
    centers = system.from_geodetic(geodetic_from_enu(CENTERS, np.array(ORIGIN)))
    move, frame = place_world(GivenWorld(kind="crs", crs=crs), centers)
    assert frame is not None
    scene = move.inverse().apply(centers)
    assert np.abs(move.apply(scene) - centers).max() < 1e-8 and np.abs(scene[:, :2]).max() < 300
    # A zone's plane is up to 4e-4 too small, its heights are not: one scale for both is off by a third of that.
    over_globe = system.from_geodetic(geodetic_from_enu(scene, frame.origin_lat_lon_alt))
    assert np.abs(over_globe - centers)[:, :2].max() < 2e-4 * 150 and np.abs(np.diff((over_globe - centers)[:, 2])).max() < 4e-4 * 60


def test_metres_are_moved_by_whole_hundreds_and_what_is_unknown_is_left() -> None:
    far = CENTERS + np.array([465_321.5, 5_246_377.25, 12.0])
    move, frame = place_world(GivenWorld(kind="metres"), far)
    assert frame is not None and frame.kind == "scaled"
    assert move.scale == 1 and (move.translation % 100 == 0).all() and np.abs(move.inverse().apply(far)[:, :2]).max() < 200
    assert place_world(GivenWorld(), far)[1] is None
