"""Captures from which no good model can come, named while the drone is still there. Once per scene.

only rotation   cameras spread over less than `LEAST_BASELINE` of the usual depth: no parallax
one line        their spread across the line is below `LEAST_ACROSS` of that along it: with GPS
                alone the scene may turn about the line
only down       all look within `DOWN_DEG` of straight down: walls, and the focal length, are weak
no overlap      groups of photographs that share fewer than `LEAST_SHARED` points with each other
exposure hunts  brightness at shared points goes up and down by more than `HUNTING_EV` stops from
                one photograph to the next, in more than `HUNTING_SHARE` of them
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene

LEAST_BASELINE = 0.03
"""Some 2° of parallax over the whole capture."""
LEAST_ACROSS = 0.02
DOWN_DEG = 12.0
LEAST_SHARED = 15
HUNTING_EV, HUNTING_SHARE = 0.3, 0.25
LEAST_POINTS = 8
"""Shared points that a difference of brightness rests on."""


@dataclass(frozen=True, kw_only=True)
class CaptureFault:
    """What is wrong, the figure that says so beside its limit, and what to fly instead."""

    name: str
    figure: float
    limit: float
    unit: str
    """Of both; of a share or a ratio too, in words."""
    advice: str

    @property
    def sentence(self) -> str:
        """As the report has it."""
        return f"{self.name} ({self.figure:.3g} {self.unit}, limit {self.limit:g}): {self.advice}."


def capture_faults(scene: SfmScene, depth: float, images: Sequence[NDArray[np.uint8]] | None = None) -> tuple[CaptureFault, ...]:
    """What is wrong with a capture of usual `depth`; images (H,W,3) in the order of the cameras, of
    any size, for their exposure."""
    if len(scene.cameras) < 2:
        return ()
    faults = [*_of_places(scene, depth), *_of_looks(scene), *_of_overlap(scene)]
    if images is not None:
        faults += _of_exposure(scene, images)
    return tuple(faults)


def _of_places(scene: SfmScene, depth: float) -> list[CaptureFault]:
    centers = scene.cameras.centers - scene.cameras.centers.mean(axis=0)
    spread = np.linalg.svd(centers, compute_uv=False) / np.sqrt(len(centers))
    baseline = float(2 * spread[0] / depth) if depth > 0 else np.inf
    if baseline < LEAST_BASELINE:
        advice = "photographs taken by turning on the spot have no depth; move between them by a tenth of the distance or more"
        return [CaptureFault(name="only rotation", figure=baseline, limit=LEAST_BASELINE, unit="of the usual depth", advice=advice)]
    across = float(spread[1] / spread[0]) if len(spread) > 1 else 0.0
    if across < LEAST_ACROSS and len(centers) > 2:
        advice = "fly a second line beside it, or one across it"
        return [CaptureFault(name="one line", figure=across, limit=LEAST_ACROSS, unit="of its length across it", advice=advice)]
    return []


def _of_looks(scene: SfmScene) -> list[CaptureFault]:
    down = np.clip(-scene.cameras.cam_from_world[:, 2, 2], -1, 1)
    widest_deg = float(np.degrees(np.arccos(down)).max())
    if widest_deg > DOWN_DEG:
        return []
    advice = "walls are not seen; add oblique views of 30 to 50 degrees from several sides"
    return [CaptureFault(name="only down", figure=widest_deg, limit=DOWN_DEG, unit="degrees", advice=advice)]


def _of_overlap(scene: SfmScene) -> list[CaptureFault]:
    shared = _shared_points(scene)
    if shared is None:
        return []
    count, group = connected_components(shared >= LEAST_SHARED, directed=False)
    sizes = np.sort(np.bincount(group))[::-1]
    if count < 2 or sizes[1] < 2:
        return []
    # The most that photographs of different groups share: what the limit was missed by.
    apart = group[:, None] != group[None]
    advice = f"groups of {', '.join(map(str, sizes.tolist()))} photographs hang together by too little; fly a line that both see"
    return [CaptureFault(name="no overlap", figure=float(shared[apart].max()), limit=LEAST_SHARED, unit="shared points", advice=advice)]


def _shared_points(scene: SfmScene) -> NDArray[np.int64] | None:
    """How many points each two cameras share (C,C); None without observations."""
    if not len(scene.observations):
        return None
    point, camera = scene.observations.T
    visibility = coo_array((np.ones(len(point), np.int64), (camera, point)), shape=(len(scene.cameras), len(scene.points))).tocsr()
    shared = np.asarray((visibility @ visibility.T).todense())
    np.fill_diagonal(shared, 0)
    return shared


def _of_exposure(scene: SfmScene, images: Sequence[NDArray[np.uint8]]) -> list[CaptureFault]:
    steps = _brightness_steps(scene, images)
    if len(steps) < 4:
        return []
    # Up and then down by as much: a slow drift, or a cloud, goes one way for long.
    turns = (np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])) > HUNTING_EV) & (steps[:-1] * steps[1:] < 0)
    share = float(turns.mean())
    if share <= HUNTING_SHARE:
        return []
    advice = "lock exposure and white balance before the next flight"
    return [CaptureFault(name="exposure hunts", figure=share, limit=HUNTING_SHARE, unit="of all photographs", advice=advice)]


def _brightness_steps(scene: SfmScene, images: Sequence[NDArray[np.uint8]]) -> FloatArray:
    """Stops by which each photograph is brighter than the one before, in the order of their names,
    at the points that both see; pairs that share too few are left out."""
    sizes = np.array([image.shape[1::-1] for image in images])
    factors = sizes / scene.cameras.sizes_wh
    order = sorted(range(len(images)), key=lambda row: scene.cameras.names[row])
    rows, pixels = scene.observed_pixels(scene.cameras)
    point, camera = scene.observations[rows].T
    seen = [_levels(images[view], point[camera == view], pixels[camera == view] * factors[view]) for view in range(len(images))]
    steps = []
    for before, after in pairwise(order):
        (points_before, levels_before), (points_after, levels_after) = seen[before], seen[after]
        both, rows_before, rows_after = np.intersect1d(points_before, points_after, assume_unique=True, return_indices=True)
        if len(both) >= LEAST_POINTS:
            steps.append(float(np.median(levels_after[rows_after] - levels_before[rows_before])))
    return np.array(steps)


def _levels(image: NDArray[np.uint8], points: NDArray[np.int64], pixels: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Which points (P,) one photograph shows, each once, and their brightness (P,) in stops."""
    points, first = np.unique(points, return_index=True)
    column, line = np.minimum(pixels[first].astype(np.int64), np.array(image.shape[1::-1]) - 1).T
    linear = (image[line, column].astype(np.float64) / 255).mean(axis=1) ** 2.2
    return points, np.log2(np.maximum(linear, 1e-4))
