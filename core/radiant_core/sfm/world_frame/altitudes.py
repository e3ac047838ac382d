"""Heights for GPS positions without altitude, as from tracks and phones. Once per scene.

Where at least three photographs and half of those with a position have an altitude, the others get
the height that the fit to those puts them at. Otherwise altitudes are left aside: up comes from the
scene, heading, scale and place from horizontal positions, and heights count from the middle of the
scene's points. What follows then fits three coordinates as always, and finds its up in the heights
given here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from radiant_core.geometry.align import robust_sim3
from radiant_core.numerics import FloatArray
from radiant_core.sfm.world_frame.orient import level_fit

MIN_ALTITUDES = 3
MIN_ALTITUDE_SHARE = 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class Heights:
    """GPS positions with a height each."""

    positions_m: FloatArray
    """(C,3), NaN without GPS."""
    origin: FloatArray
    """(3,) [deg, deg, m]."""
    altitude_known: bool = True
    """Whether the origin's altitude is one; else heights count from the middle of the points."""
    warnings: tuple[str, ...] = ()
    """For the user."""


def fill_heights(centers: FloatArray, points: FloatArray, gps: tuple[FloatArray, FloatArray], up: Callable[[], FloatArray]) -> Heights:
    """Positions of which no height is NaN. `gps` are positions (C,3) of camera centres (C,3), all
    NaN without GPS, and their origin; `up` () → (3,) gives up in the frame of the centres and
    points (P,3), only called where too few altitudes are known."""
    positions_m, origin = gps
    placed, high = np.isfinite(positions_m[:, 0]), np.isfinite(positions_m[:, 2])
    if (placed == high).all():
        return Heights(positions_m=positions_m, origin=origin)
    filled = positions_m.copy()
    low = placed & ~high
    if high.sum() >= max(MIN_ALTITUDES, MIN_ALTITUDE_SHARE * placed.sum()):
        fit = robust_sim3(centers[high], positions_m[high]).target_from_source
        filled[low, 2] = np.median(positions_m[high, 2]) if fit is None else fit.apply(centers[low])[:, 2]
        some = f"{low.sum()} of {placed.sum()} GPS positions have no altitude: their height comes from the others."
        return Heights(positions_m=filled, origin=origin, warnings=(some,))
    filled[placed, 2] = 0.0
    level = level_fit(centers[placed], filled[placed], up()) if placed.sum() >= MIN_ALTITUDES else None
    if level is not None:
        ground_m = float(np.median(level.apply(points)[:, 2])) if len(points) else 0.0
        filled[placed, 2] = level.apply(centers[placed])[:, 2] - ground_m
    warning = (
        f"{low.sum()} of {placed.sum()} GPS positions have no altitude: up comes from the scene, and heights count from the middle of its "
        "points, not from the sea."
    )
    return Heights(positions_m=filled, origin=np.array([*origin[:2], 0.0]), altitude_known=False, warnings=(warning,))
