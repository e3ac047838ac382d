"""Gaussians left out at random, so that a place does not depend on few of them. Once per step.

    o' = 0 of those dropped, each with probability r p,   o' = o / (1 − r p) ≤ 0.999 of the others

p is the share of the run that is spent. What only one photograph shows is otherwise fitted to that
photograph by piles of half-transparent Gaussians (Park 2025, DropGaussian).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from radiant_core.render.contract import SplatTensors
from radiant_core.train.parts import Moment, Part

MIN_OPACITY, MAX_OPACITY = 1e-6, 0.999
DROPPED_LOGIT = -20.0
"""An opacity of 2e-9, which no renderer shows."""


class DroppedGaussians(Part):
    """Renders each step without some Gaussians."""

    name = "drop"

    def __init__(self, share: float, seed: int) -> None:
        self._share, self._seed = share, seed

    def before_render(self, moment: Moment, splats: SplatTensors) -> SplatTensors:
        """The model with the opacities of this step, drawn by its number."""
        share = self._share * moment.progress
        if share <= 0:
            return splats
        logits = splats.logit_opacities
        uniforms = np.random.default_rng((self._seed, moment.step, 2)).random(len(splats), np.float32)
        dropped = torch.from_numpy(uniforms < share).to(logits.device)
        opacities = (torch.sigmoid(logits) / (1 - share)).clamp(MIN_OPACITY, MAX_OPACITY)
        return replace(splats, logit_opacities=torch.where(dropped, logits.new_full((), DROPPED_LOGIT), torch.logit(opacities)))
