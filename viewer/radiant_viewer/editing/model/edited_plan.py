"""`EditedPlan`: a plan with the wishes it fulfils, and how wishes become regions and strips. Once
per edit and frame of a drag."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan, require_plan_of
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.revision.captured import require_same_system
from radiant_core.plan.system import System


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanSubject:
    """The cameras to plan: names (C) unique, positions (C,3) finite, in `unit`; origin (3,) lat lon
    alt if they are on the globe; ground: its height in the positions' z, if known. Raises BadInput
    without cameras, or where these do not hold."""

    names: tuple[str, ...]
    positions: FloatArray
    unit: str = "m"
    origin: FloatArray | None = None
    ground: float | None = None
    altitude_known: bool = True
    """Whether the origin has a true altitude, as in `Frame`."""
    looks: FloatArray | None = None
    """(C,2) where the cameras look, if plans are cut by that; None: by where they stand."""

    def __post_init__(self) -> None:
        if not self.names:
            raise BadInput("the plan has no cameras: there is nothing to plan anew; make a plan of waypoints or photographs first.")
        if len(set(self.names)) != len(self.names):
            raise BadInput("a camera's name comes twice: give every one its own.")
        object.__setattr__(self, "positions", check_array("positions", self.positions, (len(self.names), 3)))
        if self.looks is not None:
            object.__setattr__(self, "looks", check_array("looks", self.looks, (len(self.names), 2)))

    @property
    def on_map(self) -> FloatArray:
        """What plans are cut by (C,2): where cameras look or stand."""
        return np.ascontiguousarray(self.positions[:, :2] if self.looks is None else self.looks)


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanWishes:
    """System, constraints, slack, and the plan that fixed weights and locks refer to."""

    system: System
    constraints: PlanConstraints
    slack: float | None
    reference: CloudPlan


@dataclass(frozen=True, kw_only=True, eq=False)
class EditedPlan:
    """A plan and the wishes it fulfils; `edges` is empty until cameras are dealt, as in a drag."""

    wishes: PlanWishes
    cloud: CloudPlan
    edges: tuple[EdgePlan, ...] = ()


def initial_plan(subject: PlanSubject, system: System, cloud: CloudPlan, edges: tuple[EdgePlan, ...]) -> EditedPlan:
    """Return an existing plan unchanged, with its edges at its own sites; BadInput where plan,
    cameras and system do not fit, or where it is cut by something else."""
    require_plan_of(len(subject.names), cloud, edges)
    require_same_system(edges, system)
    if (cloud.looks is None) != (subject.looks is None):
        plan_cut, subject_cut = ("look", "stand") if subject.looks is None else ("stand", "look")
        raise BadInput(f"that plan is cut where cameras {plan_cut}, this one where they {subject_cut}: open it by itself.")
    wishes = PlanWishes(
        system=_move_to_sites(system, cloud),
        constraints=PlanConstraints(),
        slack=cloud.slack if cloud.status == "slack" else None,
        reference=cloud,
    )
    return EditedPlan(wishes=wishes, cloud=cloud, edges=edges)


def solve_regions(subject: PlanSubject, wishes: PlanWishes, start: CloudPlan) -> EditedPlan:
    """Solve the regions for the wishes, starting from a similar plan; BadInput with the planner's
    sentence where there are none."""
    if wishes.slack is not None and wishes.constraints:
        raise BadInput("slack is for a plan in which nothing is fixed, locked or pinned: free these first, or take the slack back.")
    constraints = wishes.constraints or None
    plan = plan_regions(
        subject.on_map,
        wishes.system,
        slack=wishes.slack,
        constraints=constraints,
        start=wishes.reference if constraints else start,
    )
    if isinstance(plan, PlanInfeasible):
        raise BadInput(plan.reason)
    plan = replace(plan, looks=subject.looks)
    return EditedPlan(wishes=wishes if constraints else replace(wishes, reference=plan), cloud=plan)


def add_strips(subject: PlanSubject, plan: EditedPlan) -> EditedPlan:
    """Deal the cameras of a plan to devices."""
    return plan if plan.edges else replace(plan, edges=split_edges(subject.on_map, plan.cloud, plan.wishes.system))


def border_weight_m2(cloud: CloudPlan, edge: str, neighbour: str, distance: float) -> float:
    """Return the weight that moves the border of `edge` towards `neighbour` outwards by `distance`,
    inwards where negative."""
    first, second = cloud.edge_ids.index(edge), cloud.edge_ids.index(neighbour)
    return float(cloud.weights[first] + 2 * np.linalg.norm(cloud.sites[first] - cloud.sites[second]) * distance)


def add_empty_edge(cloud: CloudPlan, subject: PlanSubject, name: str, site: FloatArray) -> CloudPlan:
    """Add an edge without cameras: its weight is too low for any camera to lie in its cell."""
    centre = subject.on_map.mean(axis=0)  # UTM coordinates squared would lose half the digits
    cameras, sites = subject.on_map - centre, cloud.sites - centre
    nearest = assign(cameras, sites, cloud.weights)
    powers = np.sum((cameras - sites[nearest]) ** 2, axis=1) - cloud.weights[nearest]
    needed = np.sum((cameras - (site - centre)) ** 2, axis=1) - powers
    weight = float(needed.min() - 1 - np.ptp(cameras, axis=0).max() ** 2)
    return replace(
        cloud,
        edge_ids=(*cloud.edge_ids, name),
        sites=np.vstack([cloud.sites, site]),
        weights=np.append(cloud.weights, weight),
        borders=(*cloud.borders, np.zeros((0, 2))),
        edge_time_s=np.append(cloud.edge_time_s, 0.0),
    )


def remove_edge(cloud: CloudPlan, subject: PlanSubject, name: str, locked: tuple[str, ...]) -> CloudPlan:
    """Remove an edge; its cameras go to the nearest cells of edges that are not locked."""
    gone = cloud.edge_ids.index(name)
    rows = np.flatnonzero(np.arange(len(cloud.edge_ids)) != gone)
    open_edges = np.array([index for index in rows.tolist() if cloud.edge_ids[index] not in locked], np.int64)
    orphans = np.flatnonzero(cloud.edge_of_camera == gone)
    if len(orphans) and not len(open_edges):
        raise BadInput(f"the regions of all other edges are locked and {len(orphans)} cameras of {name!r} must go somewhere: free one.")
    owners: NDArray[np.int64] = cloud.edge_of_camera.copy()
    if len(orphans):
        centre = subject.on_map.mean(axis=0)
        sites = np.ascontiguousarray(cloud.sites[open_edges] - centre)
        nearest = assign(subject.on_map[orphans] - centre, sites, np.ascontiguousarray(cloud.weights[open_edges]))
        owners[orphans] = open_edges[nearest]
    return replace(
        cloud,
        edge_ids=tuple(cloud.edge_ids[index] for index in rows.tolist()),
        sites=cloud.sites[rows],
        weights=cloud.weights[rows],
        borders=tuple(cloud.borders[index] for index in rows.tolist()),
        edge_time_s=cloud.edge_time_s[rows],
        edge_of_camera=owners - (owners > gone),
    )


def _move_to_sites(system: System, cloud: CloudPlan) -> System:
    sites = [(float(x), float(y)) for x, y in cloud.sites]
    return replace(
        system, edges=tuple(replace(edge, position=site, lat_lon_deg=None) for edge, site in zip(system.edges, sites, strict=True))
    )
