"""Exposure of each photograph: an affine map of rendered colours, learnt with the model.

    c' = (I + A_v) c + b_v,   with the gauge  mean over v of A_v and b_v = 0
so that the model keeps the mean exposure of all photographs, for new views. The rate falls from
`exposure_lr` to a tenth, as in 3DGS, whose maps have no gauge. Once per step of its view.
"""

# pyright: reportIncompatibleMethodOverride=false
from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from radiant_core import _native
from radiant_core.errors import StageFailed
from radiant_core.render.contract import SplatTensors
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.parts import Moment, Part
from radiant_core.train.results import TrainResult

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8


class _NativeExposure(torch.autograd.Function):
    """The map by the native module: torch's own threads would spin on after each operation."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, map_: Tensor) -> Tensor:
        image, map_ = image.detach().contiguous(), map_.detach()
        shown = torch.empty_like(image)
        _native.apply_exposure(image, map_, shown, torch.get_num_threads())
        ctx.save_for_backward(image, map_)
        return shown

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor]:
        image, map_ = ctx.saved_tensors
        image_gradient, map_gradient = torch.empty_like(image), torch.empty_like(map_)
        _native.apply_exposure_backward(image, map_, grads[0].contiguous(), image_gradient, map_gradient, torch.get_num_threads())
        return image_gradient, map_gradient


class Exposures(Part):
    """The maps (V,3,4) of V views, A beside b, and Adam; only the fitted view's moments change."""

    name = "exposure"

    def __init__(self, num_views: int, rate: float, device: torch.device | str) -> None:
        self._rate = rate
        self._maps, self._first, self._second = (torch.zeros(num_views, 3, 4, device=device) for _ in range(3))
        self._counts = torch.zeros(num_views, dtype=torch.int64)
        self._shown: Tensor | None = None

    @property
    def largest_change(self) -> float:
        """Largest change of any channel's gain, as a share."""
        return float(self._maps[:, :, :3].diagonal(dim1=1, dim2=2).abs().max()) if len(self._maps) else 0.0

    def show(self, moment: Moment, image: Tensor) -> Tensor:
        """The image (H,W,3) mapped by its view's exposure, which `after_update` then steps."""
        self._shown = self._maps[moment.view].clone().requires_grad_()
        if image.device.type == "cpu" and image.dtype == torch.float32:
            shown: Tensor = _NativeExposure.apply(image, self._shown)
            return shown
        return image + torch.addmm(self._shown[:, 3], image.view(-1, 3), self._shown[:, :3].T).view(image.shape)

    def after_backward(self, splats: SplatTensors) -> None:
        """Raise StageFailed where the gradient of the map shown last is not finite."""
        if self._shown is not None and self._shown.grad is not None and not bool(self._shown.grad.isfinite().all()):
            raise StageFailed("the gradient of an exposure is not finite")

    @torch.no_grad()
    def after_update(self, moment: Moment, splats: SplatTensors, optimizer: SelectiveAdam) -> SplatTensors:
        """One Adam step of the map of the step's view, then the gauge; the model stays as it is."""
        if self._shown is None or self._shown.grad is None:
            return splats
        view, gradient = moment.view, self._shown.grad
        self._counts[view] += 1
        count = int(self._counts[view])
        self._first[view] += (1 - BETA1) * (gradient - self._first[view])
        self._second[view] += (1 - BETA2) * (gradient * gradient - self._second[view])
        root = (self._second[view] / (1 - BETA2**count)).sqrt() + EPSILON
        self._maps[view] -= self._rate * 0.1**moment.progress / (1 - BETA1**count) * self._first[view] / root
        self._maps -= self._maps.mean(dim=0)
        return splats

    def finish(self, result: TrainResult) -> TrainResult:
        """The result with the largest change of a gain."""
        return replace(result, max_exposure=self.largest_change)

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Copies of all that changes."""
        tensors = {"maps": self._maps, "first": self._first, "second": self._second, "counts": self._counts}
        return {name: tensor.cpu().numpy().copy() for name, tensor in tensors.items()}

    def restore(self, arrays: dict[str, NDArray[Any]], numbers: Any, splats: SplatTensors) -> None:
        """Go on from `state_arrays`; ValueError for other shapes."""
        for name, array in arrays.items():
            tensor = getattr(self, f"_{name}")
            if tensor.shape != array.shape:
                raise ValueError(f"exposure {name} is {array.shape}, expected {tuple(tensor.shape)}")
            tensor.copy_(torch.from_numpy(array))
