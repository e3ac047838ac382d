"""Points from where images see them: by rays first, then by least squares in pixels.

rays:    (Σ (I − d dᵀ)) X = Σ (I − d dᵀ) c      directions d, centres c
pixels:  Gauss–Newton of Σ ‖u − π(X)‖², cameras held
"""

from __future__ import annotations

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.sfm.control.bundle import Bundle, Rows, Ties

NUM_STEPS = 3
MIN_ANGLE_DEG = 1.0


def intersect_rays(bundle: Bundle, ties: Ties, count: int) -> FloatArray:
    """Points (count,3) of ties whose `points` are rows of the result; NaN where under two images
    see one, or their rays are within a degree."""
    directions = _directions(bundle, ties)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    sides = np.einsum("kij,kj->ki", across, bundle.centers[ties.images])
    A, b = sum_by(ties.points, across, count), sum_by(ties.points, sides, count)
    points = np.full((count, 3), np.nan)
    # The least eigenvalue is the sum of squared sines about the rays' middle.
    least = np.linalg.eigvalsh(A)[:, 0] if count else np.zeros(0)
    fixed = least > np.sin(np.radians(MIN_ANGLE_DEG)) ** 2
    points[fixed] = np.linalg.solve(A[fixed], b[fixed][:, :, None])[:, :, 0]
    return points


def refine_points(bundle: Bundle, ties: Ties, points: FloatArray) -> FloatArray:
    """Points (P,3) moved to where their ties have them; one that gets worse, or is seen by too few,
    stays."""
    best, best_cost = points, _costs(bundle, ties, points)
    for _ in range(NUM_STEPS):
        pixels, _, _, by_point = bundle.derivatives(ties.images, best[ties.points])
        residuals = ties.pixels - pixels
        is_usable = np.isfinite(residuals).all(axis=1) & np.isfinite(by_point).all(axis=(1, 2))
        J, r, rows = by_point[is_usable], residuals[is_usable], ties.points[is_usable]
        V, side = sum_by(rows, np.einsum("kij,kil->kjl", J, J), len(points)), sum_by(rows, np.einsum("kij,ki->kj", J, r), len(points))
        V = V + (1e-9 * np.einsum("pii->p", V)[:, None, None] + 1e-300) * np.eye(3)
        new = best + np.linalg.solve(V, side[:, :, None])[:, :, 0]
        cost = _costs(bundle, ties, new)
        better = cost < best_cost
        best, best_cost = np.where(better[:, None], new, best), np.where(better, cost, best_cost)
    return best


def sum_by(rows: Rows, values: FloatArray, count: int) -> FloatArray:
    """Sums (count,…) of values (K,…) over the rows (K,) that they belong to."""
    # Not -1: of no values at all the rest cannot be told.
    flat = values.reshape(len(rows), int(np.prod(values.shape[1:], dtype=np.int64)))
    sums = np.zeros((flat.shape[1], count))
    for column in range(flat.shape[1]):
        sums[column] = np.bincount(rows, flat[:, column], count)
    return sums.T.reshape(count, *values.shape[1:])


def _costs(bundle: Bundle, ties: Ties, points: FloatArray) -> FloatArray:
    squares = np.square(bundle.project(ties.images, points[ties.points]) - ties.pixels).sum(axis=1)
    return sum_by(ties.points, np.where(np.isfinite(squares), squares, 1e12), len(points))


def _directions(bundle: Bundle, ties: Ties) -> FloatArray:
    """Unit vectors (K,3) in the world of what the images see."""
    flat = np.zeros((len(ties.images), 2))
    for row, lens in enumerate(bundle.lenses):
        in_lens = bundle.lens_of_image[ties.images] == row
        if in_lens.any():
            flat[in_lens] = lens.cam_from_img(ties.pixels[in_lens])
    local = np.column_stack([flat, np.ones(len(flat))])
    turned = np.einsum("kji,kj->ki", bundle.rotations[ties.images], local)
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)
