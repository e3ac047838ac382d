"""How far a scene reaches from its middle, and what is before it for an eye farther away: sky and
haze, which are the right thing behind a scene, and hide it from outside.

    middle = medians of the Gaussians' x, y and z;  reach = `REACH` × their median distance from it
    near   = depth of the middle − reach, where that is positive

Nothing is left out for an eye within reach, behind which the middle lies, or of what lies beside or
behind the scene. What lies far before it is, whatever it is: a second place with a small share of
the Gaussians, too. Half of the Gaussians may be sky. Once per picture of a model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats

REACH = 7.0
"""3.5 half diagonals of the sample town, 1.6 of an oblique flight that sees far; the sky that
training begins with is 8 away (`train/initialize.py`)."""
NEAR_M = 0.01
"""Of an eye within reach."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reach:
    """Of a model."""

    middle: FloatArray
    """(3,)."""
    distance: float
    """Infinite where half of the model is at one place."""

    @staticmethod
    def of(splats: Splats) -> Reach:
        """Of a model of one or more Gaussians; BadInput without any."""
        if not len(splats):
            raise BadInput("the model holds no Gaussian, so that it reaches nowhere.")
        means = splats.means.astype(np.float64)
        middle = np.median(means, axis=0)
        distance = REACH * float(np.median(np.linalg.norm(means - middle, axis=1)))
        return Reach(middle=middle, distance=distance if distance > 0 else np.inf)

    def near_m(self, cameras: Cameras) -> FloatArray:
        """From which depth on each of C cameras (C,) shows the model."""
        depths = cameras.cam_from_world[:, 2, :3] @ self.middle + cameras.cam_from_world[:, 2, 3]
        near = depths - self.distance
        return np.where(near > NEAR_M, near, NEAR_M)

    def hides(self, splats: Splats, cameras: Cameras) -> NDArray[np.bool_]:
        """Which of C cameras (C,) have a Gaussian of the model before that depth."""
        hidden = np.zeros(len(cameras), bool)
        for index in np.flatnonzero((near_m := self.near_m(cameras)) > NEAR_M):
            row = cameras.cam_from_world[index, 2]
            depths = splats.means @ row[:3].astype(np.float32) + np.float32(row[3])
            hidden[index] = bool(((depths > 0) & (depths < near_m[index])).any())
        return hidden
