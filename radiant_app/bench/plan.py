"""Benchmark of the planner: makespan over the lower bound, and milliseconds, for every method on four kinds of scenes.

Each instance is drawn from a fixed seed: edges placed among the cameras, two to four devices per edge with speeds from 0.5
to 2 and uplinks from 10 to 100 Mbit/s. Time is the best of three runs. Half a minute at most for all, seconds with `quick`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import product
from typing import Literal, get_args

import numpy as np

from radiant_app.report.progress import tracked
from radiant_core.evaluate.metric import Metric
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import PlanMethod, plan_regions
from radiant_core.plan.system import Device, Edge, System

LayoutKind = Literal["uniform", "clustered", "lawnmower", "street"]
_QUICK_SIZES = ((200, 4), (1600, 4))
_SIZES = (*_QUICK_SIZES, (1600, 16), (10_000, 16))
_REPEATS = 3


def bench_plan(quick: bool) -> list[Metric]:
    """`plan.<cameras>x<edges>.<kind>.<method>.<makespan_over_bound|time_ms>` for all kinds and methods."""
    metrics: list[Metric] = []
    cases = list(product(_QUICK_SIZES if quick else _SIZES, get_args(LayoutKind)))
    for (num_cameras, num_edges), kind in tracked(cases, "bench plan"):
        rng = np.random.default_rng(num_cameras + num_edges)
        positions = camera_layout(kind, num_cameras, rng)
        system = place_edges(unequal_system(num_edges, rng), positions, None, seed=0)
        for method in get_args(PlanMethod):
            key = f"plan.{num_cameras}x{num_edges}.{kind}.{method}"
            metrics += _measured(key, lambda p=positions, s=system, m=method: plan_regions(p, s, method=m))
    return metrics


def camera_layout(kind: LayoutKind, num_cameras: int, rng: np.random.Generator) -> FloatArray:
    """Camera positions (C,2) in metres over 500 × 250 m."""
    size_m = np.array([500.0, 250.0])
    if kind == "uniform":
        return rng.random((num_cameras, 2)) * size_m
    if kind == "clustered":
        centres = rng.random((5, 2)) * size_m
        return centres[rng.integers(5, size=num_cameras)] + rng.normal(scale=15.0, size=(num_cameras, 2))
    if kind == "lawnmower":
        rows = max(1, round(np.sqrt(num_cameras / 2)))
        row, column = np.divmod(np.arange(num_cameras), -(-num_cameras // rows))
        columns = column.max(initial=1)
        there_and_back = np.where(row % 2 == 0, column, columns - column)
        return np.stack([there_and_back / columns, row / max(row.max(initial=0), 1)], axis=1) * size_m
    anywhere = rng.random((num_cameras, 2)) * size_m
    on_streets = np.round(anywhere / 50.0) * 50.0 + rng.normal(scale=2.0, size=(num_cameras, 2))
    runs_east = rng.random(num_cameras) < 0.5
    return np.where(np.stack([runs_east, ~runs_east], axis=1), anywhere, on_streets)


def unequal_system(num_edges: int, rng: np.random.Generator) -> System:
    """Edges without position whose devices differ in speed and bandwidth."""
    return System(edges=tuple(_unequal_edge(f"e{index}", rng) for index in range(num_edges)))


def _unequal_edge(name: str, rng: np.random.Generator) -> Edge:
    return Edge(
        id=name,
        position=None,
        aggregate_s=CostCurve(constant=5.0, linear=0.5),
        uplink_bytes_per_s=_uplink_bytes_per_s(rng),
        devices=tuple(_unequal_device(f"{name}-{n}", rng) for n in range(rng.integers(2, 5))),
    )


def _unequal_device(name: str, rng: np.random.Generator) -> Device:
    speed = float(np.exp(rng.uniform(np.log(0.5), np.log(2.0))))
    return Device(
        id=name,
        init_s=CostCurve(linear=0.1 / speed),
        train_s=CostCurve(constant=20.0 / speed, linear=1.0 / speed, power_coefficient=0.01 / speed, exponent=1.5),
        model_bytes=CostCurve(linear=0.5e6),
        uplink_bytes_per_s=_uplink_bytes_per_s(rng),
    )


def _uplink_bytes_per_s(rng: np.random.Generator) -> float:
    return float(rng.uniform(10e6, 100e6) / 8)


def _measured(key: str, make_plan: Callable[[], object]) -> list[Metric]:
    times_ms = []
    plan = None
    for _ in range(_REPEATS):
        start_s = time.perf_counter()
        plan = make_plan()
        times_ms.append((time.perf_counter() - start_s) * 1e3)
    assert isinstance(plan, CloudPlan), "devices without a memory limit hold every plan"
    ratio = plan.makespan_s / plan.lower_bound_s
    return [
        Metric(key=f"{key}.makespan_over_bound", value=ratio, unit="1", direction="lower", tolerance=1e-6),
        Metric(key=f"{key}.time_ms", value=min(times_ms), unit="ms", direction="lower", tolerance=min(times_ms)),
    ]
