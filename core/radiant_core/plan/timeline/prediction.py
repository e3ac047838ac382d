"""Predicts when a plan's stages happen, measures the errors, and corrects the rest of the system.

    device n: initialise G from 0 on, train F_n, send H / B^n                 (paper Eqn. 12-15)
    edge m:   aggregate F_m once its last device has sent, then send Σ_n H_n / B^m       (5-8)
    cloud:    merge once the last edge has sent, where its cost is known
    error = predicted / measured − 1, in %: negative where a stage took longer than predicted

Correction: a finished device's measured / predicted time scales the curves of all devices with the
same curves (one machine class); devices of another class whose curves are proportional (the same
profile on another machine) take the median of all such classes; edges by their own curve. Runs once
per plan, per finished node and per report; a few numbers per machine.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import System

Stage = Literal["initialise", "train", "send", "aggregate", "whole", "merge"]
"""whole: all that an edge does, where its devices are not known."""
Seconds = Mapping[tuple[str, str], float]
"""(node, stage) → seconds; nodes are `devices/<id>`, `edges/<id>` and `cloud`."""


@dataclass(frozen=True, kw_only=True)
class PlannedStage:
    """One stage of one machine as planned, seconds since the devices start."""

    node: str
    stage: Stage
    num_cameras: int
    start_s: float
    stop_s: float

    @property
    def seconds(self) -> float:
        """How long it lasts."""
        return self.stop_s - self.start_s


@dataclass(frozen=True, kw_only=True)
class StageError:
    """One stage that was predicted and measured."""

    node: str
    stage: str
    num_cameras: int
    predicted_s: float
    measured_s: float

    @property
    def error_percent(self) -> float | None:
        """100 · (predicted / measured − 1); None where nothing was measured to divide by."""
        return 100 * (self.predicted_s / self.measured_s - 1) if self.measured_s > 0 else None


def planned_stages(system: System, edge_plans: Sequence[EdgePlan]) -> tuple[PlannedStage, ...]:
    """All stages of a plan, devices before their edge; machines without cameras have none."""
    stages: list[PlannedStage] = []
    for edge, plan in zip(system.edges, edge_plans, strict=True):
        total = len(plan.camera_indices)
        if not total:
            continue
        if edge.time_s is not None:
            stages += _after(0.0, f"edges/{edge.id}", total, [("whole", float(edge.time_s(total)))])
            continue
        counts = np.bincount(plan.device_of_camera, minlength=len(edge.devices)).tolist()
        ready_s, sent_bytes = 0.0, 0.0
        for device, count in zip(edge.devices, counts, strict=True):
            if count:
                model_bytes = float(device.model_bytes(count))
                spans: tuple[tuple[Stage, float], ...] = (
                    ("initialise", float(device.init_s(count))),
                    ("train", float(device.train_s(count))),
                    ("send", model_bytes / device.uplink_bytes_per_s),
                )
                stages += _after(0.0, f"devices/{device.id}", count, spans)
                ready_s, sent_bytes = max(ready_s, stages[-1].stop_s), sent_bytes + model_bytes
        joining: tuple[tuple[Stage, float], ...] = (
            ("aggregate", edge.aggregation_s(total, sum(count > 0 for count in counts))),
            ("send", sent_bytes / edge.uplink_bytes_per_s),
        )
        stages += _after(ready_s, f"edges/{edge.id}", total, joining)
    if system.cloud.merge_s is not None and stages:
        num_cameras = sum(len(plan.camera_indices) for plan in edge_plans)
        last_s = max(row.stop_s for row in stages)
        stages += _after(last_s, "cloud", num_cameras, [("merge", float(system.cloud.merge_s(num_cameras)))])
    return tuple(stages)


def stage_errors(planned: Iterable[PlannedStage], measured: Seconds) -> tuple[StageError, ...]:
    """What was planned and measured; BadInput for a measured time below 0 or not finite."""
    for (node, stage), seconds in measured.items():
        if not np.isfinite(seconds) or seconds < 0:
            raise BadInput(f"{node} took {seconds} s to {stage}, expected a finite time of at least 0: measure again.")
    return tuple(
        StageError(
            node=row.node, stage=row.stage, num_cameras=row.num_cameras, predicted_s=row.seconds, measured_s=measured[row.node, row.stage]
        )
        for row in planned
        if (row.node, row.stage) in measured
    )


def makespan_error(errors: Sequence[StageError], edge_plans: Sequence[EdgePlan]) -> StageError | None:
    """The slowest edge when every machine works for itself, from stages measured alone, its own
    after those of its slowest device; None where a node is missing."""
    nodes = {row.node for row in errors}
    needed = {
        node
        for plan in edge_plans
        if len(plan.camera_indices)
        for node in (f"edges/{plan.edge_id}", *(f"devices/{name}" for name in plan.device_ids if len(plan.cameras_of(name))))
    }
    if not needed or needed - nodes:
        return None

    def compose(kind: str) -> float:
        spent = {node: sum(getattr(row, kind) for row in errors if row.node == node) for node in needed}
        ends = [
            max((spent.get(f"devices/{name}", 0.0) for name in plan.device_ids), default=0.0) + spent.get(f"edges/{plan.edge_id}", 0.0)
            for plan in edge_plans
        ]
        return max(ends)

    num_cameras = sum(len(plan.camera_indices) for plan in edge_plans)
    predicted_s, measured_s = compose("predicted_s"), compose("measured_s")
    return StageError(node="all", stage="makespan", num_cameras=num_cameras, predicted_s=predicted_s, measured_s=measured_s)


def correct_system(system: System, planned: Iterable[PlannedStage], measured: Seconds) -> System:
    """The system with G, F_n and F_m scaled by what was measured so far; stages that were not
    measured, or predicted or measured at 0 s, change nothing. Raises BadInput as `stage_errors`."""
    errors = stage_errors(planned, measured)
    ratio_of = {
        row.node: row.measured_s / row.predicted_s for row in errors if row.stage != "send" and min(row.predicted_s, row.measured_s) > 0
    }
    devices = {f"devices/{device.id}": (device.init_s, device.train_s) for device in system.devices}
    edges = {
        f"edges/{edge.id}": (edge.aggregate_s,) if edge.aggregate_alone_s is None else (edge.aggregate_s, edge.aggregate_alone_s)
        for edge in system.edges
    }
    factor_of = {**_factors(devices, ratio_of), **_factors(edges, ratio_of)}
    return replace(
        system,
        edges=tuple(
            replace(
                edge.with_aggregation_scaled(factor_of[f"edges/{edge.id}"]),
                devices=tuple(
                    replace(
                        device,
                        init_s=device.init_s.scaled(factor_of[f"devices/{device.id}"]),
                        train_s=device.train_s.scaled(factor_of[f"devices/{device.id}"]),
                    )
                    for device in edge.devices
                ),
            )
            for edge in system.edges
        ),
    )


def time_left_s(
    expected_s: Mapping[str, float], parents: Mapping[str, str], running_s: Mapping[str, float], ended: Iterable[str], num_workers: int
) -> float:
    """Seconds until all nodes are done on `num_workers` processes of one machine, those that may
    start taken in order.

    expected_s: node → seconds of its own; parents: device → its edge, which waits for all of them;
    running_s: node → seconds so far. A node that has run longer than expected is taken to end now.
    Raises BadInput below one worker.
    """
    if num_workers < 1:
        raise BadInput(f"{num_workers} workers cannot do anything: give at least one.")
    finished = set(ended)
    ends = {node: max(0.0, expected_s[node] - spent) for node, spent in running_s.items() if node in expected_s and node not in finished}
    waiting = [node for node in expected_s if node not in finished and node not in ends]
    now_s = 0.0
    while waiting or ends:
        blocked = {parents[node] for node in (*waiting, *ends) if node in parents}
        for node in [node for node in waiting if node not in blocked][: max(0, num_workers - len(ends))]:
            waiting.remove(node)
            ends[node] = now_s + expected_s[node]
        assert ends, "a node whose children are done is never blocked"
        first = min(ends, key=lambda node: ends[node])
        now_s = max(now_s, ends.pop(first))
    return now_s


def _after(start_s: float, node: str, num_cameras: int, spans: Iterable[tuple[Stage, float]]) -> list[PlannedStage]:
    stages: list[PlannedStage] = []
    for stage, seconds in spans:
        stages.append(PlannedStage(node=node, stage=stage, num_cameras=num_cameras, start_s=start_s, stop_s=start_s + seconds))
        start_s += seconds
    return stages


def _factors(curves_of: Mapping[str, tuple[CostCurve, ...]], ratio_of: Mapping[str, float]) -> dict[str, float]:
    """How each machine's curves are scaled: by its class, else by proportional curves, else not."""
    factors: dict[str, float] = {}
    for node, curves in curves_of.items():
        alike = [ratio_of[machine] for machine, theirs in curves_of.items() if machine in ratio_of and theirs == curves]
        if node in ratio_of:
            alike = [ratio_of[node]]
        elif not alike:
            shape = curve_shape(curves)
            alike = [ratio_of[machine] for machine, theirs in curves_of.items() if machine in ratio_of and curve_shape(theirs) == shape]
        factors[node] = float(np.median(alike)) if alike else 1.0
    return factors


def curve_shape(curves: Sequence[CostCurve]) -> tuple[float, ...]:
    """Equal for proportional curves: coefficients over their sum, exponents where terms count."""
    terms = [term for curve in curves for term in (curve.constant, curve.linear, curve.power_coefficient)]
    whole = sum(terms) or 1.0
    exponents = [curve.exponent if curve.power_coefficient else 0.0 for curve in curves]
    return (*(round(term / whole, 9) for term in terms), *exponents)
