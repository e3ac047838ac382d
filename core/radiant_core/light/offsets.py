"""By how much the light of one device's photographs differs from another's. Once per training that
machines share.

    minimise  Σ over devices d and places p  ρ(y_dp − o_d − b_p)         per channel, median o_d = 0

y are mean log brightnesses of sparse points in a device's light; a place is a cell of a grid, so
that devices whose points differ have places in common. Solved as the light of photographs is
(`solve.py`), a device in place of each photograph.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.light.solve import BLUR_PX, Observations, log_of_colors, solve_lights
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.train.views import TrainingViews

MIN_OFFSET = 8 / 128
"""Devices whose light differs less are left as they are where none models light: as
`aggregate/balance.MIN_LEVELS` at mid grey."""
CELL_SPACINGS = 2.0
"""Side of a cell of the grid in median distances of sparse points."""
MIN_PLACES = 20
"""Places in common that tell of a difference."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PointLogs:
    """Sparse points (P,3) m, and the mean log brightness (P,3) of each in a device's photographs,
    NaN where it is too dark or too bright."""

    points: FloatArray
    logs: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class LightOffsets:
    """Log brightness (D,3) of each device's light above the median of all, and what tells it."""

    offsets: FloatArray
    num_places: int

    @property
    def counts(self) -> bool:
        """Whether enough places are common."""
        return self.num_places >= MIN_PLACES

    @property
    def spread(self) -> float:
        """The largest difference from the median."""
        return float(np.abs(self.offsets).max(initial=0.0))

    @property
    def is_worth_modelling(self) -> bool:
        """Whether devices differ by more than models do anyway."""
        return self.counts and self.spread >= MIN_OFFSET

    @property
    def reason(self) -> str:
        """What it was told by, for a report."""
        if not self.counts:
            return f"they have {self.num_places} places in common, too few to compare"
        return f"at {self.num_places:,} places that several show; from {100 * MIN_OFFSET:.0f} % on, or where light is modelled, it counts"


def point_logs(scene: SfmScene, views: TrainingViews) -> PointLogs:
    """What photographs in one light show at the scene's points; `views.cameras` are the scene's."""
    rows, pixels = views.observed_pixels(scene)
    place, view = scene.observations[rows].T
    sums, counts = np.zeros((len(scene.points), 3)), np.zeros((len(scene.points), 3))
    for index in np.unique(view):
        chosen = view == index
        smooth = cv2.blur(np.asarray(views.images[index], np.float32), (BLUR_PX, BLUR_PX))
        logs = log_of_colors(smooth[pixels[chosen, 1], pixels[chosen, 0]].astype(np.float64))
        tells = np.isfinite(logs)
        np.add.at(sums, place[chosen], np.where(tells, logs, 0))
        np.add.at(counts, place[chosen], tells)
    with np.errstate(invalid="ignore"):
        return PointLogs(points=scene.points, logs=np.where(counts > 0, sums / np.maximum(counts, 1), np.nan).astype(np.float32))


def light_offsets(devices: Sequence[PointLogs]) -> LightOffsets:
    """The offsets of D devices, 0 where they have too little in common."""
    nothing = LightOffsets(offsets=np.zeros((len(devices), 3)), num_places=0)
    if len(devices) < 2 or not all(len(cloud.points) for cloud in devices):
        return nothing
    points = np.concatenate([cloud.points for cloud in devices])
    device = np.repeat(np.arange(len(devices)), [len(cloud.points) for cloud in devices])
    cells, place = np.unique(np.floor(points / _cell_m(devices)).astype(np.int64), axis=0, return_inverse=True)
    place = np.asarray(place).reshape(-1)
    logs = np.concatenate([cloud.logs for cloud in devices]).astype(np.float64)
    pair = device * len(cells) + place
    pairs, row = np.unique(pair, return_inverse=True)
    means = np.full((len(pairs), 3), np.nan)
    for channel in range(3):
        tells = np.isfinite(logs[:, channel])
        counts, sums = (np.bincount(row[tells], weights, len(pairs)) for weights in (None, logs[tells, channel]))
        means[:, channel] = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    of_device, of_place = pairs // len(cells), pairs % len(cells)
    common = int((np.bincount(of_place) > 1).sum())
    if common < MIN_PLACES:
        return LightOffsets(offsets=nothing.offsets, num_places=common)
    observed = Observations(view=of_device, squared_radii=np.zeros(len(pairs)), logs=means, place=of_place)
    lights = solve_lights(observed, _stand_ins(len(devices)))
    # By the median, so that one device whose brightness is a lie moves the light of no other.
    return LightOffsets(offsets=lights.log_gains - np.median(lights.log_gains, axis=0), num_places=common)


def _cell_m(devices: Sequence[PointLogs]) -> float:
    from scipy.spatial import KDTree

    points = max((cloud.points for cloud in devices), key=len)
    distances = KDTree(points).query(points, k=min(2, len(points)))[0].reshape(len(points), -1)[:, -1]
    spread = float(np.median(distances[distances > 0])) if (distances > 0).any() else 1.0
    return CELL_SPACINGS * spread


def _stand_ins(count: int) -> Cameras:
    """A camera for each device, all alike: a light's gain needs no more of one."""
    return Cameras(
        names=tuple(map(str, range(count))),
        Ks=np.tile(np.diag([1.0, 1.0, 1.0]), (count, 1, 1)),
        cam_from_world=np.tile(np.eye(4), (count, 1, 1)),
        sizes_wh=np.ones((count, 2), np.int64),
    )
