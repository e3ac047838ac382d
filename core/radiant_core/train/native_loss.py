"""The training loss against one target, in C++ on the CPU and by `device_loss.py` elsewhere;
`losses.py` in float64 is the plain twin of both.

    TargetStatistics: blur(y), blur(y²) − blur(y)²    once per target, beyond the budget per step
    target_loss:      (1 − λ) L1 + λ (1 − SSIM)       once per step; with it the gradient

SSIM is computed in differences d = x − y (native/loss_kernels.h), so its relative error stays at
float32's rounding also where image and target nearly agree; from its usual five moments torch's
float32 lost up to four digits of the gradient there.
"""

# pyright: reportIncompatibleMethodOverride=false
from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from radiant_core import _native
from radiant_core.errors import BadInput
from radiant_core.train.device_loss import device_loss, device_statistics
from radiant_core.train.losses import weighted_loss
from radiant_core.train.memory import STATISTICS_BUDGET_BYTES

STATISTICS_VRAM_SHARE = 0.1
"""Share of a GPU's free memory for them, of what `train.memory` leaves beside the Gaussians."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TargetStatistics:
    """A target (H,W,3) float32 in 0..1 with what SSIM needs of it: it is blurred only once."""

    target: Tensor
    """(H,W,3)."""
    means: Tensor
    """(H,W,3) blur(y)."""
    variances: Tensor
    """(H,W,3) blur(y²) − blur(y)², rounded once from float64."""

    @staticmethod
    def of(target: Tensor) -> TargetStatistics:
        """Statistics of a target, taken to float32, on its own device. Raises BadInput for a shape
        other than (H,W,3), for integers, and on the CPU for values not finite or beyond 2e18."""
        if not target.is_floating_point():
            raise BadInput(f"target is {target.dtype}, expected floating numbers in 0..1: divide bytes by 255.")
        target = target.detach().to(torch.float32).contiguous()
        if target.device.type != "cpu":
            means, variances = device_statistics(target)
            return TargetStatistics(target=target, means=means, variances=variances)
        means, variances = torch.empty_like(target), torch.empty_like(target)
        with _as_bad_input():
            _native.target_statistics(target.numpy(), means.numpy(), variances.numpy(), torch.get_num_threads())
        return TargetStatistics(target=target, means=means, variances=variances)


class StatisticsCache:
    """Means and variances by view; the first that fit into the budget stay: views come in a new
    order every epoch, so dropping the oldest would drop each of them just before its turn."""

    def __init__(self, budget_bytes: int = STATISTICS_BUDGET_BYTES, device: str = "cpu") -> None:
        """`budget_bytes` in main memory; on a GPU at most `STATISTICS_VRAM_SHARE` of what is
        free there."""
        self._free_bytes = budget_bytes if device == "cpu" else min(budget_bytes, int(STATISTICS_VRAM_SHARE * torch.cuda.mem_get_info()[0]))
        self._device = device
        self._moments: dict[int, tuple[Tensor, Tensor]] = {}

    def get(self, view: int, load: Callable[[], Tensor]) -> TargetStatistics:
        """The statistics of `view`, whose target `load` gives, the same one each time."""
        target = load().to(self._device)
        if view in self._moments:
            means, variances = self._moments[view]
            return TargetStatistics(target=target, means=means, variances=variances)
        statistics = TargetStatistics.of(target)
        num_bytes = statistics.means.nbytes + statistics.variances.nbytes
        if num_bytes <= self._free_bytes:
            self._free_bytes -= num_bytes
            self._moments[view] = statistics.means, statistics.variances
        return statistics


def target_loss(image: Tensor, statistics: TargetStatistics, weights: Tensor | None, ssim_weight: float) -> Tensor:
    """`weighted_loss` of image and `statistics.target`. Raises BadInput for an ssim_weight outside
    0..1 and, on the CPU in float32, naming tensor, count and first index of values that are not
    finite or beyond 2e18 and of negative weights; elsewhere what is not finite is so in the loss.
    """
    if not 0 <= ssim_weight <= 1:
        raise BadInput(f"ssim_weight is {ssim_weight}, expected 0 to 1: it is SSIM's share of the loss.")
    if image.device.type == "cpu" and image.dtype == torch.float32:
        wanted = torch.is_grad_enabled() and image.requires_grad
        loss: Tensor = _NativeLoss.apply(image, statistics, weights, ssim_weight, wanted)
        return loss
    weights = None if weights is None else weights.to(image)
    if image.dtype != torch.float32:
        return weighted_loss(image, statistics.target.to(image), weights, ssim_weight)
    target, means, variances = (tensor.to(image) for tensor in (statistics.target, statistics.means, statistics.variances))
    return device_loss(image, (target, means, variances), weights, ssim_weight)


class _NativeLoss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: Tensor, statistics: TargetStatistics, weights: Tensor | None, ssim_weight: float, wanted: bool) -> Tensor:
        image = image.detach().contiguous()
        gradient = torch.empty_like(image) if wanted else None
        with _as_bad_input():
            loss = _native.training_loss(
                image.numpy(),
                statistics.target.numpy(),
                statistics.means.numpy(),
                statistics.variances.numpy(),
                None if weights is None else weights.detach().contiguous().numpy(),
                None if gradient is None else gradient.numpy(),
                ssim_weight,
                torch.get_num_threads(),
            )
        if gradient is not None:
            ctx.save_for_backward(gradient)
        return torch.tensor(loss, dtype=image.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None, None, None]:
        (gradient,) = ctx.saved_tensors
        # Training calls backward on the loss itself: a pass over the image saved.
        return gradient if float(grads[0]) == 1.0 else gradient * grads[0], None, None, None, None


@contextmanager
def _as_bad_input() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise BadInput(f"{error}: check the photographs and the renderer.") from error
