"""What an edge sends to the cloud about its devices: one time curve and a capacity, nothing else.
Once per edge and profile."""

from __future__ import annotations

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.plan.counts.deadline import edge_table
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.curve_fit import FittedCurve, fit_curve
from radiant_core.plan.system import Edge

_SAMPLES = 32


def capacity_curve(edge: Edge, num_cameras: int) -> FittedCurve:
    """T^m of an edge fitted by one curve over 1..`num_cameras` cameras; `worst_error` is the
    largest relative error at its samples.

    T^m has a bend wherever a device comes in or is full, which one curve smooths. Raises BadInput
    where the edge can hold no camera.
    """
    table = edge_table(edge, num_cameras)
    if table.capacity < 1:
        raise BadInput(f"edge {edge.id!r} can hold {table.capacity} cameras: give its devices room for at least one.")
    counts = np.unique(np.round(np.geomspace(1, table.capacity, _SAMPLES)).astype(np.int64))
    times_s = table.edge_time_s[counts]
    if times_s.min() <= 0:
        raise BadInput(f"edge {edge.id!r} needs no time for {int(counts[times_s.argmin()])} cameras: profile its devices first.")
    return fit_curve(counts, times_s)


def edge_without_devices(edge: Edge, num_cameras: int) -> Edge:
    """The same edge as the cloud may receive it: place, fitted curve and how many cameras it holds
    (None: at least `num_cameras`)."""
    capacity = edge_table(edge, num_cameras).capacity
    return Edge(
        id=edge.id,
        position=edge.position,
        lat_lon_deg=edge.lat_lon_deg,
        aggregate_s=CostCurve(),
        uplink_bytes_per_s=edge.uplink_bytes_per_s,
        devices=(),
        time_s=capacity_curve(edge, num_cameras).curve,
        max_cameras=capacity if capacity < num_cameras else None,
    )
