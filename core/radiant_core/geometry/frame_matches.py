"""Pairs of one place in two models, found in pictures that the models render; no photograph is read. Once per pair of neighbours.

Coarse, at the frames that GPS gives: both models are rendered at the same cameras, SIFT features matched, lifted by the rendered depths
and the similarity taken that most agree with. Fine, twice: points are followed through several cameras of each model and triangulated in
each model by itself (`model_views.py`). Source of the features: Lowe, IJCV 60 (2004).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.model_views import MIN_ALPHA, Hub, ModelViews, corners, follow, hub_map, triangulate
from radiant_core.geometry.pair_fit import PairFit, PointPairs, consensus, fit_pairs
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats

MAX_COARSE_VIEWS = 8
MAX_FINE_VIEWS = 14
MAX_PARTNERS = 5
MIN_VIEWS = 2
MIN_SEEN_SHARE = 0.05
MIN_KNOWING_CAMERAS = 3
KNOWN_WITHIN = 1.5
"""A camera knows what it sees within this many times its model's median viewing distance; beyond, pixels are too coarse to match."""
MIN_COMMON_PIXELS = 0.05
MAX_SAMPLES = 2000
NUM_FEATURES = 1500
RATIO = 0.85
NUM_CORNERS = 250
COARSE_TOLERANCE = 0.03
"""Rendered depth and feature together, as a share of the distance to the camera."""
MIN_COARSE_PAIRS = 25
MIN_COARSE_SHARE = 0.08
MIN_FINE_PAIRS = 25
MAX_DEPTH_ERRORS = (0.1, 0.05)
"""Largest difference of rendered depths that is not an occlusion, in both fine rounds."""
MAX_RMS_PX = 1.0
IDENTITY = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlap:
    """The cameras of either model that see the other's surface, best first, and `share`: of what one model knows, by three cameras near
    enough, the other knows that much (the larger of both ways)."""

    a_cameras: Cameras
    b_cameras: Cameras
    share: float


def find_overlap(a_surface: FloatArray, a_cameras: Cameras, b_surface: FloatArray, b_cameras: Cameras) -> Overlap | None:
    """What models with surface points (N,3), (M,3) m in one frame have in common; None where under two cameras of either see the other."""
    a_points, b_points = _thinned(a_surface), _thinned(b_surface)
    if not (len(a_points) and len(b_points) and len(a_cameras) and len(b_cameras)):
        return None
    points = np.concatenate([a_points, b_points])
    of_a = np.arange(len(points)) < len(a_points)
    a_sees, b_sees = _sees(a_cameras, points), _sees(b_cameras, points)
    a_counts, b_counts = a_sees[:, ~of_a].sum(axis=1), b_sees[:, of_a].sum(axis=1)
    a_chosen = np.argsort(-a_counts, kind="stable")[: int((a_counts >= MIN_SEEN_SHARE * len(b_points)).sum())]
    b_chosen = np.argsort(-b_counts, kind="stable")[: int((b_counts >= MIN_SEEN_SHARE * len(a_points)).sum())]
    if min(len(a_chosen), len(b_chosen)) < MIN_VIEWS:
        return None
    a_knows, b_knows = _knows(a_cameras, a_sees, points, of_a), _knows(b_cameras, b_sees, points, ~of_a)
    share = float((a_knows & b_knows).sum()) / max(1.0, float(min(a_knows.sum(), b_knows.sum())))
    return Overlap(a_cameras=a_cameras.select(a_chosen), b_cameras=b_cameras.select(b_chosen), share=share)


def match_models(a: Splats, b: Splats, overlap: Overlap, seed: int) -> PairFit | str:
    """The similarity a ← b of two models in nearly one frame, or one clause that says why none was found."""
    coarse = coarse_match(a, b, overlap, seed)
    if isinstance(coarse, str):
        return coarse
    a_views = ModelViews.of(a, overlap.a_cameras.select(np.arange(min(MAX_FINE_VIEWS, len(overlap.a_cameras)))))
    b_views = ModelViews.of(b, overlap.b_cameras.select(np.arange(min(MAX_FINE_VIEWS, len(overlap.b_cameras)))))
    a_from_b, fitted = coarse, None
    for max_depth_error in MAX_DEPTH_ERRORS:
        pairs = tracked_pairs(a_views, b_views, a_from_b, max_depth_error)
        if len(pairs) < MIN_FINE_PAIRS:
            return f"only {len(pairs)} points could be followed through cameras of both"
        try:
            fitted = fit_pairs(pairs, a_from_b)
        except BadInput as error:
            return str(error).rstrip(".")
        if fitted.num_pairs < max(MIN_FINE_PAIRS, 0.25 * len(pairs)):
            return f"only {fitted.num_pairs} of {len(pairs)} points that were followed agree with one similarity"
        a_from_b = fitted.a_from_b
    assert fitted is not None
    return fitted


def coarse_match(a: Splats, b: Splats, overlap: Overlap, seed: int) -> Sim3 | str:
    """The similarity a ← b that most features of common renders agree with, good to a few decimetres, or why there is none."""
    found: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    for cameras in (overlap.a_cameras, overlap.b_cameras):
        cameras = cameras.select(np.arange(min(MAX_COARSE_VIEWS, len(cameras))))
        of_a, of_b = ModelViews.of(a, cameras), ModelViews.of(b, cameras)
        found += [pairs for index in range(len(cameras)) if (pairs := _feature_pairs(of_a, of_b, index)) is not None]
    if not found:
        return "no view shows features of both"
    a_points, b_points, tolerances = (np.concatenate(parts) for parts in zip(*found, strict=True))
    best = consensus(a_points, b_points, tolerances, seed)
    agreeing = 0 if best is None else int(best[1].sum())
    if best is None or agreeing < max(MIN_COARSE_PAIRS, MIN_COARSE_SHARE * len(a_points)):
        return f"only {agreeing} of {len(a_points)} matched features of their renders agree with one similarity"
    return best[0]


def tracked_pairs(a: ModelViews, b: ModelViews, a_from_b: Sim3, max_depth_error: float) -> PointPairs:
    """Points followed through cameras of both models and triangulated in each; P pairs, each in its own model's frame."""
    parts = []
    for index in range(len(a.cameras)):
        parts.append(_tracked_from(a, index, b, a_from_b.inverse(), max_depth_error))
    for index in range(len(b.cameras)):
        there = _tracked_from(b, index, a, a_from_b, max_depth_error)
        parts.append((there[2], there[3], there[0], there[1]))
    arrays = [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
    return PointPairs(a=arrays[0], a_covariances=arrays[1], b=arrays[2], b_covariances=arrays[3])


def _tracked_from(hub_views: ModelViews, index: int, other: ModelViews, other_from_hub: Sim3, max_depth_error: float):  # noqa: ANN202
    """Points (P,3) and covariances in the hub's model, then in the other, from one hub view."""
    nothing = np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))
    pixels = corners(hub_views, index, NUM_CORNERS)
    if not len(pixels):
        return nothing
    grid, grid_shape = hub_map(hub_views, index)
    hub = Hub(views=hub_views, index=index, pixels=pixels, grid=grid, grid_shape=grid_shape)
    center = hub_views.cameras.centers[index]
    across = {
        j: follow(hub, other, j, other_from_hub, max_depth_error) for j in _nearest(other.cameras, other_from_hub.apply(center[None])[0])
    }
    kept = sum(good.astype(np.int64) for _, good in across.values()) >= 2
    if not kept.any():
        return nothing
    own = {
        j: follow(hub, hub_views, j, IDENTITY, MAX_DEPTH_ERRORS[-1])
        for j in _nearest(hub_views.cameras, center, MAX_PARTNERS + 1)
        if j != index
    }
    kept &= sum((good.astype(np.int64) for _, good in own.values()), np.zeros(len(pixels), np.int64)) >= 1
    if not kept.any():
        return nothing
    own[index] = pixels, np.ones(len(pixels), bool)
    start = hub_views.lift(index, pixels[kept])[0]
    here, here_covariances, here_px = triangulate(hub_views.cameras, *_rays(own, kept), start)
    there, there_covariances, there_px = triangulate(other.cameras, *_rays(across, kept), other_from_hub.apply(start))
    good = (here_px < MAX_RMS_PX) & (there_px < MAX_RMS_PX)
    return here[good], here_covariances[good], there[good], there_covariances[good]


def _rays(followed: dict[int, tuple[FloatArray, NDArray[np.bool_]]], kept: NDArray[np.bool_]):  # noqa: ANN202 - camera, point, pixel
    """Camera index (O,), point index (O,) among the kept, pixel (O,2) of all that was found."""
    new_index = np.cumsum(kept) - 1
    chosen = {j: good & kept for j, (_, good) in followed.items()}
    cameras = np.concatenate([np.full(int(good.sum()), j) for j, good in chosen.items()])
    points = np.concatenate([new_index[good] for good in chosen.values()])
    return cameras, points, np.concatenate([followed[j][0][good] for j, good in chosen.items()])


def _nearest(cameras: Cameras, center: FloatArray, count: int = MAX_PARTNERS) -> list[int]:
    return np.argsort(np.linalg.norm(cameras.centers - center, axis=1), kind="stable")[:count].tolist()


def _feature_pairs(a: ModelViews, b: ModelViews, index: int) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Points (P,3) of a and of b that look alike in one view, and tolerances (P,) m; None where the view shows too little of both."""
    known = [views.views[index].alpha > MIN_ALPHA for views in (a, b)]
    if (known[0] & known[1]).mean() < MIN_COMMON_PIXELS:
        return None
    sift = cv2.SIFT_create(nfeatures=NUM_FEATURES, contrastThreshold=0.01)
    described = [sift.detectAndCompute(views.grey[index], _eroded(mask)) for views, mask in zip((a, b), known, strict=True)]
    if min(len(keypoints) for keypoints, _ in described) < 3:
        return None
    candidates = cv2.BFMatcher().knnMatch(described[0][1], described[1][1], k=2)
    chosen = [pair[0] for pair in candidates if len(pair) == 2 and pair[0].distance < RATIO * pair[1].distance]
    if not chosen:
        return None
    a_pixels = np.array([described[0][0][match.queryIdx].pt for match in chosen]) + 0.5
    b_pixels = np.array([described[1][0][match.trainIdx].pt for match in chosen]) + 0.5
    a_points, a_depths = a.lift(index, a_pixels)
    b_points, b_depths = b.lift(index, b_pixels)
    there = (a_depths > 0) & (b_depths > 0)
    return a_points[there], b_points[there], COARSE_TOLERANCE * a_depths[there]


def _eroded(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return cv2.erode(mask.astype(np.uint8), np.ones((9, 9), np.uint8))


def _thinned(points: FloatArray) -> FloatArray:
    return points[:: max(1, -(-len(points) // MAX_SAMPLES))]


def _sees(cameras: Cameras, points: FloatArray) -> NDArray[np.bool_]:
    """Whether each of the C cameras sees each of the points (P,3): (C,P)."""
    return np.array([cameras.select([index]).any_sees(points) for index in range(len(cameras))]).reshape(len(cameras), len(points))


def _knows(cameras: Cameras, sees: NDArray[np.bool_], points: FloatArray, own: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which points (P,) at least three cameras see from near enough, measured by how far they are from the model's `own` points."""
    distances = np.linalg.norm(points[None] - cameras.centers[:, None], axis=2)
    seen_own = sees & own
    if not seen_own.any():
        return np.zeros(len(points), bool)
    limit = KNOWN_WITHIN * float(np.median([np.median(row[seen]) for row, seen in zip(distances, seen_own, strict=True) if seen.any()]))
    return (sees & (distances < limit)).sum(axis=0) >= MIN_KNOWING_CAMERAS
