"""What Open3D computes for core besides file formats: ICP with scale between two sets of surface points. Once per pair of models.

    (s, R, t) = argmin Σ ‖s R x_i + t − y_c(i)‖²,  c(i) the nearest target within the radius, anew in each iteration; radii fall.
A free scale may collapse: a shrunken cloud has a near neighbour everywhere. So the result says how it fared both ways.
Sources: Besl and McKay, PAMI 14 (1992); Umeyama, PAMI 13 (1991).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.frames import Sim3
from radiant_core.numerics import FloatArray, checked_array
from radiant_core.splats import Splats

MAX_ITERATIONS = 60
MAX_SCALE_CHANGE = 0.2
MIN_POINTS = 50
SURFACE_OPACITY = 0.4


@dataclass(frozen=True, kw_only=True, eq=False)
class IcpFit:
    """Similarity target ← source, the share of source points that met a target within the last radius, and their RMS distance in m."""

    target_from_source: Sim3
    overlap: float
    residual_m: float


def surface_points(splats: Splats, largest_m: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Means (K,3) m of the Gaussians that make a surface, and which (N,) those are: opaque, and at most
    `largest_m` wide, so no sky and no haze."""
    opaque = splats.logit_opacities > np.log(SURFACE_OPACITY / (1 - SURFACE_OPACITY))
    chosen = opaque & (splats.log_scales.max(axis=1, initial=-np.inf) < np.log(largest_m))
    return splats.means[chosen].astype(np.float64), chosen


def icp_with_scale(source: ArrayLike, target: ArrayLike, start: Sim3, radii_m: Sequence[float]) -> IcpFit | None:
    """Align source (N,3) to target (M,3) from `start` with falling radii; None with under 50 points or when the scale runs away (20 %).

    Raises BadInput on shapes or values that are not finite.
    """
    import open3d as o3d

    source, target = checked_array("source", source, (None, 3)), checked_array("target", target, (None, 3))
    if min(len(source), len(target)) < MIN_POINTS:
        return None
    registration = o3d.pipelines.registration
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(points))) for points in (source, target)]
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = start.scale * start.rotation, start.translation
    overlap = residual_m = 0.0
    for radius_m in radii_m:
        result = registration.registration_icp(
            clouds[0],
            clouds[1],
            radius_m,
            matrix,
            registration.TransformationEstimationPointToPoint(True),
            registration.ICPConvergenceCriteria(max_iteration=MAX_ITERATIONS),
        )
        matrix, overlap, residual_m = np.array(result.transformation), float(result.fitness), float(result.inlier_rmse)
        determinant = float(np.linalg.det(matrix[:3, :3])) if np.isfinite(matrix).all() else 0.0
        if not abs(np.log(max(determinant, 1e-300)) / 3 - np.log(start.scale)) < MAX_SCALE_CHANGE:
            return None
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    U, _, Vt = np.linalg.svd(matrix[:3, :3])
    fit = Sim3(scale=scale, rotation=U @ Vt, translation=matrix[:3, 3])
    return IcpFit(target_from_source=fit, overlap=overlap, residual_m=residual_m)
