"""Why a list of surveyed places does not lie where GPS has it. Once per list that contradicts.

    likely = argmin over mistakes of |undo(listed, mistake) − expected|

A mistake is named only where undoing it leaves a tenth of the distance at most, and no more than
the extent of a site. Where none does, the distance itself may speak: another datum moves places by
50 to 1,500 m. Zones of UTM have one
shape: the same numbers in the next one lie 6° of longitude away at the same latitude, those of the
other hemisphere 10,000 km of northing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.georef.crs import Crs
from radiant_core.map_projection import geodetic_from_utm, utm_epsg, utm_from_geodetic
from radiant_core.numerics import FloatArray, check_array

FEET_M = {"feet": 0.3048, "US survey feet": 1200 / 3937}
EARTH_RADIUS_M = 6_371_000.0
EXPLAINED = 0.1
"""Undoing a mistake leaves this share of the distance at most."""
SITE_M = 10_000.0
"""And so much at most: photographs and points are of one site."""
CLEARLY = 0.5
"""A later mistake has to leave less than this share of what a plainer one leaves."""
DATUM_M = (50.0, 1_500.0)
"""What another datum moves a place by: NAD27 some 50 m, ED50 150 m, Tokyo 450 m, GCJ-02 to 700."""
MIN_HEIGHT_OFF_M = 200.0
"""Photographs are taken from as high above a list's points, and the geoid is up to 107 m off."""


@dataclass(frozen=True, kw_only=True)
class PlaceDifference:
    """How far a list lies from where it is expected, and the mistake that explains it."""

    horizontal_m: float
    """Median distance on the globe."""
    vertical_m: float
    """Median of listed height minus expected height."""
    cause: str | None
    """The mistake, as a part of a sentence; None where nothing explains the difference."""


def place_difference(listed_lla: ArrayLike, expected_lla: ArrayLike, system: Crs | None = None) -> PlaceDifference:
    """How far listed places (N,3) [deg, deg, m] lie from the expected ones (N,3), or their
    middle from one place (3,), and why; as `likely_cause`."""
    listed, expected = _pairs(listed_lla, expected_lla)
    return PlaceDifference(
        horizontal_m=_off_m(listed, expected),
        vertical_m=float(np.median(listed[:, 2] - expected[:, 2])),
        cause=likely_cause(listed, expected, system),
    )


def likely_cause(listed_lla: ArrayLike, expected_lla: ArrayLike, system: Crs | None = None) -> str | None:
    """The mistake that explains why listed places (N,3) [deg, deg, m] lie off the expected ones
    (N,3), or their middle off one place (3,); None where nothing does, or they lie within 50 m and
    200 m of height. `system` is the list's: where it is known, axes and units of its plane are
    tried too. BadInput without places.

    Listed at 8.5° N 47.4° E, expected at 47.4° N 8.5° E: "latitude and longitude are exchanged".
    """
    listed, expected = _pairs(listed_lla, expected_lla)
    off_m = _off_m(listed, expected)
    if off_m < DATUM_M[0]:
        return _height_cause(listed, expected)
    best, left_m = None, min(EXPLAINED * off_m, SITE_M)
    for cause, undone in _undone(listed, expected, system):
        remaining_m = _off_m(undone, expected)
        if remaining_m < (left_m if best is None else CLEARLY * left_m):
            best, left_m = cause, remaining_m
    if best is None and off_m <= DATUM_M[1]:
        return "another datum moves places by so much, such as NAD27, ED50 or Tokyo taken for WGS84"
    return best


def _pairs(listed_lla: ArrayLike, expected_lla: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Listed and expected places, one for one; of one expected place the list's middle is the
    other."""
    listed = check_array("listed_lla", listed_lla, (None, 3))
    if not len(listed):
        raise BadInput("no listed places came: give at least one.")
    expected = np.asarray(expected_lla, np.float64)
    if expected.ndim != 1:
        return listed, check_array("expected_lla", expected, listed.shape)
    expected = check_array("expected_lla", expected, (3,))
    # Longitudes beside that of the first place, so that the 180th meridian cuts nothing.
    unwrapped = np.column_stack([listed[:, 0], _turned(listed[:, 1] - listed[0, 1]), listed[:, 2]])
    middle = np.median(unwrapped, axis=0)
    return np.array([[middle[0], _turned(middle[1] + listed[0, 1]), middle[2]]]), expected[None]


def _turned(degrees: FloatArray) -> FloatArray:
    """Longitudes within −180° to 180°."""
    return (degrees + 180) % 360 - 180


def _off_m(places: FloatArray, expected: FloatArray) -> float:
    """Median distance on a sphere by the haversine, which is exact for small angles too: 0.6 % off
    the ellipsoid at most."""
    (lat, lon), (lat_0, lon_0) = np.radians(places[:, :2].T), np.radians(expected[:, :2].T)
    half = np.sin((lat - lat_0) / 2) ** 2 + np.cos(lat) * np.cos(lat_0) * np.sin((lon - lon_0) / 2) ** 2
    return float(np.median(2 * EARTH_RADIUS_M * np.arcsin(np.sqrt(np.clip(half, 0, 1)))))


def _undone(listed: FloatArray, expected: FloatArray, system: Crs | None) -> Iterator[tuple[str, FloatArray]]:
    """Each mistake that can be undone and where the list lies without it, the plainest first."""
    lat, lon, alt = listed.T
    if (np.abs(lon) <= 90).all():
        yield "latitude and longitude are exchanged", np.column_stack([lon, lat, alt])
    yield "the sign of the latitude is wrong (south is negative)", np.column_stack([-lat, lon, alt])
    yield "the sign of the longitude is wrong (west is negative)", np.column_stack([lat, -lon, alt])
    yield "the signs of latitude and longitude are wrong", np.column_stack([-lat, -lon, alt])
    if system is None or system.unit_m is not None:
        yield from _other_zones(listed, expected)
        yield from _other_hemisphere(listed, expected, system)
    if system is not None and system.unit_m is not None:
        yield from _other_plane(listed, expected, system)


def _other_zones(listed: FloatArray, expected: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Of UTM, 6° wide, and of Gauss-Krüger, 3°."""
    off_deg = float(np.median(_turned(listed[:, 1] - expected[:, 1])))
    for width_deg in (6, 3):
        zones = round(off_deg / width_deg)
        if zones:
            lon = _turned(listed[:, 1] - zones * width_deg)
            count = "one zone" if abs(zones) == 1 else f"{abs(zones)} zones"
            cause = f"the zone is {count} of {width_deg}° too far {'east' if zones > 0 else 'west'}"
            yield cause + (_zone_of(expected) if width_deg == 6 else ""), np.column_stack([listed[:, 0], lon, listed[:, 2]])


def _zone_of(expected: FloatArray) -> str:
    lat, lon, _ = np.median(expected, axis=0).tolist()
    if not -80 <= lat <= 84:
        return ""
    code = utm_epsg(lat, lon)
    return f" (GPS is in UTM zone {code % 100}{'N' if code < 32700 else 'S'}, EPSG:{code})"


def _other_hemisphere(listed: FloatArray, expected: FloatArray, system: Crs | None) -> Iterator[tuple[str, FloatArray]]:
    """The same numbers in the zone of the other hemisphere, and there in another zone."""
    try:
        lat, lon, _ = np.median(listed, axis=0).tolist()
        code = system.horizontal_epsg if system is not None and system.is_builtin and system.horizontal_epsg else utm_epsg(lat, lon)
        opposite = code + 100 if code < 32700 else code - 100
        lat_lon = geodetic_from_utm(utm_from_geodetic(listed[:, :2], code), opposite)
    except BadInput:
        return
    places = np.column_stack([lat_lon, listed[:, 2]])
    yield f"the hemisphere of the zone is wrong{_zone_of(expected)}", places
    for cause, moved in _other_zones(places, expected):
        yield f"the hemisphere of the zone is wrong, and {cause}", moved


def _other_plane(listed: FloatArray, expected: FloatArray, system: Crs) -> Iterator[tuple[str, FloatArray]]:
    """The plane's numbers in another order or unit; what then lies outside of the system explains
    nothing."""
    try:
        east, north, up = _plane(listed, expected, system).T
    except BadInput:
        return
    tries = [("east and north are exchanged", north, east)]
    for name, foot_m in FEET_M.items():
        if system.unit_m == 1.0:
            tries.append((f"east and north are in {name}, taken for metres", east * foot_m, north * foot_m))
        else:
            tries.append((f"east and north are in metres, taken for {name}", east / foot_m, north / foot_m))
    for cause, x, y in tries:
        try:
            yield cause, system.to_geodetic(np.column_stack([x, y, up]))
        except BadInput:
            continue


def _plane(listed: FloatArray, expected: FloatArray, system: Crs) -> FloatArray:
    """East, north, up of listed places, also where the system is not used: mistakes lead there."""
    if system.is_builtin:
        return system.from_geodetic(listed)
    from radiant_core.georef.proj import middle_deg, project

    return project(system.definition, listed, system.title, middle_deg(expected))


def _height_cause(listed: FloatArray, expected: FloatArray) -> str | None:
    """What explains heights that differ though the plane fits."""
    up, up_0, foot_m = float(np.median(listed[:, 2])), float(np.median(expected[:, 2])), FEET_M["feet"]
    if abs(up - up_0) < MIN_HEIGHT_OFF_M:
        return None
    left_m = {"feet, taken for metres": abs(up * foot_m - up_0), "metres, taken for feet": abs(up / foot_m - up_0)}
    unit = min(left_m, key=lambda unit: left_m[unit])
    return f"heights are in {unit}" if left_m[unit] < MIN_HEIGHT_OFF_M else None
