"""`Waypoints`: where photographs will be taken, on the globe and in metres about their middle.

P waypoints. The origin is the mean position, longitudes counted from the first waypoint so that
sites across the 180th meridian have one too. Wrong positions that can be detected: a latitude
beyond 90° is certain; a waypoint more than 300 km from the median of all is on another site, and
where exchanging its latitude and longitude brings it back, they were swapped. Where every waypoint
is swapped and none exceeds 90° this cannot be detected: they make a plan of the same shape,
mirrored, elsewhere. Made once per plan.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.choices import HeightFrom
from radiant_core.errors import BadInput
from radiant_core.frames import MAX_REACH_M, enu_from_geodetic
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.heights import ABOVE, FROM_THE_SEA, HEIGHT_KINDS, HeightCodes, HeightLimits, height_codes, kinds_among

MIN_ALTITUDE_M, MAX_ALTITUDE_M = -12_000.0, 100_000.0
"""From the deepest sea to the edge of space."""
HIGHEST_FLIGHT_M = 500.0
"""Drones are not allowed so high above the ground anywhere we know of, and flight planners take no
more above take-off: larger altitudes of a column that does not say more are absolute."""
NO_ALTITUDES = "planned by horizontal positions alone, and the lists hold no height to fly at (give --height METRES above take-off)"
MAX_NAME_CHARACTERS = 255
SAME_SPOT_SCALE = np.array([1e8, 1e8, 1e3])
"""Degrees, degrees and metres are rounded to these parts, about a millimetre each, before two
waypoints are called one."""
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")


@dataclass(frozen=True, kw_only=True, eq=False)
class Waypoints:
    """names (P) unique; lat_lon_alt (P,3) degrees north, degrees east, metres of what
    `counts_from` says.

    BadInput, naming the first offender and how many there are, for positions that are not finite,
    off the globe, probably swapped or more than 300 km from the others, for no waypoint at all, and
    for names that are empty, come twice, or cannot be written.
    """

    names: tuple[str, ...]
    lat_lon_alt: FloatArray
    heading_pitch_deg: FloatArray | None = None
    """Where the camera looks (P,2): degrees clockwise from north, and −90 down to 90 up; NaN where
    a flight plan does not say, None where it says nothing at all."""
    counts_from: HeightFrom | HeightCodes = "takeoff"
    """What altitudes count from: one kind, or the code (P,) of each where they differ."""
    ground_m: float | None = None
    """Altitude of the ground, or of take-off, among absolute ones, where it is known."""
    limits: HeightLimits = field(default_factory=HeightLimits)
    """Heights that lists may be written for."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        if not self.names:
            raise BadInput("there is no waypoint: give at least one.")
        _require_names(self.names)
        _require_finite_rows(self.names, self.lat_lon_alt)
        object.__setattr__(self, "lat_lon_alt", check_array("lat_lon_alt", self.lat_lon_alt, (len(self.names), 3)))
        _require_on_the_globe(self.names, self.lat_lon_alt)
        _require_one_site(self.names, self.lat_lon_alt)
        if self.heading_pitch_deg is not None:
            object.__setattr__(self, "heading_pitch_deg", _check_angles(self.names, self.heading_pitch_deg))
        if self.ground_m is not None and not np.isfinite(self.ground_m):
            raise BadInput(f"the altitude of the ground is {self.ground_m}, expected metres.")
        if isinstance(self.counts_from, np.ndarray):
            object.__setattr__(self, "counts_from", _one_kind(self.counts_from, len(self.names)))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def origin(self) -> FloatArray:
        """Mean position (3,) [deg, deg, m], the origin of `positions_m`."""
        lat, lon, alt = self.lat_lon_alt.T
        first = lon[0]
        mean_lon = first + _wrap(lon - first).mean()
        return np.array([lat.mean(), float(_wrap(np.array([mean_lon]))[0]), alt.mean()])

    @property
    def positions_m(self) -> FloatArray:
        """Metres east, north, up (P,3) of `origin`."""
        return enu_from_geodetic(self.lat_lon_alt, self.origin)

    @property
    def heights_m(self) -> FloatArray | None:
        """Heights (P,) above ground or take-off, NaN where nothing says how far an altitude is
        above either of them; None where that is so everywhere."""
        altitudes = self.lat_lon_alt[:, 2]
        heights_m = np.where(self.counting_from("takeoff", "ground"), altitudes, np.nan)
        if self.ground_m is not None:
            heights_m = np.where(self.counting_from(*FROM_THE_SEA), altitudes - self.ground_m, heights_m)
        return None if np.isnan(heights_m).all() else heights_m

    @property
    def height_codes(self) -> HeightCodes:
        """The kind (P,) of each height, as its place in `HEIGHT_KINDS`."""
        if isinstance(self.counts_from, np.ndarray):
            return self.counts_from
        return np.full(len(self), HEIGHT_KINDS.index(self.counts_from), np.uint8)

    @property
    def height_kinds(self) -> tuple[HeightFrom, ...]:
        """The kinds of heights that there are."""
        if isinstance(self.counts_from, np.ndarray):
            return kinds_among(self.counts_from)
        return (self.counts_from,)

    def counting_from(self, *kinds: HeightFrom) -> NDArray[np.bool_]:
        """Whether a height (P,) is of one of these kinds."""
        if isinstance(self.counts_from, np.ndarray):
            return np.isin(self.counts_from, height_codes(kinds))
        return np.full(len(self), self.counts_from in kinds)

    @property
    def absolute(self) -> bool:
        """Whether all known altitudes count from the sea or the ellipsoid, as those of GPS."""
        return self.altitude_known and all(kind in (*FROM_THE_SEA, "unknown") for kind in self.height_kinds)

    @property
    def altitude_known(self) -> bool:
        """Whether any altitude counts from anything."""
        return self.height_kinds != ("unknown",)

    @property
    def height_problem(self) -> str | None:
        """Why the heights are beyond the limits, a whole sentence; None where they are not, or not
        known."""
        heights_m = self.heights_m
        return None if heights_m is None else self.limits.problem(self.names, heights_m)

    def with_ground(self, ground_m: float) -> Waypoints:
        """The same over ground at an altitude: those that a file gave without a word count from
        where the ground's does. BadInput where heights do not count from one thing, or from the
        ground already."""
        kinds: list[HeightFrom] = [kind for kind in self.height_kinds if kind != "unknown"]
        if len(kinds) != 1 or kinds == ["ground"]:
            from_what = ", ".join(ABOVE[kind] for kind in kinds) or ABOVE["unknown"]
            raise BadInput(f"--ground is the altitude of the ground among those of the waypoints, and these are {from_what}: leave it out.")
        # Numbers among which the ground lies anywhere but at 0 do not count from take-off.
        codes = self.height_codes.copy()
        if ground_m != 0:
            codes[self.counting_from("takeoff")] = HEIGHT_KINDS.index("absolute")
        return replace(self, counts_from=codes, ground_m=ground_m)

    def at_height(self, height_m: float) -> Waypoints:
        """The same, all of them so many metres above take-off; BadInput for no number."""
        if not math.isfinite(height_m):
            raise BadInput(f"--height is {height_m}, expected metres above take-off.")
        places = self.lat_lon_alt.copy()
        places[:, 2] = height_m
        return replace(self, lat_lon_alt=places, counts_from="takeoff", ground_m=None)

    def select(self, indices: ArrayLike) -> Waypoints:
        """The waypoints at `indices` (K,) int or of a mask (P,), in order; BadInput for none."""
        chosen: NDArray[Any] = np.asarray(indices)
        picked: list[int] = np.arange(len(self))[chosen].tolist()
        angles = None if self.heading_pitch_deg is None else self.heading_pitch_deg[picked]
        names = tuple(self.names[index] for index in picked)
        codes = self.counts_from[picked] if isinstance(self.counts_from, np.ndarray) else self.counts_from
        return replace(self, names=names, lat_lon_alt=self.lat_lon_alt[picked], heading_pitch_deg=angles, counts_from=codes)


def clean_waypoints(
    names: Sequence[str],
    lat_lon_alt: ArrayLike,
    counts_from: HeightFrom | HeightCodes = "takeoff",
    heading_pitch_deg: FloatArray | None = None,
) -> tuple[Waypoints, tuple[str, ...]]:
    """`Waypoints` of a repaired list, with one warning per kind of repair; raises as `Waypoints`. A
    position that comes twice is planned once, under its first name; a name that comes twice or is
    empty gets a number, without a warning where nothing has a name, as in a flight planner's file;
    an altitude that is "unknown" becomes 0, which moves a plan by less than 0.1 % of its size up to
    6,000 m."""
    positions = np.array(lat_lon_alt, dtype=np.float64)
    warnings: list[str] = []
    unknown = HEIGHT_KINDS.index("unknown")
    is_missing = counts_from == unknown if isinstance(counts_from, np.ndarray) else np.full(len(names), counts_from == "unknown")
    missing = np.flatnonzero(is_missing)
    if len(missing):
        positions[missing, 2] = 0.0
        some = f"{_count(len(missing), len(names))} without altitude, {_label(names, missing[0])} first: the lists hold no height for them."
        warnings.append(some if len(missing) < len(names) else f"None of {len(names)} waypoints has an altitude: {NO_ALTITUDES}.")
    has_names = any(names)
    names, numbered = _unique_names(names)
    if numbered and has_names:
        warnings.append(f"{numbered[0]} of {len(names)} names are empty or come twice, {numbered[1]!r} first: they were numbered.")
    waypoints = Waypoints(names=tuple(names), lat_lon_alt=positions, heading_pitch_deg=heading_pitch_deg, counts_from=counts_from)
    first_rows, again = _first_of_each_spot(positions)
    if len(again):
        warnings.append(f"{_count(len(again), len(names))} at a position that came before, {_label(names, again[0])} first: planned once.")
        waypoints = waypoints.select(first_rows)
    return waypoints, tuple(warnings)


def _one_kind(codes: HeightCodes, count: int) -> HeightFrom | HeightCodes:
    """Codes (P,), or their kind where it is one."""
    fixed: HeightCodes = codes.copy()
    if fixed.shape != (count,) or fixed.dtype != np.uint8 or int(fixed.max()) >= len(HEIGHT_KINDS):
        raise BadInput(
            f"counts_from has shape {fixed.shape} and type {fixed.dtype}, expected a kind, or the code of each of {count} waypoints."
        )
    if (fixed == fixed[0]).all():
        return HEIGHT_KINDS[int(fixed[0])]
    fixed.flags.writeable = False
    return fixed


def _unique_names(names: Sequence[str]) -> tuple[list[str], tuple[int, str] | None]:
    """Names (P) with a number behind those that came before; how many these are, and the first of
    them. Linear in P."""
    used_names = set(names)
    if len(used_names) == len(names) and "" not in used_names:
        return list(names), None
    visited: set[str] = set()
    next_number: dict[str, int] = {}
    unique: list[str] = []
    changed, first = 0, ""
    for name in names:
        new = name
        if not name or name in visited:
            stem = name or "wp"
            number = next_number.get(stem, 1 if not name else 2)
            while (new := f"{stem}-{number}") in used_names:
                number += 1
            next_number[stem] = number + 1
            used_names.add(new)
            changed, first = changed + 1, first if changed else name
        visited.add(new)
        unique.append(new)
    return unique, (changed, first) if changed else None


def _first_of_each_spot(positions: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of the first waypoint at each position in order, and of all others."""
    rounded = np.round(positions * SAME_SPOT_SCALE).T
    order = np.lexsort(rounded)  # stable: equal positions stay in the order of the list
    repeats = (np.diff(rounded[:, order], axis=1) == 0).all(axis=0)
    is_first = np.ones(len(positions), dtype=bool)
    is_first[order[1:][repeats]] = False
    return np.flatnonzero(is_first), np.flatnonzero(~is_first)


def _require_names(names: tuple[str, ...]) -> None:
    if not all(names):
        raise BadInput(f"waypoint number {names.index('') + 1} has no name: give every waypoint one.")
    if len(set(names)) != len(names):
        visited: set[str] = set()
        twice = next(name for name in names if name in visited or visited.add(name))
        raise BadInput(f"the waypoint name {twice!r} comes twice: give every waypoint its own.")
    longest = max(names, key=len)
    if len(longest) > MAX_NAME_CHARACTERS:
        raise BadInput(f"the waypoint name {longest[:40]!r}… has {len(longest)} characters, expected at most {MAX_NAME_CHARACTERS}.")
    joined = "".join(names)
    try:
        joined.encode()
    except UnicodeEncodeError as error:
        raise BadInput(f"a waypoint name has {joined[error.start]!r}, half a character that no file can hold: rename it.") from error
    if _CONTROL.search(joined):
        name = next(name for name in names if _CONTROL.search(name))
        raise BadInput(f"the waypoint name {name!r} holds a control character: rename it.")


def _require_finite_rows(names: tuple[str, ...], lat_lon_alt: ArrayLike) -> None:
    """Name the first waypoint with NaN or Inf; wrong shapes and types are left to `check_array`."""
    array = np.asarray(lat_lon_alt)
    if array.shape == (len(names), 3) and array.dtype.kind == "f":
        bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
        if len(bad):
            raise BadInput(
                f"{_count(len(bad), len(names))} with a position that is not finite, {_label(names, bad[0])} first: "
                "give latitude, longitude and altitude as numbers."
            )


def _require_on_the_globe(names: tuple[str, ...], lat_lon_alt: FloatArray) -> None:
    lat, lon, alt = lat_lon_alt.T
    off = np.flatnonzero((np.abs(lat) > 90) | (np.abs(lon) > 180))
    if len(off):
        first = int(off[0])
        swapped = abs(lat[first]) <= 180 and abs(lon[first]) <= 90
        advice = (
            "latitude and longitude are probably swapped, exchange them (GeoJSON and KML write longitude first)"
            if swapped
            else "give degrees in WGS84, not metres of a map projection"
        )
        raise BadInput(
            f"{_count(len(off), len(names))} off the globe, {_label(names, first)} first with latitude {lat[first]:g}° and longitude "
            f"{lon[first]:g}°: {advice}."
        )
    high = np.flatnonzero((alt < MIN_ALTITUDE_M) | (alt > MAX_ALTITUDE_M))
    if len(high):
        raise BadInput(
            f"{_count(len(high), len(names))} at an altitude nobody flies at, {_label(names, high[0])} first with {alt[high[0]]:g} m: "
            "give altitudes in metres."
        )


def _check_angles(names: tuple[str, ...], heading_pitch_deg: ArrayLike) -> FloatArray:
    angles = np.array(heading_pitch_deg, dtype=np.float64)
    if angles.shape != (len(names), 2):
        raise BadInput(f"heading_pitch_deg has shape {angles.shape}, expected ({len(names)}, 2): give two angles per waypoint.")
    heading, pitch = angles.T
    wrong = np.flatnonzero(np.isinf(angles).any(axis=1) | (np.abs(heading) > 720) | (np.abs(pitch) > 90))
    if len(wrong):
        first = int(wrong[0])
        raise BadInput(
            f"{_count(len(wrong), len(names))} looking nowhere, {_label(names, first)} first with heading {heading[first]:g}° and pitch "
            f"{pitch[first]:g}°: give headings from north and pitches from −90 (down) to 90 in degrees."
        )
    angles.flags.writeable = False
    return angles


def _require_one_site(names: tuple[str, ...], lat_lon_alt: FloatArray) -> None:
    lat, lon = lat_lon_alt[:, 0], lat_lon_alt[0, 1] + _wrap(lat_lon_alt[:, 1] - lat_lon_alt[0, 1])
    middle = np.array([np.median(lat), float(_wrap(np.array([np.median(lon)]))[0]), 0.0])
    level = np.array([1.0, 1.0, 0.0])
    away_m = np.linalg.norm(enu_from_geodetic(lat_lon_alt * level, middle), axis=1)
    far = np.flatnonzero(away_m > MAX_REACH_M)
    if not len(far):
        return
    first = int(far[0])
    there = (
        f"{_count(len(far), len(names))} more than {MAX_REACH_M / 1e3:.0f} km from the middle of all, {_label(names, first)} first with "
        f"{away_m[first] / 1e3:,.0f} km"
    )
    exchanged = np.array([[lat_lon_alt[first, 1], lat_lon_alt[first, 0], 0.0]])
    if abs(exchanged[0, 0]) <= 90 and np.linalg.norm(enu_from_geodetic(exchanged, middle)) <= MAX_REACH_M:
        raise BadInput(f"{there}: with its latitude and longitude exchanged it lies among the others, so exchange them there.")
    raise BadInput(f"{there}: check whether its latitude and longitude are right and not swapped, or plan each site on its own.")


def _wrap(degrees: FloatArray) -> FloatArray:
    """Angles in [−180°, 180°]; those that are there already keep every digit."""
    return np.where(np.abs(degrees) <= 180, degrees, (degrees + 180) % 360 - 180)


def _count(some: int, of_all: int) -> str:
    return f"{some} of {of_all} waypoints"


def _label(names: Sequence[str], index: int) -> str:
    return f"{names[index]!r} (number {index + 1})"
