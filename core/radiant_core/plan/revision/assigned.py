"""The plan of photographs that already belong to devices: regions are the power diagram of the
edges' mean positions without weights, strips the hulls of devices' positions. Runs once per run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPoint, Polygon, get_coordinates
from shapely.geometry.polygon import orient

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.region_plan import regions_around
from radiant_core.plan.revision.captured import plan_of_owners
from radiant_core.plan.system import Edge, System


def device_indices(owners: Sequence[str], system: System) -> NDArray[np.int64]:
    """Index (C,) over the devices of all edges of each owner; BadInput for an unknown one."""
    index_of = {device.id: index for index, device in enumerate(system.devices)}
    unknown = sorted(set(owners) - set(index_of))
    if unknown:
        raise BadInput(f"there is no device {unknown[0]!r} in the system: its devices are {', '.join(index_of)}.")
    return np.array([index_of[owner] for owner in owners], np.int64)


def assigned_plan(positions: ArrayLike, owners: Sequence[str], system: System) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """The plan of positions (C,2) m that devices `owners` hold; raises as `plan_of_owners`."""
    positions = check_array("positions", positions, (len(owners), 2))
    device_of_camera = device_indices(owners, system)
    edge_of_device = np.repeat(np.arange(len(system.edges)), [len(edge.devices) for edge in system.edges])
    regions = regions_around(positions, edge_of_device[device_of_camera], system)
    firsts = np.cumsum([0, *(len(edge.devices) for edge in system.edges)])
    strips = [_strips_of(edge, positions, device_of_camera - first) for edge, first in zip(system.edges, firsts, strict=False)]
    return plan_of_owners(regions, strips, device_of_camera, positions, system=system)


def _strips_of(edge: Edge, positions: FloatArray, device_of_camera: NDArray[np.int64]) -> EdgePlan:
    """The edge's devices with the hull of each one's positions, without cameras."""
    return EdgePlan(
        edge_id=edge.id,
        device_ids=tuple(device.id for device in edge.devices),
        camera_indices=np.zeros(0, np.int64),
        device_of_camera=np.zeros(0, np.int64),
        strips=tuple(hull_of(positions[device_of_camera == index]) for index in range(len(edge.devices))),
        device_time_s=np.zeros(len(edge.devices)),
    )


def hull_of(points: FloatArray) -> FloatArray:
    """The convex hull of points (K,2), counter-clockwise; empty (0,2) where it has no area."""
    hull = MultiPoint(points).convex_hull if len(points) else None
    if not isinstance(hull, Polygon):
        return np.zeros((0, 2))
    corners: FloatArray = get_coordinates(orient(hull).exterior)[:-1]
    return corners
