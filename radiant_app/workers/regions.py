"""Planning at the cloud from a count raster and one curve per edge, in a process of its own.

planning/task.json holds all that the cloud receives, planning/regions.json its plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from radiant_app.reporting import EventReporter
from radiant_app.workers.tasks import PlannedEdge, RegionsTask
from radiant_core.errors import BadInput
from radiant_core.io.records import save_plan
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.count_raster import CountRaster, assign_to_regions, count_raster, regions_of_raster, system_without_devices
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.region_plan import PlanInfeasible, PlanMethod
from radiant_core.plan.system import Edge, System


def regions_task(raster: CountRaster, system: System, method: PlanMethod, paper: PaperConfig | None = None) -> RegionsTask:
    """All that the cloud receives: the raster and the position, curve and capacity of each edge."""
    total_system = system_without_devices(system, int(raster.counts.sum()))
    edges = [
        PlannedEdge(
            id=edge.id,
            position=edge.position or (0.0, 0.0),
            uplink_bytes_per_s=edge.uplink_bytes_per_s,
            time_s=edge.time_s or CostCurve(),
            max_cameras=edge.max_cameras,
        )
        for edge in total_system.edges
    ]
    cells = tuple((int(x), int(y)) for x, y in raster.cells)
    counts = tuple(int(count) for count in raster.counts)
    return RegionsTask(cell_m=raster.cell_m, cells=cells, counts=counts, edges=tuple(edges), method=method, paper=paper)


def plan_regions_of_task(task: RegionsTask) -> CloudPlan:
    """Plan the regions at the cloud; BadInput if the edges cannot hold all cameras."""
    raster = CountRaster(cell_m=task.cell_m, cells=np.array(task.cells), counts=np.array(task.counts))
    plan = regions_of_raster(raster, System(edges=tuple(map(_edge_of, task.edges))), task.method, task.paper)
    if isinstance(plan, PlanInfeasible):
        raise BadInput(f"plan: {plan.reason}")
    return plan


def plan_from_raster(
    system: System, positions: FloatArray, cell_m: float, method: PlanMethod, paper: PaperConfig | None = None
) -> CloudPlan:
    """Plan from the raster of cameras (C,2) m for placed edges; raises as
    `plan_regions_of_task`."""
    regions = plan_regions_of_task(regions_task(count_raster(positions, cell_m), system, method, paper))
    return assign_to_regions(regions, positions, system)


def run_regions(folder: Path, task: RegionsTask, reporter: EventReporter) -> Sequence[str]:
    """Plan the regions of the task and write regions.json."""
    save_plan(folder / "regions.json", plan_regions_of_task(task), ())
    return ["regions.json"]


def _edge_of(edge: PlannedEdge) -> Edge:
    return Edge(
        id=edge.id,
        position=edge.position,
        aggregate_s=CostCurve(),
        uplink_bytes_per_s=edge.uplink_bytes_per_s,
        devices=(),
        time_s=edge.time_s,
        max_cameras=edge.max_cameras,
    )
