"""Plans that no planner made."""

from __future__ import annotations

import numpy as np

from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.power_diagram import clip_polygon


def plan_of(sites: np.ndarray, weights: np.ndarray | None = None) -> CloudPlan:
    """One edge for each site (N,2); weights (N,) of the power diagram, 0 unless given."""
    count = len(sites)
    return CloudPlan(
        method="test",
        edge_ids=tuple(f"edge-{index}" for index in range(count)),
        sites=sites,
        weights=np.zeros(count) if weights is None else weights,
        borders=(np.zeros((0, 2)),) * count,
        edge_of_camera=np.zeros(0, np.int64),
        edge_time_s=np.zeros(count),
        lower_bound_s=0.0,
        status="stopped",
        certified=False,
    )


def edge_plan_of(edge_id: str, strips: list[np.ndarray]) -> EdgePlan:
    """One device for each strip, without photographs."""
    return EdgePlan(
        edge_id=edge_id,
        device_ids=tuple(f"{edge_id}-{index}" for index in range(len(strips))),
        camera_indices=np.zeros(0, np.int64),
        device_of_camera=np.zeros(0, np.int64),
        strips=tuple(strips),
        device_time_s=np.zeros(len(strips)),
    )


def two_edges_of_strips(shift: float = 0.0) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """The west edge in three oblique strips, the middle empty; the east edge with one device."""
    west = np.array([[-100.0, -50.0], [0.0, -50.0], [0.0, 50.0], [-100.0, 50.0]])
    axis, cut = np.array([0.8, 0.6]), -40.0
    first, last = clip_polygon(west, axis, cut), clip_polygon(west, -axis, -cut)
    strips = [first + shift, np.empty((0, 2)), last + shift]
    plan = plan_of(np.array([[-50.0, 0.0], [50.0, 0.0]]) + shift)
    return plan, (edge_plan_of("edge-0", strips), edge_plan_of("edge-1", [west + np.array([100.0, 0.0]) + shift]))
