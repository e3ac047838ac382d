"""Pairs of one place in two models, by pictures that they render. Once per pair of neighbours.

Coarse, at the frames that GPS gives: both models are rendered at the same cameras, SIFT features
matched, lifted by the rendered depths and the similarity taken that most agree with. Fine: points
are followed through several cameras of each model and triangulated in each model by itself
(`model_views.py`). No photograph is read. Source of the features: Lowe, IJCV 60 (2004).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.model_views import MIN_ALPHA, Hub, ModelViews, Rays, corners, follow, hub_map, triangulate
from radiant_core.geometry.pair_fit import PairFit, PointPairs, consensus, fit_pairs
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats

MAX_COARSE_VIEWS = 8
FEW_COARSE_VIEWS = 3
"""Tried first: features cost most of a coarse match, and where so few views agree clearly, more
move nothing (docs/experiments/frames.md)."""
CLEARLY = 4
"""Times the agreement that is asked for otherwise."""
MAX_FINE_VIEWS = 14
MAX_PARTNERS = 5
MIN_VIEWS = 2
MIN_SEEN_SHARE = 0.05
MIN_KNOWING_CAMERAS = 3
KNOWN_WITHIN = 1.5
"""A camera resolves what it sees within this many times its model's median viewing distance;
beyond, pixels are too coarse to match."""
MIN_COMMON_PIXELS = 0.05
MAX_SAMPLES = 2000
NUM_FEATURES = 1500
RATIO = 0.85
NUM_CORNERS = 1000
MAX_GROUND_DISTANCES = 3.0
"""In median distances of Gaussians from the nearest camera; a sky stands at ten or more."""
COARSE_TOLERANCE = 0.03
"""Rendered depth and feature together, as a share of the distance to the camera."""
MIN_COARSE_PAIRS = 25
MIN_COARSE_SHARE = 0.03
"""Of two places that have nothing in common, at most 8 of 859 features agreed; of those with little
in common, 113 of 2,054."""
MIN_FINE_PAIRS = 25
MIN_FINE_SHARE = 0.25
MAX_DEPTH_ERROR = 0.1
"""Largest difference of rendered depths, as a share, that is not an occlusion."""
MAX_RMS_PX = 1.0
MAX_POINT_ERROR = 0.03
"""Standard deviation of a triangulated point, as a share of its distance: rays that hardly differ
in direction meet anywhere."""
_Matched = tuple[FloatArray, FloatArray, FloatArray]
IDENTITY = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlap:
    """The cameras of either model that see the other's surface, best first, and `share`: of what
    one model covers, by three cameras near enough, the other covers that much (the larger of both
    ways)."""

    a_cameras: Cameras
    b_cameras: Cameras
    share: float


def find_overlap(a_surface: FloatArray, a_cameras: Cameras, b_surface: FloatArray, b_cameras: Cameras) -> Overlap | None:
    """What models with surface points (N,3), (M,3) m in one frame have in common; None where under
    two cameras of either see the other."""
    a_points, b_points = _thin(a_surface), _thin(b_surface)
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
    a_covers, b_covers = _covers(a_cameras, a_sees, points, of_a), _covers(b_cameras, b_sees, points, ~of_a)
    share = float((a_covers & b_covers).sum()) / max(1.0, float(min(a_covers.sum(), b_covers.sum())))
    return Overlap(a_cameras=a_cameras.select(a_chosen), b_cameras=b_cameras.select(b_chosen), share=share)


def match_models(a: Splats, b: Splats, overlap: Overlap, seed: int = 0) -> PairFit | str:
    """The similarity a ← b of two models in nearly one frame, or a clause on why there is none."""
    a, b = without_background(a, overlap.a_cameras), without_background(b, overlap.b_cameras)
    coarse = coarse_match(a, b, overlap, seed)
    if isinstance(coarse, str):
        return coarse
    a_views = ModelViews.of(a, _first(overlap.a_cameras, MAX_FINE_VIEWS))
    b_views = ModelViews.of(b, _first(overlap.b_cameras, MAX_FINE_VIEWS))
    pairs = tracked_pairs(a_views, b_views, coarse)
    if len(pairs) < MIN_FINE_PAIRS:
        return f"only {len(pairs)} points could be followed through cameras of both"
    try:
        fitted = fit_pairs(pairs, coarse)
    except BadInput as error:
        return str(error).rstrip(".")
    if fitted.num_pairs < max(MIN_FINE_PAIRS, MIN_FINE_SHARE * len(pairs)):
        return f"only {fitted.num_pairs} of {len(pairs)} points that were followed agree with one similarity"
    return fitted


def without_background(splats: Splats, cameras: Cameras) -> Splats:
    """The Gaussians near enough to the cameras to be the ground: a sky behind it would bend the
    mean depth of every pixel through which a hundredth of it shines."""
    distances = KDTree(cameras.centers).query(splats.means)[0]
    return splats.select(distances <= MAX_GROUND_DISTANCES * np.median(distances))


def coarse_match(a: Splats, b: Splats, overlap: Overlap, seed: int) -> Sim3 | str:
    """The similarity a ← b that most features agree with, good to decimetres, or why there is none.

    First both are rendered at the same cameras, where features look alike, a few of them and then
    all; then each at its own, which finds what lies far from its GPS.
    """
    reason = ""
    has_more = max(len(overlap.a_cameras), len(overlap.b_cameras)) > FEW_COARSE_VIEWS
    few = [(FEW_COARSE_VIEWS, True)] if has_more else []
    for num_views, together in (*few, (MAX_COARSE_VIEWS, True), (MAX_COARSE_VIEWS, False)):
        matches = _at_common_cameras(a, b, overlap, num_views) if together else _at_own_cameras(a, b, overlap)
        if not matches:
            reason = reason or "no view shows features of both"
            continue
        a_points, b_points, tolerances = (np.concatenate(parts) for parts in zip(*matches, strict=True))
        best = consensus(a_points, b_points, tolerances, seed)
        agreeing = 0 if best is None else int(best[1].sum())
        times = CLEARLY if num_views == FEW_COARSE_VIEWS else 1
        if best is not None and agreeing >= times * max(MIN_COARSE_PAIRS, MIN_COARSE_SHARE * len(a_points)):
            return best[0]
        reason = f"only {agreeing} of {len(a_points)} matched features of their renders agree with one similarity"
    return reason


def _at_common_cameras(a: Splats, b: Splats, overlap: Overlap, num_views: int) -> list[_Matched]:
    matches = []
    for of_one in (overlap.a_cameras, overlap.b_cameras):
        cameras = _first(of_one, num_views)
        of_a, of_b = ModelViews.of(a, cameras), ModelViews.of(b, cameras)
        for index in range(len(cameras)):
            both_visible = (of_a.views[index].alpha > MIN_ALPHA) & (of_b.views[index].alpha > MIN_ALPHA)
            if both_visible.mean() >= MIN_COMMON_PIXELS:
                matches.append(_match_features(_features(of_a, index), _features(of_b, index)))
    return matches


def _at_own_cameras(a: Splats, b: Splats, overlap: Overlap) -> list[_Matched]:
    sides = ((a, overlap.a_cameras), (b, overlap.b_cameras))
    views = [ModelViews.of(model, _first(cameras, MAX_COARSE_VIEWS)) for model, cameras in sides]
    features = [[_features(of_one, index) for index in range(len(of_one.cameras))] for of_one in views]
    # `consensus` requires a share of all pairs, which views without a common place would dilute.
    matched = [_match_features(first, second) for first in features[0] for second in features[1]]
    return sorted(matched, key=lambda pairs: -len(pairs[0]))[: 2 * MAX_COARSE_VIEWS]


def _first(cameras: Cameras, count: int) -> Cameras:
    return cameras.select(np.arange(min(count, len(cameras))))


def tracked_pairs(a: ModelViews, b: ModelViews, a_from_b: Sim3) -> PointPairs:
    """P points followed through cameras of both models and triangulated in each one's frame."""
    parts = [_track_from(a, index, b, a_from_b.inverse()) for index in range(len(a.cameras))]
    for index in range(len(b.cameras)):
        there = _track_from(b, index, a, a_from_b)
        parts.append((there[2], there[3], there[0], there[1]))
    arrays = [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]
    return PointPairs(a=arrays[0], a_covariances=arrays[1], b=arrays[2], b_covariances=arrays[3])


def _track_from(
    hub_views: ModelViews, index: int, other_views: ModelViews, other_from_hub: Sim3
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Points (P,3) and covariances in the hub's model, then in the other, from one hub view."""
    nothing = np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))
    pixels = corners(hub_views, index, NUM_CORNERS)
    if not len(pixels):
        return nothing
    grid, grid_shape = hub_map(hub_views, index)
    hub = Hub(views=hub_views, index=index, pixels=pixels, grid=grid, grid_shape=grid_shape)
    center = hub_views.cameras.centers[index]
    across = {
        j: follow(hub, other_views, j, other_from_hub, MAX_DEPTH_ERROR)
        for j in _nearest(other_views.cameras, other_from_hub.apply(center[None])[0])
    }
    is_tracked = sum((good.astype(np.int64) for _, good in across.values()), np.zeros(len(pixels), np.int64)) >= 2
    if not is_tracked.any():
        return nothing
    within = {
        j: follow(hub, hub_views, j, IDENTITY, MAX_DEPTH_ERROR, is_tracked)
        for j in _nearest(hub_views.cameras, center, MAX_PARTNERS + 1)
        if j != index
    }
    is_tracked &= sum((good.astype(np.int64) for _, good in within.values()), np.zeros(len(pixels), np.int64)) >= 1
    if not is_tracked.any():
        return nothing
    within[index] = pixels, np.ones(len(pixels), bool)
    start = hub_views.lift(index, pixels[is_tracked])[0]
    here, here_covariances, here_px = triangulate(hub_views.cameras, _rays(within, is_tracked), start)
    there, there_covariances, there_px = triangulate(other_views.cameras, _rays(across, is_tracked), other_from_hub.apply(start))
    good = (here_px < MAX_RMS_PX) & (there_px < MAX_RMS_PX)
    limits = MAX_POINT_ERROR * np.linalg.norm(here - center, axis=1)
    good &= _deviations(here_covariances) < limits
    good &= _deviations(there_covariances) < other_from_hub.scale * limits
    return here[good], here_covariances[good], there[good], there_covariances[good]


def _deviations(covariances: FloatArray) -> FloatArray:
    """Standard deviations (P,) along the axis known worst of covariances (P,3,3)."""
    return np.sqrt(np.linalg.eigvalsh(covariances)[:, -1])


def _rays(followed: dict[int, tuple[FloatArray, NDArray[np.bool_]]], is_tracked: NDArray[np.bool_]) -> Rays:
    """All that was found of the kept points, counted among them."""
    new_index = np.cumsum(is_tracked) - 1
    chosen = {j: good & is_tracked for j, (_, good) in followed.items()}
    cameras = np.concatenate([np.full(int(good.sum()), j) for j, good in chosen.items()])
    points = np.concatenate([new_index[good] for good in chosen.values()])
    return Rays(cameras=cameras, points=points, pixels=np.concatenate([followed[j][0][good] for j, good in chosen.items()]))


def _nearest(cameras: Cameras, center: FloatArray, count: int = MAX_PARTNERS) -> list[int]:
    return np.argsort(np.linalg.norm(cameras.centers - center, axis=1), kind="stable")[:count].tolist()


def _features(views: ModelViews, index: int) -> tuple[FloatArray, FloatArray, NDArray[np.float32]]:
    """Points (P,3) at the rendered depth, tolerances (P,) m, descriptors (P,128) of one view."""
    sift = cv2.SIFT.create(nfeatures=NUM_FEATURES, contrastThreshold=0.01)
    keypoints, descriptors = sift.detectAndCompute(views.grey[index], _erode(views.views[index].alpha > MIN_ALPHA))
    if descriptors is None:
        return np.zeros((0, 3)), np.zeros(0), np.zeros((0, 128), np.float32)
    points, depths = views.lift(index, np.array([keypoint.pt for keypoint in keypoints]) + 0.5)
    there = depths > 0
    return points[there], COARSE_TOLERANCE * depths[there], np.asarray(descriptors, np.float32)[there]


def _match_features(a: tuple, b: tuple) -> _Matched:
    """Points (P,3) of a, of b and tolerances (P,) m of features with one clearly best match."""
    if len(a[0]) < 2 or len(b[0]) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    candidates = cv2.BFMatcher().knnMatch(a[2], b[2], k=2)
    chosen = [pair[0] for pair in candidates if len(pair) == 2 and pair[0].distance < RATIO * pair[1].distance]
    a_rows, b_rows = np.array([match.queryIdx for match in chosen], np.int64), np.array([match.trainIdx for match in chosen], np.int64)
    return a[0][a_rows], b[0][b_rows], a[1][a_rows]


def _erode(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return cv2.erode(mask.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(np.uint8)


def _thin(points: FloatArray) -> FloatArray:
    return points[:: max(1, -(-len(points) // MAX_SAMPLES))]


def _sees(cameras: Cameras, points: FloatArray) -> NDArray[np.bool_]:
    """Whether each of the C cameras sees each of the points (P,3): (C,P)."""
    return np.array([cameras.select([index]).any_sees(points) for index in range(len(cameras))]).reshape(len(cameras), len(points))


def _covers(cameras: Cameras, sees: NDArray[np.bool_], points: FloatArray, of_model: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which points (P,) at least three cameras see from near enough, measured by how far they are
    from its points `of_model`."""
    distances = np.linalg.norm(points[None] - cameras.centers[:, None], axis=2)
    seen_points = sees & of_model
    if not seen_points.any():
        return np.zeros(len(points), bool)
    limit = KNOWN_WITHIN * float(np.median([np.median(row[mask]) for row, mask in zip(distances, seen_points, strict=True) if mask.any()]))
    return (sees & (distances < limit)).sum(axis=0) >= MIN_KNOWING_CAMERAS
