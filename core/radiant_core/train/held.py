"""Gaussians that are shown and never change: what they were is put back after each step, bit for bit. Once per step."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.render.contract import SplatTensors


class HeldRows:
    """The Gaussians that a mask (N,) names, as they are now."""

    def __init__(self, splats: SplatTensors, mask: ArrayLike) -> None:
        held = np.asarray(mask)
        if held.dtype != bool or held.shape != (len(splats.means),):
            raise BadInput(
                f"held is {held.dtype} of shape {held.shape}, expected one truth value for each of {len(splats.means)} Gaussians."
            )
        self._rows = torch.from_numpy(np.flatnonzero(held)).to(splats.means.device)
        self._values = {name: tensor.detach()[self._rows].clone() for name, tensor in splats.tensors().items()}

    def put_back(self, splats: SplatTensors) -> None:
        """Give the named Gaussians of the same model their values back."""
        with torch.no_grad():
            for name, tensor in splats.tensors().items():
                tensor.index_copy_(0, self._rows, self._values[name])
