"""What cameras see of facets, and what is known of each by them. K facets, V views.

    gsd          z / f, the width of a pixel there
    J = I / σ0² + Σ over views of  cos θ · (f / z)² · (I − d dᵀ)      position information (3,3)

A photograph fixes a place across its ray d, to a pixel, and says nothing along it, so that one view
leaves J weak in one direction and views of one direction never mend it; θ is the angle between ray
and normal, by which a pixel covers more of the facet. σ0, what is known of a facet before any view,
is the cell. log det J is monotone and submodular in the set of views. Once per map, O(V K).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.evaluate.support import largest_angles_deg
from radiant_core.geometry.support import MIN_PARALLAX_DEG, MIN_VIEWS
from radiant_core.next_flight.facets import Facets, Rows
from radiant_core.numerics import FloatArray
from radiant_core.survey.map_grid import MapFrame
from radiant_core.threads import in_order, usual_threads

MIN_FACING = 0.17
"""Cosine of the largest angle, 80°, between a ray and the normal of a facet that counts as seen."""
_UPPER = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, kw_only=True, eq=False)
class Sighting:
    """What one camera sees: rows (R,) of facets, pixels (R,2), gsd (R,) in the map's unit, toward
    (R,3): unit vectors on the map from the facets to the camera, facing (R,): cosine with the
    normal."""

    rows: Rows
    pixels: NDArray[np.float32]
    gsd: NDArray[np.float32]
    toward: NDArray[np.float32]
    facing: NDArray[np.float32]

    def scaled(self, shares_wh: FloatArray) -> Sighting:
        """What the same camera sees in a picture of such shares (2,) of its width and height."""
        gsd = (self.gsd / shares_wh[0]).astype(np.float32)
        return replace(self, pixels=(self.pixels * shares_wh).astype(np.float32), gsd=gsd)

    def information(self) -> NDArray[np.float32]:
        """What it adds to J of its facets, the six numbers (R,6) of a symmetric matrix."""
        weight = self.facing / np.square(self.gsd)
        outer = np.stack([self.toward[:, i] * self.toward[:, j] for i, j in _UPPER], axis=1)
        return (weight[:, None] * (np.array([1, 1, 1, 0, 0, 0], np.float32) - outer)).astype(np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class Knowledge:
    """Of K facets: num_views (K,), parallax_deg (K,), gsd (K,) the finest, infinite where none sees
    it, information (K,6) of J."""

    num_views: NDArray[np.int64]
    parallax_deg: FloatArray
    gsd: FloatArray
    information: FloatArray

    @property
    def unseen(self) -> NDArray[np.bool_]:
        """Facets (K,) that no camera sees: holes."""
        return self.num_views == 0

    @property
    def weak(self) -> NDArray[np.bool_]:
        """Facets (K,) whose depth the views that see them do not fix."""
        return ~self.unseen & ((self.num_views < MIN_VIEWS) | (self.parallax_deg < MIN_PARALLAX_DEG))

    @property
    def score(self) -> FloatArray:
        """log det J (K,): the more, the better the place of a facet is fixed."""
        return log_det(self.information)


class Sights:
    """Looks at facets from cameras of the world: `map_frame` leads between world and map."""

    def __init__(self, facets: Facets, map_frame: MapFrame) -> None:
        self.facets = facets
        self.map_frame = map_frame
        self._world = np.ascontiguousarray(map_frame.to_world(facets.places).T)

    def _sighting(self, cameras: Cameras, index: int, eye: FloatArray) -> Sighting:
        """What camera `index` sees from eye (3,) on the map."""
        K, pose, size_wh = cameras.Ks[index], cameras.cam_from_world[index], cameras.sizes_wh[index]
        projection = K @ pose[:3]
        depths = projection[2, :3] @ self._world + projection[2, 3]
        front = np.flatnonzero(depths > 0)
        pixels = (projection[:2, :3] @ self._world[:, front] + projection[:2, 3:]) / depths[front]
        rows = front[((pixels > 0) & (pixels < size_wh[:, None])).all(axis=0)]
        toward = eye - self.facets.places[rows]
        toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-12)
        facing = (toward * self.facets.normals[rows]).sum(axis=1)
        is_faced = facing > MIN_FACING
        rows, toward, facing = rows[is_faced], toward[is_faced], facing[is_faced]
        visible = self.facets.seen_from(eye, rows)
        rows = rows[visible]
        pixels = (projection[:2, :3] @ self._world[:, rows] + projection[:2, 3:]) / depths[rows]
        return Sighting(
            rows=rows,
            pixels=pixels.T.astype(np.float32),
            gsd=(depths[rows] / K[0, 0]).astype(np.float32),
            toward=toward[visible].astype(np.float32),
            facing=facing[visible].astype(np.float32),
        )

    def all_of(self, cameras: Cameras, report: Callable[[int, int], None] = lambda num_done, total: None) -> tuple[Sighting, ...]:
        """What each camera sees; `report` hears how many are done."""
        sightings, eyes = list[Sighting](), self.map_frame.from_world(cameras.centers)
        for sighting in in_order(lambda index: self._sighting(cameras, index, eyes[index]), range(len(cameras)), usual_threads()):
            sightings.append(sighting)
            report(len(sightings), len(cameras))
        return tuple(sightings)


def known_by(sights: Sights, cameras: Cameras, sightings: Sequence[Sighting]) -> Knowledge:
    """What is known of each facet by cameras that saw `sightings`, one each."""
    facets = sights.facets
    count = len(facets)
    num_views, gsd, information = np.zeros(count, np.int64), np.full(count, np.inf), prior(count, facets.surface.grid.cell)
    for sighting in sightings:
        num_views[sighting.rows] += 1
        gsd[sighting.rows] = np.minimum(gsd[sighting.rows], sighting.gsd)
        information[sighting.rows] += sighting.information()
    centers = sights.map_frame.from_world(cameras.centers)
    parallax_deg = largest_angles_deg(facets.places, centers, [sighting.rows for sighting in sightings])
    return Knowledge(num_views=num_views, parallax_deg=parallax_deg, gsd=gsd, information=information)


def prior(count: int, cell: float) -> FloatArray:
    """J (K,6) before any view."""
    return np.tile(np.array([1, 1, 1, 0, 0, 0]) / cell**2, (count, 1))


def log_det(information: NDArray[np.floating]) -> FloatArray:
    """log det (K,) of symmetric matrices by their six numbers (K,6)."""
    a, b, c, d, e, f = np.asarray(information, np.float64).T
    return np.log(a * (b * c - f * f) - d * (d * c - e * f) + e * (d * f - e * b))
