"""Depths that several photographs agree on, as points in the world. Once per photograph, and a
thinning of all.

A node's point X is kept where at least `MIN_AGREEING` partners, three photographs with its own,
have a plane at X's projection whose own point there
    projects back to within 1 px of the node,   and has a depth within 1 % of X's.
The kept point is the mean of those that agree. N nodes or points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core import _native
from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_core.train.dense.depth_planes import DepthPlanes, pixel_matrix

MIN_AGREEING = 2
MAX_REPROJECTION_PX = 1.0
MAX_DEPTH_DIFFERENCE = 0.01
MAX_COST = 0.5
"""A plane that costs more is no match."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DensePoints:
    """points and normals (N,3), normals towards the camera; colors (N,3) uint8; pixels_m (N,) the
    width of a pixel there; costs (N,) of their matches, and views (N,) whose photograph has
    them."""

    points: FloatArray
    normals: FloatArray
    colors: NDArray[np.uint8]
    pixels_m: FloatArray
    costs: FloatArray
    views: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.points)

    def select(self, chosen: NDArray[np.integer] | NDArray[np.bool_]) -> DensePoints:
        """Some of the points."""
        return DensePoints(**{name: getattr(self, name)[chosen] for name in _FIELDS})


_FIELDS = ("points", "normals", "colors", "pixels_m", "costs", "views")


def agreed_points(
    maps: Sequence[DepthPlanes | None], cameras: Cameras, index: int, partners: NDArray[np.int64], image: NDArray[np.uint8]
) -> DensePoints:
    """The points of photograph `index` (H,W,3) that enough of its partners agree on."""
    reference = maps[index]
    if reference is None:
        return no_points()
    view_indices = [index, *(int(partner) for partner in partners if maps[int(partner)] is not None)]
    planes = [lattice for at in view_indices if (lattice := maps[at]) is not None]
    sums, agreeing = _native.sum_agreeing(
        [np.ascontiguousarray(lattice.planes) for lattice in planes],
        np.ascontiguousarray(reference.costs),
        np.stack([_numbers(lattice, cameras, at) for lattice, at in zip(planes, view_indices, strict=True)]),
        np.array([MAX_COST, MAX_REPROJECTION_PX, MAX_DEPTH_DIFFERENCE]),
    )
    agreed_rows = np.flatnonzero(agreeing >= MIN_AGREEING)
    pixels, (w, a, b) = reference.pixels_of(agreed_rows), reference.planes.reshape(3, -1)[:, agreed_rows].astype(np.float64)
    K, pose = pixel_matrix(cameras, index), cameras.cam_from_world[index]
    x, y = pixels.astype(np.int64).T
    return DensePoints(
        points=sums[agreed_rows] / (1 + agreeing[agreed_rows, None]),
        normals=_normals(pixels, np.stack([w, a, b]), K, pose),
        colors=image[y, x],
        pixels_m=1 / (w * K[0, 0]),
        costs=reference.costs.ravel()[agreed_rows].astype(np.float64),
        views=np.full(len(agreed_rows), index),
    )


def thinned(points: DensePoints, most: int) -> DensePoints:
    """At most about `most` points: the best match of each cell of a grid, whose cells grow with the
    width of a pixel, so that what is near is kept finer."""
    if len(points) <= most:
        return points
    best_first = points.select(np.argsort(points.costs, kind="stable"))
    cell_px, rows = 1.0, np.arange(0)
    for _ in range(6):
        rows = _first_of_cells(best_first, cell_px)
        if 0.95 * most <= len(rows) <= most:
            break
        cell_px *= max(0.25, min(8.0, float(np.sqrt(len(rows) / (0.975 * most)))))
    return best_first.select(np.sort(rows)[:most])


def no_points() -> DensePoints:
    """None at all."""
    none = np.zeros((0, 3))
    return DensePoints(
        points=none, normals=none, colors=np.zeros((0, 3), np.uint8), pixels_m=none[:, 0], costs=none[:, 0], views=np.zeros(0, np.int64)
    )


def concatenate_points(parts: Sequence[DensePoints]) -> DensePoints:
    """All points of `parts` in order."""
    return DensePoints(**{name: np.concatenate([getattr(part, name) for part in (no_points(), *parts)]) for name in _FIELDS})


def _first_of_cells(points: DensePoints, cell_px: float) -> NDArray[np.int64]:
    """Rows of the first point of each cell of about `cell_px` pixels."""
    level = np.rint(2 * np.log2(np.maximum(cell_px * points.pixels_m, 1e-12)))
    cells = np.floor(points.points / (2 ** (level / 2))[:, None]).astype(np.int64)
    # Cells of 64 bits: a collision of two cells loses one point of millions.
    key = (cells.astype(np.uint64) * np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)).sum(axis=1)
    key ^= level.astype(np.int64).astype(np.uint64) * np.uint64(0xD6E8FEB86659FD93)
    return np.unique(key, return_index=True)[1]


def _numbers(lattice: DepthPlanes, cameras: Cameras, index: int) -> FloatArray:
    """What the native module takes of a camera and its lattice (18,)."""
    K, pose = pixel_matrix(cameras, index), cameras.cam_from_world[index, :3]
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], lattice.first, lattice.step, *pose.ravel()], np.float64)


def _normals(pixels: FloatArray, planes: FloatArray, K: FloatArray, pose: FloatArray) -> FloatArray:
    """Unit normals (N,3) in the world of planes (3,N) at pixels, towards the camera."""
    w, a, b = planes
    away = pixels - K[:2, 2]
    in_camera = np.column_stack([a * K[0, 0], b * K[1, 1], w - a * away[:, 0] - b * away[:, 1]])
    return -(in_camera / np.linalg.norm(in_camera, axis=1, keepdims=True)) @ pose[:3, :3]
