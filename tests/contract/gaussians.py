"""Models and cameras for the contract of the rasterizers: regular, needle-like, degenerate, and at the edge of the frustum."""

from __future__ import annotations

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.splats import Splats


def off_centre_cameras(width: int, height: int, *, count: int = 1, focal_px: float = 220.0) -> Cameras:
    """Cameras 12 m before the origin, each turned a little further, with principal points off the centre."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    angles = np.linspace(0.0, 0.3, count)
    poses[:, 0, 0], poses[:, 0, 2], poses[:, 2, 0], poses[:, 2, 2] = np.cos(angles), np.sin(angles), -np.sin(angles), np.cos(angles)
    poses[:, 2, 3] = 12.0
    K = np.array([[focal_px, 0, width / 2 + 13], [0, 1.05 * focal_px, height / 2 - 7], [0, 0, 1]])
    return Cameras(
        names=tuple(f"camera{index}" for index in range(count)),
        Ks=np.tile(K, (count, 1, 1)),
        cam_from_world=poses,
        sizes_wh=np.tile([width, height], (count, 1)),
    )


def _model(count: int, rng: np.random.Generator, log_scales: np.ndarray, bases: int = 16) -> Splats:
    return Splats(
        means=rng.uniform([-6, -5, -3], [6, 5, 3], (count, 3)),
        quats=rng.normal(size=(count, 4)),
        log_scales=log_scales,
        logit_opacities=rng.normal(0, 1.5, count),
        sh0=rng.normal(0, 1, (count, 1, 3)),
        shN=rng.normal(0, 0.2, (count, bases - 1, 3)),
    )


def regular(count: int, seed: int = 0, *, bases: int = 16) -> Splats:
    """Gaussians of 0.5 to 3 px, of any shape and opacity, some of them outside the image."""
    rng = np.random.default_rng(seed)
    return _model(count, rng, rng.uniform(np.log(0.03), np.log(0.15), (count, 3)), bases)


def needles(count: int, seed: int = 0) -> Splats:
    """Aspect 30 to 1,800, up to 90 px long."""
    rng = np.random.default_rng(seed)
    length, aspect = rng.uniform(np.log(0.5), np.log(5.0), count), rng.uniform(np.log(30), np.log(1800), count)
    return _model(count, rng, np.stack([length, length - aspect, length - aspect * rng.uniform(0.8, 1, count)], axis=1))


def degenerate(count: int, seed: int = 0) -> Splats:
    """Zero and huge quaternions, scales e^±60, saturated opacities; on the camera centre, behind it, at the near plane, at one depth."""
    rng = np.random.default_rng(seed)
    places = np.array([[0, 0, -12.0], [0, 0, -20.0], [0, 0, -12 + 0.01], [0, 0, 0.0], [1e4, 0, 0], [0.5, 0.5, -11.99]])
    place = rng.integers(len(places) + 2, size=count)
    spread = np.stack([*rng.uniform(-6, 6, (2, count)), np.where(rng.random(count) < 0.5, 0.0, rng.uniform(-3, 3, count))], axis=1)
    means = np.where((place < len(places))[:, None], places[np.minimum(place, len(places) - 1)], spread)
    return Splats(
        means=means,
        quats=rng.choice([0.0, 1e-30, -1e-3, 1.0, 1e18], (count, 4)) * (rng.random((count, 1)) > 0.1),
        log_scales=rng.choice([-60.0, -5.0, -2.0, 0.0, 20.0, 60.0], (count, 3), p=[0.1, 0.4, 0.3, 0.1, 0.05, 0.05]),
        logit_opacities=rng.choice([-100.0, -5.0, 0.0, 5.0, 100.0], count),
        sh0=rng.normal(0, 1, (count, 1, 3)),
        shN=rng.normal(0, 0.2, (count, 15, 3)),
    )


def frustum_edge(count: int, seed: int = 0) -> Splats:
    """Large Gaussians near the camera, most of their centres outside the image and beyond where the Jacobian is clamped."""
    rng = np.random.default_rng(seed)
    model = _model(count, rng, rng.uniform(np.log(0.5), np.log(4.0), (count, 3)))
    return Splats(**{**model.arrays(), "means": rng.uniform([-12, -9, -6], [12, 9, 2], (count, 3))})
