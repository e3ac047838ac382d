"""The mean of the last steps' models in place of the last one (Polyak & Juditsky 1992).

    x̄ₙ = x̄ₙ₋₁ + (xₙ − x̄ₙ₋₁) / n     over the steps from `TrainConfig.average_from` on

A step follows one photograph, so that the last model leans to the last ones. Their mean needs no
small rates to be steady: centres may move ten times as far at the end. What stands still keeps its
bits. Once per step of the last ones.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from radiant_core.render.contract import SplatTensors
from radiant_core.splats import TENSORS
from radiant_core.train.parts import Part


class MeanModel(Part):
    """The mean over the steps after a share of the run; anew where the number of Gaussians
    changes."""

    name = "mean"

    def __init__(self, start: float) -> None:
        """`start`: that share."""
        self._start = start
        self._means: dict[str, Tensor] = {}
        self.num_steps = 0

    @torch.no_grad()
    def after_step(self, step: int, progress: float, splats: SplatTensors) -> None:
        """Count the model."""
        if progress < self._start:
            return
        tensors = splats.tensors()
        if self.num_steps == 0 or self._means["means"].shape != tensors["means"].shape:
            self._means, self.num_steps = {name: tensor.detach().clone() for name, tensor in tensors.items()}, 1
            return
        self.num_steps += 1
        for name, tensor in tensors.items():
            # Not in place: a checkpoint may hold the mean before.
            self._means[name] = self._means[name] + (tensor.detach() - self._means[name]) / self.num_steps

    @torch.no_grad()
    def last(self, splats: SplatTensors) -> SplatTensors:
        """The mean of what was counted; the model itself where nothing was."""
        if self.num_steps == 0 or self._means["means"].shape != splats.means.shape:
            return splats
        return replace(splats, **{name: tensor.clone() for name, tensor in self._means.items()})

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """The mean so far, which later steps leave alone; empty before the first."""
        return {name: tensor.cpu().numpy() for name, tensor in self._means.items()}

    def state_numbers(self) -> dict[str, Any]:
        """How many steps were counted."""
        return {"num_steps": self.num_steps}

    def restore(self, arrays: dict[str, NDArray[Any]], numbers: Any, splats: SplatTensors) -> None:
        """Go on from both."""
        self.num_steps = int(numbers["num_steps"])
        names = TENSORS if self.num_steps else ()
        self._means = {name: torch.from_numpy(np.array(arrays[name])).to(splats.means.device) for name in names}
