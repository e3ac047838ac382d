"""A second, independent renderer for tests: numpy float64, one pixel after another, every Gaussian
at every pixel, no tiles."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.splats import Splats


def brute_force_image(splats: Splats, cameras: Cameras, background: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Image (H,W,3), alpha (H,W), depth (H,W) of the first camera, degree 0 colours only; written
    from the equations of the contract."""
    pose, K = cameras.cam_from_world[0], cameras.Ks[0]
    width, height = cameras.sizes_wh[0]
    inside = splats.means.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    order = [i for i in np.argsort(inside[:, 2], kind="stable") if inside[i, 2] > 0.01]
    covariances = [_covariance_2d(splats, index, inside[index], pose, K, (width, height)) for index in order]
    centres = [(K @ (inside[index] / inside[index, 2]))[:2] for index in order]
    opacities = 1 / (1 + np.exp(-splats.logit_opacities.astype(np.float64)))
    colors = np.maximum(0.0, 0.5 + 0.28209479177387814 * splats.sh0[:, 0].astype(np.float64))
    image, alpha_image, depth = np.zeros((height, width, 3)), np.zeros((height, width)), np.zeros((height, width))
    for row in range(height):
        for column in range(width):
            pixel, transmittance = np.array([column + 0.5, row + 0.5]), 1.0
            color, weighted_depth = np.zeros(3), 0.0
            for index, centre, covariance in zip(order, centres, covariances, strict=True):
                away = pixel - centre
                alpha = min(0.999, opacities[index] * np.exp(-0.5 * away @ np.linalg.solve(covariance, away)))
                if alpha < 1 / 255:
                    continue
                if transmittance * (1 - alpha) <= 1e-4:
                    break
                color += transmittance * alpha * colors[index]
                weighted_depth += transmittance * alpha * inside[index, 2]
                transmittance *= 1 - alpha
            alpha_image[row, column] = 1 - transmittance
            image[row, column] = color + transmittance * background
            depth[row, column] = weighted_depth / max(1 - transmittance, 1e-10)
    return image, alpha_image, depth


def _covariance_2d(splats: Splats, index: int, inside: np.ndarray, pose: np.ndarray, K: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    w, x, y, z = splats.quats[index].astype(np.float64)
    rotation = Rotation.from_quat([x, y, z, w]).as_matrix()
    axes = rotation @ np.diag(np.exp(splats.log_scales[index].astype(np.float64)))
    ratios = inside[:2] / inside[2]
    for axis, (focal, centre, length) in enumerate(((K[0, 0], K[0, 2], size[0]), (K[1, 1], K[1, 2], size[1]))):
        ratios[axis] = np.clip(ratios[axis], (-centre - 0.15 * length) / focal, (length - centre + 0.15 * length) / focal)
    x, y, z = *(ratios * inside[2]), inside[2]
    jacobian = np.array([[K[0, 0] / z, 0, -K[0, 0] * x / z**2], [0, K[1, 1] / z, -K[1, 1] * y / z**2]])
    half = jacobian @ pose[:3, :3] @ axes
    return half @ half.T + 0.3 * np.eye(2)
