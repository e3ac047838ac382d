"""The mean of the last steps' models in place of the last one (Polyak & Juditsky 1992).

    x̄ = x₁ + 1/n Σ (xₜ − x₁)     over the n steps from `TrainConfig.average_from` on

A step follows one photograph, so that the last model leans to the last ones. Their mean needs no
small rates to be steady: centres may move ten times as far at the end. Differences from the first,
so that what stands still keeps its bits. Once per step of the last ones.
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
        self._first: dict[str, Tensor] = {}
        self._sums: dict[str, Tensor] = {}
        self.num_steps = 0

    @torch.no_grad()
    def after_step(self, step: int, progress: float, splats: SplatTensors) -> None:
        """Count the model."""
        if progress < self._start:
            return
        tensors = splats.tensors()
        if self.num_steps == 0 or any(self._first[name].shape != tensor.shape for name, tensor in tensors.items()):
            self._first = {name: tensor.detach().clone() for name, tensor in tensors.items()}
            self._sums = {name: torch.zeros_like(tensor) for name, tensor in self._first.items()}
            self.num_steps = 0
        self.num_steps += 1
        for name, tensor in tensors.items():
            self._sums[name] += tensor.detach() - self._first[name]

    @torch.no_grad()
    def last(self, splats: SplatTensors) -> SplatTensors:
        """The mean of what was counted; the model itself where nothing was."""
        if self.num_steps == 0 or self._first["means"].shape != splats.means.shape:
            return splats
        return replace(splats, **{name: self._first[name] + self._sums[name] / self.num_steps for name in TENSORS})

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Copies of the first model and of the sums; empty before it."""
        parts = {"first": self._first, "sums": self._sums}
        return {f"{part}.{name}": tensor.cpu().numpy().copy() for part, tensors in parts.items() for name, tensor in tensors.items()}

    def state_numbers(self) -> int:
        """How many steps were counted."""
        return self.num_steps

    def restore(self, arrays: dict[str, NDArray[Any]], numbers: Any, splats: SplatTensors) -> None:
        """Go on from both."""
        self.num_steps, device = int(numbers), splats.means.device
        names = TENSORS if self.num_steps else ()
        self._first, self._sums = (
            {name: torch.from_numpy(np.array(arrays[f"{part}.{name}"])).to(device) for name in names} for part in ("first", "sums")
        )
