"""`Lights`: in which light photographs were taken, beside one canonical light of a model.

    photograph(u) = g_v · exp(a₁ r² + a₂ r⁴ + a₃ r⁶) · canonical(u)        per channel

g_v of photograph v holds exposure and white balance, a the vignetting of its camera; r is the
distance of pixel u from the principal point over half of the image's diagonal. The gauge: the mean
of log g over photographs is 0, the vignetting is 1 in the middle. Colours are as stored (sRGB): a
gain of linear light is nearly one there too, and was no better (docs/experiments/light.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.regimes import LIGHT, Regime, require
from radiant_core.train.views import TrainingViews

NUM_TERMS = 3
"""Even powers of the radius in the logarithm of a vignetting."""
FOCAL_STEP = 0.05
"""Cameras whose sizes agree, and focal lengths to about this share, count as one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lights:
    """The light of V photographs: log_gains (V,3); camera_of (V,), the camera of each of K;
    vignettings (K,3 terms,3 channels); is_known (V,), whether its gain was measured, else 0;
    evenness, how well gains explain whole pictures (`evenness.py`). BadInput when shapes
    disagree."""

    log_gains: FloatArray
    camera_of: NDArray[np.int64]
    vignettings: FloatArray
    is_known: NDArray[np.bool_]
    evenness: float = np.inf

    def __post_init__(self) -> None:
        count = len(np.asarray(self.log_gains))
        object.__setattr__(self, "log_gains", check_array("log_gains", self.log_gains, (count, 3)))
        object.__setattr__(self, "camera_of", check_array("camera_of", self.camera_of, (count,), np.int64))
        object.__setattr__(self, "vignettings", check_array("vignettings", self.vignettings, (None, NUM_TERMS, 3)))
        object.__setattr__(self, "is_known", np.asarray(self.is_known, bool))
        if self.is_known.shape != (count,) or (count and not 0 <= self.camera_of.min() <= self.camera_of.max() < len(self.vignettings)):
            raise BadInput(f"lights of {count} photographs name cameras or flags that are not there: give one of each per photograph.")

    @staticmethod
    def canonical(cameras: Cameras) -> Lights:
        """Those of V photographs that are in the canonical light as they were taken."""
        camera_of, num_cameras = cameras_alike(cameras)
        vignettings = np.zeros((num_cameras, NUM_TERMS, 3))
        return Lights(
            log_gains=np.zeros((len(cameras), 3)), camera_of=camera_of, vignettings=vignettings, is_known=np.zeros(len(cameras), bool)
        )

    def __len__(self) -> int:
        return len(self.log_gains)

    @property
    def spread(self) -> float:
        """Standard deviation of the known log gains over photographs, root mean square over
        channels; 0 of fewer than two."""
        log_gains = self.log_gains[self.is_known]
        return float(np.sqrt(np.mean(log_gains.var(axis=0)))) if len(log_gains) > 1 else 0.0

    @property
    def regime(self) -> Regime:
        """The case of its spread and evenness."""
        return require(LIGHT, {"spread": self.spread, "evenness": self.evenness})

    @property
    def is_worth_modelling(self) -> bool:
        """Whether light differs, by gains that explain whole pictures."""
        return bool(self.is_known.any()) and bool(self.regime.values["taken_out"])

    @property
    def corner(self) -> float:
        """Log of the vignetting in a corner, of the camera and channel where it is largest."""
        sums = self.vignettings.sum(axis=1)
        return float(sums.ravel()[np.abs(sums).argmax()]) if sums.size else 0.0

    def select(self, indices: ArrayLike) -> Lights:
        """Those of some photographs (K,) int, in that order."""
        rows = np.asarray(indices, np.int64)
        return replace(self, log_gains=self.log_gains[rows], camera_of=self.camera_of[rows], is_known=self.is_known[rows])

    def factors(self, index: int, cameras: Cameras) -> NDArray[np.float32]:
        """By what photograph `index` is brighter than the canonical light, (H,W,3) at the size of
        its camera in `cameras` (V)."""
        squared = squared_radii(cameras, index)[..., None]
        powers = np.concatenate([squared ** (term + 1) for term in range(NUM_TERMS)], axis=-1)
        logs = powers @ self.vignettings[self.camera_of[index]] + self.log_gains[index]
        return np.exp(logs).astype(np.float32)


def cameras_alike(cameras: Cameras) -> tuple[NDArray[np.int64], int]:
    """Which camera took each photograph (V,), told by size and focal length, and their number."""
    kinds, kind_indices = np.unique(camera_keys(cameras), axis=0, return_inverse=True)
    return np.asarray(kind_indices, np.int64).reshape(-1), len(kinds)


def camera_keys(cameras: Cameras) -> NDArray[np.int64]:
    """Focal length over width and shape of each camera (V,2) in steps; equal for one camera at any
    size of its pictures."""
    ratios = np.column_stack([cameras.Ks[:, 0, 0] / cameras.sizes_wh[:, 0], cameras.sizes_wh[:, 1] / cameras.sizes_wh[:, 0]])
    return np.round(np.log(ratios) / FOCAL_STEP).astype(np.int64)


def squared_radii(cameras: Cameras, index: int) -> FloatArray:
    """r² (H,W) of the pixels of a camera: 1 at half of the diagonal from the principal point."""
    width, height = (int(side) for side in cameras.sizes_wh[index])
    x, y = np.arange(width) + 0.5 - cameras.Ks[index, 0, 2], np.arange(height) + 0.5 - cameras.Ks[index, 1, 2]
    return 4 * (x[None] ** 2 + y[:, None] ** 2) / (width**2 + height**2)


def in_canonical_light(views: TrainingViews, lights: Lights) -> TrainingViews:
    """The photographs as if all had been taken in the canonical light, rounded and cut to 8 bits;
    `lights` in the order of the views."""
    images = tuple(
        np.clip(views.images[index] / lights.factors(index, views.cameras), 0, 255).round().astype(np.uint8) for index in range(len(views))
    )
    return replace(views, images=images)
