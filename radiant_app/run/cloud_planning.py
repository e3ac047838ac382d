"""Planning at the cloud from a count raster and a curve per edge, see `workers/regions.py`."""

from __future__ import annotations

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Decided
from radiant_app.executors.local import run_task
from radiant_app.executors.protocol import NodeTask
from radiant_app.files.run_folder import PLANNING_FOLDER
from radiant_app.run.progress import Progress
from radiant_app.workers.regions import regions_task
from radiant_core import __version__
from radiant_core.decisions import Decision
from radiant_core.hierarchy.codec import save_task, task_key
from radiant_core.io.records import load_plan
from radiant_core.io.run_store import content_key
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.count_raster import assign_to_regions, count_raster
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.system import System


def place_edges_by_raster(system: System, positions: FloatArray, origin: FloatArray | None, cell_m: float | None, seed: int) -> System:
    """Place edges among the cameras (C,2) m, or among the cells of their raster with `cell_m`."""
    places = positions if cell_m is None else count_raster(positions, cell_m).places
    return place_edges(system, places, origin, seed)


def plan_at_cloud(config: RunConfig, cell_m: float, system: System, positions: FloatArray, progress: Progress) -> CloudPlan:
    """Plan at the cloud, which receives only the raster, in planning/."""
    folder = config.out / PLANNING_FOLDER
    folder.mkdir(exist_ok=True)
    task = regions_task(count_raster(positions, cell_m), system, config.plan.method, config.plan.paper)
    save_task(folder, task)
    node = NodeTask(kind="regions", stage=PLANNING_FOLDER, folder=folder, key=content_key(__version__, task_key(task)))
    run_task(node, progress.listen, progress.clock)
    regions, _ = load_plan(folder / "regions.json")
    plan = assign_to_regions(regions, positions, system)
    progress.listen(Decided(decision=raster_decision(cell_m, plan)))
    return plan


def raster_decision(cell_m: float, plan: CloudPlan) -> Decision:
    """The decision to plan from a raster, with how far the makespan is above the shortest."""
    ratio = plan.makespan_s / plan.lower_bound_s if plan.lower_bound_s > 0 else 1.0
    return Decision(
        stage=PLANNING_FOLDER,
        topic="what the cloud plans from",
        choice=f"a count raster of {cell_m:g} m and one curve per edge",
        figure=100 * (ratio - 1),
        unit="% above the shortest makespan",
        reason="the cloud gets no position, device or number of devices; with positions the plan would be exact",
    )
