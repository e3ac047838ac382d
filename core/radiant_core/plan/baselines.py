"""Baselines of the exact planner: other ways to deal cameras to edges, side by side.

    paper          Alg. 1 on power weights with a fixed d, stopped where it cycles (`paper_arp`)
    paper-halved   the same, d halved whenever an edge's border turns back
    paper-literal  Alg. 1 as written, with its orphans (`other_splits`)
    even           as `region_plan`
    content        halves of equal content (as LoBE-style splits) where it is given by camera

Each runs once per comparison; the iterated ones O(C E) per iteration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.counts.deadline import EdgeTable, edge_tables, fastest_counts
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.other_splits import Indices, half_planes, move_borders
from radiant_core.plan.regions.paper_arp import estimated_times_s
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import System


@dataclass(frozen=True, kw_only=True, eq=False)
class ComparedPlan:
    """One method: edge_of_camera (C,), −1 for a camera in no region; history: max|T − T̄| / T̄
    before each iteration and at the end."""

    method: str
    edge_of_camera: Indices
    edge_time_s: FloatArray
    """(E,), of the cameras in each region."""
    makespan_s: float
    over_bound: float
    """Makespan over the geography-free bound of all cameras; below 1 only where cameras are left
    out, or where equal shares send fewer bytes than the fastest, which the bound ignores."""
    num_orphans: int
    squared_distance_m2: float
    """Σ ‖camera − edge‖² over cameras that have an edge."""
    history: tuple[float, ...]


def compare(
    positions: ArrayLike,
    system: System,
    *,
    content: ArrayLike | None = None,
    paper: PaperConfig | None = None,
    max_iterations: int = 300,
) -> tuple[ComparedPlan, ...]:
    """All methods on cameras (C,2) m and edges with positions; content (C,) ≥ 0 weighs cameras for
    `content`, which is left out without; `paper`: d and T_thres of all readings of Alg. 1."""
    paper = replace(paper or PaperConfig(), max_iterations=max_iterations)
    positions = check_array("positions", positions, (None, 2))
    weights = None if content is None else check_array("content", content, (len(positions),))
    if not len(positions) or (weights is not None and weights.min() < 0):
        raise BadInput("a comparison needs at least one camera, and content of at least 0 for each.")
    tables = edge_tables(system, len(positions))
    if sum(table.capacity for table in tables) < len(positions):
        raise BadInput(f"the devices cannot hold {len(positions)} cameras: raise max_cameras or add devices.")
    _, bound_s = fastest_counts(tables, len(positions))
    plan = plan_regions(positions, system)
    assert isinstance(plan, CloudPlan), "the capacity was checked"
    sites = plan.sites - positions.mean(axis=0)
    local = positions - positions.mean(axis=0)
    step_m = paper.boundary_step * (float(np.ptp(local, axis=0).max()) or 1.0)
    dealt: list[tuple[str, Indices, tuple[float, ...]]] = [
        ("exact", plan.edge_of_camera, ()),
        ("paper", *_power_weights(local, sites, tables, step_m, False, paper)),
        ("paper-halved", *_power_weights(local, sites, tables, step_m, True, paper)),
        ("paper-literal", *half_planes(local, sites, tables, step_m, paper.threshold * bound_s, paper.max_iterations)),
    ]
    even = plan_regions(positions, system, method="even")
    assert isinstance(even, CloudPlan), "the capacity was checked"
    dealt.append(("even", even.edge_of_camera, ()))
    if weights is not None:
        dealt.append(("content", halve_by_weight(local, sites, weights), ()))

    def times_s(name: str, cells: Indices) -> FloatArray:
        # Devices with equal shares are not done as soon as those whose shares fit them.
        return even.edge_time_s if name == "even" else estimated_times_s(tables, np.bincount(cells[cells >= 0], minlength=len(tables)))

    return tuple(
        _compare(name, _squared_distance_m2(local, sites, cells), times_s(name, cells), bound_s, cells, history)
        for name, cells, history in dealt
    )


def halve_by_weight(positions: FloatArray, sites: FloatArray, weights: FloatArray) -> Indices:
    """Edge (C,) of each camera: the land is halved across its longer side, edges in order along it,
    equal weight per edge."""
    edge_of_camera = np.zeros(len(positions), np.int64)
    parts = [(np.arange(len(positions)), np.arange(len(sites)))]
    while parts:
        cameras, edges = parts.pop()
        if len(edges) == 1 or not len(cameras):
            edge_of_camera[cameras] = edges[0]
            continue
        axis = int(np.ptp(positions[cameras], axis=0).argmax())
        cameras = cameras[np.argsort(positions[cameras, axis], kind="stable")]
        edges = edges[np.argsort(sites[edges, axis], kind="stable")]
        half = len(edges) // 2
        filled = np.cumsum(weights[cameras])
        cut = int(filled.searchsorted(float(filled[-1]) * half / len(edges) * (1 + 1e-12), side="right"))
        parts += [(cameras[:cut], edges[:half]), (cameras[cut:], edges[half:])]
    return edge_of_camera


def _power_weights(
    positions: FloatArray, sites: FloatArray, tables: Sequence[EdgeTable], step_m: float, halved: bool, paper: PaperConfig
) -> tuple[Indices, tuple[float, ...]]:
    """Alg. 1 with weight changes ∓ 2 d ‖P_m − P_nearest‖, to a share of the mean; the last
    cells."""
    apart = np.hypot(*np.moveaxis(sites[:, None] - sites, -1, 0))
    np.fill_diagonal(apart, np.inf)
    unit = 2 * step_m * np.where(np.isfinite(apart.min(axis=1)), apart.min(axis=1), 0.0)

    def cells(offsets: FloatArray) -> Indices:
        return assign(positions, sites, offsets * unit)

    return move_borders(cells, tables, lambda times_s: paper.threshold * float(times_s.mean()), halved, paper.max_iterations)


def _squared_distance_m2(positions: FloatArray, sites: FloatArray, edge_of_camera: Indices) -> float:
    owned = edge_of_camera >= 0
    return float(np.sum((positions[owned] - sites[edge_of_camera[owned]]) ** 2))


def _compare(
    method: str, squared_distance_m2: float, times_s: FloatArray, bound_s: float, edge_of_camera: Indices, history: tuple[float, ...]
) -> ComparedPlan:
    mean_s = float(times_s.mean())
    return ComparedPlan(
        method=method,
        edge_of_camera=edge_of_camera,
        edge_time_s=times_s,
        makespan_s=float(times_s.max()),
        over_bound=float(times_s.max()) / bound_s if bound_s > 0 else 1.0,
        num_orphans=int((edge_of_camera < 0).sum()),
        squared_distance_m2=squared_distance_m2,
        history=history or ((float(np.abs(times_s - mean_s).max()) / mean_s if mean_s > 0 else 0.0),),
    )
