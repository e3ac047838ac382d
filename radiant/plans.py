"""Plans: which machine makes which part of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant.scenes import Scene
from radiant_core.choices import PlanMethod
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions as plan_regions_of_edges
from radiant_core.plan.system import System


@dataclass(frozen=True, kw_only=True, eq=False)
class RegionPlan:
    """Regions of edges and strips of their devices, with the cameras (C) of each."""

    system: System
    """With every edge at its place."""
    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]

    def __repr__(self) -> str:
        dealt = ", ".join(f"{device} {len(self.cameras_of(device))}" for device in self.devices)
        return f"RegionPlan({len(self.edges)} edges, cameras: {dealt}; {self.makespan_s:.1f} s)"

    @property
    def devices(self) -> tuple[str, ...]:
        """Ids of all devices."""
        return tuple(device for edge in self.edges for device in edge.device_ids)

    @property
    def makespan_s(self) -> float:
        """Predicted seconds until the last edge is done."""
        return float(self.cloud.edge_time_s.max())

    def cameras_of(self, device: str) -> NDArray[np.int64]:
        """Rows (K,) of the planned cameras that a device gets; BadInput for an unknown device."""
        for edge in self.edges:
            if device in edge.device_ids:
                return edge.cameras_of(device)
        raise BadInput(f"there is no device {device!r} in the plan: use one of {', '.join(self.devices)}.")

    def strip_of(self, device: str) -> FloatArray:
        """The convex polygon (V,2) m of a device's part; empty (0,2) where it gets no camera."""
        for edge in self.edges:
            if device in edge.device_ids:
                return edge.strips[edge.device_ids.index(device)]
        raise BadInput(f"there is no device {device!r} in the plan: use one of {', '.join(self.devices)}.")


def plan_regions(cameras: Scene | ArrayLike, system: System, *, method: PlanMethod = "exact", seed: int = 0) -> RegionPlan:
    """Deal cameras to edges and their devices so that the last one ends as early as may be.

    Use it to see who would take and train what, before capture too; `run` plans by itself.

    Args:
        cameras: a scene, of which the training photographs count, or positions (C,2) m, such as
            waypoints before capture.
        system: machines, from `load_system` or `even_system`; costs are those of its file.
        method: exact, or one of the paper's and its rivals.
        seed: of the places of edges that have none; by default 0.

    Returns:
        The plan; rows count the training photographs of a scene (`scene.indices("training")`).

    Raises:
        BadInput: the machines cannot hold so many, or a position is not finite.

    Example:
        >>> waypoints = np.mgrid[0:60:10, 0:40:10].reshape(2, -1).T
        >>> plan = radiant.plan_regions(waypoints, radiant.even_system(1, 2))
        >>> [len(plan.cameras_of(device)) for device in plan.devices]
        [12, 12]
    """
    positions = cameras.cameras.centers[cameras.indices("training"), :2] if isinstance(cameras, Scene) else np.asarray(cameras, float)
    placed = place_edges(system, positions, None, seed)
    cloud = plan_regions_of_edges(positions, placed, method=method)
    if not isinstance(cloud, CloudPlan):
        raise BadInput(f"no plan fits: {cloud.reason}")
    return RegionPlan(system=placed, cloud=cloud, edges=split_edges(positions, cloud, placed))
