"""The training loss in torch's operations, for GPUs; its equations stand in
`native/training/loss_kernels.h`.

A launch takes longer there than its arithmetic, so the gradient is written out: 64 operations in
place of the 105 that autograd takes for `losses.py`; and in differences of image and target, which
keep float32's precision where both nearly agree. Once per training step.
"""

# pyright: reportIncompatibleMethodOverride=false
from __future__ import annotations

import functools
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import conv2d

from radiant_core.train.losses import RADIUS_PX, window

_C1, _C2 = 0.01**2, 0.03**2


def device_statistics(target: Tensor) -> tuple[Tensor, Tensor]:
    """blur(y) and blur(y²) − blur(y)² (H,W,3) of a target, rounded once from float64."""
    y = target.double().permute(2, 0, 1)
    means, squares = _blur(torch.stack([y, y * y]))
    variances = (squares - means * means).clamp_min(0)
    means, variances = (planes.permute(1, 2, 0).to(target.dtype).contiguous() for planes in (means, variances))
    return means, variances


def device_loss(image: Tensor, target_moments: tuple[Tensor, Tensor, Tensor], weights: Tensor | None, ssim_weight: float) -> Tensor:
    """`losses.weighted_loss` of image and target (H,W,3); `target_moments` are the target and its
    `device_statistics`; weights (H,W), or ones for None."""
    loss: Tensor = _DeviceLoss.apply(image, target_moments, weights, ssim_weight)
    return loss


class _DeviceLoss(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, image: Tensor, target_moments: tuple[Tensor, Tensor, Tensor], weights: Tensor | None, ssim_weight: float
    ) -> Tensor:
        y, mean_y, var_y = (planes.permute(2, 0, 1) for planes in target_moments)
        d = image.detach().permute(2, 0, 1) - y
        # The share of each value in the mean: (1,1,1), or (H,W) over all three channels.
        share = d.new_full((1, 1, 1), 1 / d.numel()) if weights is None else weights / (3 * weights.sum().clamp_min(1e-6))
        errors = d.abs()
        step = d.sign() * share * (1 - ssim_weight)
        if ssim_weight > 0:
            p, q, r = _blur(torch.stack([d, d * d, y * d]))
            mean_x = mean_y + p
            inverse1 = (mean_x * mean_x + mean_y * mean_y).add_(_C1).reciprocal_()
            a = p * p * inverse1
            like = 1 - a
            # Variances are not negative and b is at most 2, whatever rounding gives.
            v = torch.addcmul(q, p, p, value=-1).clamp_min_(0)
            inverse2 = (2 * (var_y + torch.addcmul(r, mean_y, p, value=-1)) + v).clamp_min_(0).add_(_C2).reciprocal_()
            b = (v * inverse2).clamp_max_(2)
            unlike = torch.addcmul(a, like, b)
            structure = 1 - b
            by_q = like * structure * inverse2
            by_r = -2 * like * b * inverse2
            by_p = 2 * (structure * (p - a * mean_x) * inverse1 - p * by_q) - mean_y * by_r
            by_p, by_q, by_r = _blur(torch.stack([by_p, by_q, by_r]) * (share * ssim_weight))
            step = step + by_p + 2 * d * by_q + y * by_r
            errors = torch.lerp(errors, unlike, ssim_weight)
        ctx.save_for_backward(step.permute(1, 2, 0))
        return (errors * share).sum()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        (gradient,) = ctx.saved_tensors
        return gradient * grads[0], None, None, None


def _blur(planes: Tensor) -> Tensor:
    """Planes (K,3,H,W), each blurred by the window of SSIM with zeros around it."""
    kernel = _kernel(planes.dtype, planes.device)
    single = planes.reshape(-1, 1, *planes.shape[2:])
    # TF32, which cuDNN may take for float32, has three digits: too few for variances.
    with torch.backends.cudnn.flags(enabled=torch.backends.cudnn.enabled, allow_tf32=False):
        across = conv2d(single, kernel.view(1, 1, 1, -1), padding=(0, RADIUS_PX))
        return conv2d(across, kernel.view(1, 1, -1, 1), padding=(RADIUS_PX, 0)).view_as(planes)


@functools.cache
def _kernel(dtype: torch.dtype, device: torch.device) -> Tensor:
    return window(dtype).to(device)
