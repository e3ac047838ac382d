"""Where cameras look against a median one by one, and κ against a count of all observations."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from shapely import Point, Polygon

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.numerics import FloatArray
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.looks import camera_looks, strip_agreement
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.edge_sites import MAX_COORDINATE_M
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import System
from radiant_core.scene import SfmScene
from tests.seeds import for_seeds

from .instances import linear_system, random_system

Plan = tuple[CloudPlan, tuple[EdgePlan, ...]]


def scene_of(stands: FloatArray, points: FloatArray, observations: Any) -> SfmScene:
    """Cameras that stand at (C,2), 50 m up, points (P,2) on the ground and observations (T,2)."""
    count = len(stands)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = -np.column_stack([stands, np.full(count, 50.0)])
    return SfmScene(
        cameras=Cameras(
            names=tuple(f"{index:05d}.jpg" for index in range(count)),
            Ks=np.tile(np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), (count, 1, 1)),
            cam_from_world=poses,
            sizes_wh=np.tile([640, 480], (count, 1)),
        ),
        points=np.column_stack([points, np.zeros(len(points))]),
        colors=np.zeros((len(points), 3), np.uint8),
        observations=np.asarray(observations, np.int64).reshape(-1, 2),
        frame=Frame(kind="metric", origin_lat_lon_alt=np.array([47.0, 8.0, 400.0])),
    )


def random_scene(rng: np.random.Generator, num_cameras: int, num_points: int, num_observations: int) -> SfmScene:
    stands, points = rng.uniform(0, 100, (num_cameras, 2)), rng.uniform(-20, 120, (num_points, 2))
    seen = np.column_stack([rng.integers(num_points, size=num_observations), rng.integers(num_cameras, size=num_observations)])
    return scene_of(stands, points, np.unique(seen, axis=0))


def oblique_scene(rng: np.random.Generator, num_cameras: int = 40, per_camera: int = 30) -> SfmScene:
    """Cameras all over a field, each of which sees ground on the other side of the field."""
    stands = rng.uniform(0, 100, (num_cameras, 2))
    points = np.repeat(100 - stands, per_camera, axis=0) + rng.normal(scale=8.0, size=(num_cameras * per_camera, 2))
    seen = np.column_stack([np.arange(len(points)), np.repeat(np.arange(num_cameras), per_camera)])
    return scene_of(stands, points, seen)


def planned(places: FloatArray, system: System) -> Plan:
    cloud = plan_regions(places, system)
    assert isinstance(cloud, CloudPlan)
    return cloud, split_edges(places, cloud, system)


def equal_edges(count: int) -> System:
    """Up to two edges in the west and the east of the field, with a device each."""
    return linear_system(np.array([[25.0, 50.0], [75.0, 50.0]])[:count], np.ones(count))


def counted_kappa(scene: SfmScene, edges: tuple[EdgePlan, ...]) -> float | None:
    """κ by the confusion matrix of all observations, one after another."""
    devices = [(plan.strips[index], set(plan.cameras_of(name).tolist())) for plan in edges for index, name in enumerate(plan.device_ids)]
    table = np.zeros((len(devices), len(devices)))
    for point, camera in scene.observations.tolist():
        place = Point(scene.points[point, :2])
        away = [Polygon(strip).distance(place) if len(strip) > 2 else np.inf for strip, _ in devices]
        table[next(index for index, (_, own) in enumerate(devices) if camera in own), int(np.argmin(away))] += 1
    if not table.sum():
        return None
    table /= table.sum()
    chance = float(table.sum(axis=0) @ table.sum(axis=1))
    return None if chance >= 1 else (float(np.trace(table)) - chance) / (1 - chance)


@for_seeds(20)
def test_each_camera_looks_at_the_median_of_its_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, int(rng.integers(1, 12)), int(rng.integers(1, 40)), int(rng.integers(0, 90)))
    looks = camera_looks(scene)
    for index, stand in enumerate(scene.cameras.centers[:, :2]):
        own = scene.points[scene.observations[scene.observations[:, 1] == index, 0], :2]
        # Two middle values are added before or after halving: the last digit may differ.
        np.testing.assert_allclose(looks[index], np.median(own, axis=0) if len(own) else stand, rtol=1e-15, atol=1e-13)


@for_seeds(20)
def test_kappa_is_that_of_the_confusion_matrix(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, int(rng.integers(1, 30)), int(rng.integers(1, 60)), int(rng.integers(1, 300)))
    cloud, edges = planned(scene.cameras.centers[:, :2], random_system(rng, int(rng.integers(1, 4))))
    found, expected = strip_agreement(scene, cloud, edges), counted_kappa(scene, edges)
    assert (found is None) == (expected is None)
    if found is not None and expected is not None:
        assert found == pytest.approx(expected, abs=1e-12) and -1 <= found <= 1


def test_strips_cut_where_cameras_look_hold_what_their_devices_see() -> None:
    scene, system = oblique_scene(np.random.default_rng(1)), equal_edges(2)
    stand, look = (strip_agreement(scene, *planned(places, system)) for places in (scene.cameras.centers[:, :2], camera_looks(scene)))
    assert stand is not None and look is not None and stand < 0.2 and look > 0.7


@for_seeds(10)
def test_the_numbering_of_cameras_points_and_observations_changes_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene, system = random_scene(rng, 20, 50, 250), random_system(rng, 2)
    cloud, edges = planned(scene.cameras.centers[:, :2], system)
    cameras, points = rng.permutation(20), rng.permutation(50)
    seen = np.column_stack([np.argsort(points)[scene.observations[:, 0]], np.argsort(cameras)[scene.observations[:, 1]]])
    other = scene_of(scene.cameras.centers[cameras, :2], scene.points[points, :2], rng.permutation(seen))
    assert np.array_equal(camera_looks(other), camera_looks(scene)[cameras])
    moved = tuple(replace(plan, camera_indices=np.argsort(cameras)[plan.camera_indices]) for plan in edges)
    renumbered = replace(cloud, edge_of_camera=cloud.edge_of_camera[cameras])
    assert strip_agreement(other, renumbered, moved) == strip_agreement(scene, cloud, edges)


def test_an_edge_that_deals_later_counts_as_one_device() -> None:
    scene, system = oblique_scene(np.random.default_rng(2)), equal_edges(2)
    cloud, edges = planned(camera_looks(scene), system)
    undealt = tuple(
        replace(plan, device_ids=(), strips=(), device_time_s=[], device_of_camera=np.full(len(plan.camera_indices), -1), dealt=False)
        for plan in edges
    )
    one_each = tuple(
        replace(plan, device_ids=("all",), strips=(border,), device_time_s=[1.0], device_of_camera=np.zeros(len(plan.camera_indices)))
        for plan, border in zip(edges, cloud.borders, strict=True)
    )
    assert strip_agreement(scene, cloud, undealt) == pytest.approx(counted_kappa(scene, one_each), abs=1e-12)


def test_without_points_or_with_a_single_device_there_is_no_kappa() -> None:
    stands = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 5.0]])
    unseen = scene_of(stands, np.array([[3.0, 4.0]]), [])
    assert np.array_equal(camera_looks(unseen), stands)
    assert strip_agreement(unseen, *planned(stands, equal_edges(2))) is None
    seen = scene_of(stands, np.array([[3.0, 4.0], [1e6, 1e6]]), [[0, 0], [0, 2]])  # the second point is seen by nobody
    assert np.array_equal(camera_looks(seen), [[3.0, 4.0], [10.0, 0.0], [3.0, 4.0]])
    assert strip_agreement(seen, *planned(stands, equal_edges(1))) is None


def test_one_camera_and_cameras_of_one_region_alone_say_nothing() -> None:
    spot = np.array([[5.0, 5.0]])
    alone = scene_of(spot, np.array([[0.0, 0.0], [9.0, 9.0], [4.0, 7.0]]), [[0, 0], [1, 0], [2, 0]])
    assert np.array_equal(camera_looks(alone), [[4.0, 7.0]])
    assert strip_agreement(alone, *planned(spot, equal_edges(1))) is None
    # The edge without the camera has no land, and so no point.
    assert strip_agreement(alone, *planned(spot, equal_edges(2))) is None
    scene = oblique_scene(np.random.default_rng(3))
    cloud, edges = planned(scene.cameras.centers[:, :2], equal_edges(2))
    none, every = np.zeros(0, np.int64), np.arange(len(scene.cameras))
    first = replace(edges[0], camera_indices=every, device_of_camera=np.zeros(len(every), np.int64))
    rest = [replace(plan, camera_indices=none, device_of_camera=none) for plan in edges[1:]]
    # All observations are by one device: how many of them hit its strip is chance.
    owned = replace(cloud, edge_of_camera=np.zeros(len(every), np.int64))
    assert strip_agreement(scene, owned, (first, *rest)) == pytest.approx(0, abs=1e-12)


def test_points_beyond_any_plan_leave_a_camera_where_it_stands_and_nan_is_refused() -> None:
    stands = np.array([[0.0, 0.0], [10.0, 0.0]])
    far = scene_of(stands, np.array([[1e300, 0.0], [-1e300, 0.0], [1.7e308, 1.7e308], [7.0, 8.0]]), [[0, 0], [2, 0], [3, 1]])
    assert np.array_equal(camera_looks(far), [[0.0, 0.0], [7.0, 8.0]])
    edge = scene_of(stands, np.array([[MAX_COORDINATE_M, 0.0]]), [[0, 0]])
    assert np.array_equal(camera_looks(edge), [[MAX_COORDINATE_M, 0.0], [10.0, 0.0]])
    for poison in (np.nan, np.inf):
        with pytest.raises(BadInput, match="points"):
            scene_of(stands, np.array([[poison, 0.0]]), [[0, 0]])


def test_a_plan_of_other_cameras_is_refused() -> None:
    scene = oblique_scene(np.random.default_rng(4))
    cloud, edges = planned(scene.cameras.centers[:-1, :2], equal_edges(2))
    with pytest.raises(BadInput, match="is of 39 cameras, there are 40"):
        strip_agreement(scene, cloud, edges)
