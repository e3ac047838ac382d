"""Cameras placed by ground control against their GPS: place, height, scale, north and up. Once per
scene.

Where a list has a place on the globe, all of them must agree; of a site without one (LOCAL) the
scale must. GPS shifts by some 20 m as a whole, heights by the geoid (up to 107 m) and by altitudes
that count from elsewhere, so that a height alone never stops the work. Altitudes that drift during
a flight tilt what is fitted to them, and stretch it: where photographs would be rolled by that,
only the plane of GPS is compared.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.frames import Frame, Sim3, geodetic_from_enu
from radiant_core.geometry.align import Alignment, robust_sim3
from radiant_core.georef.control_points import ControlRequest, system_of
from radiant_core.georef.likely_cause import likely_cause
from radiant_core.io.photos.listing import Photograph
from radiant_core.numerics import FloatArray
from radiant_core.sfm.colmap.pairs import gps_about, gps_positions
from radiant_core.sfm.control.before_matching import cause_text, distance_text, listed_system
from radiant_core.sfm.control.priors import accurate_positions, are_enough
from radiant_core.sfm.world_frame.contradictions import (
    FOOT_M,
    GROSS_LEAN_DEG,
    GROSS_SCALE,
    GROSS_SIGMAS,
    GROSS_TURN_DEG,
    NOTABLE_LEAN_DEG,
    NOTABLE_SCALE,
    NOTABLE_SIGMAS,
    NOTABLE_TURN_DEG,
    UNIT_SHARE,
    Contradiction,
    drift_factor,
    heading_sigma_deg,
    scale_sigma,
)
from radiant_core.sfm.world_frame.orient import level_fit
from radiant_core.sfm.world_frame.up import roll_deg
from radiant_core.sfm.world_frame.world import MAX_GPS_ROLL_DEG

NOTABLE_SHIFT_M, GROSS_SHIFT_M = 30.0, 200.0
"""Beyond what consumer receivers are off as a whole; beyond all of them and most datums."""
ACCURATE_SHIFT_M = 5.0
"""Of positions of known accuracy: their base may stand on a place known to metres."""
SPREADS = 5.0
"""A shift within so many median residuals is their noise."""
NOTABLE_HEIGHT_M = 120.0
"""The geoid is up to 107 m from the ellipsoid."""
MIN_POSITIONS = 4
"""Three positions fit any similarity."""
UPSIDE_DOWN = 0.3
"""Mean of what is up in photographs that look down or ahead, along up, is above 0.7 as a rule."""
LIST_UP = np.array([0.0, 0.0, 1.0])


def against_gps(cameras: Cameras, frame: Frame, photographs: tuple[Photograph, ...], request: ControlRequest) -> tuple[Contradiction, ...]:
    """What of a frame by a list of ground control contradicts the cameras themselves and their
    photographs' GPS, which need not be known."""
    by_name = {photo.name: photo for photo in photographs}
    placed = tuple(by_name[name] for name in cameras.names)
    gps_m = gps_about(placed, frame.origin_lat_lon_alt) if frame.kind == "metric" else gps_positions(placed)[0]
    has_gps = np.isfinite(gps_m[:, 0])
    contradictions = list(_upside_down(cameras, request.source))
    if not has_gps.any():
        return tuple(contradictions)
    centers, gps_m = cameras.centers[has_gps], gps_m[has_gps]
    if frame.kind == "metric":
        accurate = are_enough(accurate_positions(placed)[0])
        contradictions += _shifts(centers, gps_m, frame, request, ACCURATE_SHIFT_M if accurate else NOTABLE_SHIFT_M)
    high = np.isfinite(gps_m[:, 2])
    if high.sum() >= MIN_POSITIONS:
        high_cameras = cameras.select(np.flatnonzero(has_gps)[high])
        contradictions += _turns(high_cameras, gps_m[high], request.source, on_globe=frame.kind == "metric")
    return tuple(contradictions)


def _upside_down(cameras: Cameras, source: str) -> Iterator[Contradiction]:
    """Points in a plane fit their own mirror image from below."""
    upward = -(cameras.cam_from_world[:, 2, :3] + cameras.cam_from_world[:, 1, :3]).mean(axis=0)
    if upward[2] < -UPSIDE_DOWN:
        yield Contradiction(
            sentence=f"{source} turns the scene upside down: all photographs would look up; likely cause: east and north are exchanged, or "
            "heights have the wrong sign",
            is_gross=True,
            outcome="the list is taken",
            remedy="correct the order and signs of its coordinates, unless the photographs do look up",
        )


def _shifts(centers: FloatArray, gps_m: FloatArray, frame: Frame, request: ControlRequest, floor_m: float) -> Iterator[Contradiction]:
    away_m = (centers - gps_m)[:, :2]
    shift_m = np.median(away_m, axis=0)
    off_m, spread_m = float(np.linalg.norm(shift_m)), float(np.median(np.linalg.norm(away_m - shift_m, axis=1)))
    high = np.isfinite(gps_m[:, 2])
    system = system_of(listed_system(request), request.source)
    listed, expected = (geodetic_from_enu(places, frame.origin_lat_lon_alt) for places in (centers, np.nan_to_num(gps_m)))
    # Not along the axis up of the one place, from which the globe curves away: 16 km in 457 km.
    rise_m = float(np.median((listed - expected)[high, 2])) if high.any() else 0.0
    if off_m > max(floor_m, SPREADS * spread_m):
        yield Contradiction(
            sentence=f"{request.source} and the photographs' GPS contradict each other: by the list the photographs were taken "
            f"{distance_text(off_m)} from where GPS has them (median){cause_text(likely_cause(listed, expected, system))}",
            is_gross=off_m > max(GROSS_SHIFT_M, 2 * SPREADS * spread_m),
            outcome="the list is taken",
            remedy="correct the list's first line or its coordinates",
        )
    if abs(rise_m) > NOTABLE_HEIGHT_M:
        cause = likely_cause(listed[high], np.column_stack([listed[high, :2], expected[high, 2]]), system)
        side = "above" if rise_m > 0 else "below"
        yield Contradiction(
            sentence=f"{request.source} puts the photographs {abs(rise_m):,.0f} m {side} their GPS altitudes, more than a geoid"
            f"{cause_text(cause or 'altitudes that count from take-off, or heights in another unit')}",
            is_gross=False,
            outcome="the list is taken",
            remedy="correct its heights",
        )


def _turns(cameras: Cameras, gps_m: FloatArray, source: str, *, on_globe: bool) -> Iterator[Contradiction]:
    """Of a similarity from the list's frame to GPS, which should be none but for a shift."""
    fit = robust_sim3(cameras.centers, gps_m)
    gps_from_list = _gps_from_list(cameras, gps_m, fit)
    if gps_from_list is None:
        return
    ratio, sigma = gps_from_list.scale, scale_sigma(fit)
    off = abs(float(np.log(ratio)))
    if off > max(NOTABLE_SCALE, NOTABLE_SIGMAS * sigma):
        foot = abs(np.log(ratio / FOOT_M)) < UNIT_SHARE
        yield Contradiction(
            sentence=f"{source} and the photographs' GPS contradict each other: a metre of the list is {ratio:.3g} m by GPS, whose "
            f"scale is known to {100 * sigma:.2g} %{cause_text('the coordinates are in feet' if foot else None)}",
            is_gross=off > max(GROSS_SCALE, GROSS_SIGMAS * sigma),
            outcome="the list is taken",
            remedy="correct the unit of its coordinates",
        )
    if not on_globe or fit.status != "ok":
        return
    rotation, sigma_deg = gps_from_list.rotation, heading_sigma_deg(fit)
    lean_deg = float(np.degrees(np.arccos(np.clip(rotation[2, 2], -1, 1))))
    turn_deg = abs(float(np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))))
    if lean_deg > max(NOTABLE_LEAN_DEG, NOTABLE_SIGMAS * float(np.degrees(fit.tilt_error_rad)) * drift_factor(fit)):
        yield Contradiction(
            sentence=f"{source} puts up {lean_deg:.0f}° away from where the photographs' GPS has it",
            is_gross=lean_deg > GROSS_LEAN_DEG,
            outcome="the list is taken",
            remedy="correct the order and signs of its coordinates",
        )
    elif turn_deg > max(NOTABLE_TURN_DEG, NOTABLE_SIGMAS * sigma_deg):
        yield Contradiction(
            sentence=f"{source} and the photographs' GPS contradict each other: north of the list is {turn_deg:.0f}° away from that of "
            f"GPS, which is known to {sigma_deg:.1f}°",
            is_gross=turn_deg > max(GROSS_TURN_DEG, GROSS_SIGMAS * sigma_deg),
            outcome="the list is taken",
            remedy="correct the order and signs of its coordinates",
        )


def _gps_from_list(cameras: Cameras, gps_m: FloatArray, fit: Alignment) -> Sim3 | None:
    """What `fit` found, without its tilt where altitudes make that; None where GPS says nothing."""
    if fit.target_from_source is None or fit.status == "inconsistent":
        return None
    rolled_deg = roll_deg(cameras, fit.target_from_source.rotation[2])
    if fit.status != "ok" or rolled_deg <= max(MAX_GPS_ROLL_DEG, 2 * roll_deg(cameras, LIST_UP)):
        return fit.target_from_source
    return level_fit(cameras.centers[fit.inliers], gps_m[fit.inliers], LIST_UP)
