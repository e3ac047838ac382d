"""Which surveyed points and positions an adjustment rests on, and when too few do. Once per scene.

Robust weights let an adjustment pass over what does not fit; what it then rests on may be little. A
point counts where two of its marks do and its difference is within four standard deviations, or
within four times what is usual among the others where the survey is worse than was said. A fit that
passes over more than half of its points, or leaves fewer than fix a scene, is none; and where it
passes over any, the three that nearly fit whatever they are have to be checked by a fourth.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.sfm.control.before_matching import MIN_CONTROL
from radiant_core.sfm.control.quality import PointQuality

BLUNDER_SIGMAS = 4.0
MAX_NAMED = 5
MAX_MISFIT_SHARE, MISFIT_SIGMAS = 0.05, 10.0
"""Points that miss by more than this share of their extent are not those of the photographs."""
CLAIMED_TIMES = 10.0
"""Positions that miss by so many times what they claim are not of that accuracy."""


def sigmas_off(point: PointQuality, sigmas_m: FloatArray) -> float:
    """By how many standard deviations of the survey (3,) and the photographs a point is off."""
    sigma = np.array(point.expected_m) if point.is_check else np.hypot(sigmas_m, point.expected_m)
    return float(np.max(np.abs(point.residual_m) / sigma))


def with_counts(points: tuple[PointQuality, ...], sigmas_m: FloatArray) -> tuple[PointQuality, ...]:
    """The same points, all control or all checks, with whether each counts."""
    off = {point.name: sigmas_off(point, sigmas_m) for point in points if point.is_seen}
    limit = BLUNDER_SIGMAS * max(1.0, float(np.median(list(off.values()))) if off else 1.0)
    return tuple(replace(point, counts=point.is_seen and off[point.name] <= limit) for point in points)


def require_counting(points: tuple[PointQuality, ...], sigmas_m: FloatArray, extent_m: float, *, checked: bool) -> None:
    """Raise BadInput where most control points, which extend over `extent_m`, do not count, those
    that do fit anyhow and are not `checked` by others, or all are off by a good part of that."""
    counting = [point for point in points if point.counts]
    least = MIN_CONTROL if checked or len(counting) == len(points) else MIN_CONTROL + 1
    if len(counting) < max(least, len(points) / 2):
        anyhow = f", for any {MIN_CONTROL} nearly fit" if least > MIN_CONTROL else ""
        raise BadInput(
            f"ground control does not fit the photographs: {len(counting)} of {len(points)} points count, expected half of them and "
            f"{least} or more{anyhow} ({said_of(points)}): check marks, and order, signs and units of coordinates, and whether marks "
            "count in photographs as stored."
        )
    missed_m = float(np.median([point.length_m for point in counting]))
    if missed_m > MAX_MISFIT_SHARE * extent_m and missed_m > MISFIT_SIGMAS * float(sigmas_m.max()):
        raise BadInput(
            f"ground control does not fit the photographs: its points miss their places by {missed_m:.3g} m (median) over {extent_m:.3g} "
            "m: check the order and units of its coordinates, and whether marks count in photographs as stored."
        )


def misfit_doubt(points: tuple[PointQuality, ...], sigmas_m: FloatArray) -> tuple[str, ...]:
    """A doubt where control points as a whole miss by far more than their survey's deviations."""
    off = [sigmas_off(point, sigmas_m) for point in points if point.is_seen]
    if not off or float(np.median(off)) <= BLUNDER_SIGMAS:
        return ()
    return (
        f"ground control misses the photographs by {float(np.median(off)):.0f} standard deviations (median): it is worse than "
        f"± {float(sigmas_m.max()):.2g} m (--gcp-accuracy), or some of its coordinates or marks are wrong.",
    )


def said_of(points: tuple[PointQuality, ...]) -> str:
    """The points that do not count, each with the reason."""
    uncounted = [point for point in points if not point.counts]
    named = [f"{point.name}: {reason_of(point)}" for point in uncounted[:MAX_NAMED]]
    return "; ".join([*named, f"{len(uncounted) - MAX_NAMED} more"] if len(uncounted) > MAX_NAMED else named)


def reason_of(point: PointQuality) -> str:
    """Why a point does not count."""
    if not point.is_seen:
        return f"{point.num_counting} of {point.num_images} marks fit"
    return f"{point.length_m:.3g} m off"


def counting_positions(misses_m: FloatArray, sigmas_m: FloatArray) -> NDArray[np.bool_]:
    """Which positions (C,3), NaN where there is none, count, as points do."""
    off = np.max(np.abs(misses_m) / sigmas_m, axis=1)
    is_finite = np.isfinite(off)
    if not is_finite.any():
        return is_finite
    return is_finite & (np.nan_to_num(off, nan=np.inf) <= BLUNDER_SIGMAS * max(1.0, float(np.median(off[is_finite]))))


def claim_warning(misses_m: FloatArray, sigmas_m: FloatArray) -> tuple[str, ...]:
    """A warning where positions (C,3) miss by far more than they claim (C,3)."""
    is_finite = np.isfinite(misses_m).all(axis=1)
    if not is_finite.any():
        return ()
    missed_m, claimed_m = (float(np.median(np.linalg.norm(values[is_finite], axis=1))) for values in (misses_m, sigmas_m))
    if missed_m <= CLAIMED_TIMES * claimed_m:
        return ()
    return (
        f"camera positions claim to be known to {claimed_m:.2g} m and miss the photographs' geometry by {missed_m:.2g} m (median): they "
        "are not so accurate, or photographs are placed wrongly.",
    )
