"""Photographs whose GPS is far from their place: the fit leaves them aside. Once per scene.

A difference alone does not say which of the two is off. GPS is it where a photograph would have
been taken so far outside of the site that it could not overlap with the others; nearer, a lens that
is taken for another or wrong matches may have put the photograph wrongly as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from radiant_core.io.photos.listing import Photograph
from radiant_core.scene import SfmScene
from radiant_core.sfm.colmap.pairs import gps_about

MAX_NAMED = 5
OUTLIER_FACTOR = 10.0
"""Farther than this many median residuals is no noise of a receiver."""
LEAST_M = 10.0
"""Nearer than this any receiver may be off."""
MANY = 0.1
"""A share of the photographs above which a scene is in doubt where they may be placed wrongly."""
OUTSIDE_M, OUTSIDE_EXTENTS = 1_000.0, 3.0
"""Farther than both no photograph overlaps with others of the site."""


@dataclass(frozen=True, kw_only=True)
class GpsOutliers:
    """Photographs whose GPS is `away_m` from where the scene has them, the farthest first, of so
    many with GPS."""

    names: tuple[str, ...]
    away_m: tuple[float, ...]
    num_gps: int
    extent_m: float = 0.0
    """Of all cameras of the scene, across."""

    @property
    def is_gps_off(self) -> bool:
        """Whether all of them lie so far out that nothing but their GPS can be wrong."""
        return min(self.away_m) > max(OUTSIDE_M, OUTSIDE_EXTENTS * self.extent_m)

    def warning(self, *, named: bool = True) -> tuple[str, ...]:
        """The warning about them, if any, in a sentence; without names where those are private."""
        if not self.names:
            return ()
        away = f"up to {self.away_m[0] / 1e3:,.1f} km" if self.away_m[0] >= 1e3 else f"up to {self.away_m[0]:,.0f} m"
        many = f"{len(self.names)} of {self.num_gps} photographs"
        sentence = f"the GPS positions of {many} are {away} from where the photographs were taken, and are not used"
        if not self.is_gps_off:
            sentence = (
                f"GPS and structure from motion put {many} {away} apart, whose GPS positions are not used: either these are off, or the "
                "photographs are placed wrongly (another lens or zoom, wrong matches)"
            )
        listed = f" ({', '.join(self.names[:MAX_NAMED])}{' …' if len(self.names) > MAX_NAMED else ''})" if named else ""
        return (f"{sentence}{listed}.",)

    def doubt(self) -> tuple[str, ...]:
        """The warning again where it puts the scene in doubt: many photographs, and not their GPS
        alone."""
        return () if not self.names or self.is_gps_off or len(self.names) <= MANY * self.num_gps else self.warning()


def gps_outliers(scene: SfmScene, photographs: tuple[Photograph, ...]) -> GpsOutliers:
    """The outliers among the photographs of a scene, by horizontal distance; none in a scene whose
    frame is not of GPS."""
    by_name = {photo.name: photo for photo in photographs}
    placed = [by_name[name] for name in scene.cameras.names]
    if scene.frame.kind != "metric":
        return GpsOutliers(names=(), away_m=(), num_gps=sum(photo.lat_lon_alt is not None for photo in placed))
    positions_m = gps_about(tuple(placed), scene.frame.origin_lat_lon_alt)
    away_m = np.linalg.norm((positions_m - scene.cameras.centers)[:, :2], axis=1)
    has_gps = np.isfinite(away_m)
    limit_m = max(LEAST_M, OUTLIER_FACTOR * float(np.median(away_m[has_gps]))) if has_gps.any() else LEAST_M
    far = [int(index) for index in np.argsort(-away_m) if has_gps[index] and away_m[index] > limit_m]
    return GpsOutliers(
        names=tuple(scene.cameras.names[index] for index in far),
        away_m=tuple(away_m[far].tolist()),
        num_gps=int(has_gps.sum()),
        extent_m=float(np.linalg.norm(np.ptp(scene.cameras.centers[:, :2], axis=0))),
    )
