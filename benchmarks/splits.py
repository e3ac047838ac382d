"""Plans of regions that no run makes, to compare with. Once per plan.

voronoi  every camera to its nearest edge
kd       halves of equal counts across the longer side, edges halved along with them
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from radiant_core.choices import PlanMethod
from radiant_core.numerics import FloatArray
from radiant_core.plan.baselines import ComparedPlan, compare, halve_by_weight
from radiant_core.plan.counts.wide_deadline import fastest_edge_counts, system_capacity, times_of_counts
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.plan.regions.region_plan import PlanInfeasible, num_cameras_outside, plan_regions, regions_with_counts
from radiant_core.plan.system import System

Split = Literal["voronoi", "kd"]
AnyMethod = PlanMethod | Split
ALL_METHODS: tuple[AnyMethod, ...] = (*get_args(PlanMethod), *get_args(Split))
NEAREST = 1e12
"""A tolerance within which every camera stays at its nearest edge."""


def plan_by(method: AnyMethod, positions: FloatArray, system: System) -> CloudPlan | PlanInfeasible:
    """Regions for cameras (C,2) m by a method of runs or a split; edges are placed. A split beyond
    the memory of an edge is infeasible."""
    if method not in ("voronoi", "kd"):
        return plan_regions(positions, system, method=method)
    cells = split(method, positions, system)
    counts = np.bincount(cells, minlength=len(system.edges))
    for edge, count in zip(system.edges, counts, strict=True):
        if count > (capacity := system_capacity(System(edges=(edge,)), len(positions))):
            reason = f"method {method} gives edge {edge.id!r} {count} cameras, it can hold {capacity}: use method exact."
            return PlanInfeasible(method="exact", num_cameras=len(positions), capacity=capacity, reason=reason)
    if method == "voronoi":
        plan = plan_regions(positions, system, tolerance=NEAREST)
        assert isinstance(plan, CloudPlan), "no edge has more cameras than it can hold"
        return replace(plan, method=method)
    plan = regions_with_counts(positions, cells, system)
    return replace(
        plan,
        method=method,
        edge_time_s=times_of_counts(system, counts),
        lower_bound_s=float(fastest_edge_counts(system, len(positions)).edge_time_s.max()),
        num_outside=num_cameras_outside(positions, plan.sites, plan.weights, cells),
    )


def split(method: Split, positions: FloatArray, system: System) -> NDArray[np.int64]:
    """The edge (C,) of each camera (C,2) m, whatever the edges can hold."""
    sites = np.array([edge.position for edge in system.edges])
    if method == "kd":
        return halve_by_weight(positions, sites, np.ones(len(positions)))
    return assign(positions - positions.mean(axis=0), sites - positions.mean(axis=0), np.zeros(len(sites)))


def compare_all(positions: FloatArray, system: System) -> tuple[ComparedPlan, ...]:
    """The methods that `radiant plan --compare` shows, and the splits."""
    rows = compare(positions, system)
    bound_s = rows[0].makespan_s / rows[0].over_bound
    sites = np.array([edge.position for edge in system.edges])

    def row(method: Split) -> ComparedPlan:
        cells = split(method, positions, system)
        times_s = times_of_counts(system, np.bincount(cells, minlength=len(system.edges)))
        mean_s, makespan_s = float(times_s.mean()), float(times_s.max())
        return ComparedPlan(
            method=method,
            edge_of_camera=cells,
            edge_time_s=times_s,
            makespan_s=makespan_s,
            over_bound=makespan_s / bound_s if bound_s > 0 else 1.0,
            num_orphans=0,
            squared_distance_m2=float(np.sum((positions - sites[cells]) ** 2)),
            history=(float(np.abs(times_s - mean_s).max()) / mean_s if mean_s > 0 else 0.0,),
        )

    return (*rows, *map(row, get_args(Split)))
