"""A plan whose devices fly whole lines, where that costs at most a given slack. Once per plan.

Lines that run one way are sorted across it and dealt to the devices in turn, so that a device has
lines beside each other and its land is a strip between them. Of all ways to cut that sequence of C
cameras into runs, one per device, in which no edge needs longer than slack · T*, the one with the
fewest lines cut is found exactly:

    cuts_d(p) = [p inside a line] + min { cuts_{d−1}(a) : p − capacity_d ≤ a ≤ p },   p = 0 … C

with capacity_d what device d does within that time less what its edge needs to join. Of all slacks
up to the given one the least is taken that cuts as few lines. O(D C) per slack. T* is the bound of
the plan. Lines that run several ways have no such order: the plan then stays as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from shapely import MultiPoint, Polygon, get_coordinates
from shapely.geometry.polygon import orient

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.deadline import aggregate_times_s, device_time_s, edge_table
from radiant_core.plan.flight.lines import flight_lines
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.power_diagram import clip_polygon
from radiant_core.plan.system import Device, Edge, System

MAX_SPREAD_DEG = 20.0
"""Lines within this angle of the usual direction run the same way."""
MIN_SAME_WAY = 0.8
"""Share of the cameras that must lie on lines that run the same way."""
NUM_SLACKS = 21
Counts = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class LinePlan:
    """A plan that keeps lines, or why there is none."""

    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]
    num_lines: int
    cut_before: int
    """Lines that the plan before dealt to several devices."""
    cut: int
    slack: float
    """Makespan over the bound."""
    reason: str | None = None
    """Why the plan stays as it was, a whole sentence; None where it does not."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sequence:
    """Cameras in the order of dealing: (C,) indices, and which line each is on, −1 for none."""

    cameras: Counts
    line: Counts
    across: FloatArray
    """(C,) place of its line, or its own, across the flight."""
    axis: FloatArray
    """(2,) unit vector across the flight."""


def num_cut(lines: Sequence[Counts], device_of_camera: Counts) -> int:
    """Lines whose cameras go to more than one device."""
    return sum(len(np.unique(device_of_camera[line])) > 1 for line in lines)


def device_of_all(edges: Sequence[EdgePlan], num_cameras: int) -> Counts:
    """Number of the device of every camera (C,), counted over all edges; −1 where not dealt."""
    device_of_camera, first = np.full(num_cameras, -1), 0
    for plan in edges:
        dealt = plan.device_of_camera >= 0
        device_of_camera[plan.camera_indices[dealt]] = first + plan.device_of_camera[dealt]
        first += len(plan.device_ids)
    return device_of_camera


def keep_lines(positions: FloatArray, cloud: CloudPlan, edges: tuple[EdgePlan, ...], system: System, slack: float) -> LinePlan:
    """Deal whole lines of cameras (C,2) m, in the order of the flight, within `slack` times the
    bound of a plan; BadInput for a slack below 1 or an edge without devices."""
    if not 1 <= slack < 100:
        raise BadInput(f"--whole-lines is {slack}, expected how many times the shortest makespan the plan may take, such as 1.05.")
    if any(not edge.devices for edge in system.edges):
        raise BadInput("--whole-lines deals lines to devices, and an edge of the system has none: name its devices.")
    lines = flight_lines(np.column_stack([positions, np.zeros(len(positions))]))
    before = num_cut(lines, device_of_all(edges, len(positions)))
    unchanged = LinePlan(
        cloud=cloud,
        edges=edges,
        num_lines=len(lines),
        cut_before=before,
        cut=before,
        slack=_over(cloud.makespan_s, cloud),
        reason="",
    )
    sequence = _sequence(positions, lines)
    if isinstance(sequence, str):
        return replace(unchanged, reason=sequence)
    order = _order_of_edges(system, cloud, sequence.axis)
    ends = _fewest_cuts(sequence, system, order, cloud.lower_bound_s, slack)
    if ends is None:
        reason = f"no slack up to {slack:g} fits whole or cut lines to the devices in the order of the land."
        return replace(unchanged, reason=reason)
    new_cloud, new_edges = _plan_of(sequence, ends, order, system, cloud)
    after = num_cut(lines, device_of_all(new_edges, len(positions)))
    return LinePlan(
        cloud=new_cloud,
        edges=new_edges,
        num_lines=len(lines),
        cut_before=before,
        cut=after,
        slack=_over(new_cloud.makespan_s, cloud),
    )


def _over(makespan_s: float, cloud: CloudPlan) -> float:
    return makespan_s / cloud.lower_bound_s if cloud.lower_bound_s > 0 else 1.0


def _sequence(positions: FloatArray, lines: list[Counts]) -> _Sequence | str:
    """The order of dealing, or why there is none."""
    if len(lines) < 2:
        return "no two straight flight lines were found in the order of the positions."
    ways = np.array([positions[line[-1]] - positions[line[0]] for line in lines])
    # Twice the angle: to and fro are one way.
    doubled = np.exp(2j * np.arctan2(ways[:, 1], ways[:, 0])) * np.linalg.norm(ways, axis=1)
    usual = np.angle(doubled.sum()) / 2
    off = np.abs(np.angle(doubled * np.exp(-2j * usual))) / 2
    count = sum(len(line) for line, angle in zip(lines, off, strict=True) if angle <= np.radians(MAX_SPREAD_DEG))
    if count < MIN_SAME_WAY * len(positions):
        return (
            f"only {count} of {len(positions)} positions lie on flight lines that run one way, and strips of lines need {MIN_SAME_WAY:.0%}."
        )
    axis = np.array([-np.sin(usual), np.cos(usual)])
    across, line_of = positions @ axis, np.full(len(positions), -1)
    for number, line in enumerate(lines):
        line_of[line], across[line] = number, across[line].mean()
    along = positions @ np.array([np.cos(usual), np.sin(usual)])
    cameras = np.lexsort((along, line_of, across))
    return _Sequence(cameras=cameras, line=line_of[cameras], across=across[cameras], axis=axis)


def _order_of_edges(system: System, cloud: CloudPlan, axis: FloatArray) -> list[int]:
    """Edges in the order of their places across the flight."""
    return sorted(range(len(system.edges)), key=lambda index: (float(cloud.sites[index] @ axis), system.edges[index].id))


def _fewest_cuts(sequence: _Sequence, system: System, order: list[int], bound_s: float, slack: float) -> Counts | None:
    """Where each device's run ends (D,), for the least slack that cuts as few lines as the whole
    one; None where the cameras do not fit."""
    best: tuple[int, Counts] | None = None
    for tried in np.linspace(slack, 1.0, NUM_SLACKS) if slack > 1 else [1.0]:
        # 1e-9: the bound itself is met by quotas that were rounded once.
        capacities = [
            capacity
            for index in order
            for capacity in _capacities(system.edges[index], len(sequence.cameras), tried * bound_s * (1 + 1e-9))
        ]
        dealt = _deal(sequence.line, np.array(capacities, np.int64))
        if dealt is None or (best is not None and dealt[0] > best[0]):
            continue
        best = dealt
    return None if best is None else best[1]


def _capacities(edge: Edge, num_cameras: int, within_s: float) -> list[int]:
    """Cameras that each device of an edge can take so that the edge is done in time."""
    table = edge_table(edge, num_cameras)
    most = int(table.edge_time_s.searchsorted(within_s, side="right")) - 1
    if most <= 0:
        return [0] * len(edge.devices)
    quotas = table.quotas(most)
    slowest_s = max(float(device_time_s(device, count)) for device, count in zip(edge.devices, quotas, strict=True))
    left_s = within_s - (float(table.edge_time_s[most]) - slowest_s)
    return [_capacity(device, most, left_s) for device in edge.devices]


def _capacity(device: Device, most: int, within_s: float) -> int:
    limit = most if device.max_cameras is None else min(most, device.max_cameras)
    times_s = device_time_s(device, np.arange(1, limit + 1))
    return int(np.searchsorted(np.maximum.accumulate(times_s), within_s, side="right")) if limit else 0


def _deal(line: Counts, capacities: Counts) -> tuple[int, Counts] | None:
    """The fewest cuts of a sequence (C,) into runs no longer than the capacities (D,), and where
    the runs end (D,); None where they are too short."""
    count = len(line)
    inside = np.zeros(count + 1, np.int64)
    inside[1:count] = (line[1:] == line[:-1]) & (line[1:] >= 0)
    never = count + 1
    cost = np.full(count + 1, never)
    cost[0] = 0
    history = [cost]
    for capacity in capacities.tolist():
        least = _least_before(cost, min(capacity, count), never)
        cost = np.minimum(least + inside, never)
        history.append(cost)
    if cost[count] >= never:
        return None
    ends, at = np.zeros(len(capacities), np.int64), count
    for device in range(len(capacities) - 1, -1, -1):
        ends[device] = at
        low = max(0, at - int(capacities[device]))
        before = history[device][low : at + 1]
        starts = low + np.flatnonzero(before == before.min())
        # As much as the others take of what is left, so that nobody is idle without need.
        share = at * capacities[device] / max(1, capacities[: device + 1].sum())
        at = int(starts[np.argmin(np.abs(starts - (at - share)))])
    return int(history[-1][count]), ends


def _least_before(cost: Counts, reach: int, never: int) -> Counts:
    """The least of cost[p − reach … p] at every p (C+1,): windows of twice the length are made of
    two of the length before, and the last one of two that overlap."""
    least, length = cost, 1
    while 2 * length <= reach + 1:
        least = np.minimum(least, _shifted(least, length, never))
        length *= 2
    return np.minimum(least, _shifted(least, reach + 1 - length, never))


def _shifted(values: Counts, places: int, never: int) -> Counts:
    return np.concatenate([np.full(places, never), values[: len(values) - places]])


def _plan_of(
    sequence: _Sequence, ends: Counts, order: list[int], system: System, cloud: CloudPlan
) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    device_of = np.searchsorted(ends, np.arange(len(sequence.cameras)), side="right")
    land = _land(cloud)
    cuts = _cuts(sequence.across, ends)
    edges: dict[int, EdgePlan] = {}
    borders: dict[int, FloatArray] = {}
    edge_of_camera, edge_time_s = np.zeros(len(sequence.cameras), np.int64), np.zeros(len(system.edges))
    first = 0
    for index in order:
        edge = system.edges[index]
        last = first + len(edge.devices)
        in_edge = np.flatnonzero((device_of >= first) & (device_of < last))
        rows = np.argsort(sequence.cameras[in_edge])
        indices, devices = sequence.cameras[in_edge][rows], device_of[in_edge][rows] - first
        counts = np.bincount(devices, minlength=len(edge.devices))
        edge_of_camera[indices] = index
        edge_time_s[index] = _edge_time_s(edge, counts)
        borders[index] = _between(land, sequence.axis, cuts[first], cuts[last]) if len(in_edge) else np.empty((0, 2))
        strips = [
            _between(land, sequence.axis, cuts[device], cuts[device + 1]) if counts[device - first] else np.empty((0, 2))
            for device in range(first, last)
        ]
        edges[index] = EdgePlan(
            edge_id=edge.id,
            device_ids=tuple(device.id for device in edge.devices),
            camera_indices=indices,
            device_of_camera=devices,
            strips=tuple(strips),
            device_time_s=np.array([float(device_time_s(device, count)) for device, count in zip(edge.devices, counts, strict=True)]),
        )
        first = last
    sites, weights = _sites(borders, order, sequence.axis, cloud)
    new = replace(
        cloud,
        sites=sites,
        weights=weights,
        borders=tuple(borders[index] for index in range(len(system.edges))),
        edge_of_camera=edge_of_camera,
        edge_time_s=edge_time_s,
        status="constrained",
        certified=False,
        constrained=(*cloud.constrained, "whole flight lines"),
    )
    return replace(new, num_outside=_num_outside(new, sequence)), tuple(edges[index] for index in range(len(system.edges)))


def _sites(borders: dict[int, FloatArray], order: list[int], axis: FloatArray, cloud: CloudPlan) -> tuple[FloatArray, FloatArray]:
    """Sites (E,2) m and weights (E,) m² of which the strips are the power diagram:
    w' = w + (t − s')² − (t − s)² for sites s, s' on either side of a cut at t."""
    sites, weights = cloud.sites.copy(), np.zeros(len(cloud.sites))
    along = np.array([axis[1], -axis[0]])
    before: tuple[float, float] | None = None
    for index in order:
        if not len(borders[index]):
            continue
        low, high = (float(value) for value in (np.min(borders[index] @ axis), np.max(borders[index] @ axis)))
        middle = (low + high) / 2
        sites[index] = middle * axis + float((borders[index] @ along).mean()) * along
        if before is not None:
            site, weight = before
            weights[index] = weight + (low - middle) ** 2 - (low - site) ** 2
        before = (middle, float(weights[index]))
    empty = [index for index in order if not len(borders[index])]
    if empty and before is not None:
        reach = float(np.ptp(np.concatenate([sites, *borders.values()]), axis=0).max())
        weights[empty] = weights.min() - 9 * reach**2
    # All on one line across the flight, or the borders between them would lean.
    level = float(np.mean([sites[index] @ along for index in order if len(borders[index])] or [0.0]))
    for index in order:
        if len(borders[index]):
            sites[index] = (sites[index] @ axis) * axis + level * along
    return sites, weights


def _land(cloud: CloudPlan) -> FloatArray:
    """The convex hull (V,2) of all regions, counter-clockwise."""
    corners = np.concatenate([border for border in cloud.borders if len(border)])
    hull = MultiPoint(corners).convex_hull
    return get_coordinates(orient(hull))[:-1] if isinstance(hull, Polygon) else np.empty((0, 2))


def _cuts(across: FloatArray, ends: Counts) -> FloatArray:
    """Where the land is cut across the flight (D+1,): midway between neighbouring cameras."""
    inner = [
        -np.inf if end <= 0 else np.inf if end >= len(across) else float(across[end - 1] + across[end]) / 2 for end in ends[:-1].tolist()
    ]
    return np.array([-np.inf, *inner, np.inf])


def _between(land: FloatArray, axis: FloatArray, low: float, high: float) -> FloatArray:
    part = land
    if np.isfinite(high) and len(part):
        part = clip_polygon(part, axis, high)
    if np.isfinite(low) and len(part):
        part = clip_polygon(part, -axis, -low)
    return part


def _edge_time_s(edge: Edge, counts: Counts) -> float:
    total, largest = int(counts.sum()), int(counts.max(initial=0))
    if not total:
        return 0.0
    slowest_s = max(float(device_time_s(device, count)) for device, count in zip(edge.devices, counts, strict=True))
    sent_bytes = sum(float(device.model_bytes(count)) for device, count in zip(edge.devices, counts, strict=True))
    joined_s = float(aggregate_times_s(edge, total, total if largest == total else 0))
    return slowest_s + joined_s + sent_bytes / edge.uplink_bytes_per_s


def _num_outside(cloud: CloudPlan, sequence: _Sequence) -> int:
    """Cameras outside of their edge's strip: those of lines that are cut."""
    place = np.zeros(len(sequence.cameras))
    place[sequence.cameras] = sequence.across
    outside = 0
    for index, border in enumerate(cloud.borders):
        edge_places = place[cloud.edge_of_camera == index]
        if len(border) and len(edge_places):
            along = border @ sequence.axis
            outside += int(((edge_places < along.min() - 1e-9) | (edge_places > along.max() + 1e-9)).sum())
    return outside
