"""Deals planned positions whose device captured nothing to the other devices. Once per run.

Only where devices keep their own photographs and the plan was made before capture. The run goes on
without these positions, warns of them and writes a new plan for another flight.
"""

from __future__ import annotations

import shutil
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from radiant_core.export.plan import save_device_waypoints
from radiant_core.io.records import save_plan
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.revision.captured import device_of_planned, require_same_system
from radiant_core.plan.revision.replan import FleetChange, ReplanInfeasible, replan
from radiant_core.plan.system import System
from radiant_core.plan.waypoints import Waypoints

UNCAPTURED = "uncaptured"
"""Folder of the run: plan.json, and one list per device of what it captures in place of others."""


def deal_uncaptured(
    run: Path, plan: tuple[CloudPlan, tuple[EdgePlan, ...], Waypoints], system: System, delivered: Collection[str]
) -> str | None:
    """Deal positions of devices not in `delivered` to those that are, in uncaptured/; a warning, or
    None if every device with waypoints has photographs. BadInput for another plan's system."""
    cloud, edges, waypoints = plan
    require_same_system(edges, system)
    ids = [device.id for device in system.devices]
    owner = device_of_planned(edges, len(waypoints))
    dead = [name for index, name in enumerate(ids) if name not in delivered and (owner == index).any()]
    shutil.rmtree(run / UNCAPTURED, ignore_errors=True)
    if not dead:
        return None
    missing = np.isin(owner, [ids.index(name) for name in dead])
    # Edges are where the plan has them.
    placed = [replace(edge, position=(x, y), lat_lon_deg=None) for edge, (x, y) in zip(system.edges, cloud.sites.tolist(), strict=True)]
    change = FleetChange(dead=frozenset(dead))
    new = replan(cloud, edges, waypoints.positions_m[:, :2], replace(system, edges=tuple(placed)), change, captured=~missing)
    missed = f"{missing.sum()} planned positions of {', '.join(dead)} were not captured and are missing from the scene"
    if isinstance(new, ReplanInfeasible):
        return f"{missed}; the other devices cannot take them: {new.reason}"
    (run / UNCAPTURED).mkdir()
    save_plan(run / UNCAPTURED / "plan.json", new.cloud, new.edges, waypoints)
    save_device_waypoints(run / UNCAPTURED, new.cloud, new.edges, waypoints, only=missing)
    takers = sorted({ids[index] for index in new.device_after[missing].tolist()})
    return f"{missed}; {UNCAPTURED}/ has lists that deal them to {', '.join(takers)}"
