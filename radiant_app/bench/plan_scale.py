"""Scale of the planner: seconds of one core for large plans, warm plans and drags, each beside makespan over bound; and fleets.

CPU time of the process, so that a busy machine changes little. Minutes for all, seconds with `quick`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import radiant_app
from radiant_app.bench.plan import LayoutKind, camera_layout, unequal_system
from radiant_app.files.system_file import load_system
from radiant_app.report.progress import tracked
from radiant_core.evaluate.metric import Metric
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.deadline import device_time_s, edge_table
from radiant_core.plan.counts.wide_deadline import fastest_edge_counts
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import Device, Edge, System
from radiant_core.plan.timeline.simulate import fleet_of, merged_s, simulate

_SIZES: tuple[tuple[int, int, LayoutKind], ...] = (
    (1700, 4, "uniform"),
    (1700, 4, "street"),
    (1_000_000, 256, "uniform"),
    (1_000_000, 256, "lawnmower"),
    (1_000_000, 256, "street"),
    (1_000_000, 256, "clustered"),
    (10_000_000, 1024, "uniform"),
)
_DRAGS = 40
_SCENES = {"rubble": 1678, "building": 1940}
_MERGE_S_PER_CAMERA = 6.0
"""Assumed: Fed3DGS distils a client's model into the global one by rendering, some ten times an edge's retraining of 0.6 s."""
_BAND = 0.3
_DRAWS = 200


def bench_plan_scale(quick: bool) -> list[Metric]:
    """`plan.<cameras>x<edges>.<kind>.exact.<cold|warm>_…`, `plan.<cameras>x<edges>.slack_<factor>_…`, `plan.2000x64.[weight_]drag_…`,
    `plan.system<N>.<scene>.<method>.simulated_s`."""
    metrics: list[Metric] = []
    for num_cameras, num_edges, kind in tracked(_SIZES[:2] if quick else _SIZES, "bench plan, scale"):
        metrics += _scaled(num_cameras, num_edges, kind)
    metrics += [*_dragged(5 if quick else _DRAGS), *weight_dragged(5 if quick else _DRAGS), *slacks(1 if quick else 3)]
    metrics += [*regret(10 if quick else 100)]
    return [*metrics, *simulated_systems(20 if quick else _DRAWS)]


def _timed_s(work: Callable[[], CloudPlan]) -> tuple[CloudPlan, float]:
    start_s = time.process_time()
    plan = work()
    return plan, time.process_time() - start_s


def _plan(
    positions: FloatArray,
    system: System,
    start: CloudPlan | None = None,
    *,
    slack: float | None = None,
    constraints: PlanConstraints | None = None,
) -> CloudPlan:
    plan = plan_regions(positions, system, start=start, slack=slack, constraints=constraints)
    assert isinstance(plan, CloudPlan), "devices without a memory limit hold every plan"
    return plan


def _scaled(num_cameras: int, num_edges: int, kind: LayoutKind) -> list[Metric]:
    rng = np.random.default_rng(num_cameras + num_edges)
    positions = camera_layout(kind, num_cameras, rng)
    system = place_edges(unequal_system(num_edges, rng), positions[:: max(1, num_cameras // 20_000)], None, seed=0)
    key = f"plan.{num_cameras}x{num_edges}.{kind}.exact"
    repeats = 3 if num_cameras < 2_000_000 else 1
    colds = [_timed_s(lambda: _plan(positions, system)) for _ in range(repeats)]
    cold = colds[0][0]
    first, *others = system.edges
    slower = replace(first, devices=tuple(replace(d, train_s=d.train_s.scaled(2.0)) for d in first.devices))
    warm, warm_s = _timed_s(lambda: _plan(positions, System(edges=(slower, *others)), cold))
    return [
        _ms(f"{key}.cold_median_ms", float(np.median([seconds for _, seconds in colds]))),
        _ms(f"{key}.cold_worst_ms", max(seconds for _, seconds in colds)),
        *_quality(f"{key}.cold", cold),
        _ms(f"{key}.warm_ms", warm_s),
        *_quality(f"{key}.warm", warm),
    ]


def _dragged(num_moves: int) -> list[Metric]:
    """One edge of 64 pulled across 2,000 cameras, planned anew from the last plan at every step."""
    rng = np.random.default_rng(0)
    positions = camera_layout("uniform", 2000, rng)
    system = place_edges(unequal_system(64, rng), positions, None, seed=0)
    plan = _plan(positions, system)
    times_s, worst = [], 1.0
    for share in np.linspace(0, 1, num_moves):
        first, *others = system.edges
        x_m, y_m = (1 - share) * np.array([50.0, 50.0]) + share * np.array([450.0, 200.0])
        moved = System(edges=(replace(first, position=(float(x_m), float(y_m))), *others))
        plan, seconds = _timed_s(lambda moved=moved, plan=plan: _plan(positions, moved, plan))
        times_s.append(seconds)
        worst = max(worst, plan.makespan_s / plan.lower_bound_s)
    return [
        _ms("plan.2000x64.drag_p95_ms", float(np.percentile(times_s, 95))),
        Metric(key="plan.2000x64.drag_makespan_over_bound", value=worst, unit="1", direction="lower", tolerance=1e-6),
    ]


def weight_dragged(num_moves: int) -> list[Metric]:
    """One of 64 weights pulled over ±800 m² at 2,000 cameras, planned around it at every step from the plan before the drag."""
    rng = np.random.default_rng(0)
    positions = camera_layout("uniform", 2000, rng)
    system = place_edges(unequal_system(64, rng), positions, None, seed=0)
    before = _plan(positions, system)
    edge_id, weight_m2 = before.edge_ids[0], float(before.weights[0])
    times_s, outside, worst = [], 0, 1.0
    for shift_m2 in np.linspace(-800, 800, num_moves).tolist():
        held = PlanConstraints(fixed_weights_m2={edge_id: weight_m2 + shift_m2})
        plan, seconds = _timed_s(lambda held=held: _plan(positions, system, before, constraints=held))
        times_s.append(seconds)
        outside = max(outside, plan.num_outside)
        worst = max(worst, plan.makespan_s / plan.lower_bound_s)
    return [
        _ms("plan.2000x64.weight_drag_median_ms", float(np.median(times_s))),
        _ms("plan.2000x64.weight_drag_p95_ms", float(np.percentile(times_s, 95))),
        Metric(key="plan.2000x64.weight_drag_outside", value=float(outside), unit="cameras", direction="info"),
        Metric(key="plan.2000x64.weight_drag_makespan_over_bound", value=worst, unit="1", direction="info"),
    ]


def slacks(num_sizes: int) -> list[Metric]:
    """What the slacks 1, 1.1 and 1.5 buy: root mean square distance of cameras to their edges, makespan over bound, time."""
    metrics: list[Metric] = []
    for num_cameras, num_edges in ((1600, 16), (10_000, 16), (100_000, 64))[:num_sizes]:
        rng = np.random.default_rng(num_cameras + num_edges)
        positions = camera_layout("uniform", num_cameras, rng)
        system = place_edges(unequal_system(num_edges, rng), positions, None, seed=0)
        for slack in (1.0, 1.1, 1.5):
            plan, seconds = _timed_s(lambda slack=slack, positions=positions, system=system: _plan(positions, system, slack=slack))
            squared_m2 = np.sum((positions - plan.sites[plan.edge_of_camera]) ** 2, axis=1)
            key = f"plan.{num_cameras}x{num_edges}.slack_{slack:g}"
            metrics += [
                _ms(f"{key}_ms", seconds),
                Metric(key=f"{key}_rms_distance_m", value=float(np.sqrt(squared_m2.mean())), unit="m", direction="lower", tolerance=1e-6),
                *_quality(key, plan),
            ]
    return metrics


def regret(num_draws: int) -> list[Metric]:
    """Real makespan over an oracle's when every coefficient was profiled with 5 % noise; without and with one sample per device.

    The sample is the device's time on half the quota that the noisy plan gave it; its curves are scaled by it and all is planned anew.
    """
    ratios: dict[str, list[float]] = {"profiled": [], "corrected": []}
    for draw in range(num_draws):
        rng = np.random.default_rng(draw)
        real = unequal_system(8, rng)
        num_cameras = 1600
        oracle_s = float(fastest_edge_counts(real, num_cameras).edge_time_s.max())
        noisy = System(edges=tuple(replace(edge, devices=tuple(_noisy(d, rng) for d in edge.devices)) for edge in real.edges))
        quotas = _quotas(noisy, num_cameras)
        halves = np.maximum(quotas // 2, 1).tolist()
        factors = [float(device_time_s(r, h) / device_time_s(n, h)) for r, n, h in zip(real.devices, noisy.devices, halves, strict=True)]
        of_device = dict(zip((d.id for d in real.devices), factors, strict=True))
        mended = [replace(edge, devices=tuple(_scaled_by(d, of_device[d.id]) for d in edge.devices)) for edge in noisy.edges]
        ratios["profiled"].append(simulate(fleet_of(real, quotas)).makespan_s / oracle_s)
        corrected = _quotas(System(edges=tuple(mended)), num_cameras)
        ratios["corrected"].append(simulate(fleet_of(real, corrected)).makespan_s / oracle_s)
    return [
        Metric(
            key=f"plan.regret.{name}_p{percentile}_percent",
            value=100 * (float(np.percentile(values, percentile)) - 1),
            unit="%",
            direction="lower",
            tolerance=1.0,
        )
        for name, values in ratios.items()
        for percentile in (50, 95)
    ]


def _quotas(system: System, num_cameras: int) -> NDArray[np.int64]:
    counts = fastest_edge_counts(system, num_cameras).counts
    return np.concatenate([edge_table(edge, int(count)).quotas(int(count)) for edge, count in zip(system.edges, counts, strict=True)])


def _noisy(device: Device, rng: np.random.Generator) -> Device:
    def noisy(curve: CostCurve) -> CostCurve:
        constant, linear, power = np.maximum(rng.normal(1, 0.05, 3), 0) * [curve.constant, curve.linear, curve.power_coefficient]
        return replace(curve, constant=float(constant), linear=float(linear), power_coefficient=float(power))

    return replace(device, init_s=noisy(device.init_s), train_s=noisy(device.train_s), model_bytes=noisy(device.model_bytes))


def _scaled_by(device: Device, factor: float) -> Device:
    return replace(
        device,
        init_s=device.init_s.scaled(factor),
        train_s=device.train_s.scaled(factor),
        model_bytes=device.model_bytes.scaled(factor),
    )


def simulated_systems(num_draws: int) -> list[Metric]:
    """The paper's systems 1 and 2 played: seconds of each method, and the band over `num_draws` times that all assumptions vary by 30 %."""
    metrics: list[Metric] = []
    folder = Path(radiant_app.__file__).parent / "systems"
    for number in (1, 2):
        system = load_system(folder / f"paper_{number}.toml")
        for scene, num_cameras in _SCENES.items():
            rng = np.random.default_rng(0)
            positions = camera_layout("lawnmower", num_cameras, rng)
            nominal = _methods_s(system, positions, 1.0)
            draws = [_methods_s(varied(system, rng), positions, float(rng.uniform(1 - _BAND, 1 + _BAND))) for _ in range(num_draws)]
            for method, seconds in nominal.items():
                key = f"plan.system{number}.{scene}.{method}"
                low, high = np.percentile([draw[method] for draw in draws], [5, 95])
                metrics += [_s(f"{key}.simulated_s", seconds), _s(f"{key}.simulated_p5_s", low), _s(f"{key}.simulated_p95_s", high)]
            for other in ("even_per_device", "fed3dgs"):
                saved = [100 * (1 - draw["exact"] / draw[other]) for draw in draws]
                key = f"plan.system{number}.{scene}.exact_saves_over_{other}"
                metrics.append(
                    Metric(key=f"{key}_percent", value=100 * (1 - nominal["exact"] / nominal[other]), unit="%", direction="info")
                )
                for percentile in (5, 95):
                    value = float(np.percentile(saved, percentile))
                    metrics.append(Metric(key=f"{key}_p{percentile}_percent", value=value, unit="%", direction="info"))
    return metrics


def varied(system: System, rng: np.random.Generator) -> System:
    """Every curve and uplink times its own factor within ±30 %."""

    def factor() -> float:
        return float(rng.uniform(1 - _BAND, 1 + _BAND))

    def edge_of(edge: Edge) -> Edge:
        devices = tuple(
            replace(
                d,
                init_s=d.init_s.scaled(factor()),
                train_s=d.train_s.scaled(factor()),
                model_bytes=d.model_bytes.scaled(factor()),
                uplink_bytes_per_s=d.uplink_bytes_per_s * factor(),
            )
            for d in edge.devices
        )
        return replace(
            edge,
            devices=devices,
            aggregate_s=edge.aggregate_s.scaled(factor()),
            uplink_bytes_per_s=edge.uplink_bytes_per_s * factor(),
        )

    return System(edges=tuple(edge_of(edge) for edge in system.edges))


def _methods_s(system: System, positions: FloatArray, merge_factor: float) -> dict[str, float]:
    """Seconds of one scene: planned exactly, by Alg. 1, equal per device, and merged client by client at one server."""
    placed = place_edges(system, positions, None, seed=0)
    num_devices = len(placed.devices)
    even = np.full(num_devices, len(positions) // num_devices)
    even[: len(positions) % num_devices] += 1
    seconds: dict[str, float] = {}
    for method in ("exact", "paper"):
        plan = plan_regions(positions, placed, method=method)
        if isinstance(plan, CloudPlan):
            edges = split_edges(positions, plan, placed)
            quotas = np.concatenate([np.bincount(e.device_of_camera, minlength=len(e.device_ids)) for e in edges])
            seconds[method] = simulate(fleet_of(placed, quotas)).makespan_s
    seconds["even_per_device"] = simulate(fleet_of(placed, even)).makespan_s
    merge_s = merge_factor * _MERGE_S_PER_CAMERA * len(positions)
    alone = replace_aggregation(placed)
    done_s = simulate(fleet_of(alone, even)).device_done_s
    seconds["fed3dgs"] = merged_s(done_s, merge_s / num_devices)
    seconds["fed3dgs_4_mergers"] = merged_s(done_s, merge_s / num_devices, num_mergers=4)
    return seconds


def replace_aggregation(system: System) -> System:
    """The system without anything to do at the edges."""
    return System(edges=tuple(replace(edge, aggregate_s=CostCurve()) for edge in system.edges))


def _quality(key: str, plan: CloudPlan) -> list[Metric]:
    ratio = plan.makespan_s / plan.lower_bound_s
    return [
        Metric(key=f"{key}_makespan_over_bound", value=ratio, unit="1", direction="lower", tolerance=1e-6),
        Metric(key=f"{key}_certified", value=float(plan.certified), unit="1", direction="higher"),
    ]


def _ms(key: str, seconds: float) -> Metric:
    return Metric(key=key, value=1e3 * seconds, unit="ms", direction="lower", tolerance=1e3 * seconds)


def _s(key: str, seconds: float) -> Metric:
    return Metric(key=key, value=seconds, unit="s", direction="info")
