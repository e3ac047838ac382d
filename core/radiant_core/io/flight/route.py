"""`Route`: one device's waypoints in the order that they are flown, ready to be written, each with
a height that is known, and what it counts from. Once per device.

Formats differ in what they can let a height count from, so that a writer takes the kinds it knows
and refuses others: 80 m above the sea are no 80 m above take-off, and the sea's level is up to
107 m off the ellipsoid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.choices import HeightFrom, Heights
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.heights import ABOVE, FROM_THE_SEA, HEIGHT_KINDS, HeightCodes, kinds_among
from radiant_core.plan.waypoints import Waypoints

LEVEL_GROUND = "which stood in the waypoints as heights above the ground below each point: level ground is taken for granted"
NEEDS_GEOID = (
    "give --geoid with the metres that the sea's level lies above the WGS84 ellipsoid there (47 in Zurich, −33 in New York), or --ground "
    "for heights above take-off"
)


@dataclass(frozen=True, kw_only=True)
class FlownHeights:
    """Which heights lists are to have."""

    heights: Heights | None = None
    """None: above take-off where that is known, else as they are."""
    geoid_m: float | None = None
    """Metres that the sea's level lies above the WGS84 ellipsoid."""

    def __post_init__(self) -> None:
        # EGM2008 lies between −107 and 86 m.
        if self.geoid_m is not None and not -120 <= self.geoid_m <= 120:
            raise BadInput(f"--geoid is {self.geoid_m} m, expected how far the sea's level lies above the WGS84 ellipsoid, −120 to 120.")


@dataclass(frozen=True, kw_only=True, eq=False)
class Route:
    """lat_lon (P,2) deg; heights_m (P,) of the kinds `height_codes` (P,) in `HEIGHT_KINDS`, none of
    them unknown; heading_pitch_deg (P,2), NaN where a plan does not say."""

    name: str
    names: tuple[str, ...]
    lat_lon: FloatArray
    heights_m: FloatArray
    height_codes: HeightCodes
    heading_pitch_deg: FloatArray
    speed_m_per_s: float
    geoid_m: float | None = None
    level_ground: bool = False
    """Whether heights above the ground are taken for heights above take-off."""

    @property
    def kinds(self) -> tuple[HeightFrom, ...]:
        """The kinds of heights that there are."""
        return kinds_among(self.height_codes)

    @property
    def heights_text(self) -> str:
        """What heights count from, for the files."""
        text = "heights are " + " or ".join(ABOVE[kind] for kind in self.kinds or ("takeoff",))
        return f"{text}, {LEVEL_GROUND}" if self.level_ground else text

    def heights_above(self, level: HeightFrom) -> FloatArray:
        """Heights (P,), all absolute ones from the sea or from the ellipsoid; BadInput where the
        geoid that this needs is not known."""
        if set(self.kinds) & set(FROM_THE_SEA) - {level}:
            _require_geoid(self, level)
        is_sea = self.height_codes == HEIGHT_KINDS.index("sea")
        offset = 0.0 if self.geoid_m is None else self.geoid_m
        return self.heights_m + offset * (is_sea.astype(np.float64) - (level == "sea"))


def _require_geoid(route: Route, level: HeightFrom) -> None:
    if "absolute" in route.kinds:
        raise BadInput(
            f"this list needs heights {ABOVE[level]}, and nothing says whether the altitudes count from the sea or the ellipsoid, up to "
            "107 m apart: give --ground for heights above take-off."
        )
    if route.geoid_m is None:
        others = " or ".join(ABOVE[kind] for kind in route.kinds if kind in FROM_THE_SEA and kind != level)
        raise BadInput(f"this list needs heights {ABOVE[level]}, and the waypoints have some {others}: {NEEDS_GEOID}.")


def routes_heights(waypoints: Waypoints, flown: FlownHeights) -> tuple[FloatArray, HeightCodes]:
    """The heights (P,) that are flown, and their kinds. BadInput, with what to give, where one is
    not known or of another kind than was asked for, and where they are beyond the limits."""
    heights_m, codes = (
        _above_take_off(waypoints) if flown.heights == "takeoff" else _as_they_are(waypoints, absolute=flown.heights == "absolute")
    )
    problem = waypoints.height_problem
    if problem is not None:
        raise BadInput(problem)
    return heights_m, codes


def _above_take_off(waypoints: Waypoints) -> tuple[FloatArray, HeightCodes]:
    heights_m = waypoints.heights_m
    _require_known(waypoints)
    if heights_m is None or np.isnan(heights_m).any():
        raise BadInput(
            "heights above take-off are asked for, and nothing says how far the positions lie above the ground: give --ground, or --height."
        )
    return heights_m, np.full(len(waypoints), HEIGHT_KINDS.index("takeoff"), np.uint8)


def _as_they_are(waypoints: Waypoints, *, absolute: bool) -> tuple[FloatArray, HeightCodes]:
    _require_known(waypoints)
    if absolute:
        if not waypoints.counting_from(*FROM_THE_SEA).all():
            raise BadInput("absolute heights are asked for, and the positions have none: they count from take-off, or from the ground.")
        return waypoints.lat_lon_alt[:, 2], waypoints.height_codes
    if waypoints.ground_m is not None:
        return _above_take_off(waypoints)
    return waypoints.lat_lon_alt[:, 2], waypoints.height_codes


def _require_known(waypoints: Waypoints) -> None:
    missing = np.flatnonzero(waypoints.counting_from("unknown"))
    if len(missing):
        raise BadInput(
            f"{len(missing)} of {len(waypoints)} waypoints have no height to fly at, {waypoints.names[missing[0]]!r} first: give --height "
            "with metres above take-off for all of them."
        )


def route_of(name: str, waypoints: Waypoints, indices: NDArray[np.int64], flown: FlownHeights, speed_m_per_s: float) -> Route:
    """The route of some waypoints; raises as `routes_heights` for any of them all."""
    heights_m, codes = routes_heights(waypoints, flown)
    angles = waypoints.heading_pitch_deg
    return Route(
        name=name,
        names=tuple(waypoints.names[index] for index in indices.tolist()),
        lat_lon=waypoints.lat_lon_alt[indices, :2],
        heights_m=heights_m[indices],
        height_codes=codes[indices],
        heading_pitch_deg=np.full((len(indices), 2), np.nan) if angles is None else angles[indices],
        speed_m_per_s=speed_m_per_s,
        geoid_m=flown.geoid_m,
        level_ground=flown.heights == "takeoff" and "ground" in waypoints.height_kinds,
    )
