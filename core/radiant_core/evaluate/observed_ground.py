"""How well places of the ground were observed. Once per plan, O(C · K).

    share of x = min(1, coverage(x) / median coverage of the scene's own points),   0 where fewer
    than `MIN_VIEWS` images show x, fewer than `MIN_POINTS` points lie near, or it is below
    `MIN_SHARE`

`coverage` sums the resolution of the images that show x (`geometry.coverage`). x stands at the
middle height of the `NUM_NEAREST` points around it; occlusion does not count. Where structure from
motion placed no points, no two images agreed on what stands there: a model's haze, about which no
statement is made. C cameras, K places, P points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from radiant_core.cameras import Cameras
from radiant_core.geometry.coverage import coverage
from radiant_core.numerics import FloatArray, check_array
from radiant_core.scene import SfmScene

MIN_VIEWS = 2
"""What one image alone shows has no depth."""
MIN_SHARE = 0.25
"""Where the images' resolution adds up to less than a quarter of what it usually does, the place
lies beside what was photographed."""
MIN_POINTS = 3
NUM_NEAREST, NUM_SAMPLED = 16, 1000


def observed_coverage(places_xy: ArrayLike, scene: SfmScene, reach: float) -> FloatArray:
    """Share (K,) of the usual coverage that each of the places (K,2) has, 0 to 1; 0 where it was
    not observed. `reach`: how near points must lie, in the frame's unit."""
    places_xy = check_array("places_xy", places_xy, (None, 2))
    if len(scene.points) < MIN_POINTS or not len(scene.cameras):
        return np.zeros(len(places_xy))
    sampled = scene.points[np.random.default_rng(0).permutation(len(scene.points))[:NUM_SAMPLED]]
    num_nearest = min(NUM_NEAREST, len(scene.points))
    distances, nearest = KDTree(scene.points[:, :2]).query(places_xy, num_nearest)
    heights = np.median(scene.points[:, 2][nearest], axis=1)
    covered, num_views = _coverage_and_views(np.column_stack([places_xy, heights]), scene.cameras)
    usual = float(np.median(coverage(sampled, scene.cameras)))
    shares = np.minimum(1.0, covered / usual) if usual > 0 else np.zeros(len(covered))
    observed = (num_views >= MIN_VIEWS) & (distances[:, MIN_POINTS - 1] <= reach) & (shares >= MIN_SHARE)
    return np.where(observed, shares, 0.0)


def _coverage_and_views(places: FloatArray, cameras: Cameras) -> tuple[FloatArray, FloatArray]:
    """Coverage (K,) of places (K,3), and by how many images each is shown (K,)."""
    covered, num_views = np.zeros(len(places)), np.zeros(len(places))
    for index in range(len(cameras)):
        camera_coverage = coverage(places, cameras.select(np.array([index])))
        covered += camera_coverage
        num_views += camera_coverage > 0
    return covered, num_views
