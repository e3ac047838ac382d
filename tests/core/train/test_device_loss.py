"""The loss of GPUs, on the CPU: values, gradients and statistics against float64, its own precision,
and how few operations it takes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from radiant_core.train.device_loss import device_loss, device_statistics
from radiant_core.train.losses import weighted_loss
from radiant_core.train.native_loss import TargetStatistics
from tests.core.train.test_native_loss import SHAPES, exact, pair, random_weights, relative


def on_a_device(image, target, weights, ssim_weight):
    leaf = image.clone().requires_grad_()
    loss = device_loss(leaf, (target, *device_statistics(target)), weights, ssim_weight)
    loss.backward()
    assert leaf.grad is not None
    return loss.item(), leaf.grad


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("distance", [1.0, 0.05, 1e-3])
def test_value_and_gradient_equal_float64(shape: tuple[int, int], distance: float) -> None:
    image, target = pair(shape, distance)
    for weights in (None, random_weights(shape) + 0.01):
        for ssim_weight in (0.0, 0.2, 1.0):
            loss, gradient = on_a_device(image, target, weights, ssim_weight)
            exact_loss, exact_gradient = exact(image, target, weights, ssim_weight)
            assert loss == pytest.approx(exact_loss, rel=2e-6)
            assert relative(gradient - exact_gradient, exact_gradient) < 2e-6


def test_its_equations_are_exact() -> None:
    image, target = (tensor.double() for tensor in pair((33, 41), 0.7))
    loss, gradient = on_a_device(image, target, random_weights((33, 41)).double(), 0.3)
    exact_loss, exact_gradient = exact(image, target, random_weights((33, 41)), 0.3)
    assert loss == pytest.approx(exact_loss, rel=1e-12)
    assert relative(gradient - exact_gradient, exact_gradient) < 1e-12


def test_statistics_are_those_of_the_native_kernel() -> None:
    _, target = pair((30, 41), 0.0)
    ours, native = device_statistics(target), TargetStatistics.of(target)
    torch.testing.assert_close(ours[0], native.means, rtol=1.2e-7, atol=0)
    torch.testing.assert_close(ours[1], native.variances, rtol=2.4e-7, atol=1e-15)


def test_weights_of_zero_have_no_loss_and_no_gradient() -> None:
    image, target = pair((20, 20), 1.0)
    loss, gradient = on_a_device(image, target, torch.zeros(20, 20), 0.2)
    assert loss == 0 and not gradient.any()


@pytest.mark.parametrize(("image", "target"), [(0.0, 3e8), (3e8, 0.0), (1e9, 1e9), (3e8, 2.9e8)])
def test_bright_planes_keep_the_limits_that_rounding_would_break(image: float, target: float) -> None:
    # Variances of such planes are differences of 1e17; a negative one would divide by what is near 0.
    pictures = [torch.full((24, 24, 3), value) for value in (image, target)]
    for picture in pictures:
        picture[::2] *= 1 + 1e-7
    loss, gradient = on_a_device(pictures[0], pictures[1], None, 1.0)
    assert 0 <= loss <= 2.001 and torch.isfinite(gradient).all()
    assert (device_statistics(pictures[1])[1] >= 0).all()


@pytest.mark.parametrize("poison", [np.nan, np.inf, 1e30])
def test_what_is_not_finite_shows_in_the_loss(poison: float) -> None:
    image, target = pair((20, 20), 1.0)
    image[3, 4, 1] = poison
    loss = device_loss(image, (target, *device_statistics(target)), None, 0.2)
    assert not torch.isfinite(loss) or loss > 1e20


def test_it_takes_two_thirds_of_the_operations_of_autograd() -> None:
    image, target = pair((20, 20), 1.0)
    statistics = device_statistics(target)
    counts = []
    for loss in (lambda leaf: device_loss(leaf, (target, *statistics), None, 0.2), lambda leaf: weighted_loss(leaf, target, None, 0.2)):
        with Operations() as operations:
            loss(image.clone().requires_grad_()).backward()
        counts.append(operations.count)
    assert counts[0] <= 2 / 3 * counts[1], counts


class Operations(TorchDispatchMode):
    """Counts the operations that would launch something on a GPU: all but views."""

    count = 0

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        self.count += not func.is_view
        return func(*args, **(kwargs or {}))
