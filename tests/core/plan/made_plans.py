"""Plans that no planner made."""

from __future__ import annotations

import numpy as np

from radiant_core.plan.plans import CloudPlan


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
