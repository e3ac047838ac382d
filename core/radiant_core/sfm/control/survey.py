"""A reconstruction adjusted to ground control and accurate positions, in their frame. Per scene.

    marks ─ rays ─→ points ─ similarity to the survey ─→ adjustment ⇄ σ of ties and marks ─→ quality

Ties are chosen where an image has more than it needs: those of the longest tracks. All other points
follow the adjusted cameras afterwards. σ of ties and marks are what their residuals show.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3
from radiant_core.geometry.align import fit_sim3, robust_sim3
from radiant_core.georef.control_points import ControlPoints
from radiant_core.io.photos.listing import Photograph
from radiant_core.numerics import FloatArray
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.config import Report, SfmProgress
from radiant_core.sfm.control.adjust import Adjusted, Measurements, adjust, with_sigmas
from radiant_core.sfm.control.before_matching import MIN_CONTROL, is_spread, require_spread
from radiant_core.sfm.control.bundle import Bundle, Ties, bundle_of, write_back
from radiant_core.sfm.control.counting import (
    BLUNDER_SIGMAS,
    claim_warning,
    counting_positions,
    misfit_doubt,
    require_counting,
    said_of,
    sigmas_off,
    with_counts,
)
from radiant_core.sfm.control.intersect import intersect_rays, refine_points
from radiant_core.sfm.control.marked import Marked, marks_of
from radiant_core.sfm.control.priors import accurate_positions, are_enough, middle_of, positions_about
from radiant_core.sfm.control.quality import PointQuality, Summary, check_points, control_points, summarize
from radiant_core.sfm.control.scale import scale_by_points, scale_by_positions

TIES_PER_IMAGE = 250
FIRST_MARK_PX, LEAST_MARK_PX, LEAST_TIE_PX = 0.5, 0.1, 0.05
SIGMA_FROM_MEDIAN = 1.4826
ENOUGH_FOR_BLUNDERS = 5
ROUNDS = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Surveyed:
    """What the adjustment came to."""

    frame: Frame
    points: tuple[PointQuality, ...]
    control: Summary | None
    check: Summary | None
    num_positions: int
    """Photographs whose own position was adjusted to."""
    num_positions_counting: int
    """Those of them that are not far off."""
    positions_rms_m: float | None
    shift_m: tuple[float, float, float]
    """Those positions minus ground control."""
    tie_sigma_px: float
    mark_sigma_px: float
    system: str
    warnings: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    """Those of the warnings after which the frame may be wrong."""
    scale_sigma: float | None = None
    """Relative standard deviation of the scale (`scale.py`)."""

    def decision(self) -> Decision:
        """For the report: what places the scene, and how well."""
        parts = []
        if self.control is not None:
            parts.append(f"{_some(self.control.num_counting, self.control.num_points)} ground control points")
        if self.num_positions:
            parts.append(f"{_some(self.num_positions_counting, self.num_positions)} camera positions of known accuracy")
        quality = self.check or self.control
        figure = quality.rms_axis_m if quality is not None else self.positions_rms_m or 0.0
        of = f"RMS per axis of {self.check.num_points} check points" if self.check else "RMS per axis of what was adjusted to"
        reason = f"{self.check.expected_axis_m:.3g} m were expected" if self.check else "no check points were kept out"
        return Decision(
            stage="sfm", topic="frame", choice=f"adjusted to {' and '.join(parts)}", figure=figure, unit=f"m {of}", reason=reason
        )


def adjust_to_survey(
    model: pycolmap.Reconstruction, photographs: tuple[Photograph, ...], control: ControlPoints | None, report: Report
) -> Surveyed | None:
    """Move and adjust `model` in place; None, and nothing done, where there is neither ground
    control nor enough positions of known accuracy. BadInput where the control does not fix it."""
    bundle, ties = bundle_of(model)
    by_name = {photo.name: photo for photo in photographs}
    geodetic, gps_sigmas_m = accurate_positions(tuple(by_name[name] for name in bundle.names))
    if control is None and not (are_enough(geodetic) and _fix_a_scene(bundle, geodetic)):
        return None
    report(SfmProgress(phase="refining", done=0, total=len(bundle.names)))
    local = control is not None and control.origin_lat_lon_alt is None
    origin = middle_of(geodetic) if control is None else control.origin_lat_lon_alt
    gps_m = np.full_like(geodetic, np.nan) if local or origin is None else positions_about(geodetic, origin)
    marked = None if control is None else marks_of(control, bundle)
    started = _start(bundle, None if marked is None or marked.is_check.all() else marked, gps_m)
    chosen, some = _chosen_ties(started, ties)
    measurements = _measurements(marked, gps_m, gps_sigmas_m)
    adjusted, measurements = _adjust_rounds(chosen, some, measurements, marked)
    finished = _with_all_points(adjusted, started, ties)
    write_back(finished, model)
    report(SfmProgress(phase="refining", done=len(bundle.names), total=len(bundle.names)))
    return _surveyed(adjusted, measurements, marked, control, origin)


def _start(bundle: Bundle, marked: Marked | None, gps_m: FloatArray) -> Bundle:
    """The bundle moved to the survey by a similarity: by ground control, else by GPS."""
    if marked is not None:
        rows, marks = marked.rows(check=False)
        if len(rows) < MIN_CONTROL:
            raise BadInput(
                f"{len(rows)} points of ground control are marked in two photographs or more and not kept out for checking, expected "
                f"{MIN_CONTROL} or more: mark more, or keep fewer out."
            )
        source, target = intersect_rays(bundle, marks, len(rows)), marked.places_m[rows]
        require_spread(target)
    else:
        has_gps = np.isfinite(gps_m[:, 0])
        source, target = bundle.centers[has_gps], gps_m[has_gps]
        if not is_spread(target):
            raise BadInput(
                "all points of ground control that can be used are kept out for checking, and no positions of known accuracy place the "
                f"scene: keep fewer out, so that {MIN_CONTROL} or more place it."
            )
    fit = None
    if len(source) >= ENOUGH_FOR_BLUNDERS:
        fit = robust_sim3(source, target).target_from_source
    return _move(bundle, fit or fit_sim3(source, target))


def _fix_a_scene(bundle: Bundle, geodetic: FloatArray) -> bool:
    """Whether positions (C,3) alone fix all of a frame; else they place it as those of any receiver
    do, with what the scene says of up."""
    has_gps = np.isfinite(geodetic[:, 0])
    positions_m = positions_about(geodetic, middle_of(geodetic))[has_gps]
    return is_spread(positions_m) and robust_sim3(bundle.centers[has_gps], positions_m).status == "ok"


def _some(counting: int, total: int) -> str:
    return f"{total}" if counting == total else f"{counting} of {total}"


def _move(bundle: Bundle, similarity: Sim3) -> Bundle:
    return replace(
        bundle,
        rotations=bundle.rotations @ similarity.rotation.T,
        centers=similarity.apply(bundle.centers),
        points=similarity.apply(bundle.points),
    )


def _chosen_ties(bundle: Bundle, ties: Ties) -> tuple[Bundle, Ties]:
    """A bundle with the points of the longest tracks of every image, and all their ties."""
    tracks = np.bincount(ties.points, minlength=len(bundle.points))
    order = np.lexsort((ties.points, -tracks[ties.points], ties.images))
    starts = np.searchsorted(ties.images[order], np.arange(len(bundle.names)))
    rank = np.arange(len(order)) - starts[ties.images[order]]
    point_rows = np.unique(ties.points[order[rank < TIES_PER_IMAGE]])
    chosen = ties.at(np.isin(ties.points, point_rows))
    some = replace(chosen, points=np.searchsorted(point_rows, chosen.points))
    return replace(bundle, points=bundle.points[point_rows], point_ids=bundle.point_ids[point_rows]), some


def _measurements(marked: Marked | None, gps_m: FloatArray, gps_sigmas_m: FloatArray) -> Measurements:
    empty = Ties(images=np.zeros(0, np.int64), points=np.zeros(0, np.int64), pixels=np.zeros((0, 2)))
    rows, marks = (np.zeros(0, np.int64), empty) if marked is None else marked.rows(check=False)
    return Measurements(
        places_m=np.zeros((0, 3)) if marked is None else marked.places_m[rows],
        sigmas_m=np.ones(3) if marked is None else marked.sigmas_m,
        marks=marks,
        gps_m=gps_m,
        gps_sigmas_m=gps_sigmas_m,
        tie_sigma_px=FIRST_MARK_PX,
        mark_sigma_px=FIRST_MARK_PX,
    )


def _adjust_rounds(bundle: Bundle, ties: Ties, measurements: Measurements, marked: Marked | None) -> tuple[Adjusted, Measurements]:
    """Adjust, see what ties and marks are good for, and adjust again."""
    # The old points are off by how far the start is from the survey; cameras are right among them.
    adjusted = adjust(bundle, ties, measurements)
    for _ in range(ROUNDS):
        measurements = with_sigmas(measurements, *_sigmas_px(adjusted, ties, marked))
        adjusted = adjust(adjusted.bundle, ties, measurements)
    return adjusted, measurements


def _sigmas_px(adjusted: Adjusted, ties: Ties, marked: Marked | None) -> tuple[float, float]:
    bundle = adjusted.bundle
    tie = _sigma_of(bundle.project(ties.images, bundle.points[ties.points]) - ties.pixels, len(bundle.points))
    if marked is None:
        return max(tie, LEAST_TIE_PX), FIRST_MARK_PX
    points = refine_points(bundle, marked.marks, intersect_rays(bundle, marked.marks, len(marked.names)))
    mark = _sigma_of(bundle.project(marked.marks.images, points[marked.marks.points]) - marked.marks.pixels, len(points))
    return max(tie, LEAST_TIE_PX), max(mark, LEAST_MARK_PX)


def _sigma_of(residuals_px: FloatArray, num_points: int) -> float:
    """Standard deviation per axis, by the median, corrected for three fitted numbers a point."""
    values = np.abs(residuals_px[np.isfinite(residuals_px).all(axis=1)]).ravel()
    if len(values) <= 3 * num_points:
        return FIRST_MARK_PX
    return SIGMA_FROM_MEDIAN * float(np.median(values)) * float(np.sqrt(len(values) / (len(values) - 3 * num_points)))


def _with_all_points(adjusted: Adjusted, started: Bundle, ties: Ties) -> Bundle:
    """The adjusted bundle with the points that took no part, which follow its cameras."""
    points = started.points.copy()
    points[np.searchsorted(started.point_ids, adjusted.bundle.point_ids)] = adjusted.bundle.points
    bundle = replace(adjusted.bundle, points=points, point_ids=started.point_ids)
    return replace(bundle, points=refine_points(bundle, ties, points))


def _surveyed(
    adjusted: Adjusted, measurements: Measurements, marked: Marked | None, control: ControlPoints | None, origin: FloatArray | None
) -> Surveyed:
    points, warnings, doubts = judged_points(adjusted, measurements, marked) if marked is not None else ((), (), ())
    misses = measurements.gps_m - adjusted.bundle.centers - adjusted.shift_m
    has_gps = np.isfinite(misses).all(axis=1)
    rms = float(np.sqrt(np.mean(np.square(misses[has_gps])))) if has_gps.any() else None
    kind = "scaled" if origin is None else "metric"
    claims = claim_warning(misses, measurements.gps_sigmas_m)
    counting = counting_positions(misses, measurements.gps_sigmas_m)
    scale_sigma = scale_by_points(points, measurements.places_m, measurements.sigmas_m)
    if scale_sigma is None:
        scale_sigma = scale_by_positions(measurements.gps_m[counting], misses[counting], measurements.gps_sigmas_m[counting])
    east, north, up = adjusted.shift_m.tolist()
    return Surveyed(
        frame=Frame(kind=kind, origin_lat_lon_alt=np.zeros(3) if origin is None else origin, residual_m=rms),
        points=points,
        control=summarize(tuple(point for point in points if not point.is_check)),
        check=summarize(tuple(point for point in points if point.is_check)),
        num_positions=int(has_gps.sum()),
        num_positions_counting=int(counting.sum()),
        positions_rms_m=rms,
        shift_m=(east, north, up),
        tie_sigma_px=measurements.tie_sigma_px,
        mark_sigma_px=measurements.mark_sigma_px,
        system="WGS84" if control is None else control.system,
        warnings=(*(() if control is None else control.warnings), *warnings, *blunders(points, measurements), *doubts, *claims),
        doubts=(*doubts, *claims),
        scale_sigma=scale_sigma,
    )


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
