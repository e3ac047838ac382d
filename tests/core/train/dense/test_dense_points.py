"""Dense points of a plane and of a step of known height, and of scenes that allow none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.train.dense.fuse import DensePoints, concatenate_points, no_points, thinned
from radiant_core.train.dense.points import dense_points
from radiant_core.train.dense.sources import choose_sources
from tests.core.train.dense.textured import GRID, HEIGHT_M, SIZE_WH, step_height, step_scene

PIXEL_M = HEIGHT_M / (0.9 * SIZE_WH[0])


def test_a_plane_is_found_where_three_photographs_see_it() -> None:
    scene, views = step_scene(0.0)
    found = dense_points(scene, views, most=10**6)
    assert len(found) > 500
    assert np.median(np.abs(found.points[:, 2])) < 0.2 * PIXEL_M
    assert np.quantile(np.abs(found.points[:, 2]), 0.95) < PIXEL_M
    assert (found.normals @ [0, 0, 1] > 0.97).mean() > 0.95
    np.testing.assert_allclose(np.median(found.pixels_m), PIXEL_M, rtol=0.01)


def test_a_step_has_both_heights_and_nothing_between() -> None:
    height_m = 0.8
    scene, views = step_scene(height_m)
    found = dense_points(scene, views, most=10**6)
    edge = np.abs(np.abs(found.points[:, :2]).max(axis=1) - 1.0)
    errors = np.abs(found.points[:, 2] - step_height(found.points[:, :2], height_m))
    # A window is 15 px wide: only nearer than half of one to the edge it holds both surfaces.
    clear = edge > 7 * PIXEL_M
    on_top = step_height(found.points[:, :2], height_m) > 0
    assert (clear & on_top).sum() > 50 and (clear & ~on_top).sum() > 300
    assert np.quantile(errors[clear], 0.95) < PIXEL_M
    assert (errors < 2 * PIXEL_M).mean() > 0.8


def test_colors_are_those_of_the_photographs() -> None:
    scene, views = step_scene(0.0)
    found = dense_points(scene, views, most=10**6)
    cameras = views.cameras
    for index in np.unique(found.views):
        own = found.select(found.views == index)
        in_camera = own.points @ cameras.cam_from_world[index, :3, :3].T + cameras.cam_from_world[index, :3, 3]
        x, y = np.floor((in_camera @ cameras.Ks[index].T)[:, :2] / in_camera[:, 2:]).astype(int).T
        near = np.abs(views.images[int(index)][y, x].astype(int) - own.colors).max(axis=1) <= 40
        assert near.mean() > 0.9


def test_neither_threads_nor_calls_change_a_bit() -> None:
    scene, views = step_scene(0.4)
    one, again, three = (dense_points(scene, views, most=400, num_threads=threads) for threads in (1, 1, 3))
    for name in ("points", "normals", "colors", "costs", "views"):
        np.testing.assert_array_equal(getattr(one, name), getattr(again, name))
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))


def test_masked_pixels_give_no_points() -> None:
    scene, views = step_scene(0.0)
    weights = tuple(
        np.where(np.arange(SIZE_WH[0]) < SIZE_WH[0] // 2, 255, 0).astype(np.uint8) * np.ones((SIZE_WH[1], 1), np.uint8) for _ in GRID
    )
    found = dense_points(scene, replace(views, weights=weights), most=10**6)
    assert len(found) > 100
    centers = views.cameras.centers[found.views]
    assert (found.points[:, 0] - centers[:, 0] < PIXEL_M).all()


@pytest.mark.parametrize("level", [0, 255])
def test_photographs_without_texture_give_nothing(level: int) -> None:
    scene, views = step_scene(0.0)
    flat = tuple(np.full_like(image, level) for image in views.images)
    assert len(dense_points(scene, replace(views, images=flat), most=1000)) == 0


def test_cameras_in_one_place_give_nothing() -> None:
    scene, views = step_scene(0.0)
    still = replace(scene.cameras, cam_from_world=np.repeat(scene.cameras.cam_from_world[4:5], len(GRID), axis=0))
    assert len(dense_points(replace(scene, cameras=still), replace(views, cameras=still), most=1000)) == 0


@pytest.mark.parametrize("count", [1, 2])
def test_fewer_than_three_photographs_give_nothing(count: int) -> None:
    scene, views = step_scene(0.0)
    few = np.arange(count)
    assert len(dense_points(scene.restricted_to(few), views.select(few), most=1000)) == 0


def test_photographs_that_share_no_points_give_nothing() -> None:
    scene, views = step_scene(0.0)
    own = scene.observations[scene.observations[:, 0] % len(GRID) == scene.observations[:, 1]]
    assert len(dense_points(replace(scene, observations=own), views, most=1000)) == 0


def test_a_scene_without_observations_gives_nothing() -> None:
    scene, views = step_scene(0.0)
    assert len(dense_points(replace(scene, observations=np.zeros((0, 2), np.int64)), views, most=1000)) == 0


def test_photographs_of_a_few_pixels_give_nothing() -> None:
    scene, views = step_scene(0.0)
    assert len(dense_points(scene, views.scaled(0.03), most=1000)) == 0


def test_points_behind_and_at_the_cameras_break_nothing() -> None:
    scene, views = step_scene(0.0)
    points = scene.points.copy()
    points[:10] = views.cameras.centers[0]
    points[10:20, 2] = 50.0
    found = dense_points(replace(scene, points=points), views, most=10**6)
    assert np.isfinite(found.points).all() and len(found) > 500
    assert np.median(np.abs(found.points[:, 2])) < 0.2 * PIXEL_M


def test_partners_are_the_cameras_beside_and_never_itself() -> None:
    scene, _ = step_scene(0.0)
    partners = choose_sources(scene, 4)
    for index, own in enumerate(partners):
        assert index not in own and len(own) == 4
        assert len(np.unique(own)) == 4
    # All share all points; from a corner the two beside it are seen under 7.6°, the opposite one 21°.
    assert 8 not in partners[0] and 0 not in partners[8]


def cloud(count: int, seed: int = 0) -> DensePoints:
    rng = np.random.default_rng(seed)
    return DensePoints(
        points=np.column_stack([rng.uniform(0, 10, (count, 2)), np.zeros(count)]),
        normals=np.tile([0.0, 0, 1], (count, 1)),
        colors=np.zeros((count, 3), np.uint8),
        pixels_m=np.full(count, 0.05),
        costs=rng.random(count),
        views=np.zeros(count, np.int64),
    )


@pytest.mark.parametrize("most", [1, 10, 1000, 5000, 10**6])
def test_thinning_keeps_to_the_number_evenly_and_prefers_good_matches(most: int) -> None:
    points = cloud(20_000)
    kept = thinned(points, most)
    assert min(most, 1) <= len(kept) <= min(most, len(points))
    if most == 1000:
        assert len(kept) > 600
        quarters = np.histogram2d(kept.points[:, 0], kept.points[:, 1], bins=4)[0]
        assert quarters.min() > 0.5 * len(kept) / 16
        assert kept.costs.mean() < 0.2


def test_nothing_is_thinned_to_nothing() -> None:
    assert len(thinned(no_points(), 10)) == len(concatenate_points([])) == 0
