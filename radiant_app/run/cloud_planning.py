"""Planning at the cloud from what it may know: a count raster and edges by their curves, in a process and a folder of its own.

planning/task.json holds all that the cloud is told; planning/regions.json what it answers. The edges follow with positions and curves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.events import Decided, Event, Listener
from radiant_app.executors.local import run_task
from radiant_app.executors.protocol import NodeTask
from radiant_app.run.config import PlanMethod, RunConfig
from radiant_core import __version__
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan, save_plan
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.count_raster import CountRaster, count_raster, followed_by_edges, known_to_the_cloud, regions_of_raster
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import PlanInfeasible
from radiant_core.plan.system import Edge, System

STAGE = "planning"


def cloud_task(raster: CountRaster, system: System, method: PlanMethod) -> dict[str, Any]:
    """All that the cloud is told: the raster, and of each edge place, curve and how many cameras it holds."""
    told = known_to_the_cloud(system, int(raster.counts.sum()))
    edges = [
        {
            "id": edge.id,
            "position": edge.position,
            "uplink_bytes_per_s": edge.uplink_bytes_per_s,
            "time_s": asdict(edge.time_s or CostCurve()),
            "max_cameras": edge.max_cameras,
        }
        for edge in told.edges
    ]
    return {"cell_m": raster.cell_m, "cells": raster.cells.tolist(), "counts": raster.counts.tolist(), "edges": edges, "method": method}


def planned_at_cloud(task: dict[str, Any]) -> CloudPlan:
    """The cloud's answer to such a task; BadInput where the edges cannot hold all cameras."""
    raster = CountRaster(cell_m=task["cell_m"], cells=np.array(task["cells"]), counts=np.array(task["counts"]))
    edges = [_edge_of(record) for record in task["edges"]]
    plan = regions_of_raster(raster, System(edges=tuple(edges)), task["method"])
    if isinstance(plan, PlanInfeasible):
        raise BadInput(f"plan: {plan.reason}")
    return plan


def planned_from_raster(system: System, positions: FloatArray, cell_m: float, method: PlanMethod) -> CloudPlan:
    """Both sides of it in this process, for placed edges and cameras (C,2) m; raises as `planned_at_cloud`."""
    regions = planned_at_cloud(cloud_task(count_raster(positions, cell_m), system, method))
    return followed_by_edges(regions, positions, system)


def placed_by_raster(system: System, positions: FloatArray, origin: FloatArray | None, cell_m: float | None, seed: int) -> System:
    """`place_edges` among the cameras (C,2) m, of which only the raster is looked at where there is one."""
    places = positions if cell_m is None else count_raster(positions, cell_m).places
    return place_edges(system, places, origin, seed)


def plan_at_cloud(
    config: RunConfig, cell_m: float, system: System, positions: FloatArray, running: tuple[Listener, Callable[[], float]]
) -> CloudPlan:
    """The plan of a run whose cloud gets the raster alone, in planning/; `running` is the listener and the clock."""
    listen, clock = running
    folder = config.out / STAGE
    folder.mkdir(exist_ok=True)
    task = cloud_task(count_raster(positions, cell_m), system, config.plan_method)
    write_json(folder / "task.json", task)
    run_task(NodeTask(kind="regions", stage=STAGE, folder=folder, key=content_key(__version__, task)), listen, clock)
    regions, _ = load_plan(folder / "regions.json")
    plan = followed_by_edges(regions, positions, system)
    listen(Decided(decision=raster_decision(cell_m, plan)))
    return plan


def raster_decision(cell_m: float, plan: CloudPlan) -> Decision:
    """What the cloud planned from, and how far from the shortest makespan that ended."""
    ratio = plan.makespan_s / plan.lower_bound_s if plan.lower_bound_s > 0 else 1.0
    return Decision(
        stage=STAGE,
        topic="what the cloud plans from",
        choice=f"a count raster of {cell_m:g} m and one curve per edge",
        figure=100 * (ratio - 1),
        unit="% above the shortest makespan",
        reason="the cloud learns no position, device or number of devices; with positions it would plan exactly",
    )


def run_regions(folder: Path, stage: str, emit: Callable[[Event], None]) -> Sequence[str]:
    """The cloud's part: regions from the raster and the curves that task.json holds."""
    save_plan(folder / "regions.json", planned_at_cloud(read_json(folder / "task.json")), ())
    return ["regions.json"]


def _edge_of(record: dict[str, Any]) -> Edge:
    return Edge(
        id=record["id"],
        position=tuple(record["position"]),
        aggregate_s=CostCurve(),
        uplink_bytes_per_s=record["uplink_bytes_per_s"],
        devices=(),
        time_s=CostCurve(**record["time_s"]),
        max_cameras=record["max_cameras"],
    )
