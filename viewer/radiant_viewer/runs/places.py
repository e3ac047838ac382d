"""Places and names as people read them: coordinates of a map, heights, natural order."""

from __future__ import annotations

import re

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import Frame, geodetic_from_enu
from radiant_core.map_projection import utm_epsg, utm_from_geodetic
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_viewer.runs.run_layers import ground_height

DIGITS = 12
"""Numbers in names are compared with this many digits."""


def camera_heights(scene: SfmScene) -> tuple[str, FloatArray]:
    """Return the heading and the heights (C,) of the cameras above the ground; where no points show
    the ground, heights as they are."""
    heights = scene.cameras.centers[:, 2]
    if not len(scene.points):
        return f"Height ({scene.frame.unit})", heights
    return f"Above ground ({scene.frame.unit})", heights - ground_height(scene)


def natural_key(name: str) -> str:
    """Return a key that sorts names as people count: wp-2 before wp-10."""
    return re.sub(r"\d+", lambda digits: digits.group().lstrip("0").rjust(DIGITS, "0"), name.lower())


def place_text(place: FloatArray, frame: Frame | None) -> str:
    """Return a place (2,) of the map in the frame's unit; with a place on the globe also in its UTM
    zone and in degrees."""
    east, north = (float(value) for value in place)
    if frame is None or frame.kind != "metric":
        unit = "units" if frame is None else frame.unit
        return f"{_number(east)} east, {_number(north)} north ({unit})"
    try:
        lat_lon = geodetic_from_enu(np.array([[east, north, 0.0]]), frame.origin_lat_lon_alt)[:, :2]
        epsg = utm_epsg(float(frame.origin_lat_lon_alt[0]), float(frame.origin_lat_lon_alt[1]))
        x, y = utm_from_geodetic(lat_lon, epsg)[0]
    except BadInput:
        return f"{_number(east)} east, {_number(north)} north (m)"
    return f"{x:,.1f} E {y:,.1f} N (EPSG:{epsg})   {_number(lat_lon[0, 0], 6)}° {_number(lat_lon[0, 1], 6)}°"


def _number(value: float, decimals: int = 1) -> str:
    return f"{value:.{decimals}f}".replace("-", "−")
