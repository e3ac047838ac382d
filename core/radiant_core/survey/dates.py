"""The frame of one date brought onto another's by what did not change between them. Once per pair.

GPS gives the first guess. Points followed through renders of both models (`geometry.frame_matches`)
give the similarity, robustly (Geman–McClure): what changed is an outlier there. A plane through the
differences of the height rasters takes out what is left of height and tilt, robustly too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3, enu_change
from radiant_core.geometry.frame_matches import IDENTITY, find_overlap, match_models
from radiant_core.geometry.open3d_ops import surface_points
from radiant_core.geometry.pair_fit import PairFit, compose
from radiant_core.geometry.similarity import move_splats
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_core.survey.heights import HeightMap

MAX_SURFACE_SHARE = 0.03
"""Largest Gaussian of a surface, as a share of the extent of the cameras."""
NUM_ROUNDS, ROBUST_SIGMAS = 8, 2.0
MIN_CELLS = 100
_SIGMA_OF_MAD = 1.4826


@dataclass(frozen=True, kw_only=True, eq=False)
class DateFit:
    """Similarity older ← newer of two world frames, the shift that it takes out at the middle of
    the ground (3,), how many of the points followed agree, and what is left, the median distance of
    those."""

    older_from_newer: Sim3
    shift: FloatArray
    num_points: int
    num_followed: int
    residual: float


def fit_dates(older: tuple[Splats, Cameras, Frame], newer: tuple[Splats, Cameras, Frame]) -> DateFit:
    """The frame of a newer model on an older one's, each with cameras and frame.

    Raises BadInput where they share no ground or too little of it looks alike.
    """
    first = _by_gps(older[2], newer[2])
    splats, cameras = move_splats(newer[0], first), replace(newer[1], cam_from_world=first.apply_to_poses(newer[1].cam_from_world))
    surfaces = [surface_points(model, _largest(views))[0] for model, views in ((older[0], older[1]), (splats, cameras))]
    overlap = find_overlap(surfaces[0], older[1], surfaces[1], cameras)
    if overlap is None:
        raise BadInput("the two runs share no ground: their cameras do not see each other's surface; give two runs of one place.")
    fit = match_models(older[0], splats, overlap)
    if not isinstance(fit, PairFit):
        raise BadInput(f"the two runs cannot be aligned: {fit}; give two runs of one place, from like heights and in like light.")
    shift = fit.a_from_b.apply(fit.center[None])[0] - fit.center
    return DateFit(
        older_from_newer=compose(fit.a_from_b, first),
        shift=shift,
        num_points=fit.num_pairs,
        num_followed=fit.num_followed,
        residual=fit.residual_m,
    )


def levelled(older: HeightMap, newer: HeightMap) -> tuple[HeightMap, FloatArray]:
    """The newer heights without the plane that most of both rasters' common cells differ by, and
    that plane (3,): at the middle of the raster, and per unit east and north."""
    common = (older.source == 1) & (newer.source == 1)
    if common.sum() < MIN_CELLS:
        raise BadInput(
            f"the heights of both dates share {int(common.sum())} measured cells, too few to compare: give two runs of one place."
        )
    rows, columns = np.nonzero(common)
    cell, (height, width) = older.grid.cell, older.grid.shape
    design = _design(rows, columns, cell, (height, width))
    differences = (newer.heights - older.heights)[common]
    plane = np.array([np.median(differences), 0.0, 0.0])
    for _ in range(NUM_ROUNDS):
        residuals = differences - design @ plane
        scale = max(_SIGMA_OF_MAD * float(np.median(np.abs(residuals))), 1e-6)
        weights = 1 / np.square(1 + np.square(residuals / (ROBUST_SIGMAS * scale)))
        plane = np.linalg.lstsq(design * weights[:, None], differences * weights, rcond=None)[0]
    every = np.indices((height, width)).reshape(2, -1)
    whole = _design(every[0], every[1], cell, (height, width)) @ plane
    return replace(newer, heights=newer.heights - whole.reshape(height, width)), np.asarray(plane, np.float64)


def _design(rows: NDArray[np.int64], columns: NDArray[np.int64], cell: float, shape: tuple[int, int]) -> FloatArray:
    return np.column_stack([np.ones(len(rows)), cell * (columns - shape[1] / 2), -cell * (rows - shape[0] / 2)]).astype(np.float64)


def _by_gps(older: Frame, newer: Frame) -> Sim3:
    if older.kind != newer.kind:
        raise BadInput(f"one run is {older.kind} and the other {newer.kind}: both need GPS, or neither and one frame.")
    return enu_change(newer.origin_lat_lon_alt, older.origin_lat_lon_alt) if older.kind == "metric" else IDENTITY


def _largest(cameras: Cameras) -> float:
    return max(MAX_SURFACE_SHARE * float(np.linalg.norm(np.ptp(cameras.centers, axis=0))), 1e-6)
