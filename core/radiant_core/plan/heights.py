"""What heights of waypoints count from, and which are flown unasked. Once per plan.

A number alone is no height: the same 80 m are above take-off in one file, above the sea in another
and nothing at all in a third (`HeightFrom`). Most countries let drones of the open category fly up
to 120 m above the ground (EU 2019/947, UAS.OPEN.010; 400 ft, 122 m, in 14 CFR 107.51), so that what
lies beyond is more often feet, or heights from the sea, than meant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from radiant_core.choices import HeightFrom
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray

HEIGHT_KINDS: tuple[HeightFrom, ...] = get_args(HeightFrom)
USUAL_LIMIT_M = 120.0
"""Metres above take-off or ground that lists are written for unasked."""
ABOVE: dict[HeightFrom, str] = {
    "takeoff": "above take-off",
    "ground": "above the ground below each point",
    "sea": "above sea level",
    "ellipsoid": "above the WGS84 ellipsoid",
    "absolute": "above sea level or the ellipsoid, which is not said",
    "unknown": "not known",
}
FROM_THE_SEA: tuple[HeightFrom, ...] = ("sea", "ellipsoid", "absolute")
"""Kinds that say nothing of the ground below."""
HeightCodes = NDArray[np.uint8]
"""Places in `HEIGHT_KINDS`, one a waypoint."""


def height_codes(kinds: Sequence[HeightFrom]) -> HeightCodes:
    """The codes (P,) of kinds."""
    code_of = {kind: code for code, kind in enumerate(HEIGHT_KINDS)}
    return np.fromiter((code_of[kind] for kind in kinds), np.uint8, len(kinds))


def kinds_among(codes: HeightCodes) -> tuple[HeightFrom, ...]:
    """The kinds that codes (P,) are of, in the order of `HEIGHT_KINDS`."""
    return tuple(kind for code, kind in enumerate(HEIGHT_KINDS) if bool((codes == code).any()))


@dataclass(frozen=True, kw_only=True)
class HeightLimits:
    """Heights above take-off or ground that may be flown; BadInput where there are none."""

    lowest_m: float | None = None
    """The lowest one; None: anything above 0."""
    highest_m: float = USUAL_LIMIT_M

    def __post_init__(self) -> None:
        lowest_m = 0.0 if self.lowest_m is None else self.lowest_m
        if not (math.isfinite(self.highest_m) and math.isfinite(lowest_m) and lowest_m <= self.highest_m):
            raise BadInput(
                f"heights from {lowest_m:g} to {self.highest_m:g} m may be flown, expected numbers that rise: correct --min-height and "
                "--max-height."
            )

    def problem(self, names: Sequence[str], heights_m: FloatArray) -> str | None:
        """Why heights (P,), NaN where there is none, are not flown unasked, a whole sentence."""
        low = heights_m <= 0 if self.lowest_m is None else heights_m < self.lowest_m
        high = heights_m > self.highest_m
        for beyond, option in ((low, "--min-height"), (high, "--max-height")):
            rows = np.flatnonzero(beyond)
            if not len(rows):
                continue
            first = int(rows[0])
            worst_m = float(heights_m[rows].min() if option == "--min-height" else heights_m[rows].max())
            rounded = math.floor(worst_m) if option == "--min-height" else math.ceil(worst_m)
            return (
                f"{len(rows)} of {len(names)} heights are {self._side(option)}, {names[first]!r} first with {heights_m[first]:g} m, and "
                f"are not flown unasked (are they feet, or from the sea?): give {option} {rounded} where that may be flown, --ground with "
                "the ground's altitude where they count from the sea, or --height with one for all."
            )
        return None

    def _side(self, option: str) -> str:
        if option == "--max-height":
            return f"more than {self.highest_m:g} m above take-off or ground"
        return "not above take-off or ground" if self.lowest_m is None else f"below {self.lowest_m:g} m"


def said_heights(heights_m: FloatArray, codes: HeightCodes) -> str:
    """Heights (P,) and what they count from, such as "75 to 80 m above take-off"."""
    parts: list[str] = []
    for code, kind in enumerate(HEIGHT_KINDS):
        rows = codes == code
        if not rows.any():
            continue
        count_text = f" ({int(rows.sum())} waypoints)" if not rows.all() else ""
        parts.append(f"{'' if kind == 'unknown' else _range(heights_m[rows])}{ABOVE[kind]}{count_text}")
    return ", ".join(parts)


def _range(heights_m: FloatArray) -> str:
    low, high = (f"{value:.1f}".removesuffix(".0") for value in (float(heights_m.min()), float(heights_m.max())))
    return f"{low} m " if low == high else f"{low} to {high} m "
