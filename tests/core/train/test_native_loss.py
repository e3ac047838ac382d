"""The native loss against the plain one in float64: values, gradients, weights, every build,
hostile images; all in float32 itself."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import torch
from torch import Tensor

from radiant_core import _native
from radiant_core.errors import BadInput
from radiant_core.train.losses import weighted_loss
from radiant_core.train.memory import STATISTICS_BYTES_PER_PX
from radiant_core.train.native_loss import StatisticsCache, TargetStatistics, target_loss

SHAPES = [(1, 1), (1, 40), (40, 1), (3, 500), (5, 5), (11, 17), (33, 64), (70, 43)]
# Float32's rounding is 6e-8; a window of 121 weighted terms and a row of pixels add a few of them.
LOSS_TOLERANCE, GRADIENT_TOLERANCE = 1e-6, 1e-6


def pair(shape: tuple[int, int], distance: float, seed: int = 0) -> tuple[Tensor, Tensor]:
    """An image and a smooth-and-noisy target, some `distance` apart."""
    rng = np.random.default_rng((seed, *shape))
    ramp = np.linspace(0.1, 0.6, shape[1])[None, :, None]
    target = ramp + 0.4 * rng.random((*shape, 3))
    image = target + distance * (rng.random((*shape, 3)) - 0.5)
    return torch.tensor(image, dtype=torch.float32), torch.tensor(target, dtype=torch.float32)


def random_weights(shape: tuple[int, int]) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(7)) * (
        torch.rand(shape, generator=torch.Generator().manual_seed(8)) > 0.3
    )


def exact(image: Tensor, target: Tensor, weights: Tensor | None, ssim_weight: float) -> tuple[float, Tensor]:
    image = image.double().requires_grad_()
    loss = weighted_loss(image, target.double(), None if weights is None else weights.double(), ssim_weight)
    return loss.item(), torch.autograd.grad(loss, image)[0]


def native(
    image: Tensor, target: Tensor, weights: Tensor | None, ssim_weight: float, num_threads: int = 1, build: str = ""
) -> tuple[float, Tensor]:
    means, variances, gradient = (torch.empty_like(target) for _ in range(3))
    _native.target_statistics(target, means, variances, num_threads, build)
    return _native.training_loss(image, target, means, variances, weights, gradient, ssim_weight, num_threads, build), gradient


def relative(error: Tensor, truth: Tensor) -> float:
    return float(error.norm() / truth.norm().clamp_min(1e-30))


@pytest.mark.parametrize("build", _native.instruction_sets())
@pytest.mark.parametrize("shape", SHAPES)
def test_every_build_equals_float64(shape: tuple[int, int], build: str) -> None:
    for distance in (1.0, 0.05):
        image, target = pair(shape, distance)
        for weights in (None, random_weights(shape) + 0.01):
            for ssim_weight in (0.0, 0.2, 1.0):
                loss, gradient = native(image, target, weights, ssim_weight, build=build)
                exact_loss, exact_gradient = exact(image, target, weights, ssim_weight)
                assert loss == pytest.approx(exact_loss, rel=LOSS_TOLERANCE)
                assert relative(gradient - exact_gradient, exact_gradient) < GRADIENT_TOLERANCE


def test_precision_holds_where_image_and_target_nearly_meet() -> None:
    # Differences of 1e-3 cost torch's float32 up to 4 of 7 digits of the SSIM gradient; written in
    # differences it keeps them.
    image, target = pair((48, 64), 1e-3)
    loss, gradient = native(image, target, None, 1.0)
    exact_loss, exact_gradient = exact(image, target, None, 1.0)
    assert loss == pytest.approx(exact_loss, rel=LOSS_TOLERANCE)
    assert relative(gradient - exact_gradient, exact_gradient) < GRADIENT_TOLERANCE
    plain = image.clone().requires_grad_()
    weighted_loss(plain, target, None, 1.0).backward()
    assert plain.grad is not None
    assert relative(plain.grad - exact_gradient, exact_gradient) > 1e-5


def test_gradient_matches_finite_differences_of_the_native_loss() -> None:
    image, target = pair((14, 13), 1.0)
    weights = random_weights((14, 13))
    _, gradient = native(image, target, weights, 0.2)
    for flat in np.random.default_rng(0).choice(image.numel(), 40, replace=False):
        # ± 1e-3: the third derivative adds 1e-6 of the gradient, rounding of the two losses 1e-4.
        # Kinks of |d| are left out.
        if (image - target).flatten()[flat].abs() < 2e-3:
            continue
        step = torch.zeros(image.numel())
        step[flat] = 1e-3
        ahead, behind = image + step.view_as(image), image - step.view_as(image)
        slope = native(ahead, target, weights, 0.2)[0] - native(behind, target, weights, 0.2)[0]
        slope /= float((ahead - behind).flatten()[flat])
        assert slope == pytest.approx(float(gradient.flatten()[flat]), rel=2e-3, abs=1e-3 * float(gradient.abs().max()))


@pytest.mark.parametrize("build", _native.instruction_sets())
@pytest.mark.parametrize("shape", [(3, 500), (97, 50), (600, 9)])
def test_threads_do_not_change_a_bit(shape: tuple[int, int], build: str) -> None:
    image, target = pair(shape, 0.3)
    for weights in (None, random_weights(shape)):
        loss, gradient = native(image, target, weights, 0.2, 1, build)
        for num_threads in (2, 3, 16):
            other_loss, other = native(image, target, weights, 0.2, num_threads, build)
            assert loss == other_loss
            assert torch.equal(gradient.view(torch.int32), other.view(torch.int32))


def test_the_value_alone_is_the_same_as_with_the_gradient() -> None:
    image, target = pair((70, 43), 0.3)
    statistics = TargetStatistics.of(target)
    with_gradient = target_loss(image.clone().requires_grad_(), statistics, None, 0.2)
    alone = target_loss(image, statistics, None, 0.2)
    assert with_gradient.requires_grad and not alone.requires_grad
    assert with_gradient.item() == alone.item()


def test_statistics_are_the_blurred_mean_and_variance() -> None:
    from scipy.ndimage import gaussian_filter

    _, target = pair((30, 41), 0.0)
    statistics = TargetStatistics.of(target)
    y = target.double().numpy()
    mean, square = (gaussian_filter(plane, (1.5, 1.5, 0), mode="constant", radius=(5, 5, 0)) for plane in (y, y * y))
    np.testing.assert_allclose(statistics.means, mean, rtol=1e-7)  # one rounding to float32
    np.testing.assert_allclose(statistics.variances, square - mean**2, rtol=2e-7, atol=1e-15)


def test_backward_scales_with_what_comes_from_above() -> None:
    image, target = pair((20, 20), 0.5)
    statistics = TargetStatistics.of(target)
    gradients = []
    for factor in (1.0, -2.5):
        leaf = image.clone().requires_grad_()
        (factor * target_loss(leaf, statistics, None, 0.2)).backward()
        gradients.append(leaf.grad)
    assert gradients[0] is not None and gradients[1] is not None
    torch.testing.assert_close(gradients[1], -2.5 * gradients[0], rtol=1e-6, atol=0)


def test_other_types_take_the_plain_path() -> None:
    image, target = pair((20, 20), 0.5)
    loss = target_loss(image.double().requires_grad_(), TargetStatistics.of(target), random_weights((20, 20)), 0.2)
    assert loss.dtype == torch.float64 and loss.requires_grad
    assert loss.item() == pytest.approx(exact(image, target, random_weights((20, 20)), 0.2)[0], rel=1e-12)


@pytest.mark.parametrize("dtype", [torch.float16, torch.float64])
def test_targets_of_another_type_have_the_same_statistics(dtype: torch.dtype) -> None:
    image, target = pair((20, 20), 0.5)
    target = target.half().float()
    statistics = TargetStatistics.of(target.to(dtype))
    assert statistics.target.dtype == statistics.means.dtype == torch.float32
    assert target_loss(image, statistics, None, 0.2).item() == target_loss(image, TargetStatistics.of(target), None, 0.2).item()
    with pytest.raises(BadInput, match=r"target is torch.uint8"):
        TargetStatistics.of((target * 255).to(torch.uint8))
    for wrong in (target.double(), target.permute(1, 0, 2)):
        with pytest.raises(TypeError, match="incompatible function arguments"):
            _native.target_statistics(target, torch.empty_like(target), wrong)


def test_without_gradients_none_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    image, target = pair((20, 20), 0.5)
    given: list[Tensor | None] = []
    kernel = _native.training_loss
    monkeypatch.setattr(_native, "training_loss", lambda *arguments: given.append(arguments[5]) or kernel(*arguments))
    with torch.no_grad():
        target_loss(image.requires_grad_(), TargetStatistics.of(target), None, 0.2)
    assert given == [None]


def test_views_into_larger_tensors_are_read_in_their_own_order() -> None:
    image, target = pair((20, 30), 0.5)
    turned = image.permute(1, 0, 2).contiguous().permute(1, 0, 2)
    assert not turned.is_contiguous()
    statistics = TargetStatistics.of(target.permute(1, 0, 2).contiguous().permute(1, 0, 2))
    assert target_loss(turned, statistics, None, 0.2).item() == target_loss(image, TargetStatistics.of(target), None, 0.2).item()


@pytest.mark.parametrize(("value", "target_value"), [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0), (0.5, 0.5), (0.3, 0.7)])
def test_flat_images_have_the_right_and_finite_gradient(value: float, target_value: float) -> None:
    image, target = torch.full((25, 33, 3), value), torch.full((25, 33, 3), target_value)
    loss, gradient = native(image, target, None, 0.2)
    exact_loss, exact_gradient = exact(image, target, None, 0.2)
    assert torch.isfinite(gradient).all()
    # Variances of a flat picture are zero inside, so float32's rounding of d² over C2 = 9e-4
    # remains: 1e-7 / 9e-4.
    assert loss == pytest.approx(exact_loss, rel=1e-5, abs=1e-12)
    assert float((gradient - exact_gradient).abs().max()) < 2e-4 * max(float(exact_gradient.abs().max()), 1e-6)


def test_equal_images_cost_exactly_nothing() -> None:
    _, target = pair((31, 29), 0.0)
    loss, gradient = native(target.clone(), target, None, 0.2)
    assert loss == 0.0 and (gradient == 0).all()


def test_all_weights_zero_give_zero_and_no_gradient() -> None:
    image, target = pair((23, 31), 0.5)
    loss, gradient = native(image, target, torch.zeros(23, 31), 0.2)
    assert loss == 0.0 and (gradient == 0).all()


@pytest.mark.parametrize("scale", [1e-30, 1e3, 1e9, 1e18])
def test_huge_and_tiny_values_stay_finite(scale: float) -> None:
    image, target = pair((20, 24), 0.5)
    for x, y in ((image * scale, target), (image, target * scale), (-image * scale, target * scale)):
        loss, gradient = native(x, y, None, 0.2)
        assert np.isfinite(loss) and loss >= 0 and torch.isfinite(gradient).all()


class TestPoison:
    @pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize("ssim_weight", [0.0, 0.2, 1.0])
    def test_in_the_image_is_named(self, poison: float, ssim_weight: float) -> None:
        image, target = pair((12, 13), 0.5)
        image[3, 4, 1] = image[9, 0, 2] = poison
        weights = torch.zeros(12, 13)  # also where nobody looks
        for given in (None, weights):
            with pytest.raises(BadInput, match=r"image has 2 values that are not finite, the first at index \(3, 4, 1\)"):
                target_loss(image, TargetStatistics.of(target), given, ssim_weight)

    def test_in_the_target_is_named(self) -> None:
        _, target = pair((12, 13), 0.5)
        target[11, 12, 2] = torch.nan
        with pytest.raises(BadInput, match=r"target has 1 values that are not finite, the first at index \(11, 12, 2\)"):
            TargetStatistics.of(target)

    def test_in_the_weights_is_named(self) -> None:
        image, target = pair((12, 13), 0.5)
        weights = torch.ones(12, 13)
        weights[2, 3] = torch.nan
        with pytest.raises(BadInput, match=r"weights has 1 values that are not finite, the first at index \(2, 3\)"):
            target_loss(image, TargetStatistics.of(target), weights, 0.2)

    def test_negative_weights_are_named(self) -> None:
        image, target = pair((12, 13), 0.5)
        weights = torch.ones(12, 13)
        weights[2, 3] = weights[4, 0] = -0.5
        with pytest.raises(BadInput, match=r"weights has 2 values that are negative, the first at index \(2, 3\)"):
            target_loss(image, TargetStatistics.of(target), weights, 0.2)

    @pytest.mark.parametrize("ssim_weight", [0.0, 0.2, 1.0])
    def test_values_whose_squares_leave_float32_are_named(self, ssim_weight: float) -> None:
        image, target = pair((12, 13), 0.5)
        huge = image.clone()
        huge[5, 6, 1] = 1e30
        with pytest.raises(BadInput, match=r"image has 1 values that are beyond 2e18, the first at index \(5, 6, 1\)"):
            target_loss(huge, TargetStatistics.of(target), None, ssim_weight)
        with pytest.raises(BadInput, match=r"target has 1 values that are beyond 2e18, the first at index \(5, 6, 1\)"):
            TargetStatistics.of(huge)

    @pytest.mark.parametrize("ssim_weight", [np.nan, -0.1, 1.5])
    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    def test_a_share_that_is_none_is_refused(self, ssim_weight: float, dtype: torch.dtype) -> None:
        image, target = pair((12, 13), 0.5)
        with pytest.raises(BadInput, match="ssim_weight is"):
            target_loss(image.to(dtype), TargetStatistics.of(target), None, ssim_weight)

    def test_wrong_shapes_are_named(self) -> None:
        image, target = pair((12, 13), 0.5)
        statistics = TargetStatistics.of(target)
        with pytest.raises(BadInput, match=r"target has shape \(12, 13, 3\), expected \(11, 13, 3\)"):
            target_loss(image[:11], statistics, None, 0.2)
        with pytest.raises(BadInput, match=r"weights has shape \(13, 12\), expected \(12, 13\)"):
            target_loss(image, statistics, torch.ones(13, 12), 0.2)
        with pytest.raises(BadInput, match=r"target has shape \(0, 13, 3\)"):
            TargetStatistics.of(target[:0])

    def test_an_unknown_build_is_named(self) -> None:
        image, target = pair((12, 13), 0.5)
        with pytest.raises(ValueError, match="instruction_set 'mmx' is unknown"):
            native(image, target, None, 0.2, build="mmx")


def test_the_cache_keeps_the_first_that_fit() -> None:
    targets = [pair((20, 20), 0.0, seed)[1] for seed in range(3)]
    cache = StatisticsCache(budget_bytes=2 * STATISTICS_BYTES_PER_PX * 20 * 20)
    rounds = [[cache.get(view, lambda view=view: targets[view].clone()) for view in range(3)] for _ in range(2)]
    for first, second, target in zip(*rounds, targets, strict=True):
        fresh = TargetStatistics.of(target)
        for name in ("target", "means", "variances"):
            assert torch.equal(getattr(second, name), getattr(fresh, name)) and torch.equal(getattr(first, name), getattr(fresh, name))
    shared = [first.means.data_ptr() == second.means.data_ptr() for first, second in zip(*rounds, strict=True)]
    assert shared == [True, True, False]


def test_denormals_survive_the_import() -> None:
    code = "import numpy as np; from radiant_core import _native; x = np.float32(1e-40); assert x * np.float32(0.5) > 0, 'flushed'"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
