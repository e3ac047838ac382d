"""How far points are from where they were surveyed, and how far they were expected to be.

    Σ_X = V⁻¹ + (V⁻¹ Jᵀ B) Σ_cameras (V⁻¹ Jᵀ B)ᵀ,   V = JᵀJ
    expected = √(diag Σ_X + σ²_survey)

J: derivatives of a point's pixels by the point, B: by cameras and lenses, both over σ of a mark;
Σ_cameras: the inverse of the adjustment's normal equations. Once per scene.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.sfm.control.adjust import Adjusted
from radiant_core.sfm.control.bundle import Ties
from radiant_core.sfm.control.intersect import intersect_rays, refine_points


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

    @property
    def length_m(self) -> float:
        """Distance in space."""
        return float(np.linalg.norm(self.residual_m))


@dataclass(frozen=True, kw_only=True)
class Summary:
    """RMS per axis of several points, measured and expected."""

    num_points: int
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
    """Of some points together; None without any."""
    if not points:
        return None
    rms = np.sqrt(np.mean(np.square([point.residual_m for point in points]), axis=0))
    expected = np.sqrt(np.mean(np.square([point.expected_m for point in points]), axis=0))
    return Summary(num_points=len(points), rms_m=_triple(rms), expected_m=_triple(expected))


def check_points(
    adjusted: Adjusted, marks: Ties, names: tuple[str, ...], places_m: FloatArray, sigmas_m: FloatArray, mark_px: float
) -> tuple[PointQuality, ...]:
    """Points (G,3) that were kept out, intersected from the adjusted cameras; those that under two
    photographs show well are left out."""
    found = refine_points(adjusted.bundle, marks, intersect_rays(adjusted.bundle, marks, len(names)))
    kept = []
    for row, name in enumerate(names):
        own = marks.at(marks.points == row)
        if not np.isfinite(found[row]).all():
            continue
        covariance, rms_px = _covariance(adjusted, own, found[row], mark_px)
        expected = np.sqrt(np.diag(covariance) + sigmas_m**2)
        kept.append(
            PointQuality(
                name=name,
                is_check=True,
                num_images=len(own.images),
                residual_m=_triple(found[row] - places_m[row]),
                expected_m=_triple(expected),
                residual_px=rms_px,
            )
        )
    return tuple(kept)


def control_points(adjusted: Adjusted, marks: Ties, names: tuple[str, ...], places_m: FloatArray) -> tuple[PointQuality, ...]:
    """Ground control after the adjustment."""
    normal, first = adjusted.normal, len(adjusted.bundle.points)
    kept = []
    for row, name in enumerate(names):
        own = marks.at(marks.points == row)
        at = first + row
        follow = normal.point_from_camera[3 * at : 3 * at + 3].toarray()
        covariance = normal.point_inverse[at] + follow @ normal.solve(follow.T)
        pixels = adjusted.bundle.project(own.images, np.repeat(adjusted.control_m[row : row + 1], len(own.images), axis=0))
        kept.append(
            PointQuality(
                name=name,
                is_check=False,
                num_images=len(own.images),
                residual_m=_triple(adjusted.control_m[row] - places_m[row]),
                expected_m=_triple(np.sqrt(np.diag(covariance))),
                residual_px=_rms(pixels - own.pixels),
            )
        )
    return tuple(kept)


def _covariance(adjusted: Adjusted, marks: Ties, point: FloatArray, mark_px: float) -> tuple[FloatArray, float]:
    """Of an intersected point (3,3), and the RMS of its marks in px."""
    bundle = adjusted.bundle
    pixels, by_pose, by_lens, by_point = bundle.derivatives(marks.images, np.repeat(point[None], len(marks.images), axis=0))
    J = by_point.reshape(-1, 3) / mark_px
    inverse = np.linalg.inv(J.T @ J)
    C, F = len(bundle.names), bundle.most_free
    B = np.zeros((len(marks.images), 2, 6 * C + F * len(bundle.lenses) + 3))
    for row, image in enumerate(marks.images.tolist()):
        B[row, :, 6 * image : 6 * image + 6] = by_pose[row]
        at = 6 * C + F * int(bundle.lens_of_image[image])
        B[row, :, at : at + F] = by_lens[row]
    follow = inverse @ J.T @ B.reshape(-1, B.shape[2]) / mark_px
    return inverse + follow @ adjusted.normal.solve(follow.T), _rms(pixels - marks.pixels)


def _rms(residuals: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(residuals)))) if residuals.size else 0.0


def _triple(values: FloatArray) -> tuple[float, float, float]:
    east, north, up = values.tolist()
    return east, north, up
