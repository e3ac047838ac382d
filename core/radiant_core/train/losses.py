"""The training loss (1 − λ) L1 + λ (1 − SSIM) (paper Eqn. 4), each pixel weighted. Once per step.

SSIM as in Wang et al. 2004: Gaussian window 11×11, σ = 1.5, C1 = 0.01², C2 = 0.03², zero padding.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import conv2d

_SIGMA_PX, RADIUS_PX = 1.5, 5


def weighted_loss(image: Tensor, target: Tensor, weights: Tensor | None, ssim_weight: float) -> Tensor:
    """Scalar loss of image and target (H,W,3) in 0..1, weights (H,W) or ones; 0 if all are zero."""
    errors = (1 - ssim_weight) * (image - target).abs().mean(-1)
    if ssim_weight > 0:
        errors = errors + ssim_weight * (1 - ssim_map(image, target).mean(-1))
    if weights is None:
        return errors.mean()
    return (errors * weights).sum() / weights.sum().clamp_min(1e-6)


def ssim_map(image: Tensor, target: Tensor) -> Tensor:
    """Local structural similarity (H,W,3) of two images (H,W,3)."""
    x, y = image.permute(2, 0, 1)[:, None], target.permute(2, 0, 1)[:, None]
    mean_x, mean_y, mean_xx, mean_yy, mean_xy = _blur(torch.cat([x, y, x * x, y * y, x * y])).chunk(5)
    var_x, var_y, cov = mean_xx - mean_x**2, mean_yy - mean_y**2, mean_xy - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + 0.01**2) / (mean_x**2 + mean_y**2 + 0.01**2)
    structure = (2 * cov + 0.03**2) / (var_x + var_y + 0.03**2)
    return (luminance * structure)[:, 0].permute(1, 2, 0)


def window(dtype: torch.dtype) -> Tensor:
    """The 11 weights (11) of SSIM's window along one axis; they add up to 1."""
    offsets = torch.arange(-RADIUS_PX, RADIUS_PX + 1, dtype=torch.float64)
    weights = torch.exp(-0.5 * (offsets / _SIGMA_PX) ** 2)
    return (weights / weights.sum()).to(dtype)


def _blur(planes: Tensor) -> Tensor:
    kernel = window(planes.dtype).to(planes.device)
    across = conv2d(planes, kernel[None, None, None, :], padding=(0, RADIUS_PX))
    return conv2d(across, kernel[None, None, :, None], padding=(RADIUS_PX, 0))
