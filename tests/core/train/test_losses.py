"""The training loss against an independent float64 SSIM, and its gradients."""

from __future__ import annotations

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from radiant_core.train.losses import ssim_map, weighted_loss


def images(seed: int, shape: tuple[int, int, int] = (23, 31, 3)) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(shape, generator=generator, dtype=torch.float64), torch.rand(shape, generator=generator, dtype=torch.float64)


def scipy_ssim(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    def blur(plane: np.ndarray) -> np.ndarray:
        return gaussian_filter(plane, (1.5, 1.5, 0), mode="constant", radius=(5, 5, 0))

    mean_x, mean_y = blur(x), blur(y)
    var_x, var_y, cov = blur(x * x) - mean_x**2, blur(y * y) - mean_y**2, blur(x * y) - mean_x * mean_y
    return (2 * mean_x * mean_y + 1e-4) * (2 * cov + 9e-4) / ((mean_x**2 + mean_y**2 + 1e-4) * (var_x + var_y + 9e-4))


def test_ssim_matches_scipy_on_noise() -> None:
    x, y = images(0)
    np.testing.assert_allclose(ssim_map(x, y), scipy_ssim(x.numpy(), y.numpy()), atol=1e-12)


def test_equal_images_cost_nothing_and_different_ones_something() -> None:
    x, y = images(1)
    assert abs(float(weighted_loss(x, x, None, 0.2))) < 1e-12
    assert float(weighted_loss(x, y, None, 0.2)) > 0.1


def test_loss_gradient_matches_finite_differences() -> None:
    x, y = images(2, (12, 13, 3))
    weights = torch.rand(12, 13, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    # |x − y| has no kink here: two random images never meet within the step.
    assert torch.autograd.gradcheck(lambda image: weighted_loss(image, y, weights, 0.2), x.requires_grad_(), eps=1e-7, atol=1e-7)


def test_pixels_without_weight_teach_nothing_directly() -> None:
    x, y = images(4)
    weights = torch.ones(23, 31, dtype=torch.float64)
    weights[:, 20:] = 0
    x.requires_grad_()
    weighted_loss(x, y, weights, 0.0).backward()
    assert x.grad is not None
    assert (x.grad[:, 20:] == 0).all() and (x.grad[:, :20] != 0).all()


def test_all_weights_zero_give_a_finite_zero() -> None:
    x, y = images(5)
    assert float(weighted_loss(x, y, torch.zeros(23, 31, dtype=torch.float64), 0.2)) == 0.0


def test_black_white_and_flat_images_have_finite_gradients() -> None:
    for value, target in ((0.0, 1.0), (1.0, 0.0), (0.5, 0.5)):
        x = torch.full((16, 16, 3), value, requires_grad=True)
        weighted_loss(x, torch.full((16, 16, 3), target), None, 0.2).backward()
        assert x.grad is not None and torch.isfinite(x.grad).all()
