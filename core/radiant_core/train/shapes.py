"""Limits of shape: large Gaussians and needles are shortened, those that no pixel shows removed.

    longest axis ≤ max_scale_per_distance · distance to the nearest camera     else haze elsewhere
    longest axis ≤ max_elongation · max(second longest, pixel)                 else spikes elsewhere
    opacity < 1/255                                                            dead: no gradient

A pixel is as wide as at the distance of the nearest camera: photographs do not show how thin
something thinner is, so that its second axis means nothing. The limits are applied every few
steps; the dead are left out of the result, which changes no picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_core.render.contract import ALPHA_MIN, SplatTensors
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig


@dataclass(frozen=True, kw_only=True)
class ShapeCounts:
    """How many Gaussians of a finished model are at a limit, and how many dead were left out."""

    num_screen_filling: int = 0
    num_needles: int = 0
    num_dead: int = 0


@torch.no_grad()
def limit_shapes(splats: SplatTensors, camera_centers: FloatArray, config: TrainConfig) -> ShapeCounts:
    """Shorten, in place, the axes that are beyond the limits for cameras at (C,3), and count the
    Gaussians that had one."""
    logs = splats.log_scales
    if not logs.numel():
        return ShapeCounts()
    if config.max_elongation is None and config.max_scale_per_distance is None:
        return ShapeCounts()
    distances, _ = KDTree(camera_centers).query(splats.means.detach().cpu().numpy().astype(np.float64))
    num_needles = num_screen_filling = 0
    if config.max_elongation is not None:
        # Without photographs nothing says how wide a pixel is.
        share = 0.0 if config.needle_width_per_distance == "auto" else config.needle_width_per_distance
        width = torch.maximum(logs.sort(dim=1).values[:, 1:2], _log_share(share, distances, logs))
        num_needles = _clamp(logs, width + math.log(config.max_elongation))
    if config.max_scale_per_distance is not None:
        num_screen_filling = _clamp(logs, _log_share(config.max_scale_per_distance, distances, logs))
    return ShapeCounts(num_needles=num_needles, num_screen_filling=num_screen_filling)


def with_needle_width(config: TrainConfig, cameras: Cameras) -> TrainConfig:
    """The configuration with the width of a pixel of these cameras, the median, where it is
    "auto"."""
    if config.needle_width_per_distance != "auto":
        return config
    return replace(config, needle_width_per_distance=min(0.5, float(np.median(1 / cameras.Ks[:, 0, 0]))))


def _log_share(share: float, distances: FloatArray, like: Tensor) -> Tensor:
    """Logarithm (N,1) of a share of distances (N,)."""
    return torch.from_numpy(np.log(np.maximum(share * distances, np.finfo(np.float32).tiny))).to(like)[:, None]


def _clamp(logs: Tensor, limits: Tensor) -> int:
    """Lower `logs` (N,3), in place, to at most `limits` (N,1); how many rows were above."""
    above = int((logs > limits).any(dim=1).sum())
    logs.copy_(torch.minimum(logs, limits))
    return above


def without_dead(splats: Splats) -> tuple[Splats, int]:
    """The model without Gaussians that no pixel shows, and how many they were; one is kept."""
    with np.errstate(over="ignore"):
        alive = splats.opacities >= ALPHA_MIN
    if len(splats) and not alive.any():
        alive[np.argmax(splats.logit_opacities)] = True
    return (splats, 0) if alive.all() else (splats.select(alive), int((~alive).sum()))
