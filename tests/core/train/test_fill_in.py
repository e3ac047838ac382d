"""Fill-in on a flat ground seen from above: where it lies, its colours, what it leaves alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from radiant_core.cameras import Cameras
from radiant_core.frames import Frame
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig
from radiant_core.train.fill_in import DEPTH_REACH_CELLS, NO_POINTS, contradicted_share, fill_in_points
from radiant_core.train.initialize import first_splats
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above

CAMERAS = cameras_above([(-1.0, 0.0), (1.0, 0.0)], size_wh=(80, 60))


def flat_scene(half_side_m: float) -> tuple[SfmScene, TrainingViews]:
    """Points of a square on z = 0, seen by both cameras; photographs red in the west, else blue."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-half_side_m, half_side_m, (200, 2)), np.zeros(200)])
    observations = np.array([(point, camera) for point in range(200) for camera in (0, 1)])
    frame = Frame(kind="metric", origin_lat_lon_alt=np.zeros(3))
    scene = SfmScene(cameras=CAMERAS, points=points, colors=np.full((200, 3), 99, np.uint8), observations=observations, frame=frame)
    images = []
    for center_x in (-1.0, 1.0):
        x = center_x + (np.arange(80) + 0.5 - 40) * 6.0 / 72
        row = np.where((x < 0)[:, None], [255, 0, 0], [0, 0, 255]).astype(np.uint8)
        images.append(np.broadcast_to(row, (60, 80, 3)).copy())
    return scene, TrainingViews(cameras=CAMERAS, images=tuple(images))


def test_fill_in_lies_on_the_ground_inside_the_images_in_their_colours() -> None:
    scene, views = flat_scene(half_side_m=0.7)
    added = fill_in_points(scene, views)
    assert len(added.points) > 100
    np.testing.assert_allclose(added.points[:, 2], 0, atol=1e-9)
    assert CAMERAS.any_sees(added.points).all()
    clear = np.abs(added.points[:, 0]) > 0.2
    west = added.points[clear, 0] < 0
    np.testing.assert_array_equal(added.colors[clear][west], np.broadcast_to([255, 0, 0], (west.sum(), 3)))
    np.testing.assert_array_equal(added.colors[clear][~west], np.broadcast_to([0, 0, 255], ((~west).sum(), 3)))


def test_places_with_sparse_points_get_nothing() -> None:
    scene, views = flat_scene(half_side_m=0.7)
    inside = (np.abs(fill_in_points(scene, views).points[:, :2]) < 0.5).all(axis=1)
    # 200 points on 1.4 × 1.4 m and cells of 0.33 m: hardly a cell in the square is empty.
    assert inside.sum() <= 6


def test_two_cameras_do_not_fill_the_same_place_twice() -> None:
    scene, views = flat_scene(half_side_m=0.7)
    points = fill_in_points(scene, views).points
    distances = np.linalg.norm(points[:, None] - points, axis=2) + 9 * np.eye(len(points))
    # Cells are 4 px, that is 0.333 m; cells of one camera touch, those of two keep 0.7 of a cell
    # apart.
    assert distances.min() > 0.7 * 0.33


def test_the_limit_holds_with_all_of_them() -> None:
    scene, views = flat_scene(half_side_m=0.7)
    for limit in (100, 300, 5000):
        splats, _ = first_splats(scene, views, TrainConfig(max_num_splats=limit, sh_degree=0))
        assert len(splats) <= limit


def test_a_camera_that_sees_almost_nothing_adds_nothing() -> None:
    scene, views = flat_scene(half_side_m=0.7)
    blind = SfmScene(cameras=CAMERAS, points=scene.points, colors=scene.colors, observations=np.array([[0, 0], [1, 0]]), frame=scene.frame)
    assert len(fill_in_points(blind, views).points) == 0


def oblique_camera() -> Cameras:
    """6 m above the ground, looking north and 25° down: the upper rows see over the horizon."""
    down = np.radians(25)
    rotation = np.array([[1.0, 0, 0], [0, -np.sin(down), -np.cos(down)], [0, np.cos(down), -np.sin(down)]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rotation @ np.array([0, 0, -6.0])
    K = np.array([[50.0, 0, 40], [0, 50, 30], [0, 0, 1]])
    return Cameras(names=("oblique.jpg",), Ks=K[None], cam_from_world=pose[None], sizes_wh=np.array([[80, 60]]))


def test_the_far_ground_of_an_oblique_view_comes_down_to_the_ground() -> None:
    rng = np.random.default_rng(0)
    near = np.column_stack([rng.uniform(-3, 3, 100), rng.uniform(7, 12, 100), np.zeros(100)])
    frame = Frame(kind="metric", origin_lat_lon_alt=np.zeros(3))
    observations = np.column_stack([np.arange(100), np.zeros(100, int)])
    camera = oblique_camera()
    scene = SfmScene(cameras=camera, points=near, colors=np.zeros((100, 3), np.uint8), observations=observations, frame=frame)
    added = fill_in_points(scene, TrainingViews(cameras=camera, images=(np.full((60, 80, 3), 7, np.uint8),))).points
    far = added[added[:, 1] > 15]
    assert len(far) > 20, "cells above the sparse points"
    # Up to 10 times the neighbours' depth of some 12 m rays reach the ground; flatter ones end at
    # that distance, above it.
    np.testing.assert_allclose(far[far[:, 1] < 90, 2], 0, atol=1e-9)
    assert np.linalg.norm(added, axis=1).max() < 10 * np.linalg.norm(near, axis=1).max() * 2


def wall_with_a_gap() -> tuple[SfmScene, TrainingViews]:
    """A wall 4 m north of two level cameras, a point every few cm but in a square 1 m wide."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-2, 2, 900), np.full(900, 4.0), rng.uniform(-1.4, 1.4, 900)])
    points = points[(np.abs(points[:, 0]) > 0.5) | (np.abs(points[:, 2] + 0.5) > 0.5)]
    poses = np.tile(np.eye(4), (2, 1, 1))
    # Camera axes: x east, y down, z north.
    poses[:, :3, :3] = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    poses[:, 0, 3] = [0.3, -0.3]
    K = np.array([[80.0, 0, 40], [0, 80, 30], [0, 0, 1]])
    cameras = Cameras(names=("a.jpg", "b.jpg"), Ks=np.tile(K, (2, 1, 1)), cam_from_world=poses, sizes_wh=np.tile([80, 60], (2, 1)))
    observations = np.array([(point, camera) for point in range(len(points)) for camera in (0, 1)])
    frame = Frame(kind="metric", origin_lat_lon_alt=np.zeros(3))
    scene = SfmScene(cameras=cameras, points=points, colors=np.full((len(points), 3), 99, np.uint8), observations=observations, frame=frame)
    return scene, TrainingViews(cameras=cameras, images=tuple(np.full((60, 80, 3), 7, np.uint8) for _ in range(2)))


def test_a_gap_in_a_wall_is_filled_in_the_wall_and_one_in_the_ground_in_the_ground() -> None:
    """Observed points say by which rule: a ray that is level comes down to no height."""
    wall = fill_in_points(*wall_with_a_gap())
    assert wall.rule == "depth" and wall.errors["depth"] < 1e-6 < 0.05 < wall.errors["height"]
    assert len(wall.points) >= 4
    np.testing.assert_allclose(wall.points[:, 1], 4.0, atol=1e-6)
    assert "at the depth of the points beside them (0.0 % off at observed points" in wall.placed
    ground = fill_in_points(*flat_scene(half_side_m=0.7))
    assert ground.rule == "height"


def test_by_depth_only_cells_near_an_observed_point_are_filled() -> None:
    """A gap 5 cells wide in the wall: its middle stays empty, and with a longer reach it is filled."""
    scene, views = wall_with_a_gap()
    cell_m = 4 * 4.0 / 80
    distances, _ = KDTree(scene.points).query(fill_in_points(scene, views).points)
    # Cameras 0.3 m aside see a cell's middle and an observed point as far apart as they are in the wall.
    assert distances.max() < DEPTH_REACH_CELLS * cell_m + 1e-6
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("radiant_core.train.fill_in.DEPTH_REACH_CELLS", 9.0)
        distances, _ = KDTree(scene.points).query(fill_in_points(scene, views).points)
        assert distances.max() > 2 * cell_m


def test_of_few_observed_points_none_is_asked() -> None:
    scene, views = wall_with_a_gap()
    few = replace(scene, observations=scene.observations[scene.observations[:, 0] < 10])
    added = fill_in_points(few, views)
    assert added.rule == "height" and not added.errors
    assert added.placed == "at the height of the points beside them"


def ring_of_cameras(num_views: int) -> Cameras:
    """Level cameras 5 m around the origin, 1 m above the ground, that look at it."""
    poses = []
    for angle in 2 * np.pi * np.arange(num_views) / num_views:
        center, forward = np.array([5 * np.cos(angle), 5 * np.sin(angle), 1.0]), np.array([-np.cos(angle), -np.sin(angle), -0.15])
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ center
        poses.append(pose)
    K = np.array([[70.0, 0, 40], [0, 70, 30], [0, 0, 1]])
    sizes = np.tile([80, 60], (num_views, 1))
    names = tuple(f"{view:02}.jpg" for view in range(num_views))
    return Cameras(names=names, Ks=np.tile(K, (num_views, 1, 1)), cam_from_world=np.stack(poses), sizes_wh=sizes)


def ball_before_a_wall() -> tuple[SfmScene, TrainingViews]:
    """A ball of 0.8 m that eight cameras see from all sides, a ring of the ground around it, and
    nothing of what is behind them."""
    rng, cameras = np.random.default_rng(0), ring_of_cameras(8)
    normals = rng.normal(size=(1_500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = 0.8 * normals + np.array([0, 0, 0.8])
    toward = cameras.centers[None] - points[:, None]
    facing = np.einsum("pc,pvc->pv", normals, toward) > 0
    angles, radii = rng.uniform(0, 2 * np.pi, 900), rng.uniform(2.6, 3.4, 900)
    points = np.concatenate([points, np.column_stack([radii * np.cos(angles), radii * np.sin(angles), np.zeros(900)])])
    facing = np.concatenate([facing, np.array([cameras.select([view]).any_sees(points[1_500:]) for view in range(8)]).T])
    frame = Frame(kind="metric", origin_lat_lon_alt=np.zeros(3))
    colors = np.full((len(points), 3), 99, np.uint8)
    scene = SfmScene(cameras=cameras, points=points, colors=colors, observations=np.argwhere(facing), frame=frame)
    return scene, TrainingViews(cameras=cameras, images=tuple(np.full((60, 80, 3), 7, np.uint8) for _ in range(8)))


def test_no_point_hangs_before_what_another_photograph_shows() -> None:
    """Rays beside the ball come down before it, where the camera opposite looks."""
    scene, views = ball_before_a_wall()
    added = fill_in_points(scene, views)
    assert added.seen_through_share > 0.02 and len(added.points)
    for pose, center in zip(views.cameras.cam_from_world, views.cameras.centers, strict=True):
        in_camera = added.points @ pose[:3, :3].T + pose[:3, 3]
        pixels = 70 * in_camera[:, :2] / in_camera[:, 2:]
        ball = (pose[:3, :3] @ np.array([0, 0, 0.8]) + pose[:3, 3]) / np.linalg.norm(center - [0, 0, 0.8])
        before = (in_camera[:, 2] > 0) & (in_camera[:, 2] < 3.5) & (np.linalg.norm(pixels - 70 * ball[:2] / ball[2], axis=1) < 7)
        assert not before.any()


def test_over_flat_ground_nothing_is_seen_through() -> None:
    assert fill_in_points(*flat_scene(half_side_m=0.7)).seen_through_share == 0.0


def test_points_are_contradicted_where_photographs_show_another_colour_there() -> None:
    """Photographs of one colour agree; of a colour each, most differ from any one of them."""
    scene, views = ball_before_a_wall()
    assert contradicted_share(fill_in_points(scene, views), views) == 0.0 == contradicted_share(NO_POINTS, views)
    colors = np.random.default_rng(0).integers(0, 255, (len(views), 3))
    each = replace(views, images=tuple(np.broadcast_to(color, (60, 80, 3)).astype(np.uint8) for color in colors))
    assert contradicted_share(fill_in_points(scene, each), each) > 0.6
    # Behind masks nothing contradicts them.
    masked = replace(each, weights=tuple(np.zeros((60, 80), np.uint8) for _ in each.images))
    assert contradicted_share(fill_in_points(scene, each), masked) == 0.0
