"""Do matches agree with the poses of their photographs? Once per pair.

    e = |x₂ᵀ E x₁| f / √((E x₁)₁² + (E x₁)₂² + (Eᵀ x₂)₁² + (Eᵀ x₂)₂²)      Sampson's distance, px

with E = [t]ₓ R of the two poses and x on the image planes at distance 1. Where poses are known this
replaces RANSAC: E need not be searched for, and what lies within 4 px of its line is what RANSAC
would keep for that E.
"""

from __future__ import annotations

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.quick.descriptors import Matches

MAX_EPIPOLAR_PX = 4.0
"""The error up to which COLMAP calls a match verified."""
MIN_MATCHES = 15
"""Pairs with fewer verified matches say nothing, as COLMAP counts them too."""


def camera_rays(camera: pycolmap.Camera, keypoints: FloatArray) -> FloatArray:
    """Keypoints (N,≥2) on the image plane at distance 1, homogeneous (N,3); a point outside of what
    the lens can show is not finite."""
    plane = np.asarray(camera.cam_from_img(keypoints[:, :2]), np.float64).reshape(-1, 2)
    return np.column_stack([plane, np.ones(len(plane))])


def epipolar_errors(second_from_first: FloatArray, from_first: FloatArray, from_second: FloatArray) -> FloatArray:
    """Sampson's distances (N,) of rays (N,3) on the image planes at distance 1, for a rigid motion
    (4,4); not a number where both images are in one place."""
    x, y, z = second_from_first[:3, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ second_from_first[:3, :3]
    with np.errstate(invalid="ignore", divide="ignore"):
        lines, back = from_first @ essential.T, from_second @ essential
        return np.abs((from_second * lines).sum(axis=1)) / np.sqrt((lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))


def verify_by_poses(
    second_from_first: FloatArray, rays: tuple[FloatArray, FloatArray], matches: Matches, focal_px: float
) -> pycolmap.TwoViewGeometry | None:
    """The matches (K,2) that lie within 4 px of their epipolar lines, none where they are under 15;
    `rays` (K,3) of both sides. None where both photographs are in one place and have no lines."""
    errors = epipolar_errors(second_from_first, *rays) * focal_px
    if len(matches) and not np.isfinite(errors).any():
        return None
    agreeing = matches[errors <= MAX_EPIPOLAR_PX]
    geometry = pycolmap.TwoViewGeometry()
    enough = len(agreeing) >= MIN_MATCHES
    geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED if enough else pycolmap.TwoViewGeometryConfiguration.DEGENERATE
    geometry.inlier_matches = agreeing if enough else agreeing[:0]
    geometry.cam2_from_cam1 = pycolmap.Rigid3d(second_from_first[:3])
    return geometry
