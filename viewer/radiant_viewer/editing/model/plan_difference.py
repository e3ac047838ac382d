"""The difference of two plans: moved cameras, makespan and times. Once per edit or comparison."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_viewer.layers.region_layer import duration_text

MAX_FLOWS = 4
"""Number of moves between edges that a sentence names."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanDifference:
    """Between two plans of the same C cameras: new_edge and new_device (C,) bool, cameras that
    move; flows: numbers of cameras from edge to edge, the largest first."""

    new_edge: NDArray[np.bool_]
    new_device: NDArray[np.bool_]
    flows: tuple[tuple[str, str, int], ...]
    makespan_before_s: float
    makespan_after_s: float

    @property
    def text(self) -> str:
        """One sentence for a status line."""
        before, after = duration_text(self.makespan_before_s), duration_text(self.makespan_after_s)
        times = f"makespan {before}, as before" if before == after else f"makespan {before} → {after}"
        if not self.flows:
            moved = int(self.new_device.sum())
            return f"No camera changes its edge{f', {moved} their device' if moved else ''}; {times}."
        named = ", ".join(f"{count} {first} → {second}" for first, second, count in self.flows[:MAX_FLOWS])
        more = f" and {len(self.flows) - MAX_FLOWS} more ways" if len(self.flows) > MAX_FLOWS else ""
        count = int(self.new_edge.sum())
        return f"{count} camera{'s change' if count > 1 else ' changes'} hands ({named}{more}); {times}."


def plan_difference(before: tuple[CloudPlan, Sequence[EdgePlan]], after: tuple[CloudPlan, Sequence[EdgePlan]]) -> PlanDifference:
    """Compare two plans by the ids of edges, and of devices where both plans deal them; BadInput
    for different numbers of cameras."""
    counts = [len(cloud.edge_of_camera) for cloud, _ in (before, after)]
    if counts[0] != counts[1]:
        raise BadInput(f"a plan of {counts[0]} cameras is compared with one of {counts[1]}: compare plans of the same cameras.")
    owners = [np.array(cloud.edge_ids)[cloud.edge_of_camera] for cloud, _ in (before, after)]
    new_edge: NDArray[np.bool_] = owners[0] != owners[1]
    ways = Counter(zip(owners[0][new_edge].tolist(), owners[1][new_edge].tolist(), strict=True))
    devices = [device_names(edges, counts[0]) for _, edges in (before, after)]
    is_dealt = bool(before[1]) and bool(after[1])
    return PlanDifference(
        new_edge=new_edge,
        new_device=devices[0] != devices[1] if is_dealt else new_edge,
        flows=tuple((first, second, count) for (first, second), count in ways.most_common()),
        makespan_before_s=before[0].makespan_s,
        makespan_after_s=after[0].makespan_s,
    )


def device_names(edges: Sequence[EdgePlan], num_cameras: int) -> NDArray[np.str_]:
    """Return the device id (C,) of every camera, empty where it is not dealt yet."""
    names = np.zeros(num_cameras, dtype="U64")
    for plan in edges:
        if plan.dealt and len(plan.camera_indices):
            names[plan.camera_indices] = np.array(plan.device_ids)[plan.device_of_camera]
    return names
