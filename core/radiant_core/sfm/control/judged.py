"""Surveyed points after an adjustment: how good each is, and what to say of it. Once per scene."""

from __future__ import annotations

import numpy as np

from radiant_core.sfm.control.adjust import Adjusted, Measurements
from radiant_core.sfm.control.counting import BLUNDER_SIGMAS, misfit_doubt, require_counting, said_of, sigmas_off, with_counts
from radiant_core.sfm.control.marked import Marked
from radiant_core.sfm.control.quality import PointQuality, check_points, control_points

LEAST_MARK_LIMIT_PX, MARK_LIMIT_SHARE = 3.0, 0.002
"""A mark by hand is off by no more than this, or this share of a photograph's long side."""


def judged_points(
    adjusted: Adjusted, measurements: Measurements, marked: Marked
) -> tuple[tuple[PointQuality, ...], tuple[str, ...], tuple[str, ...]]:
    """All surveyed points with whether they count, warnings, and doubts about the checks. BadInput
    where most that are adjusted to do not count."""
    long_side_px = max(max(lens.width, lens.height) for lens in adjusted.bundle.lenses)
    mark_px = min(measurements.mark_sigma_px, max(LEAST_MARK_LIMIT_PX, MARK_LIMIT_SHARE * long_side_px))
    rows, marks = marked.rows(check=False)
    names, places_m = tuple(marked.names[row] for row in rows), marked.places_m[rows]
    control = with_counts(control_points(adjusted, marks, names, places_m, mark_px), marked.sigmas_m)
    rows, marks = marked.rows(check=True)
    names = tuple(marked.names[row] for row in rows)
    check = with_counts(check_points(adjusted, marks, names, marked.places_m[rows], marked.sigmas_m, mark_px), marked.sigmas_m)
    if control:
        extent_m = float(np.linalg.norm(np.ptp(places_m, axis=0)))
        require_counting(control, marked.sigmas_m, extent_m, checked=any(point.counts for point in check))
    lost = sorted(set(names) - {point.name for point in check})
    warnings = marked.warnings
    if lost:
        warnings += (f"{len(lost)} check points are seen by too few photographs to be placed: {', '.join(lost[:10])}.",)
    # Those that are seen and far off are named by `blunders`.
    unfit = tuple(point for point in (*control, *check) if not point.is_seen)
    if unfit:
        warnings += (f"{len(unfit)} of {len(control) + len(check)} surveyed points do not count: {said_of(unfit)}.",)
    doubts = misfit_doubt(control, marked.sigmas_m)
    if 2 * sum(point.counts for point in check) < len(check):
        counting = sum(point.counts for point in check)
        doubts += (f"only {counting} of {len(check)} check points count, which says nothing good of the frame or of their marks.",)
    return (*control, *check), warnings, doubts


def blunders(points: tuple[PointQuality, ...], measurements: Measurements) -> tuple[str, ...]:
    """Warnings of points that are farther off than any noise."""
    warnings = []
    for point in points:
        worst = sigmas_off(point, measurements.sigmas_m)
        if worst > BLUNDER_SIGMAS:
            kind = "check point" if point.is_check else "ground control point"
            warnings.append(
                f"{kind} {point.name!r} is {point.length_m:.3g} m from where the photographs have it, {worst:.0f} standard deviations: "
                "check its coordinates and its marks."
            )
    return tuple(warnings)
