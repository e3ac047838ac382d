"""The box on the map that a flight saw, and how fine. Once per raster.

box = points of at least 3 photographs, within the cameras' box widened by the usual depth R,
      their 0.5 to 99.5 % along each axis
GSD = median over photographs of R / f, the width of a pixel on the ground
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.survey.map_grid import MapFrame, MapGrid

MIN_VIEWS = 3
QUANTILES = (0.005, 0.995)
MIN_POINTS = 20
MOST_CAMERAS = 64


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenGround:
    """low, high (2,): box on the map; hull (K,2): corners of the convex ground within; level: its
    median height; reach: the usual depth; gsd: the ground sampling distance of the undistorted
    photographs; all in the frame's unit."""

    hull: FloatArray
    low: FloatArray
    high: FloatArray
    level: float
    reach: float
    gsd: float

    def mask(self, grid: MapGrid) -> NDArray[np.bool_]:
        """Which cells (H,W) of a raster lie within the hull."""
        corners = np.rint(grid.cells_of(self.hull)[:, ::-1] - 0.5).astype(np.int32)
        return cv2.fillConvexPoly(np.zeros(grid.shape, np.uint8), corners, 1) > 0


def seen_ground(scene: SfmScene, map_frame: MapFrame) -> SeenGround:
    """The ground that the scene's photographs see; BadInput with fewer than 20 points that three
    of them share."""
    counts = np.bincount(scene.observations[:, 0], minlength=len(scene.points))
    # A COLMAP text model may come without tracks: then every point counts.
    counts = counts if len(scene.observations) else np.full(len(scene.points), MIN_VIEWS)
    centers = scene.cameras.centers
    reach = usual_depth(scene)
    near = ((scene.points >= centers.min(axis=0) - reach) & (scene.points <= centers.max(axis=0) + reach))[:, :2].all(axis=1)
    points = scene.points[near & (counts >= MIN_VIEWS)]
    if len(points) < MIN_POINTS:
        raise BadInput(
            f"{len(points)} points are shared by {MIN_VIEWS} photographs, at least {MIN_POINTS} are needed to say what ground was seen: "
            "add photographs that overlap."
        )
    places = map_frame.from_world(points)
    low, high = np.quantile(places[:, :2], QUANTILES, axis=0)
    inner = places[((places[:, :2] >= low) & (places[:, :2] <= high)).all(axis=1), :2]
    if len(inner) < MIN_POINTS or np.linalg.matrix_rank(inner - inner.mean(axis=0), tol=1e-6 * reach) < 2:
        raise BadInput("the points that photographs share lie on a line, so they span no ground: add photographs beside it.")
    hull = inner[ConvexHull(inner).vertices]
    gsd = reach / float(np.median(scene.cameras.Ks[:, 0, 0]))
    return SeenGround(hull=hull, low=low, high=high, level=float(np.median(points[:, 2])), reach=reach, gsd=gsd)


def usual_depth(scene: SfmScene) -> float:
    """Median over cameras of the median depth of the points in their pictures; 0 where none sees
    one."""
    chosen = np.unique(np.linspace(0, len(scene.cameras) - 1, MOST_CAMERAS).astype(np.int64)) if len(scene.cameras) else []
    depths = []
    for index in chosen:
        K, pose = scene.cameras.Ks[index], scene.cameras.cam_from_world[index]
        in_camera = scene.points @ pose[:3, :3].T + pose[:3, 3]
        front = in_camera[in_camera[:, 2] > 0]
        pixels = (front @ K.T)[:, :2] / front[:, 2:]
        inside = ((pixels > 0) & (pixels < scene.cameras.sizes_wh[index])).all(axis=1)
        depths += [float(np.median(front[inside, 2]))] if inside.any() else []
    return float(np.median(depths)) if depths else 0.0
