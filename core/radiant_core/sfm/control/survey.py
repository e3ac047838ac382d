"""A reconstruction adjusted to ground control and accurate positions, in their frame. Per scene.

    marks ─ rays ─→ points ─ similarity to the survey ─→ adjustment ⇄ σ of ties and marks ─→ quality

Ties are chosen where an image has more than it needs: those of the longest tracks. All other points
follow the adjusted cameras afterwards. σ of ties and marks are what their residuals show.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3
from radiant_core.georef.control_points import ControlPoints
from radiant_core.io.photos.listing import Photograph
from radiant_core.numerics import FloatArray
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.config import Report, SfmProgress
from radiant_core.sfm.control.adjust import Adjusted, Known, adjust, with_sigmas
from radiant_core.sfm.control.bundle import Bundle, Rows, Ties, bundle_of, write_back
from radiant_core.sfm.control.intersect import intersect_rays, refine_points
from radiant_core.sfm.control.priors import accurate_positions, are_enough, middle_of, positions_about
from radiant_core.sfm.control.quality import PointQuality, Summary, check_points, control_points, summarize
from radiant_core.sfm.world_frame.align import fit_sim3, robust_sim3

TIES_PER_IMAGE = 250
FIRST_MARK_PX, LEAST_MARK_PX, LEAST_TIE_PX = 0.5, 0.1, 0.05
SIGMA_FROM_MEDIAN = 1.4826
MIN_CONTROL, ENOUGH_FOR_BLUNDERS = 3, 5
MIN_SPREAD = 0.02
"""Across the line through them, ground control must spread by this share of its length."""
BLUNDER_SIGMAS = 4.0
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
    positions_rms_m: float | None
    shift_m: tuple[float, float, float]
    """Those positions minus ground control."""
    tie_sigma_px: float
    mark_sigma_px: float
    system: str
    warnings: tuple[str, ...]

    def decision(self) -> Decision:
        """For the report: what places the scene, and how well."""
        parts = []
        if self.control is not None:
            parts.append(f"{self.control.num_points} ground control points")
        if self.num_positions:
            parts.append(f"{self.num_positions} camera positions of known accuracy")
        said = self.check or self.control
        figure = said.rms_axis_m if said is not None else self.positions_rms_m or 0.0
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
    if control is None and not are_enough(geodetic):
        return None
    report(SfmProgress(phase="refining", done=0, total=len(bundle.names)))
    local = control is not None and control.origin_lat_lon_alt is None
    origin = middle_of(geodetic) if control is None else control.origin_lat_lon_alt
    gps_m = np.full_like(geodetic, np.nan) if local or origin is None else positions_about(geodetic, origin)
    marked = None if control is None else _marks_of(control, bundle)
    started = _start(bundle, marked, gps_m)
    chosen, some = _chosen_ties(started, ties)
    known = _known(marked, gps_m, gps_sigmas_m)
    adjusted, known = _adjust_rounds(chosen, some, known, marked)
    finished = _with_all_points(adjusted, started, ties)
    write_back(finished, model)
    report(SfmProgress(phase="refining", done=len(bundle.names), total=len(bundle.names)))
    return _surveyed(adjusted, known, marked, control, origin)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Marked:
    """Ground control with marks in photographs that are placed."""

    names: tuple[str, ...]
    places_m: FloatArray
    is_check: NDArray[np.bool_]
    sigmas_m: FloatArray
    marks: Ties
    warnings: tuple[str, ...]

    def rows(self, *, check: bool) -> tuple[Rows, Ties]:
        """Points that are kept out, or not, and their marks with rows among them."""
        rows = np.flatnonzero(self.is_check == check)
        own = self.marks.at(np.isin(self.marks.points, rows))
        return rows, replace(own, points=np.searchsorted(rows, own.points))


def _marks_of(control: ControlPoints, bundle: Bundle) -> _Marked:
    row_of = {name: row for row, name in enumerate(bundle.names)}
    placed = np.array([name in row_of for name in control.mark_images])
    if not placed.any():
        raise BadInput(
            f"none of the {len(placed)} marks of ground control is in a photograph that was placed ({control.mark_images[0]!r} first): "
            "the list names photographs by their file names."
        )
    lost = sorted({name for name, there in zip(control.mark_images, placed, strict=True) if not there})
    warnings = (f"marks of ground control in {len(lost)} photographs that are not placed are left out, {lost[0]!r} first.",) if lost else ()
    images = np.array([row_of.get(name, -1) for name in control.mark_images], np.int64)[placed]
    marks = Ties(images=images, points=control.mark_points[placed], pixels=control.mark_pixels[placed])
    seen = np.isfinite(intersect_rays(bundle, marks, len(control.names))).all(axis=1)
    if not seen.all():
        first = control.names[int(np.flatnonzero(~seen)[0])]
        warnings += (
            f"{int((~seen).sum())} points of ground control are marked in fewer than two photographs that lie apart, {first!r} first.",
        )
    rows = np.flatnonzero(seen)
    own = marks.at(np.isin(marks.points, rows))
    return _Marked(
        names=tuple(control.names[row] for row in rows),
        places_m=control.places_m[rows],
        is_check=control.is_check[rows],
        sigmas_m=control.sigmas_m,
        marks=replace(own, points=np.searchsorted(rows, own.points)),
        warnings=warnings,
    )


def _start(bundle: Bundle, marked: _Marked | None, gps_m: FloatArray) -> Bundle:
    """The bundle moved to the survey by a similarity: by ground control, else by GPS."""
    if marked is not None:
        rows, marks = marked.rows(check=False)
        if len(rows) < MIN_CONTROL:
            raise BadInput(
                f"{len(rows)} points of ground control are marked in two photographs or more and not kept out for checking, expected "
                f"{MIN_CONTROL} or more: mark more, or keep fewer out."
            )
        source, target = intersect_rays(bundle, marks, len(rows)), marked.places_m[rows]
        _require_spread(target)
    else:
        known = np.isfinite(gps_m[:, 0])
        source, target = bundle.centers[known], gps_m[known]
        _require_spread(target)
    fit = None
    if len(source) >= ENOUGH_FOR_BLUNDERS:
        fit = robust_sim3(source, target).target_from_source
    return _move(bundle, fit or fit_sim3(source, target))


def _require_spread(places_m: FloatArray) -> None:
    spread = np.linalg.svd(places_m - places_m.mean(axis=0), compute_uv=False)
    if not spread[1] > MIN_SPREAD * spread[0]:
        raise BadInput("the points that are to place the scene lie on a line, which leaves the roll about it open: add one beside it.")


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
    kept = np.unique(ties.points[order[rank < TIES_PER_IMAGE]])
    own = ties.at(np.isin(ties.points, kept))
    some = replace(own, points=np.searchsorted(kept, own.points))
    return replace(bundle, points=bundle.points[kept], point_ids=bundle.point_ids[kept]), some


def _known(marked: _Marked | None, gps_m: FloatArray, gps_sigmas_m: FloatArray) -> Known:
    empty = Ties(images=np.zeros(0, np.int64), points=np.zeros(0, np.int64), pixels=np.zeros((0, 2)))
    rows, marks = (np.zeros(0, np.int64), empty) if marked is None else marked.rows(check=False)
    return Known(
        places_m=np.zeros((0, 3)) if marked is None else marked.places_m[rows],
        sigmas_m=np.ones(3) if marked is None else marked.sigmas_m,
        marks=marks,
        gps_m=gps_m,
        gps_sigmas_m=gps_sigmas_m,
        tie_sigma_px=FIRST_MARK_PX,
        mark_sigma_px=FIRST_MARK_PX,
    )


def _adjust_rounds(bundle: Bundle, ties: Ties, known: Known, marked: _Marked | None) -> tuple[Adjusted, Known]:
    """Adjust, see what ties and marks are good for, and adjust again."""
    # The old points are off by how far the start is from the survey; cameras are right among them.
    adjusted = adjust(bundle, ties, known)
    for _ in range(ROUNDS):
        known = with_sigmas(known, *_sigmas_px(adjusted, ties, marked))
        adjusted = adjust(adjusted.bundle, ties, known)
    return adjusted, known


def _sigmas_px(adjusted: Adjusted, ties: Ties, marked: _Marked | None) -> tuple[float, float]:
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
    adjusted: Adjusted, known: Known, marked: _Marked | None, control: ControlPoints | None, origin: FloatArray | None
) -> Surveyed:
    points: tuple[PointQuality, ...] = ()
    if marked is not None:
        rows, marks = marked.rows(check=False)
        points = control_points(adjusted, marks, tuple(marked.names[row] for row in rows), marked.places_m[rows])
        rows, marks = marked.rows(check=True)
        names = tuple(marked.names[row] for row in rows)
        points += check_points(adjusted, marks, names, marked.places_m[rows], marked.sigmas_m, known.mark_sigma_px)
    misses = known.gps_m - adjusted.bundle.centers - adjusted.shift_m
    has_gps = np.isfinite(misses).all(axis=1)
    rms = float(np.sqrt(np.mean(np.square(misses[has_gps])))) if has_gps.any() else None
    kind = "scaled" if origin is None else "metric"
    east, north, up = adjusted.shift_m.tolist()
    return Surveyed(
        frame=Frame(kind=kind, origin_lat_lon_alt=np.zeros(3) if origin is None else origin, residual_m=rms),
        points=points,
        control=summarize(tuple(point for point in points if not point.is_check)),
        check=summarize(tuple(point for point in points if point.is_check)),
        num_positions=int(has_gps.sum()),
        positions_rms_m=rms,
        shift_m=(east, north, up),
        tie_sigma_px=known.tie_sigma_px,
        mark_sigma_px=known.mark_sigma_px,
        system="WGS84" if control is None else control.system,
        warnings=(*(() if control is None else control.warnings), *(() if marked is None else marked.warnings), *_blunders(points, known)),
    )


def _blunders(points: tuple[PointQuality, ...], known: Known) -> tuple[str, ...]:
    """Warnings of points that are farther off than any noise."""
    found = []
    for point in points:
        sigma = np.array(point.expected_m) if point.is_check else np.hypot(known.sigmas_m, point.expected_m)
        worst = float(np.max(np.abs(point.residual_m) / sigma))
        if worst > BLUNDER_SIGMAS:
            kind = "check point" if point.is_check else "ground control point"
            found.append(
                f"{kind} {point.name!r} is {point.length_m:.3g} m from where the photographs have it, {worst:.0f} standard deviations: "
                "check its coordinates and its marks."
            )
    return tuple(found)
