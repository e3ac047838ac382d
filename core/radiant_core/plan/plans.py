"""`CloudPlan` and `EdgePlan`, the planner's results. E edges, D devices of one edge, C cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array

PlanStatus = Literal["optimal", "converged", "stopped", "infeasible", "slack", "constrained"]
"""optimal: equals the lower bound with a certificate; converged: within the threshold; stopped:
iteration limit; infeasible: not all cameras fit; slack: least distance for a makespan that may be
longer, with a certificate; constrained: least makespan and distance around what was fixed, locked
or pinned."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CloudPlan:
    """Regions of the edges: a power diagram of the edge positions and the cameras in each cell.

    sites (E,2) m; weights (E,) m²: camera x belongs to argmin ‖x − sites_e‖² − weights_e; borders:
    per edge a convex polygon (V,2) m, counter-clockwise, clipped to the scene; empty (0,2) for an
    empty cell; edge_of_camera (C,); edge_time_s (E,); lower_bound_s: the best makespan that any
    assignment of these counts can reach; history: makespan in seconds after each iteration.
    """

    method: str
    edge_ids: tuple[str, ...]
    sites: FloatArray
    weights: FloatArray
    borders: tuple[FloatArray, ...]
    edge_of_camera: NDArray[np.int64]
    edge_time_s: FloatArray
    lower_bound_s: float
    status: PlanStatus
    certified: bool
    """Whether every camera was found to lie in its own power cell."""
    history: tuple[float, ...] = ()
    slack: float | None = None
    """Factor by which the makespan could exceed the bound; None where the bound alone decided."""
    constrained: tuple[str, ...] = ()
    """What was fixed, locked or pinned, one sentence each."""
    num_outside: int = 0
    """Cameras outside their own power cell."""
    looks: FloatArray | None = None
    """(C,2) m where each camera looks, if regions and strips were cut by that; None: by where it
    stands."""

    def __post_init__(self) -> None:
        count = len(self.edge_ids)
        if count == 0 or len(set(self.edge_ids)) != count:
            raise BadInput(f"the plan has the edges {self.edge_ids}, expected one or more, each with its own id.")
        if self.status not in get_args(PlanStatus) or not np.isfinite(self.lower_bound_s):
            raise BadInput(f"the plan has status {self.status!r} and lower bound {self.lower_bound_s} s: plan again.")
        object.__setattr__(self, "sites", check_array("sites", self.sites, (count, 2)))
        object.__setattr__(self, "weights", check_array("weights", self.weights, (count,)))
        object.__setattr__(self, "edge_time_s", check_array("edge_time_s", self.edge_time_s, (count,)))
        object.__setattr__(self, "edge_of_camera", check_array("edge_of_camera", self.edge_of_camera, (None,), np.int64))
        object.__setattr__(self, "borders", tuple(check_array("borders", border, (None, 2)) for border in self.borders))
        if self.looks is not None:
            object.__setattr__(self, "looks", check_array("looks", self.looks, (len(self.edge_of_camera), 2)))
        if len(self.borders) != count:
            raise BadInput(f"the plan has {len(self.borders)} borders for {count} edges: give one polygon per edge.")
        if len(self.edge_of_camera) and not (self.edge_of_camera.min() >= 0 and self.edge_of_camera.max() < count):
            raise BadInput("the plan assigns a camera to an edge that is not there: check edge_of_camera.")

    @property
    def counts(self) -> NDArray[np.int64]:
        """Cameras per edge (E,)."""
        return np.bincount(self.edge_of_camera, minlength=len(self.edge_ids))

    @property
    def cut_by(self) -> Literal["positions", "looks"]:
        """What regions and strips were cut by, as in `choices.CutBy`."""
        return "positions" if self.looks is None else "looks"

    def places_of(self, positions: FloatArray) -> FloatArray:
        """What the plan was cut by, (C,2) m: where cameras look, else the `positions` (C,2) m where
        they stand. Raises BadInput for positions of other cameras."""
        if len(positions) != len(self.edge_of_camera):
            raise BadInput(f"the plan is of {len(self.edge_of_camera)} cameras, there are positions of {len(positions)}: plan again.")
        return positions if self.looks is None else self.looks

    def moved(self, shift: FloatArray) -> CloudPlan:
        """The same plan about an origin that lies at -`shift` (2,) m."""
        return replace(
            self,
            sites=self.sites + shift,
            borders=tuple(border + shift for border in self.borders),
            looks=None if self.looks is None else self.looks + shift,
        )

    @property
    def makespan_s(self) -> float:
        """Time of the slowest edge."""
        return float(self.edge_time_s.max())


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgePlan:
    """One edge's cameras dealt to its devices by RTP (paper Sec. III-C): camera_indices (K,) into
    the scene's cameras; device_of_camera (K,) into `device_ids`; strips: per device a polygon (V,2)
    m inside the edge's border, empty (0,2) without cameras; device_time_s (D,)."""

    edge_id: str
    device_ids: tuple[str, ...]
    camera_indices: NDArray[np.int64]
    device_of_camera: NDArray[np.int64]
    strips: tuple[FloatArray, ...]
    device_time_s: FloatArray
    dealt: bool = True
    """False where the edge is known by its curve alone: no devices, device_of_camera −1; the edge
    deals its cameras itself, later."""

    def __post_init__(self) -> None:
        count = len(self.device_ids)
        if not self.dealt and count:
            raise BadInput(f"the plan of edge {self.edge_id!r} has devices and says that it is not dealt: plan again.")
        if len(set(self.device_ids)) != count:
            raise BadInput(f"the plan of edge {self.edge_id!r} has the devices {self.device_ids}: give each its own id.")
        object.__setattr__(self, "camera_indices", check_array("camera_indices", self.camera_indices, (None,), np.int64))
        shape = (len(self.camera_indices),)
        if len(np.unique(self.camera_indices)) != shape[0] or self.camera_indices.min(initial=0) < 0:
            raise BadInput(f"the plan of edge {self.edge_id!r} has a camera twice or a negative index: check camera_indices.")
        object.__setattr__(self, "device_of_camera", check_array("device_of_camera", self.device_of_camera, shape, np.int64))
        object.__setattr__(self, "device_time_s", check_array("device_time_s", self.device_time_s, (count,)))
        object.__setattr__(self, "strips", tuple(check_array("strips", strip, (None, 2)) for strip in self.strips))
        if len(self.strips) != count:
            raise BadInput(f"the plan of edge {self.edge_id!r} has {len(self.strips)} strips for {count} devices.")
        allowed = range(count) if self.dealt else range(-1, 0)
        if shape[0] and not (self.device_of_camera.min() in allowed and self.device_of_camera.max() in allowed):
            raise BadInput(f"the plan of edge {self.edge_id!r} gives a camera to a device that is not there.")

    def cameras_of(self, device_id: str) -> NDArray[np.int64]:
        """Indices (K,) into the scene's cameras of one device."""
        return self.camera_indices[self.device_of_camera == self.device_ids.index(device_id)]


def require_plan_of(num_cameras: int, cloud: CloudPlan, edges: Sequence[EdgePlan]) -> None:
    """Raise BadInput unless both levels deal exactly the cameras 0..C-1, each to the same edge."""
    if len(cloud.edge_of_camera) != num_cameras:
        raise BadInput(f"the plan is of {len(cloud.edge_of_camera)} cameras, there are {num_cameras}: it was made from others, plan again.")
    if tuple(plan.edge_id for plan in edges) != cloud.edge_ids:
        raise BadInput(f"the plan has regions of {', '.join(cloud.edge_ids)} and deals cameras of other edges: plan again.")
    edge_of_camera = np.full(num_cameras, -1)
    for index, plan in enumerate(edges):
        if plan.camera_indices.max(initial=-1) >= num_cameras:
            raise BadInput(f"the plan of edge {plan.edge_id!r} deals camera {plan.camera_indices.max()} of {num_cameras}: plan again.")
        edge_of_camera[plan.camera_indices] = index
    wrong = np.flatnonzero(edge_of_camera != cloud.edge_of_camera)
    if len(wrong) or sum(len(plan.camera_indices) for plan in edges) != num_cameras:
        raise BadInput(f"the plan's two levels disagree about {len(wrong)} of {num_cameras} cameras: plan again.")
