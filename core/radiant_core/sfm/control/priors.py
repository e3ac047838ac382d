"""Camera positions of known accuracy, as RTK receivers write them: which of them count. Per scene.

A position counts where EXIF or XMP says how accurate it is and that is half a metre or better: the
errors of other receivers drift together during a flight, and would bend the scene if each were
believed on its own. Those still place the scene as a whole, as ever.
"""

from __future__ import annotations

import numpy as np

from radiant_core.frames import enu_from_geodetic
from radiant_core.io.photos.listing import Photograph
from radiant_core.numerics import FloatArray

MAX_SIGMA_M = 0.5
MIN_SIGMA_M = 0.01
"""The clock and the lever arm of a camera are known to no better."""
MIN_POSITIONS, MIN_SHARE = 4, 0.5


def accurate_positions(photographs: tuple[Photograph, ...]) -> tuple[FloatArray, FloatArray]:
    """Degrees, degrees, metres (C,3) and standard deviations (C,3) m east, north, up; NaN where a
    position does not count."""
    geodetic, sigmas_m = np.full((len(photographs), 3), np.nan), np.full((len(photographs), 3), np.nan)
    for row, photo in enumerate(photographs):
        if photo.lat_lon_alt is None or photo.position_sigma_m is None or not np.isfinite(photo.lat_lon_alt).all():
            continue
        if max(photo.position_sigma_m) <= MAX_SIGMA_M:
            geodetic[row], sigmas_m[row] = photo.lat_lon_alt, np.maximum(photo.position_sigma_m, MIN_SIGMA_M)
    return geodetic, sigmas_m


def are_enough(geodetic: FloatArray) -> bool:
    """Whether positions (C,3) alone fix a scene."""
    num_known = int(np.isfinite(geodetic[:, 0]).sum())
    return num_known >= max(MIN_POSITIONS, MIN_SHARE * len(geodetic))


def middle_of(geodetic: FloatArray) -> FloatArray:
    """The median position (3,), an origin."""
    return np.nanmedian(geodetic, axis=0)


def positions_about(geodetic: FloatArray, origin: FloatArray) -> FloatArray:
    """Metres east, north, up (C,3) about an origin (3,); NaN stays."""
    positions_m = np.full_like(geodetic, np.nan)
    has_gps = np.isfinite(geodetic[:, 0])
    if has_gps.any():
        positions_m[has_gps] = enu_from_geodetic(geodetic[has_gps], origin)
    return positions_m
