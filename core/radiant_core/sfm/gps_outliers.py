"""Photographs whose GPS is far from their place in the finished scene. Once per scene."""

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


@dataclass(frozen=True, kw_only=True)
class GpsOutliers:
    """Photographs whose GPS is `away_m` from their place, the farthest first, of so many."""

    names: tuple[str, ...]
    away_m: tuple[float, ...]
    num_gps: int

    def warning(self, *, named: bool = True) -> tuple[str, ...]:
        """The warning in one sentence, without names where those are private; none without any."""
        if not self.names:
            return ()
        away = f"up to {self.away_m[0] / 1e3:,.1f} km" if self.away_m[0] >= 1e3 else f"up to {self.away_m[0]:,.0f} m"
        sentence = f"the GPS positions of {len(self.names)} of {self.num_gps} photographs are {away} from where the photographs were taken"
        listed = f": {', '.join(self.names[:MAX_NAMED])}{' …' if len(self.names) > MAX_NAMED else ''}" if named else ""
        return (f"{sentence}, and are not used{listed}.",)


def gps_outliers(scene: SfmScene, photographs: tuple[Photograph, ...]) -> GpsOutliers:
    """A scene's outliers by horizontal distance; none where its frame is not of GPS."""
    by_name = {photo.name: photo for photo in photographs}
    placed = [by_name[name] for name in scene.cameras.names]
    if scene.frame.kind != "metric":
        return GpsOutliers(names=(), away_m=(), num_gps=sum(photo.lat_lon_alt is not None for photo in placed))
    positions_m = gps_about(tuple(placed), scene.frame.origin_lat_lon_alt)
    away_m = np.linalg.norm((positions_m - scene.cameras.centers)[:, :2], axis=1)
    known = np.isfinite(away_m)
    limit_m = max(LEAST_M, OUTLIER_FACTOR * float(np.median(away_m[known]))) if known.any() else LEAST_M
    far = [int(index) for index in np.argsort(-away_m) if known[index] and away_m[index] > limit_m]
    return GpsOutliers(
        names=tuple(scene.cameras.names[index] for index in far), away_m=tuple(away_m[far].tolist()), num_gps=int(known.sum())
    )
