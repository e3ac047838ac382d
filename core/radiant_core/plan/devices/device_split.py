"""Strips for the devices of an edge (paper Sec. III-C, RTP): which device trains which cameras.

The quotas come from `deadline`; the cameras are sorted along the longer side of the smallest
rectangle around them and dealt in the order of devices that keeps the seams short (`strip_order`);
strips are cut midway between the last camera of one device and the first of the next. Runs once per
edge and plan, O(K log K) in the edge's cameras K.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely import MultiPoint, get_coordinates

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.counts.deadline import device_time_s, edge_table
from radiant_core.plan.devices.even_shares import even_quotas
from radiant_core.plan.devices.strip_order import chords_across, shortest_order
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.power_diagram import clip_polygon
from radiant_core.plan.system import Edge, System


def split_edges(positions: ArrayLike, plan: CloudPlan, system: System) -> tuple[EdgePlan, ...]:
    """One `EdgePlan` per edge for the cameras (C,2) m of a plan of the same system; BadInput when
    plan and input differ."""
    positions = check_array("positions", positions, (len(plan.edge_of_camera), 2))
    if plan.edge_ids != tuple(edge.id for edge in system.edges):
        raise BadInput(f"the plan is for edges {', '.join(plan.edge_ids)}, the system has others: plan this system anew.")
    return tuple(
        split_edge(edge, positions, np.flatnonzero(plan.edge_of_camera == index), border, even=plan.method == "even")
        for index, (edge, border) in enumerate(zip(system.edges, plan.borders, strict=True))
    )


def split_edge(edge: Edge, positions: FloatArray, camera_indices: NDArray[np.int64], border: FloatArray, *, even: bool = False) -> EdgePlan:
    """Deal an edge's cameras, rows `camera_indices` (K,) of (C,2) m, to its devices; strips
    partition `border` (V,2) m.

    `even`: as many to each device, instead of so many that the slowest is done first. An edge that
    is known by its curve alone has nobody to deal to yet. Raises BadInput when the devices cannot
    hold the cameras.
    """
    if not edge.devices:
        return EdgePlan(
            edge_id=edge.id,
            device_ids=(),
            camera_indices=camera_indices,
            device_of_camera=np.full(len(camera_indices), -1),
            strips=(),
            device_time_s=np.zeros(0),
            dealt=False,
        )
    count = len(camera_indices)
    quotas = even_quotas(edge, count) if even else edge_table(edge, count).quotas(count)
    points = positions[camera_indices]
    centre = points.mean(axis=0) if len(points) else np.zeros(2)
    axis = long_axis(points)
    along = (points - centre) @ axis
    across = (points - centre) @ np.array([-axis[1], axis[0]])
    order = np.lexsort((camera_indices, across, along))
    device_of_camera = np.empty(len(points), dtype=np.int64)
    cuts = _cuts(along[order])
    dealt = shortest_order(quotas, [device.id for device in edge.devices], chords_across(border - centre, axis, cuts))
    device_of_camera[order] = np.repeat(dealt, quotas[dealt])
    strips = [strip + centre for strip in _strips(border - centre, axis, cuts, quotas, dealt)]
    return EdgePlan(
        edge_id=edge.id,
        device_ids=tuple(device.id for device in edge.devices),
        camera_indices=camera_indices,
        device_of_camera=device_of_camera,
        strips=tuple(strips),
        device_time_s=np.array([float(device_time_s(d, q)) for d, q in zip(edge.devices, quotas, strict=True)]),
    )


def long_axis(points: FloatArray) -> FloatArray:
    """Unit vector (2,), angle in [0°, 180°), along the longer side of the smallest rectangle around
    points (K,2); among equal rectangles the longest, then the smallest angle; east for one spot. A
    side of the rectangle lies on an edge of the convex hull (Freeman, Shapira 1975)."""
    spread = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
    if spread == 0:
        return np.array([1.0, 0.0])
    hull: FloatArray = get_coordinates(MultiPoint((points - points.mean(axis=0)) / spread).convex_hull)
    sides = np.diff(hull, axis=0)
    sides = sides[np.hypot(*sides.T) > 1e-12]
    angles = np.arctan2(sides[:, 1], sides[:, 0])
    angles: FloatArray = np.unique(np.round(np.concatenate([angles, angles + np.pi / 2]) % np.pi, 12)) % np.pi
    axes = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    lengths: FloatArray = np.ptp(hull @ axes.T, axis=0)
    widths: FloatArray = np.ptp(hull @ np.stack([-axes[:, 1], axes[:, 0]]), axis=0)
    # Rounded, so that rectangles equal by symmetry do not change places with the last digit.
    best = np.lexsort((angles, -np.round(lengths, 9), np.round(lengths * widths, 9)))[0]
    return axes[best]


def _cuts(along: FloatArray) -> FloatArray:
    """Where a strip that ends after k of K sorted cameras is cut (K+1,): midway to the next."""
    if not len(along):
        return np.zeros(1)
    return np.concatenate([along[:1], (along[:-1] + along[1:]) / 2, along[-1:]])


def _strips(
    border: FloatArray, axis: FloatArray, cuts: FloatArray, quotas: NDArray[np.int64], dealt: NDArray[np.int64]
) -> list[FloatArray]:
    """Per device its part of the border (V,2), which is cut across `axis` at `cuts` (K+1,) between
    devices in the order `dealt`."""
    strips = [np.empty((0, 2))] * len(quotas)
    remainder = border
    ends = np.cumsum(quotas[dealt])
    for device, end in zip(dealt[:-1], ends[:-1], strict=True):
        strips[device] = clip_polygon(remainder, axis, float(cuts[end]))
        remainder = clip_polygon(remainder, -axis, -float(cuts[end]))
    if len(dealt):
        strips[dealt[-1]] = remainder
    return strips
