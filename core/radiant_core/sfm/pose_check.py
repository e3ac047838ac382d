"""Whether an alignment fits its photographs, before anything is made from it. Once per source.

    observations   |lens(R X + t) − pixel|  of what the file says that its photographs see
    points         share of them that fall into two photographs, in front; their colours there
    matches        without observations or colours: distance of SIFT matches of a few pairs from
                   their epipolar lines, d = |x₂ᵀ E x₁| / √(‖(E x₁)₁₂‖² + ‖(Eᵀ x₂)₁₂‖²) · f
                   (Sampson, 1982)

Each is compared with what another reading of the same numbers gives (radial coefficients of the
other sign, p₁ and p₂ exchanged, poses the other way round, axes of another library): where one of
those fits clearly better, the sentence names it. What a check cannot see it lets pass: half a pixel
of the principal point moves matches by less than their noise (docs/begun_elsewhere.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import load_thumbnail
from radiant_core.io.poses.lens import Lens
from radiant_core.io.poses.pose_file import PosedView, PoseFile
from radiant_core.numerics import FloatArray

COMPARED_PX = 1600
LEAST_LIMIT_PX, LIMIT_SHARE = 2.0, 1 / 800
"""A median beyond 2 px, or 1/800 of the long side, is no alignment of these photographs: adjusted
ones are within half of a pixel to one."""
CLEARLY, CLEARLY_PX = 0.75, 0.1
"""Another reading is taken for the right one where it leaves so small a share of the error, and so
many px less."""
MIN_INSIDE = 0.5
MIN_IN_FRONT = 0.7
MAX_COLOUR_RATIO = 0.95
"""Mean difference of colours over that with points exchanged at random, which is 1 by chance."""
MAX_PAIRS, MAX_TRIES = 6, 24
MIN_MATCHES = 25
MAX_POINTS, MAX_VIEWS = 4_000, 12
NUM_FEATURES = 3_000
MATCH_RATIO = 0.75
CELLS_ACROSS = 64
LEAST_Z = 0.05

Poses = Callable[[FloatArray], FloatArray]
Lenses = Callable[[Lens], Lens]
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Another way to read the same numbers."""

    says: str
    pose: Poses = lambda pose: pose
    lens: Lenses = lambda lens: lens


def _transposed(pose: FloatArray) -> FloatArray:
    inverse = np.eye(4)
    inverse[:3, :3], inverse[:3, 3] = pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3]
    return inverse


def _center_for_translation(pose: FloatArray) -> FloatArray:
    moved = pose.copy()
    moved[:3, 3] = -pose[:3, :3] @ pose[:3, 3]
    return moved


def _translation_for_center(pose: FloatArray) -> FloatArray:
    moved = pose.copy()
    moved[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return moved


def _shifted(lens: Lens, shift_px: float) -> Lens:
    return replace(lens, cx=lens.cx + shift_px, cy=lens.cy + shift_px)


POSE_READINGS = (
    Reading(says="poses that lead from the camera to the world, not to it", pose=_transposed),
    Reading(says="camera axes with y up and z back", pose=lambda pose: FLIP @ pose),
    Reading(says="camera axes with y up and z back, from the camera to the world", pose=lambda pose: FLIP @ _transposed(pose)),
    Reading(says="a centre that stands where the translation is expected", pose=_center_for_translation),
    Reading(says="a translation that stands where the centre is expected", pose=_translation_for_center),
)
LENS_READINGS = (
    Reading(
        says="radial coefficients of the other sign",
        lens=lambda lens: replace(lens, k=(-lens.k[0], -lens.k[1], -lens.k[2], -lens.k[3])),
    ),
    Reading(says="p1 and p2 exchanged", lens=lambda lens: replace(lens, p1=lens.p2, p2=lens.p1)),
    Reading(says="a principal point that counts from half a pixel before", lens=lambda lens: _shifted(lens, 0.5)),
    Reading(says="a principal point that counts from half a pixel behind", lens=lambda lens: _shifted(lens, -0.5)),
)
UNCHECKED = "no pair of photographs could be matched, and the file does not say what they see: the poses are not checked"
AS_READ = Reading(says="as it was read")
Errors = Callable[[Reading], FloatArray]
"""Distances (N,) px under a reading; NaN where it puts a point nowhere."""


def check_poses(project: PoseFile, photos: Path, *, rough: bool = False) -> Decision:
    """The figure by which an alignment, named by the photographs in `photos`, is taken; BadInput
    with the figure where it does not fit them. `rough`: what is wrong by pixels is adjusted, so
    that only other readings are refused."""
    limit_px = max(LEAST_LIMIT_PX, LIMIT_SHARE * max(max(lens.size_wh) for lens in project.lenses.values()))
    _require_inside(project)
    thumbnails, num_seen = _Thumbnails(project=project, photos=photos), project.num_seen
    decision = None
    if num_seen:
        figure = _require_small(project, lambda reading: _reprojection_px(project, reading), ("points", limit_px, rough))
        decision = _decision(project, figure, "px", f"median distance of {num_seen} observed points from where the poses put them")
    # Observations without colours say nothing of the photographs.
    if decision is None or project.colors is None:
        decision = decision or _decision(project, 0.0, "matched pairs", UNCHECKED)
        pairs = tuple(_matched_pairs(project, thumbnails))
        if pairs:
            figure = _require_small(project, lambda reading: _epipolar_px(pairs, reading), ("matched points", limit_px, rough))
            _require_in_front(project, pairs)
            count = sum(len(pair.pixels[0]) for pair in pairs)
            reason = f"median distance of {count} matches in {len(pairs)} pairs from their epipolar lines"
            decision = _decision(project, figure, "px", reason)
    if not rough:
        _require_colours(project, thumbnails)
    return decision


def _decision(project: PoseFile, figure: float, unit: str, reason: str) -> Decision:
    return Decision(stage="sfm", topic="poses", choice=f"those of {project.title}", figure=figure, unit=unit, reason=reason)


def _require_small(project: PoseFile, errors_of: Errors, limits: tuple[str, float, bool]) -> float:
    """The median error as it was read; BadInput where it is too large, or another reading has
    less."""
    noun, limit_px, rough = limits
    as_read = errors_of(AS_READ)
    median_px = _median(as_read)
    readings = (*LENS_READINGS, *(POSE_READINGS if median_px > limit_px else ()))
    others = [(_median(errors_of(reading)), reading) for reading in readings if _matters(project, reading)]
    best_px, best = min(others, key=lambda pair: pair[0], default=(np.inf, AS_READ))
    wins = best_px < CLEARLY * median_px and best_px < median_px - CLEARLY_PX and (median_px <= limit_px or best_px <= limit_px)
    if wins:
        raise BadInput(
            f"{project.title} does not fit its photographs: {noun} lie {_px(median_px)} from where poses and lenses put them (median of "
            f"{len(as_read)}), and {_px(best_px)} if it has {best.says}: export it again in the form that docs/begun_elsewhere.md names."
        )
    if median_px > limit_px and not rough:
        raise BadInput(
            f"{project.title} does not fit its photographs: {noun} lie {_px(median_px)} from where poses and lenses put them (median of "
            f"{len(as_read)}), expected at most {limit_px:.1f} px: give the photographs that it was made from, let --refine-poses adjust "
            "rough poses, or --poses none place the photographs anew."
        )
    return median_px


def _px(value: float) -> str:
    return f"{value:.2f} px" if np.isfinite(value) else "nowhere near"


def _matters(project: PoseFile, reading: Reading) -> bool:
    """Whether a reading differs for any lens or pose."""
    return reading in POSE_READINGS or any(reading.lens(lens) != lens for lens in project.lenses.values())


def _median(errors_px: FloatArray) -> float:
    """The median, with what is nowhere beyond all others."""
    if not len(errors_px):
        return float("inf")
    return float(np.median(np.where(np.isfinite(errors_px), errors_px, np.inf)))


def _reprojection_px(project: PoseFile, reading: Reading) -> FloatArray:
    parts = []
    for view in project.views:
        pose = reading.pose(view.cam_from_world)
        in_camera = project.points[view.point_rows] @ pose[:3, :3].T + pose[:3, 3]
        lens = reading.lens(project.lenses[view.lens_id])
        parts.append(np.linalg.norm(lens.img_from_cam(in_camera) - view.pixels, axis=1))
    return np.concatenate(parts)


def _projected(project: PoseFile, view: PosedView, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels (P,2) and depths (P,) of points (P,3) in a view; NaN outside of it or behind."""
    lens = project.lenses[view.lens_id]
    in_camera = points @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    pixels = lens.img_from_cam(in_camera)
    outside = ~((pixels >= 0) & (pixels < lens.size_wh)).all(axis=1)
    outside |= (in_camera[:, 2] <= 0) & (lens.kind == "brown")
    pixels[outside] = np.nan
    return pixels, in_camera[:, 2]


def _require_inside(project: PoseFile) -> None:
    """Raise BadInput where most points fall into fewer than two photographs; of those that name
    who sees them, which may be a few of many photographs, only points that some of these see."""
    rows = np.arange(len(project.points))
    least = np.full(len(rows), min(2, len(project.views)))
    if project.num_seen:
        view_counts = np.bincount(np.concatenate([np.unique(view.point_rows) for view in project.views]), minlength=len(rows))
        rows, least = np.flatnonzero(view_counts), np.minimum(least, view_counts)[view_counts > 0]
    some = _some(len(rows), MAX_POINTS)
    rows, least = rows[some], least[some]
    if not len(rows):
        return
    counts = sum((np.isfinite(_projected(project, view, project.points[rows])[0][:, 0]).astype(int) for view in project.views), np.zeros(1))
    inside = float((counts >= least).mean())
    if inside < MIN_INSIDE:
        raise BadInput(
            f"{project.title} does not fit itself: {inside:.0%} of its points fall into two or more photographs in front of the camera, "
            f"expected {MIN_INSIDE:.0%} or more: its poses are of another convention or of another project than its points."
        )


def _require_colours(project: PoseFile, thumbnails: _Thumbnails) -> None:
    """Raise BadInput where points have the colours of photographs no more than by chance."""
    if project.colors is None or len(project.points) < MIN_MATCHES or np.ptp(project.colors, axis=0).max() == 0:
        return
    rows = _some(len(project.points), MAX_POINTS)
    shuffled = np.random.default_rng(0).permutation(len(rows))
    matched, by_chance = [np.zeros(0)], [np.zeros(0)]
    for number in _some(len(project.views), MAX_VIEWS):
        view = project.views[number]
        pixels, depths = _projected(project, view, project.points[rows])
        visible = _nearest_seen(pixels, depths, project.lenses[view.lens_id].size_wh)
        picture, scale = thumbnails.of(number)
        columns, lines = np.minimum((pixels[visible] * scale).astype(np.int64), np.array(picture.shape[1::-1]) - 1).T
        colours = picture[lines, columns].astype(np.float64)
        matched.append(np.abs(colours - project.colors[rows[visible]]).mean(axis=1))
        by_chance.append(np.abs(colours - project.colors[rows[shuffled[visible]]]).mean(axis=1))
    right, chance = float(np.mean(np.concatenate(matched))), float(np.mean(np.concatenate(by_chance)))
    if right > MAX_COLOUR_RATIO * chance:
        raise BadInput(
            f"{project.title} does not fit its photographs: the colours of its points differ by {right:.0f} grey levels from the pixels "
            f"that the poses put them at, and by {chance:.0f} from any other: give the photographs that it was made from, or --poses none."
        )


def _nearest_seen(pixels: FloatArray, depths: FloatArray, size_wh: tuple[int, int]) -> NDArray[np.int64]:
    """Rows of the points that lie in a view and not behind nearer ones of their cell."""
    inside = np.flatnonzero(np.isfinite(pixels[:, 0]))
    columns, lines = (pixels[inside] // (max(size_wh) / CELLS_ACROSS)).astype(np.int64).T
    cells = lines * CELLS_ACROSS + columns
    nearest = np.full(CELLS_ACROSS * CELLS_ACROSS, np.inf)
    np.minimum.at(nearest, cells, depths[inside])
    return inside[depths[inside] <= 1.05 * nearest[cells]]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pair:
    """Two views, their lenses and the pixels (M,2) of their matches in either."""

    views: tuple[PosedView, PosedView]
    lenses: tuple[Lens, Lens]
    pixels: tuple[FloatArray, FloatArray]


class _Thumbnails:
    """Reduced photographs and their features, each read once."""

    def __init__(self, *, project: PoseFile, photos: Path) -> None:
        self._project, self._photos = project, photos
        self._pictures: dict[int, tuple[np.ndarray, FloatArray]] = {}
        self._features: dict[int, tuple[FloatArray, np.ndarray]] = {}

    def of(self, number: int) -> tuple[np.ndarray, FloatArray]:
        """The picture (H,W,3) of a view and its size over the lens's (2,)."""
        if number not in self._pictures:
            view = self._project.views[number]
            picture = load_thumbnail(self._photos / view.name, COMPARED_PX)
            self._pictures[number] = picture, np.array(picture.shape[1::-1]) / self._project.lenses[view.lens_id].size_wh
        return self._pictures[number]

    def features(self, number: int) -> tuple[FloatArray, np.ndarray]:
        """Pixels (F,2) of the lens and descriptors (F,128)."""
        if number not in self._features:
            picture, scale = self.of(number)
            grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
            sift = getattr(cv2, "SIFT_create")(nfeatures=NUM_FEATURES)  # noqa: B009
            points, descriptors = sift.detectAndCompute(grey, None)
            places = np.array([point.pt for point in points], np.float64).reshape(-1, 2)
            described = np.zeros((0, 128), np.float32) if descriptors is None else descriptors
            self._features[number] = (places + 0.5) / scale, described
        return self._features[number]


def _matched_pairs(project: PoseFile, thumbnails: _Thumbnails) -> Iterator[_Pair]:
    """Up to `MAX_PAIRS` pairs that match: neighbours by name, which wrong poses do not change, and
    by place."""
    yielded = 0
    for first, second in _candidates(project):
        pixels = _matches(thumbnails.features(first), thumbnails.features(second), project.lenses[project.views[first].lens_id])
        if len(pixels[0]) < MIN_MATCHES:
            continue
        views = project.views[first], project.views[second]
        yield _Pair(views=views, lenses=(project.lenses[views[0].lens_id], project.lenses[views[1].lens_id]), pixels=pixels)
        yielded += 1
        if yielded == MAX_PAIRS:
            return


def _candidates(project: PoseFile) -> list[tuple[int, int]]:
    centers = np.array([-view.cam_from_world[:3, :3].T @ view.cam_from_world[:3, 3] for view in project.views])
    pairs: list[tuple[int, int]] = []
    for number in _some(len(project.views), MAX_TRIES // 2).tolist():
        if number + 1 < len(project.views):
            pairs.append((number, number + 1))
        away = np.linalg.norm(centers - centers[number], axis=1)
        # At one place two photographs have no epipolar lines.
        away[away <= 1e-6 * max(1e-12, float(np.ptp(centers, axis=0).max()))] = np.inf
        nearest = int(np.argmin(away))
        if np.isfinite(away[nearest]):
            pairs.append((min(number, nearest), max(number, nearest)))
    return list(dict.fromkeys(pairs))


def _matches(first: tuple[FloatArray, np.ndarray], second: tuple[FloatArray, np.ndarray], lens: Lens) -> tuple[FloatArray, FloatArray]:
    """Pixels (M,2) of mutual matches that some fundamental matrix agrees with."""
    none = np.zeros((0, 2)), np.zeros((0, 2))
    if min(len(first[0]), len(second[0])) < MIN_MATCHES:
        return none
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    forth, back = (matcher.knnMatch(queries, targets, k=2) for queries, targets in ((first[1], second[1]), (second[1], first[1])))
    best = {
        match[0].queryIdx: match[0].trainIdx for match in forth if len(match) == 2 and match[0].distance < MATCH_RATIO * match[1].distance
    }
    returned = {match[0].queryIdx: match[0].trainIdx for match in back if match}
    rows = np.array([(query, target) for query, target in best.items() if returned.get(target) == query], np.int64).reshape(-1, 2)
    if len(rows) < MIN_MATCHES:
        return none
    first_px, second_px = first[0][rows[:, 0]], second[0][rows[:, 1]]
    cv2.setRNGSeed(0)
    # Wide, since a lens bends the lines.
    _, inliers = cv2.findFundamentalMat(first_px, second_px, cv2.USAC_MAGSAC, max(lens.size_wh) / 300, 0.999, 5000)
    agree = np.zeros(len(first_px), bool) if inliers is None else np.asarray(inliers, bool).ravel()
    return first_px[agree], second_px[agree]


def _epipolar_px(pairs: tuple[_Pair, ...], reading: Reading) -> FloatArray:
    parts = []
    for pair in pairs:
        (first, second), move = _rays(pair, reading), _second_from_first(pair, reading)
        essential = np.cross(np.eye(3), move[:3, 3]) @ move[:3, :3]
        lines, back = first @ essential.T, second @ essential
        with np.errstate(all="ignore"):
            weight = np.sqrt((lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))
            errors = np.abs((second * lines).sum(axis=1)) / weight
        focal_px = float(np.mean([np.sqrt(lens.fx * lens.fy) for lens in pair.lenses]))
        parts.append(focal_px * errors)
    return np.concatenate(parts)


def _rays(pair: _Pair, reading: Reading) -> tuple[FloatArray, FloatArray]:
    first, second = (reading.lens(lens).cam_from_img(pixels) for lens, pixels in zip(pair.lenses, pair.pixels, strict=True))
    # Sampson's distance is one of the plane z = 1; a fisheye's rays beyond it have none.
    with np.errstate(all="ignore"):
        flat = [np.where(rays[:, 2:] > LEAST_Z, rays / rays[:, 2:], np.nan) for rays in (first, second)]
    return flat[0], flat[1]


def _second_from_first(pair: _Pair, reading: Reading) -> FloatArray:
    first, second = (reading.pose(view.cam_from_world) for view in pair.views)
    return second @ _transposed(first)


def _require_in_front(project: PoseFile, pairs: tuple[_Pair, ...]) -> None:
    """Raise BadInput where matches lie behind the cameras, which their epipolar lines do not
    show."""
    shares = []
    for pair in pairs:
        (first, second), move = _rays(pair, AS_READ), _second_from_first(pair, AS_READ)
        turned = first @ move[:3, :3].T
        # Depths a, b of a·turned + t = b·second, least squares.
        tt, ts, ss = (turned * turned).sum(1), (turned * second).sum(1), (second * second).sum(1)
        tx, sx = turned @ move[:3, 3], second @ move[:3, 3]
        with np.errstate(all="ignore"):
            det = tt * ss - ts * ts
            depths = (ts * sx - ss * tx) / det, (tt * sx - ts * tx) / det
        is_defined = np.isfinite(depths[0]) & (np.abs(det) > 1e-12)
        shares.append(((depths[0] > 0) & (depths[1] > 0))[is_defined])
    in_front = np.concatenate(shares)
    if len(in_front) and in_front.mean() < MIN_IN_FRONT:
        raise BadInput(
            f"{project.title} does not fit its photographs: {in_front.mean():.0%} of the points matched between them lie in front of both "
            f"cameras, expected {MIN_IN_FRONT:.0%} or more: its translations are of the other sign."
        )


def _some(count: int, most: int) -> np.ndarray:
    """At most so many indices below `count`, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)) if count else np.zeros(0, np.int64)
