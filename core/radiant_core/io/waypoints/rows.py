"""`WaypointRows`: what a reader gathers for `clean_waypoints`, 24 bytes and a name each."""

from __future__ import annotations

from array import array
from collections import Counter

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.georef.crs import Crs
from radiant_core.numerics import FloatArray


class WaypointRows:
    """Names and positions in the file's order; a missing name is empty, a missing altitude None."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.ignored: Counter[str] = Counter()
        """What the file holds besides waypoints, by kind."""
        self.absolute = False
        """Whether the file says that its altitudes count from the sea."""
        self.shortfall: str | None = None
        """Which grids the system of the file lacks, and what that costs."""
        self._numbers = array("d")
        self._no_altitude = bytearray()
        self._angles = array("d")

    def add(self, name: str, lat: float, lon: float, alt: float | None, heading_pitch_deg: tuple[float, float] = (np.nan, np.nan)) -> None:
        """One waypoint; runs of white space in its name become one blank."""
        self._angles.extend(heading_pitch_deg)
        self.names.append(" ".join(name.split()))
        self._numbers.extend((lat, lon, 0.0 if alt is None else alt))
        self._no_altitude.append(alt is None)

    def move_from(self, system: Crs) -> None:
        """Take what was read as latitude and longitude for north and east in a system, and
        altitudes for heights in its unit over its datum, if it has one. BadInput for places that it
        does not have."""
        read = self.lat_lon_alt
        found = system.to_geodetic(read[:, [1, 0, 2]])
        if not system.vertical_name:
            # Heights that count from nothing are metres now, and no shift of datum is theirs.
            found[:, 2] = read[:, 2] * system.height_unit_m
        self._numbers = array("d", found.ravel().tolist())
        if len(found):
            self.shortfall = system.shortfall_over(found)

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
    def no_altitude(self) -> np.ndarray:
        """Where the file says no altitude (P,) bool."""
        return np.frombuffer(self._no_altitude, np.bool_)


def number(text: str, what: str) -> float:
    """A number as text; BadInput naming `what` when it is none. NaN and Inf pass: the waypoint they
    belong to is named later."""
    try:
        if "_" in text:  # Python's own way of writing 1_000
            raise ValueError
        return float(text)
    except ValueError:
        hint = "write decimals with a point" if "," in text else "write degrees and metres as plain numbers"
        raise BadInput(f"{what} is {text[:40]!r}, no number: {hint}.") from None
