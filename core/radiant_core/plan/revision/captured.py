"""Applies a plan to captured photographs: each belongs to the device of the nearest waypoint.

P planned, C captured. Once per run, after capture, O((P + C) log P). Photographs never move between
devices, so nothing is balanced again: borders and strips stay, counts and times are those of what
was captured,
    T^m = max_n T^n(k_n) + F_m(Σ k_n) + Σ_n H_n(k_n) / B^m    for k_n photographs at n (Eqn. 5-8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree  # pyright: ignore[reportMissingTypeStubs]

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.counts.deadline import device_time_s
from radiant_core.plan.counts.wide_deadline import fastest_edge_counts
from radiant_core.plan.plans import CloudPlan, EdgePlan, PlanStatus, require_plan_of
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.region_plan import is_certified
from radiant_core.plan.system import Edge, System

MIN_SITE_M = 100.0
"""Least width in metres of the site of a plan with few waypoints."""


def plan_captured(
    cloud_plan: CloudPlan, edge_plans: Sequence[EdgePlan], planned_xy: ArrayLike, captured_xy: ArrayLike, *, system: System
) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """The plan of `planned_xy` (P,2) m for photographs at `captured_xy` (C,2) m of the same frame;
    indices are rows of the latter. A device none of whose waypoints was captured has no camera and
    no time. status: optimal or converged where the captured counts happen to be, against the bound
    of C cameras; else stopped. Raises BadInput as `plan_of_owners` and `nearest_planned`, and when
    nothing was captured."""
    planned = check_array("planned_xy", planned_xy, (None, 2))
    captured = check_array("captured_xy", captured_xy, (None, 2))
    require_plan_of(len(planned), cloud_plan, edge_plans)
    require_same_system(edge_plans, system)
    if not len(captured):
        raise BadInput("no photograph was captured: check the folder, or plan again.")
    nearest = nearest_planned(planned, captured)
    # A photograph looks as far from where it was taken as its waypoint does.
    looks = None if cloud_plan.looks is None else captured + (cloud_plan.looks - planned)[nearest]
    device_of_captured = device_of_planned(edge_plans, len(planned))[nearest]
    places = captured if looks is None else looks
    cloud, edges = plan_of_owners(cloud_plan, edge_plans, device_of_captured, places, system=system)
    return replace(cloud, looks=looks), edges


def plan_of_owners(
    cloud_plan: CloudPlan, edge_plans: Sequence[EdgePlan], device_of_captured: NDArray[np.int64], captured_xy: ArrayLike, *, system: System
) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """The regions and strips of a plan for photographs at `captured_xy` (C,2) m on devices (C,),
    counted over all edges; the plan does not know where they look. Raises BadInput when plan and
    system are not of one kind, or when a device captured more than its memory holds."""
    captured = check_array("captured_xy", captured_xy, (len(device_of_captured), 2))
    require_same_system(edge_plans, system)
    counts = np.bincount(device_of_captured, minlength=len(system.devices))
    _require_memory(system, counts)
    new_edge_plans: list[EdgePlan] = []
    edge_of_camera = np.empty(len(captured), dtype=np.int64)
    first = 0
    for index, (edge, old) in enumerate(zip(system.edges, edge_plans, strict=True)):
        last = first + len(edge.devices)
        cameras = np.flatnonzero((device_of_captured >= first) & (device_of_captured < last))
        edge_of_camera[cameras] = index
        new_edge_plans.append(
            replace(
                old,
                camera_indices=cameras,
                device_of_camera=device_of_captured[cameras] - first,
                device_time_s=_device_times_s(edge, counts[first:last]),
            )
        )
        first = last
    edge_time_s = np.array([_edge_time_s(edge, plan) for edge, plan in zip(system.edges, new_edge_plans, strict=True)])
    return _add_bound(cloud_plan, captured, edge_of_camera, edge_time_s, system), tuple(new_edge_plans)


def find_captured_elsewhere(
    edge_plans: Sequence[EdgePlan], planned_xy: ArrayLike, device_of_captured: NDArray[np.int64], captured_xy: ArrayLike
) -> NDArray[np.bool_]:
    """Which photographs (C,) of the devices (C,) lie nearest to a waypoint of another edge's
    devices, whose region is not theirs; raises as `nearest_planned`."""
    planned = check_array("planned_xy", planned_xy, (None, 2))
    captured = check_array("captured_xy", captured_xy, (len(device_of_captured), 2))
    edge_of_device = np.repeat(np.arange(len(edge_plans)), [len(plan.device_ids) for plan in edge_plans])
    meant = device_of_planned(edge_plans, len(planned))[nearest_planned(planned, captured)]
    return edge_of_device[meant] != edge_of_device[device_of_captured]


def require_same_system(edge_plans: Sequence[EdgePlan], system: System) -> None:
    """Raise BadInput unless the plan has the system's edges with their devices, in their order."""
    ids = [(edge.id, tuple(device.id for device in edge.devices)) for edge in system.edges]
    planned = [(plan.edge_id, plan.device_ids) for plan in edge_plans]
    if planned != ids:
        has, wanted = ("; ".join(f"{edge} ({', '.join(devices)})" for edge, devices in part) for part in (planned, ids))
        raise BadInput(f"the plan is for {has}, the system has {wanted}: use the system it was planned for.")


def nearest_planned(planned: FloatArray, captured: FloatArray) -> NDArray[np.int64]:
    """Row of the nearest waypoint (C,) of photographs (C,2) m; BadInput when most lie farther from
    all than the plan is wide."""
    tree: Any = KDTree(planned)
    distances_m: FloatArray
    nearest: NDArray[np.int64]
    distances_m, nearest = tree.query(captured)
    width_m = max(float(np.hypot(*np.ptp(planned, axis=0))), MIN_SITE_M)
    far = np.flatnonzero(distances_m > width_m)
    if 2 * len(far) > len(captured):
        raise BadInput(
            f"{len(far)} of {len(captured)} photographs lie farther than {width_m:.0f} m, the width of the plan, from every waypoint, the "
            f"first by {distances_m[far[0]]:.0f} m: use the plan of this site."
        )
    return nearest


def device_of_planned(edge_plans: Sequence[EdgePlan], num_planned: int) -> NDArray[np.int64]:
    """Device (P,) of each waypoint, counted over all edges in order."""
    device_of_planned = np.empty(num_planned, dtype=np.int64)
    first = 0
    for plan in edge_plans:
        device_of_planned[plan.camera_indices] = first + plan.device_of_camera
        first += len(plan.device_ids)
    return device_of_planned


def _require_memory(system: System, counts: NDArray[np.int64]) -> None:
    for device, count in zip(system.devices, counts.tolist(), strict=True):
        if device.max_cameras is not None and count > device.max_cameras:
            raise BadInput(
                f"device {device.id!r} captured {count} photographs, its memory holds {device.max_cameras}: raise max_cameras or leave "
                "some out."
            )


def _device_times_s(edge: Edge, counts: NDArray[np.int64]) -> FloatArray:
    return np.array([float(device_time_s(device, count)) for device, count in zip(edge.devices, counts, strict=True)])


def _edge_time_s(edge: Edge, plan: EdgePlan) -> float:
    counts = np.bincount(plan.device_of_camera, minlength=len(edge.devices))
    model_bytes = sum(float(device.model_bytes(count)) for device, count in zip(edge.devices, counts, strict=True))
    joining_s = edge.aggregation_s(int(counts.sum()), int((counts > 0).sum()))
    return float(plan.device_time_s.max() + joining_s + model_bytes / edge.uplink_bytes_per_s)


def _add_bound(
    cloud_plan: CloudPlan, captured: FloatArray, edge_of_camera: NDArray[np.int64], edge_time_s: FloatArray, system: System
) -> CloudPlan:
    lower_bound_s = float(fastest_edge_counts(system, len(captured)).edge_time_s.max())
    centre = captured.mean(axis=0)  # UTM-sized coordinates would lose half the digits when squared
    certified = is_certified(captured - centre, cloud_plan.sites - centre, cloud_plan.weights, edge_of_camera)
    makespan_s = float(edge_time_s.max())
    status: PlanStatus = "stopped"
    # 1e-9: the tables add up the bytes of each camera, here they are taken at once.
    if certified and makespan_s <= lower_bound_s * (1 + 1e-9):
        status = "optimal"
    elif makespan_s <= (1 + PaperConfig().threshold) * lower_bound_s:
        status = "converged"
    return replace(
        cloud_plan,
        edge_of_camera=edge_of_camera,
        looks=None,
        edge_time_s=edge_time_s,
        lower_bound_s=lower_bound_s,
        status=status,
        certified=certified,
        history=(makespan_s,),
    )
