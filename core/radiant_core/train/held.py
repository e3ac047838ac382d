"""Gaussians that are rendered and never change: restored bit for bit after each step."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.render.contract import SplatTensors
from radiant_core.train.parts import Part


class HeldRows(Part):
    """The Gaussians that a mask (N,) selects, with the values that they have at the start."""

    name = "held"

    def __init__(self, splats: SplatTensors, mask: ArrayLike) -> None:
        frozen = np.asarray(mask)
        if frozen.dtype != bool or frozen.shape != (len(splats.means),):
            raise BadInput(
                f"frozen is {frozen.dtype} of shape {frozen.shape}, expected one truth value for each of {len(splats.means)} Gaussians."
            )
        self._rows = torch.from_numpy(np.flatnonzero(frozen)).to(splats.means.device)
        self._values = {name: tensor.detach()[self._rows].clone() for name, tensor in splats.tensors().items()}

    def hold(self, splats: SplatTensors) -> None:
        """Restore the values of these Gaussians, in place."""
        with torch.no_grad():
            for name, tensor in splats.tensors().items():
                tensor.index_copy_(0, self._rows, self._values[name])
