"""Points that photographs agree on: against the same law in numpy, of broken planes, and what the
native module refuses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from radiant_core import _native
from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_core.train.dense.depth_planes import DepthPlanes, pixel_matrix
from radiant_core.train.dense.fuse import MAX_COST, MAX_DEPTH_DIFFERENCE, MAX_REPROJECTION_PX, MIN_AGREEING, agreed_points
from tests.core.scenes import cameras_above
from tests.core.train.dense.textured import GRID, HEIGHT_M, SIZE_WH, step_height, surface_of

STEP_M = 0.6
# Off a regular grid, on which nodes are seen exactly half-way between two others: either may be
# the nearest.
PLACES = [(x + 0.0137 * at, y - 0.0071 * at) for at, (x, y) in enumerate(GRID)]


def planes_of(
    cameras: Cameras, index: int, rng: np.random.Generator, *, first: int = 2, step: int = 5, noise: float = 0.006
) -> DepthPlanes:
    """What a camera sees of the step at the nodes of a lattice, some of it wrong, none or dear."""
    centers = surface_of(cameras, index, STEP_M)
    z = centers @ cameras.cam_from_world[index, 2, :3] + cameras.cam_from_world[index, 2, 3]
    w = 1 / z[first::step, first::step] * (1 + noise * rng.normal(size=z[first::step, first::step].shape))
    w[rng.uniform(size=w.shape) < 0.1] *= 1.3
    w[rng.uniform(size=w.shape) < 0.1] = 0
    slopes = rng.normal(size=(2, *w.shape)) * 1e-4
    return DepthPlanes(
        planes=np.concatenate([w[None], slopes]).astype(np.float32),
        costs=rng.uniform(0, 0.6, w.shape).astype(np.float32),
        first=first,
        step=step,
    )


def to_world(pixels: FloatArray, w: FloatArray, K: FloatArray, pose: FloatArray) -> FloatArray:
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(K).T
    return (rays / w[:, None] - pose[:3, 3]) @ pose[:3, :3]


def to_image(points: FloatArray, K: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    projected = in_camera @ K.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return projected[:, :2] / projected[:, 2:], in_camera[:, 2]


def twin(maps: Sequence[DepthPlanes], cameras: Cameras, index: int, partners: Sequence[int]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Sums and counts of all nodes, photograph after photograph."""
    own = maps[index]
    pixels = own.pixels_of(np.arange(own.costs.size))
    w = own.planes[0].ravel().astype(np.float64)
    asked = (w > 0) & (own.costs.ravel() < MAX_COST)
    K, pose = pixel_matrix(cameras, index), cameras.cam_from_world[index]
    points = to_world(pixels, np.where(asked, w, 1), K, pose)
    sums, counts = np.where(asked[:, None], points, 0), np.zeros(len(w), np.int64)
    for partner in partners:
        other = maps[partner]
        K_other, pose_other = pixel_matrix(cameras, partner), cameras.cam_from_world[partner]
        seen_at, z = to_image(points, K_other, pose_other)
        at = np.rint((seen_at - other.first) / other.step)
        inside = (at >= 0).all(axis=1) & (at[:, 0] < other.costs.shape[1]) & (at[:, 1] < other.costs.shape[0]) & (z > 0)
        column, row = np.where(inside[:, None], at, 0).astype(int).T
        of_node, a, b = other.planes[:, row, column].astype(np.float64)
        away = seen_at - (other.first + other.step * np.column_stack([column, row]))
        w_other = of_node + a * away[:, 0] + b * away[:, 1]
        found = inside & (of_node > 0) & (w_other > 0)
        theirs = to_world(seen_at, np.where(found, w_other, 1), K_other, pose_other)
        back, z_back = to_image(theirs, K, pose)
        near = (
            (z_back > 0) & (np.abs(z_back * w - 1) < MAX_DEPTH_DIFFERENCE) & (np.linalg.norm(back - pixels, axis=1) < MAX_REPROJECTION_PX)
        )
        near &= found & asked
        sums[near] += theirs[near]
        counts += near
    return sums, counts


@pytest.mark.parametrize("index", [0, 4])
def test_points_are_those_of_the_law_in_numpy(index: int) -> None:
    cameras = cameras_above(PLACES, height_m=HEIGHT_M, size_wh=SIZE_WH)
    rng = np.random.default_rng(index)
    maps = [planes_of(cameras, at, rng, first=at % 3, step=3 + at % 3) for at in range(len(cameras))]
    partners = np.array([at for at in range(len(cameras)) if at != index])
    image = rng.integers(0, 256, (SIZE_WH[1], SIZE_WH[0], 3)).astype(np.uint8)
    sums, counts = twin(maps, cameras, index, partners.tolist())
    kept = np.flatnonzero(counts >= MIN_AGREEING)
    assert 100 < len(kept) < 0.9 * len(counts), "the twin keeps nearly nothing or all"
    found = agreed_points(maps, cameras, index, partners, image)
    np.testing.assert_allclose(found.points, sums[kept] / (1 + counts[kept, None]), rtol=0, atol=1e-12)
    x, y = maps[index].pixels_of(kept).astype(int).T
    np.testing.assert_array_equal(found.colors, image[y, x])
    np.testing.assert_array_equal(found.costs, maps[index].costs.ravel()[kept])
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1)
    # What is kept lies on the step: within what its planes are off by.
    off = np.abs(found.points[:, 2] - step_height(found.points[:, :2], STEP_M))
    assert np.quantile(off, 0.9) < 0.02 * HEIGHT_M
    missing = [None if at == int(partners[0]) else each for at, each in enumerate(maps)]
    assert len(agreed_points(missing, cameras, index, partners, image)) == len(agreed_points(maps, cameras, index, partners[1:], image))
    assert len(agreed_points([None] * len(maps), cameras, index, partners, image)) == 0
    assert len(agreed_points(maps, cameras, index, partners[:0], image)) == 0


@pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-38, 3e38])
def test_broken_planes_give_no_point_and_spoil_none(poison: float) -> None:
    cameras = cameras_above(PLACES, height_m=HEIGHT_M, size_wh=SIZE_WH)
    rng = np.random.default_rng(1)
    maps = [planes_of(cameras, at, rng, noise=0.0) for at in range(len(cameras))]
    partners, image = np.array([0, 1, 2, 3]), np.zeros((SIZE_WH[1], SIZE_WH[0], 3), np.uint8)
    clean = agreed_points(maps, cameras, 4, partners, image)
    for part in range(3):
        for at in (0, 4):
            planes = maps[at].planes.copy()
            planes[part, ::2] = poison
            broken = [DepthPlanes(planes=planes, costs=each.costs, first=2, step=5) if each is maps[at] else each for each in maps]
            found = agreed_points(broken, cameras, 4, partners, image)
            assert np.isfinite(found.points).all() and 0 < len(found) <= len(clean)
            off = np.abs(found.points[:, 2] - step_height(found.points[:, :2], STEP_M))
            assert np.median(off) < 0.02 * HEIGHT_M


def test_what_cannot_be_is_refused() -> None:
    planes, costs = np.ones((3, 4, 5), np.float32), np.zeros((4, 5), np.float32)
    camera = np.concatenate([[10, 10, 5, 4, 0, 1], np.eye(4)[:3].ravel()])[None]
    limits = np.array([0.5, 1.0, 0.01])
    sums, counts = _native.sum_agreeing([planes], costs, camera, limits)
    assert sums.shape == (20, 3) and counts.tolist() == [0] * 20 and (sums[:, 2] == 1).all()
    empty = np.zeros((3, 0, 5), np.float32)
    assert len(_native.sum_agreeing([empty], empty[0], camera, limits)[1]) == 0
    for wrong, told in (
        (([], costs, camera[:0], limits), "planes is empty"),
        (([planes[:2]], costs, camera, limits), r"expected \(3, R, C\)"),
        (([planes], costs[:2], camera, limits), "costs has another shape"),
        (([planes], costs, camera[:, 1:], limits), "cameras has 17 numbers, expected 18"),
        (([planes], costs, camera * np.nan, limits), "not finite"),
        (([planes], costs, camera * -1, limits), "not positive"),
        (([planes], costs, camera, limits[:2]), "limits has 2 numbers, expected 3"),
    ):
        with pytest.raises(ValueError, match=told):
            _native.sum_agreeing(*wrong)
