"""The similarity between two models from their surfaces alone, by ICP. Once per pair.

For models whose renders have no texture to match. ICP with a free scale finds many wrong answers
(in the town it was right for 1 of 4 pairs, and one collapsed by 94 %: docs/experiments/frames.md).
So it is accepted only where runs both ways are each other's inverse and most points meet.
"""

from __future__ import annotations

import numpy as np

from radiant_core.geometry.frame_matches import IDENTITY
from radiant_core.geometry.open3d_ops import icp_with_scale
from radiant_core.geometry.pair_fit import PairFit, compose, similarity_about, xi_about
from radiant_core.numerics import FloatArray

MIN_OVERLAP = 0.6
MAX_APART = np.array([0.15, 0.15, 0.15, 0.003, 0.003, 0.003, 0.003])
"""How far (m, rad, 1) both ways may differ."""
LAST_RADIUS_M = 0.5
MAX_POINTS = 20_000


def icp_match(a: FloatArray, b: FloatArray, first_radius_m: float) -> PairFit | str:
    """The similarity a ← b of common surface points (N,3), (M,3) m in nearly one frame, or one
    clause that says why there is none."""
    a, b = _thin(a), _thin(b)
    radii_m = [radius_m for radius_m in first_radius_m * 0.5 ** np.arange(12) if radius_m > LAST_RADIUS_M]
    radii_m.append(LAST_RADIUS_M)
    there, back = icp_with_scale(b, a, IDENTITY, radii_m), icp_with_scale(a, b, IDENTITY, radii_m)
    if there is None or back is None:
        return "ICP of their surfaces lost its scale or had too few points"
    overlap = min(there.overlap, back.overlap)
    if overlap < MIN_OVERLAP:
        return f"ICP of their surfaces brought only {overlap:.0%} of the points within {LAST_RADIUS_M} m"
    center = a.mean(axis=0)
    apart = xi_about(center, compose(there.target_from_source, back.target_from_source))
    if (np.abs(apart) > MAX_APART).any():
        return f"ICP of their surfaces there and back differ by {np.linalg.norm(apart[:3]):.2f} m and {100 * apart[6]:.2f} % of scale"
    return PairFit(
        a_from_b=compose(similarity_about(center, -apart / 2), there.target_from_source),
        center=center,
        covariance=np.diag((MAX_APART / 2) ** 2 + apart**2),
        num_pairs=int(there.overlap * len(b)),
        residual_m=there.residual_m,
        num_followed=len(b),
    )


def _thin(points: FloatArray) -> FloatArray:
    return points[:: max(1, -(-len(points) // MAX_POINTS))]
