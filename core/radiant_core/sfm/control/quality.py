"""How far points are from where they were surveyed, and how far they were expected to be.

    Σ_X = V⁻¹ + (V⁻¹ Jᵀ B) Σ_cameras (V⁻¹ Jᵀ B)ᵀ,   V = JᵀJ
    expected = √(diag Σ_X + σ²_survey)

J: derivatives of a point's pixels by the point, B: by cameras and lenses, both over σ of a mark;
Σ_cameras: the inverse of the adjustment's normal equations. Once per scene.

The adjustment takes weight from what does not fit, so that a point whose marks are all wrong stays
exactly where it was surveyed: no difference, and nothing learnt. Hence every point says how many of
its marks count, and counts itself where two of them do and it is not far off among the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.sfm.control.adjust import Adjusted
from radiant_core.sfm.control.bundle import Ties
from radiant_core.sfm.control.intersect import intersect_rays, refine_points

COUNTING_SIGMAS = 6.0
"""A mark farther off than this has lost half of its weight (Huber at 3 σ)."""
MIN_MARKS = 2
MAX_CONDITION = 1e14


@dataclass(frozen=True, kw_only=True)
class PointQuality:
    """One surveyed point: photograph minus survey, metres east, north, up."""

    name: str
    is_check: bool
    num_images: int
    residual_m: tuple[float, float, float]
    expected_m: tuple[float, float, float]
    """Standard deviation of the residual of a check point; of ground control that of the point as
    it was adjusted, which the residual is part of."""
    residual_px: float
    """RMS of its marks."""
    num_counting: int
    """Marks that count."""
    counts: bool = True
    """Whether the point does."""

    @property
    def is_seen(self) -> bool:
        """Whether enough of its marks count for its residual to say anything."""
        return self.num_counting >= MIN_MARKS

    @property
    def length_m(self) -> float:
        """Distance in space."""
        return float(np.linalg.norm(self.residual_m))


@dataclass(frozen=True, kw_only=True)
class Summary:
    """RMS per axis of those of several points whose marks count, measured and expected."""

    num_points: int
    num_counting: int
    rms_m: tuple[float, float, float]
    expected_m: tuple[float, float, float]

    @property
    def rms_axis_m(self) -> float:
        """Over all three axes."""
        return float(np.sqrt(np.mean(np.square(self.rms_m))))

    @property
    def expected_axis_m(self) -> float:
        """Over all three axes."""
        return float(np.sqrt(np.mean(np.square(self.expected_m))))


def summarize(points: tuple[PointQuality, ...]) -> Summary | None:
    """Of some points together; None without any. What its marks do not place is in no RMS."""
    if not points:
        return None
    num_counting = sum(point.counts for point in points)
    num_points, points = len(points), tuple(point for point in points if point.is_seen) or points
    rms = np.sqrt(np.mean(np.square([point.residual_m for point in points]), axis=0))
    expected = np.sqrt(np.mean(np.square([point.expected_m for point in points]), axis=0))
    return Summary(num_points=num_points, num_counting=num_counting, rms_m=_triple(rms), expected_m=_triple(expected))


def check_points(
    adjusted: Adjusted, marks: Ties, names: tuple[str, ...], places_m: FloatArray, sigmas_m: FloatArray, mark_px: float
) -> tuple[PointQuality, ...]:
    """Points (G,3) that were kept out, intersected from the adjusted cameras; those that under two
    photographs show well are left out."""
    points = refine_points(adjusted.bundle, marks, intersect_rays(adjusted.bundle, marks, len(names)))
    qualities = []
    for row, name in enumerate(names):
        point_marks = marks.at(marks.points == row)
        if not np.isfinite(points[row]).all():
            continue
        point_marks, residuals_px = _in_front(adjusted, point_marks, points[row])
        covariance = _covariance(adjusted, point_marks, points[row], mark_px)
        if covariance is None:
            continue
        expected = np.sqrt(np.diag(covariance) + sigmas_m**2)
        qualities.append(
            PointQuality(
                name=name,
                is_check=True,
                num_images=len(residuals_px),
                residual_m=_triple(points[row] - places_m[row]),
                expected_m=_triple(expected),
                residual_px=_rms(residuals_px),
                num_counting=_num_counting(residuals_px, mark_px),
            )
        )
    return tuple(qualities)


def control_points(
    adjusted: Adjusted, marks: Ties, names: tuple[str, ...], places_m: FloatArray, mark_px: float
) -> tuple[PointQuality, ...]:
    """Ground control after the adjustment."""
    normal, first = adjusted.normal, len(adjusted.bundle.points)
    qualities = []
    for row, name in enumerate(names):
        point_marks = marks.at(marks.points == row)
        at = first + row
        follow = normal.point_from_camera[3 * at : 3 * at + 3].toarray()
        covariance = normal.point_inverse[at] + follow @ normal.solve(follow.T)
        pixels = adjusted.bundle.project(point_marks.images, np.repeat(adjusted.control_m[row : row + 1], len(point_marks.images), axis=0))
        qualities.append(
            PointQuality(
                name=name,
                is_check=False,
                num_images=len(point_marks.images),
                residual_m=_triple(adjusted.control_m[row] - places_m[row]),
                expected_m=_triple(np.sqrt(np.diag(covariance))),
                residual_px=_rms(pixels - point_marks.pixels),
                num_counting=_num_counting(pixels - point_marks.pixels, mark_px),
            )
        )
    return tuple(qualities)


def _in_front(adjusted: Adjusted, marks: Ties, point: FloatArray) -> tuple[Ties, FloatArray]:
    """The marks of a point (3,) in photographs that have it before them, and how far all (K,2) are
    off in px, NaN in the others."""
    pixels = adjusted.bundle.project(marks.images, np.repeat(point[None], len(marks.images), axis=0))
    return marks.at(np.flatnonzero(np.isfinite(pixels[:, 0]))), pixels - marks.pixels


def _covariance(adjusted: Adjusted, marks: Ties, point: FloatArray, mark_px: float) -> FloatArray | None:
    """Of an intersected point (3,3); None where its marks do not fix it."""
    bundle = adjusted.bundle
    if len(marks.images) < MIN_MARKS:
        return None
    _, by_pose, by_lens, by_point = bundle.derivatives(marks.images, np.repeat(point[None], len(marks.images), axis=0))
    J = by_point.reshape(-1, 3) / mark_px
    normal = J.T @ J
    if not np.linalg.cond(normal) < MAX_CONDITION:
        return None
    inverse = np.linalg.inv(normal)
    C, F = len(bundle.names), bundle.most_free
    B = np.zeros((len(marks.images), 2, 6 * C + F * len(bundle.lenses) + 3))
    for row, image in enumerate(marks.images.tolist()):
        B[row, :, 6 * image : 6 * image + 6] = by_pose[row]
        at = 6 * C + F * int(bundle.lens_of_image[image])
        B[row, :, at : at + F] = by_lens[row]
    follow = inverse @ J.T @ B.reshape(-1, B.shape[2]) / mark_px
    return inverse + follow @ adjusted.normal.solve(follow.T)


def _num_counting(residuals_px: FloatArray, mark_px: float) -> int:
    """Marks (K,2) that are not farther off than noise; one behind its camera is NaN."""
    lengths = np.linalg.norm(residuals_px, axis=1)
    return int((lengths <= COUNTING_SIGMAS * mark_px).sum())


def _rms(residuals: FloatArray) -> float:
    """Of those that are there: a photograph has none of what is behind it."""
    there = residuals[np.isfinite(residuals).all(axis=1)]
    return float(np.sqrt(np.mean(np.square(there)))) if there.size else 0.0


def _triple(values: FloatArray) -> tuple[float, float, float]:
    east, north, up = values.tolist()
    return east, north, up
