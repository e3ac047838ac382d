"""Inverse depth of one photograph as planes on a lattice of its pixels. Once per photograph.

    w(x + dx, y + dy) = w + a dx + b dy       w = 1 / z; what is flat in the world is linear in w

PatchMatch (native/dense) looks for the planes under which neighbouring photographs show the same.
It begins with the nearest sparse point of every node, facing the camera and lying flat, so that a
few passes are enough. R × C nodes, V cameras, pixels count from the middle of the first one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core import _native
from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray

STEP_PX = 5
"""Pixels from node to node."""
MARGIN = 1.25
"""Planes may be by this factor nearer or farther than the sparse points."""
RANGE_QUANTILES = (0.005, 0.995)
MIN_COSINE = 0.17
"""Surfaces steeper than 80° against the line of sight are not matched."""
PASSES = ((4, 3.0), (2, 1.0), (1, 0.3))
"""Reach in nodes and size of random changes in pixels of each pass."""
MIN_SPARSE = 4
"""A photograph with fewer sparse points has no range of depths."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthPlanes:
    """Inverse depths and slopes (3,R,C) float32 at nodes of a photograph, and costs (R,C): 0 is a
    perfect match, 1 none, 2 nothing to compare. Node (r, c) is pixel `first` + `step` (c, r)."""

    planes: NDArray[np.float32]
    costs: NDArray[np.float32]
    first: int
    step: int

    def pixels_of(self, nodes: NDArray[np.int64]) -> FloatArray:
        """Pixels (N,2) of some of the R C nodes, which count along the rows."""
        rows, columns = np.divmod(nodes, self.costs.shape[1])
        return self.first + self.step * np.column_stack([columns, rows]).astype(np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class SparseDepths:
    """Pixels (K,2) of sparse points in one photograph and their inverse depths (K,)."""

    pixels: FloatArray
    inverse_depths: FloatArray


def match_planes(
    images: Sequence[NDArray[np.uint8]], cameras: Cameras, indices: Sequence[int], sparse: SparseDepths, *, seed: int, num_threads: int
) -> DepthPlanes | None:
    """Planes of the photograph `indices[0]` against the others of `indices`; None where it has too
    few sparse points. `images`: grey (H,W) uint8 of these, in the same order; `cameras`: all."""
    if len(sparse.inverse_depths) < MIN_SPARSE:
        return None
    height, width = images[0].shape
    reference = int(indices[0])
    first, step = STEP_PX // 2, STEP_PX
    shape = (height - 1 - first) // step + 1, (width - 1 - first) // step + 1
    K = pixel_matrix(cameras, reference)
    maps = np.stack([_map_to(cameras, reference, int(partner)) for partner in indices[1:]])
    low, high = np.quantile(sparse.inverse_depths, RANGE_QUANTILES)
    moved_px = np.array([_pixels_per_inverse_depth(one, (width, height), float(np.median(sparse.inverse_depths))) for one in maps])
    planes_and_costs = _native.match_planes(
        np.ascontiguousarray(images[0]),
        [np.ascontiguousarray(image) for image in images[1:]],
        maps,
        first_candidates(sparse, K, cameras.cam_from_world[reference, :3, :3], shape, (first, step)),
        np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], first, step]),
        np.array([low / MARGIN, high * MARGIN, MIN_COSINE, 1 / max(float(np.median(moved_px)), 1e-12)]),
        np.array(PASSES, np.float64),
        seed,
        num_threads,
    )
    return DepthPlanes(planes=planes_and_costs[:3], costs=planes_and_costs[3], first=first, step=step)


def pixel_matrix(cameras: Cameras, index: int) -> FloatArray:
    """K (3,3) of a camera for pixels that count from the middle of the first one."""
    K = cameras.Ks[index].copy()
    K[:2, 2] -= 0.5
    return K


def first_candidates(
    sparse: SparseDepths, K: FloatArray, cam_from_world: FloatArray, shape: tuple[int, int], lattice: tuple[int, int]
) -> NDArray[np.float32]:
    """Two sets of planes (2,3,R,C): at the nearest sparse point's depth, facing the camera and
    horizontal in the world (z up)."""
    first, step = lattice
    rows, columns = shape
    at = np.rint((sparse.pixels - first) / step).astype(np.int64).clip(0, np.array([columns, rows]) - 1)
    empty = np.ones(shape, np.uint8)
    empty[at[:, 1], at[:, 0]] = 0
    labels = np.asarray(cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)[1], np.int64)
    point_of = np.zeros(int(labels.max()) + 1, np.int64)
    point_of[labels[at[:, 1], at[:, 0]]] = np.arange(len(at))
    nearest = point_of[labels]
    w = sparse.inverse_depths[nearest]
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    rays = np.stack([first + step * column, first + step * row, np.ones_like(row)], axis=-1) @ np.linalg.inv(K).T
    up = cam_from_world[:, 2]
    of_points = np.column_stack([sparse.pixels, np.ones(len(at))]) @ np.linalg.inv(K).T
    heights = (of_points @ up / sparse.inverse_depths)[nearest]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        flat = np.stack([rays @ up / heights, up[0] / K[0, 0] / heights, up[1] / K[1, 1] / heights])
        flat = np.where(np.isfinite(flat) & (np.abs(flat) < 1e30), flat, 0)
    facing = np.stack([w, np.zeros(shape), np.zeros(shape)])
    return np.ascontiguousarray(np.stack([facing, flat]), np.float32)


def _map_to(cameras: Cameras, reference: int, partner: int) -> FloatArray:
    """(12,): M row by row and m of p' = M (x, y, 1) + m w, homogeneous pixels of `partner`."""
    partner_from_reference = cameras.cam_from_world[partner] @ np.linalg.inv(cameras.cam_from_world[reference])
    K_partner = pixel_matrix(cameras, partner)
    matrix = K_partner @ partner_from_reference[:3, :3] @ np.linalg.inv(pixel_matrix(cameras, reference))
    return np.concatenate([matrix.ravel(), K_partner @ partner_from_reference[:3, 3]])


def _pixels_per_inverse_depth(one: FloatArray, size_wh: tuple[int, int], w: float) -> float:
    """How far the picture of the middle pixel moves in the other photograph per inverse depth."""
    matrix, offset = one[:9].reshape(3, 3), one[9:]
    x, y, z = matrix @ np.array([size_wh[0] / 2, size_wh[1] / 2, 1.0]) + offset * w
    return float(np.hypot(offset[0] * z - offset[2] * x, offset[1] * z - offset[2] * y) / max(z * z, 1e-300))
