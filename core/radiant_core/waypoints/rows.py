"""`WaypointRows`: what a reader gathers for `clean_waypoints`, 24 bytes and a name each."""

from __future__ import annotations

from array import array
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from radiant_core.choices import HeightFrom
from radiant_core.errors import BadInput
from radiant_core.georef.crs import Crs
from radiant_core.numerics import FloatArray
from radiant_core.plan.heights import HEIGHT_KINDS, HeightCodes


class WaypointRows:
    """Names and positions in the file's order; a missing name is empty, a missing altitude None,
    and one that is there counts from what the format says."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.ignored: Counter[str] = Counter()
        """What the file holds besides waypoints, by kind."""
        self.notes: list[str] = []
        """What a user is to know of how heights were read, a sentence each."""
        self.shortfall: str | None = None
        """Which grids the system of the file lacks, and what that costs."""
        self._numbers = array("d")
        self._codes = bytearray()
        self._angles = array("d")

    def add(
        self,
        name: str,
        lat_lon: tuple[float, float],
        alt: float | None,
        counts_from: HeightFrom,
        heading_pitch_deg: tuple[float, float] = (np.nan, np.nan),
    ) -> None:
        """One waypoint; runs of white space in its name become one blank. An altitude that is
        "unknown" is none, whatever number stands there."""
        self._angles.extend(heading_pitch_deg)
        self.names.append(" ".join(name.split()))
        has_height = alt is not None and counts_from != "unknown"
        self._numbers.extend((*lat_lon, alt if has_height and alt is not None else 0.0))
        self._codes.append(HEIGHT_KINDS.index(counts_from if has_height else "unknown"))

    def set_height(self, row: int, alt: float, counts_from: HeightFrom) -> None:
        """What was read of a waypoint's height behind the waypoint itself."""
        self._numbers[3 * row + 2] = alt
        self._codes[row] = HEIGHT_KINDS.index(counts_from)

    def reckon(self, was: HeightFrom, counts_from: HeightFrom) -> None:
        """Let all heights of one kind be of another."""
        self._codes = self._codes.replace(bytes([HEIGHT_KINDS.index(was)]), bytes([HEIGHT_KINDS.index(counts_from)]))

    def move_from(self, system: Crs, has_its_height: NDArray[np.bool_]) -> None:
        """Take what was read as latitude and longitude for north and east in a system, and
        altitudes (P,) of those that have its height for heights in its unit over its datum, if it
        has one. BadInput for places that it does not have."""
        recorded = self.lat_lon_alt
        geodetic = system.to_geodetic(recorded[:, [1, 0, 2]])
        if not system.vertical_name:
            # Heights that count from nothing are metres now, and no shift of datum is theirs.
            geodetic[:, 2] = recorded[:, 2] * system.height_unit_m
        geodetic[:, 2] = np.where(has_its_height, geodetic[:, 2], recorded[:, 2])
        self._numbers = array("d", geodetic.ravel().tolist())
        if len(geodetic):
            self.shortfall = system.shortfall_over(geodetic)

    @property
    def lat_lon_alt(self) -> FloatArray:
        """Positions (P,3) as they were read."""
        return np.array(self._numbers).reshape(len(self.names), 3)

    @property
    def heading_pitch_deg(self) -> FloatArray | None:
        """Where the camera looks (P,2), NaN where unknown; None where the file never says."""
        angles = np.array(self._angles).reshape(len(self.names), 2)
        return None if np.isnan(angles).all() else angles

    @property
    def height_codes(self) -> HeightCodes:
        """What altitudes count from (P,), as places in `HEIGHT_KINDS`."""
        return np.frombuffer(bytes(self._codes), np.uint8)


def number(text: str, subject: str) -> float:
    """A number as text; BadInput naming `subject` when it is none. NaN and Inf pass: the waypoint
    they belong to is named later."""
    try:
        if "_" in text:  # Python's own way of writing 1_000
            raise ValueError
        return float(text)
    except ValueError:
        hint = "write decimals with a point" if "," in text else "write degrees and metres as plain numbers"
        raise BadInput(f"{subject} is {text[:40]!r}, no number: {hint}.") from None
