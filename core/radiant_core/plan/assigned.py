"""A plan read off from who captured what: every camera already belongs to a device. Runs once per run.

Regions are those of a plan made before capture where there is one, else the power diagram of the edges' mean positions without weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPoint, Polygon, get_coordinates
from shapely.geometry.polygon import orient

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, checked_array
from radiant_core.plan.deadline import device_time_s
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.region_plan import regions_around
from radiant_core.plan.system import Edge, System


def assigned_plan(
    positions: ArrayLike, device_of_camera: Sequence[str], system: System, regions: CloudPlan | None = None
) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """The plan in which camera i of positions (C,2) m belongs to the device with the id `device_of_camera[i]`.

    Times are the cost curves' for these counts; `regions`, a plan of the same edges, lends sites, weights and borders.
    Raises BadInput for a device the system does not have and for a plan of other edges.
    """
    positions = checked_array("positions", positions, (len(device_of_camera), 2))
    edge_of_device = {device.id: index for index, edge in enumerate(system.edges) for device in edge.devices}
    unknown = sorted(set(device_of_camera) - set(edge_of_device))
    if unknown:
        raise BadInput(f"there is no device {unknown[0]!r} in the system: its devices are {', '.join(edge_of_device)}.")
    edge_of_camera = np.array([edge_of_device[device] for device in device_of_camera], np.int64)
    if regions is None:
        regions = regions_around(positions, edge_of_camera, system)
    if regions.edge_ids != tuple(edge.id for edge in system.edges):
        raise BadInput(f"the plan is for edges {', '.join(regions.edge_ids)}, the system has others: plan this system anew.")
    owners = np.array(device_of_camera, dtype=object)
    edges = tuple(_edge_plan(edge, positions, np.flatnonzero(edge_of_camera == index), owners) for index, edge in enumerate(system.edges))
    times = np.array([_edge_time_s(edge, plan) for edge, plan in zip(system.edges, edges, strict=True)])
    cloud = replace(regions, edge_of_camera=edge_of_camera, edge_time_s=times, status="stopped", certified=False, history=())
    return cloud, edges


def _edge_plan(edge: Edge, positions: FloatArray, camera_indices: NDArray[np.int64], owners: NDArray[np.object_]) -> EdgePlan:
    ids = tuple(device.id for device in edge.devices)
    device_of_camera = np.array([ids.index(owner) for owner in owners[camera_indices]], np.int64)
    counts = np.bincount(device_of_camera, minlength=len(ids))
    return EdgePlan(
        edge_id=edge.id,
        device_ids=ids,
        camera_indices=camera_indices,
        device_of_camera=device_of_camera,
        strips=tuple(_hull(positions[camera_indices[device_of_camera == index]]) for index in range(len(ids))),
        device_time_s=np.array([float(device_time_s(device, count)) for device, count in zip(edge.devices, counts, strict=True)]),
    )


def _edge_time_s(edge: Edge, plan: EdgePlan) -> float:
    """Slowest device, then aggregation and the upload of what all devices sent."""
    if not len(plan.camera_indices):
        return 0.0
    counts = np.bincount(plan.device_of_camera, minlength=len(edge.devices))
    sent = sum(float(device.model_bytes(count)) for device, count in zip(edge.devices, counts, strict=True) if count)
    slowest = max(time for time, count in zip(plan.device_time_s, counts, strict=True) if count)
    return float(slowest + edge.aggregate_s(len(plan.camera_indices)) + sent / edge.uplink_bytes_per_s)


def _hull(points: FloatArray) -> FloatArray:
    """The convex hull of points (K,2), counter-clockwise; empty (0,2) where it has no area."""
    hull = MultiPoint(points).convex_hull if len(points) else None
    if not isinstance(hull, Polygon):
        return np.zeros((0, 2))
    corners: FloatArray = get_coordinates(orient(hull).exterior)[:-1]
    return corners
