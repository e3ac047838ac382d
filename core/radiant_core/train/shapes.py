"""Limits of shape: large Gaussians and needles are shortened, those that no pixel shows removed.

    longest axis ≤ max_scale_per_distance · distance to the nearest camera     else haze elsewhere
    longest axis ≤ max_elongation · second longest                             else spikes elsewhere
    opacity < 1/255                                                            dead: no gradient

The limits are applied every few steps; the dead are left out of the result, changing no picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

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
    """Shorten axes beyond the limits, in place, for cameras at (C,3); count the Gaussians."""
    logs = splats.log_scales
    if not logs.numel():
        return ShapeCounts()
    num_needles = num_screen_filling = 0
    if config.max_elongation is not None:
        second = logs.sort(dim=1).values[:, 1:2]
        num_needles = _clamp(logs, second + math.log(config.max_elongation))
    if config.max_scale_per_distance is not None:
        distances, _ = KDTree(camera_centers).query(splats.means.detach().cpu().numpy().astype(np.float64))
        limits = np.log(np.maximum(config.max_scale_per_distance * distances, np.finfo(np.float32).tiny))
        num_screen_filling = _clamp(logs, torch.from_numpy(limits).to(logs)[:, None])
    return ShapeCounts(num_needles=num_needles, num_screen_filling=num_screen_filling)


def _clamp(logs: Tensor, limits: Tensor) -> int:
    """Lower `logs` (N,3), in place, to at most `limits` (N,1); how many rows were above."""
    above = int((logs > limits).any(dim=1).sum())
    logs.copy_(torch.minimum(logs, limits))
    return above


def without_dead(splats: Splats) -> tuple[Splats, int]:
    """The model without Gaussians that no pixel shows, but one; and how many they were."""
    with np.errstate(over="ignore"):
        alive = splats.opacities >= ALPHA_MIN
    if len(splats) and not alive.any():
        alive[np.argmax(splats.logit_opacities)] = True
    return (splats, 0) if alive.all() else (splats.select(alive), int((~alive).sum()))
