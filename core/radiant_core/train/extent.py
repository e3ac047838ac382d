"""The length in whose units centres move and Gaussians count as large. Once per training.

    min(E, k · D)      E 3DGS's extent of the cameras, D the distance at which they see the nearer
                       quarter of what is in their pictures: no sky

3DGS takes E, the size of the flight. One of 500 m at 50 m sees no coarser than one of 50 m, but
there centres would move ten times as far in a step: its model falls apart
(docs/experiments/paper_size.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.regimes import EXTENT, require
from radiant_core.splats import Splats

NUM_CAMERAS, NUM_PLACES, NEARER = 64, 20_000, 0.25
"""So many cameras and places, evenly chosen, are asked at most, for this share of what is seen."""


def camera_extent(cameras: Cameras) -> float:
    """1.1 × the largest distance of a camera from their mean (3DGS's extent), at least 1e-6."""
    centers = cameras.centers
    return max(1e-6, 1.1 * float(np.linalg.norm(centers - centers.mean(0), axis=1).max()))


def viewing_distance(cameras: Cameras, places: NDArray[np.floating]) -> float | None:
    """Median over cameras of the depth below which a quarter of the places (N,3) in their pictures
    lie; None where no picture has one."""
    depths, places = [], places[:: max(1, -(-len(places) // NUM_PLACES))].astype(np.float64)
    for index in np.unique(np.linspace(0, len(cameras) - 1, min(NUM_CAMERAS, len(cameras))).astype(np.int64)):
        pose, (width, height) = cameras.cam_from_world[index], cameras.sizes_wh[index]
        x, y, depth = cameras.Ks[index] @ (pose[:3, :3] @ places.T + pose[:3, 3:])
        inside = (depth > 0) & (x > 0) & (x < width * depth) & (y > 0) & (y < height * depth)
        if inside.any():
            depths.append(float(np.quantile(depth[inside], NEARER)))
    return float(np.median(depths)) if depths else None


def working_extent(cameras: Cameras, splats: Splats, per_distance: float | None) -> float:
    """The cameras' extent, at most `per_distance` times the distance at which they see Gaussians;
    None for no limit."""
    extent = camera_extent(cameras)
    if per_distance is None or (distance := viewing_distance(cameras, splats.means)) is None:
        return extent
    return max(1e-6, min(extent, per_distance * distance))


def extent_decision(cameras: Cameras, splats: Splats, per_distance: float | None) -> Decision:
    """In which unit the centres of a training move, as the report lists it."""
    case = require(EXTENT)
    flown, used = camera_extent(cameras), working_extent(cameras, splats, per_distance)
    return Decision(
        stage="train",
        topic="extent",
        choice=f"centres move in units of {used:.3g}" + (f" instead of {flown:.3g}" if used < flown else ""),
        figure=flown / used,
        unit="times as far would be a step in units of the cameras' extent",
        reason="as in 3DGS" if per_distance is None else f"{case.reason}: at most {per_distance:g} times the distance at which cameras see",
        row="" if per_distance is None else case.row,
        otherwise="--set train.max_extent_per_distance=none" if used < flown else "",
        changes_nothing=used == flown,
    )
