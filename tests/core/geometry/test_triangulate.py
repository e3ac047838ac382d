"""Points triangulated from rays: against an independent method, and where rays fix nothing."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.optimize import least_squares

from radiant_core.cameras import Cameras
from radiant_core.geometry.model_views import MIN_Z, Rays, triangulate

K = np.array([[300.0, 0, 200], [0, 300.0, 150], [0, 0, 1]])


def row_of_cameras(count: int) -> Cameras:
    """Cameras one metre apart along x that look along z."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = -np.arange(count, dtype=float)
    return Cameras(
        cam_from_world=poses, Ks=np.tile(K, (count, 1, 1)), sizes_wh=np.tile([400, 300], (count, 1)), names=tuple(map(str, range(count)))
    )


def project(cameras: Cameras, index: int, point: np.ndarray) -> np.ndarray:
    pose = cameras.cam_from_world[index]
    in_camera = pose[:3, :3] @ point + pose[:3, 3]
    return in_camera[:2] / in_camera[2] * K[[0, 1], [0, 1]] + K[:2, 2]


def rays_of(cameras: Cameras, points: np.ndarray, noise: np.ndarray | float = 0.0) -> Rays:
    seen = [(index, number) for number in range(len(points)) for index in range(len(cameras))]
    pixels = np.array([project(cameras, index, points[number]) for index, number in seen]) + noise
    return Rays(cameras=np.array([index for index, _ in seen]), points=np.array([number for _, number in seen]), pixels=pixels)


def test_points_are_those_of_scipy_with_the_same_loss() -> None:
    rng = np.random.default_rng(0)
    cameras, true = row_of_cameras(4), rng.uniform([-1, -1, 5], [4, 1, 12], (20, 3))
    rays = rays_of(cameras, true, rng.normal(0, 0.3, (80, 2)))
    points, covariances, rms_px = triangulate(cameras, rays, true + rng.normal(0, 0.2, true.shape))
    for number in range(len(true)):
        own = rays.points == number

        def misses(point: np.ndarray, own: np.ndarray = own) -> np.ndarray:
            return np.array(
                [project(cameras, index, point) - pixel for index, pixel in zip(rays.cameras[own], rays.pixels[own], strict=True)]
            )

        # The weights of the last step are held: with them the squares are least at the same point.
        weights = np.sqrt(1 / (1 + np.square(misses(points[number])).sum(axis=1)))
        best = least_squares(lambda point, misses=misses, weights=weights: (weights[:, None] * misses(point)).ravel(), true[number])
        np.testing.assert_allclose(points[number], best.x, atol=1e-4)
        assert rms_px[number] == pytest.approx(np.sqrt(np.square(misses(points[number])).sum(axis=1).mean()), abs=1e-4)
        expected = np.linalg.inv(best.jac.T @ best.jac / 0.25 + 1e-6 * np.eye(3))
        np.testing.assert_allclose(covariances[number], expected, rtol=1e-2)


@pytest.mark.parametrize(
    "start",
    [
        (0.0, 0.0, -50.0),
        (117.9, -45.5, -209.3),
        (0.5, 0.0, MIN_Z),
        (0.5, 0.0, 2 * MIN_Z),
        (0.5, 1e6, 1e-5),
        (1e200, 0.0, 5.0),
        (1e308,) * 3,
        (np.nan,) * 3,
    ],
    ids=["behind", "far behind", "in the plane", "before the plane", "grazing", "huge", "largest", "not a number"],
)
def test_a_point_that_no_camera_can_hold_is_unsure_and_spoils_no_other(start: tuple[float, float, float]) -> None:
    cameras, true = row_of_cameras(2), np.array([[0.5, 0.2, 8.0], [1.0, -0.4, 6.0]])
    rays = rays_of(cameras, true)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        points, covariances, rms_px = triangulate(cameras, rays, np.array([true[0] + 0.1, start]))
    np.testing.assert_allclose(points[0], true[0], atol=1e-6)
    found = rms_px[1] < 1e-3 and np.allclose(points[1], true[1], atol=1e-3)
    assert np.isfinite(covariances).all() and (found or not rms_px[1] < 1)


def test_a_lone_ray_leaves_its_direction_open() -> None:
    cameras, true = row_of_cameras(1), np.array([[0.0, 0.0, 8.0]])
    _, covariances, _ = triangulate(cameras, rays_of(cameras, true), true)
    assert np.sqrt(np.linalg.eigvalsh(covariances[0])[-1]) == pytest.approx(1000, rel=1e-3)
