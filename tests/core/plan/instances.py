"""Random systems and camera layouts that the planner's tests share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.footprints import RegionShares
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import Device, Edge, System


def _uniform(rng: np.random.Generator, count: int) -> FloatArray:
    return rng.random((count, 2)) * np.array([500.0, 250.0])


def _clustered(rng: np.random.Generator, count: int) -> FloatArray:
    return rng.choice([0.0, 200.0, 400.0], (count, 1)) + rng.normal(size=(count, 2)) * 10.0


def _lattice(_: np.random.Generator, count: int) -> FloatArray:
    return np.stack(np.divmod(np.arange(count), 7), axis=1).astype(np.float64) * 10.0


def _collinear(rng: np.random.Generator, count: int) -> FloatArray:
    return np.outer(rng.random(count), [300.0, 100.0])


def _duplicates(rng: np.random.Generator, count: int) -> FloatArray:
    return rng.choice([0.0, 50.0, 100.0], (count, 2))


def _one_spot(_: np.random.Generator, count: int) -> FloatArray:
    return np.full((count, 2), 12.5)


LAYOUTS: dict[str, Callable[[np.random.Generator, int], FloatArray]] = {
    "uniform": _uniform,
    "clustered": _clustered,
    "lattice": _lattice,
    "collinear": _collinear,
    "duplicates": _duplicates,
    "one spot": _one_spot,
}


def random_curve(rng: np.random.Generator, scale: float = 1.0) -> CostCurve:
    """A curve in which each of the three terms may be missing: flat and zero curves occur, too."""
    constant, linear, power = rng.random(3) * (rng.random(3) < 0.7) * scale
    return CostCurve(constant=10 * constant, linear=linear, power_coefficient=0.1 * power, exponent=rng.uniform(0, 2))


def random_device(rng: np.random.Generator, name: str, limits: tuple[int, int] | None) -> Device:
    """A device; `limits`: smallest and largest memory limit, None without."""
    return Device(
        id=name,
        init_s=random_curve(rng),
        train_s=random_curve(rng),
        model_bytes=random_curve(rng, 1e6),
        uplink_bytes_per_s=rng.uniform(1e5, 1e7),
        max_cameras=None if limits is None else int(rng.integers(*limits, endpoint=True)),
    )


def random_edge(rng: np.random.Generator, name: str, num_devices: int, limits: tuple[int, int] | None = None) -> Edge:
    """An edge somewhere in 500 × 250 m."""
    return Edge(
        id=name,
        position=(rng.uniform(0, 500), rng.uniform(0, 250)),
        aggregate_s=random_curve(rng),
        uplink_bytes_per_s=rng.uniform(1e5, 1e7),
        devices=tuple(random_device(rng, f"{name}-{index}", limits) for index in range(num_devices)),
    )


def random_system(rng: np.random.Generator, num_edges: int, limits: tuple[int, int] | None = None) -> System:
    """Edges with one to three devices each."""
    return System(edges=tuple(random_edge(rng, f"e{index}", int(rng.integers(1, 4)), limits) for index in range(num_edges)))


def linear_system(positions: FloatArray, seconds_per_camera: FloatArray, max_cameras: int | None = None) -> System:
    """One device per edge whose time is proportional to its cameras; nothing else has a cost."""
    return System(
        edges=tuple(
            Edge(
                id=f"e{index}",
                position=(float(x), float(y)),
                aggregate_s=CostCurve(),
                uplink_bytes_per_s=1.0,
                devices=(
                    Device(
                        id=f"d{index}",
                        init_s=CostCurve(),
                        train_s=CostCurve(linear=float(seconds)),
                        model_bytes=CostCurve(),
                        uplink_bytes_per_s=1.0,
                        max_cameras=max_cameras,
                    ),
                ),
            )
            for index, ((x, y), seconds) in enumerate(zip(positions, seconds_per_camera, strict=True))
        )
    )


def dense(shares: RegionShares) -> np.ndarray:
    """The whole matrix (P,E) of shares."""
    matrix = np.zeros((shares.num_images, shares.num_regions))
    matrix[shares.images, shares.regions] = shares.shares
    return matrix
