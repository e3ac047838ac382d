"""Buffer captures: positions of a neighbouring region that a device takes as they see its own.

Without them an image near a border trains only the side its camera stands on. A position comes into
question for every other region into which it sees at least `min_share` of its footprint, or whose
border is at most `within_m` away (from where it looks, if the plan was cut by that); it goes to the
device of the nearest strip. Per edge those that see most come first, as many as fit into memory and
keep the edge within `deadline_s`:
    T = max_n T_n(own + extra) + F(own + extra) + Σ_n H_n(own + extra) / B
An edge whose devices are not known takes none. Once per plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.borders.borders import distance_outside_m
from radiant_core.plan.borders.footprints import RegionShares
from radiant_core.plan.counts.deadline import device_time_s
from radiant_core.plan.plans import CloudPlan, EdgePlan, require_plan_of
from radiant_core.plan.revision.captured import require_same_system
from radiant_core.plan.system import Edge, System


@dataclass(frozen=True, kw_only=True)
class BufferRule:
    """Which positions come into question. Raises BadInput unless exactly one of the first two is
    given, in its range."""

    min_share: float | None = None
    """Least share of the footprint inside the region, above 0 and at most 1."""
    within_m: float | None = None
    """Largest distance from the region, in metres."""
    deadline_s: float | None = None
    """An edge takes no more than keeps it within this time; None: what its memory holds."""

    def __post_init__(self) -> None:
        if (self.min_share is None) == (self.within_m is None):
            raise BadInput("buffer captures need one rule: a least share of the footprint, or a distance in metres.")
        if self.min_share is not None and not 0 < self.min_share <= 1:
            raise BadInput(f"the least share of a buffer capture is {self.min_share}, expected above 0 and at most 1.")
        for name, value in (("the distance", self.within_m), ("the deadline", self.deadline_s)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise BadInput(f"{name} of buffer captures is {value}, expected a positive number.")


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeBuffer:
    """What one edge takes besides its own: camera_indices (K,) of other regions, device_of_camera
    (K,), those that see most first; device_time_s (D,) and edge_time_s are predicted with them,
    planned_edge_time_s without; num_refused came into question and did not fit."""

    edge_id: str
    device_ids: tuple[str, ...]
    camera_indices: NDArray[np.int64]
    device_of_camera: NDArray[np.int64]
    device_time_s: FloatArray
    edge_time_s: float
    planned_edge_time_s: float
    num_refused: int

    def cameras_of(self, device_id: str) -> NDArray[np.int64]:
        """The extra cameras (K,) of one device."""
        return self.camera_indices[self.device_of_camera == self.device_ids.index(device_id)]


def plan_buffers(
    positions: ArrayLike, shares: RegionShares | None, cloud: CloudPlan, edges: Sequence[EdgePlan], system: System, rule: BufferRule
) -> tuple[EdgeBuffer, ...]:
    """One `EdgeBuffer` per edge for cameras (P,2) m; shares (P,E) as `region_shares`, needed for
    `min_share` alone. BadInput when positions, shares, plan and system do not belong together."""
    positions = cloud.places_of(check_array("positions", positions, (len(cloud.edge_of_camera), 2)))
    require_plan_of(len(positions), cloud, edges)
    require_same_system(edges, system)
    if rule.min_share is not None and (shares is None or (shares.num_images, shares.num_regions) != (len(positions), len(edges))):
        raise BadInput(f"shares of {len(positions)} footprints in {len(edges)} regions are needed: call region_shares of this plan.")
    buffers: list[EdgeBuffer] = []
    for index, (edge, plan) in enumerate(zip(system.edges, edges, strict=True)):
        border = cloud.borders[index]
        if len(border) < 3 or not edge.devices:
            candidates = np.zeros(0, np.int64)
        elif rule.within_m is not None:
            candidates = _near(positions, border, cloud.edge_of_camera != index, rule.within_m)
        else:
            assert shares is not None and rule.min_share is not None
            candidates = _seeing(shares, index, cloud.edge_of_camera, rule.min_share)
        buffers.append(_take(edge, plan, positions, candidates, rule.deadline_s, float(cloud.edge_time_s[index])))
    return tuple(buffers)


def _near(positions: FloatArray, border: FloatArray, others: NDArray[np.bool_], within_m: float) -> NDArray[np.int64]:
    """Cameras (K,) of other regions within that distance of a region, nearest first."""
    low, high = border.min(axis=0) - within_m, border.max(axis=0) + within_m
    rows = np.flatnonzero(others & (positions >= low).all(axis=1) & (positions <= high).all(axis=1))
    away_m = distance_outside_m(positions[rows], border)
    is_near = away_m <= within_m
    return rows[is_near][np.lexsort((rows[is_near], away_m[is_near]))]


def _seeing(shares: RegionShares, index: int, edge_of_camera: NDArray[np.int64], min_share: float) -> NDArray[np.int64]:
    """Cameras (K,) of other regions with at least that share of their footprint in a region, the
    largest share first."""
    rows, values = shares.of_region(index)
    sees_region = (values >= min_share) & (edge_of_camera[rows] != index)
    return rows[sees_region][np.lexsort((rows[sees_region], -values[sees_region]))]


def _take(
    edge: Edge, plan: EdgePlan, positions: FloatArray, candidates: NDArray[np.int64], deadline_s: float | None, planned_s: float
) -> EdgeBuffer:
    planned_counts = np.array([len(plan.cameras_of(device.id)) for device in edge.devices], dtype=np.int64)
    device_of, fits = _nearest_with_room(edge, plan, positions[candidates], planned_counts)
    chosen, device_of = candidates[fits], device_of[fits]

    def counts(num_taken: int) -> NDArray[np.int64]:
        return planned_counts + np.bincount(device_of[:num_taken], minlength=len(planned_counts))

    num_taken = len(chosen)
    if deadline_s is not None and _edge_time_s(edge, counts(num_taken)) > deadline_s:
        low, high = 0, num_taken  # Time never falls with cameras: the most that fit lie between.
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if _edge_time_s(edge, counts(middle)) <= deadline_s else (low, middle)
        num_taken = low
    final = counts(num_taken)
    return EdgeBuffer(
        edge_id=edge.id,
        device_ids=plan.device_ids,
        camera_indices=chosen[:num_taken],
        device_of_camera=device_of[:num_taken],
        device_time_s=np.array([float(device_time_s(d, n)) for d, n in zip(edge.devices, final.tolist(), strict=True)]),
        edge_time_s=_edge_time_s(edge, final) if num_taken else planned_s,
        planned_edge_time_s=planned_s,
        num_refused=len(candidates) - num_taken,
    )


def _nearest_with_room(
    edge: Edge, plan: EdgePlan, places: FloatArray, planned_counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Device (K,) whose strip is nearest to each place (K,2) among those that own land, and whether
    its memory still holds it."""
    device_of, fits = np.zeros(len(places), np.int64), np.zeros(len(places), bool)
    landed = [index for index, strip in enumerate(plan.strips) if len(strip) >= 3]
    if not landed or not len(places):
        return device_of, fits
    away_m = np.stack([distance_outside_m(places, plan.strips[index]) for index in landed])
    device_of = np.array(landed, np.int64)[away_m.argmin(axis=0)]
    for index in landed:
        limit = edge.devices[index].max_cameras
        nearest = np.flatnonzero(device_of == index)
        fits[nearest[: None if limit is None else max(0, limit - int(planned_counts[index]))]] = True
    return device_of, fits


def _edge_time_s(edge: Edge, counts: NDArray[np.int64]) -> float:
    total = int(counts.sum())
    slowest_s = max(float(device_time_s(d, n)) for d, n in zip(edge.devices, counts.tolist(), strict=True))
    sent_bytes = sum(float(d.model_bytes(n)) for d, n in zip(edge.devices, counts.tolist(), strict=True))
    return slowest_s + edge.aggregation_s(total, int((counts > 0).sum())) + sent_bytes / edge.uplink_bytes_per_s
