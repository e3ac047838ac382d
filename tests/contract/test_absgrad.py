"""absgrad: Σ_p |∂loss_p/∂means2d| against a float64 backward pass for each pixel, and that asking for it changes nothing else; weights:
the pixels that each Gaussian makes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from torch import Tensor

from radiant_core.cameras import Cameras
from radiant_core.render.contract import RenderOutput
from radiant_core.splats import Splats

from . import gaussians
from .backends import BACKENDS, NATIVE, Rendered, random_loss, render, undecided_pixels

on_every_backend = pytest.mark.parametrize("backend", BACKENDS)
on_every_native_build = pytest.mark.parametrize("backend", NATIVE)
PICTURES = ("images", "alphas", "depths")


def large(count: int, seed: int) -> Splats:
    """Gaussians of 1 to 8 px at a focal length of 20 px, some of them opaque beyond the cap of α."""
    splats = gaussians.regular(count, seed=seed)
    logits = splats.logit_opacities.copy()
    logits[::4] = 9.0
    return replace(splats, log_scales=splats.log_scales + np.float32(3), logit_opacities=logits)


def weights_of(output: RenderOutput, keep: Tensor, parts: tuple[str, ...]) -> dict[str, Tensor]:
    """∂loss by each picture, of both signs, the same for every backend; 0 at the pixels that are not kept."""
    generator = torch.Generator().manual_seed(3)
    drawn = {part: torch.randn(getattr(output, part).shape, generator=generator, dtype=torch.float64) for part in PICTURES}
    return {part: drawn[part] * (keep[..., None] if part == "images" else keep) for part in parts}


# Two cameras of 18 × 6 px: two tiles, blocks of which only a part is in the picture, 216 backward
# passes.
SPLATS, CAMERAS = large(40, seed=2), gaussians.off_centre_cameras(18, 6, count=2, focal_px=20)


@cache
def absolute_by_pixel(parts: tuple[str, ...], antialiased: bool) -> tuple[Tensor, dict[str, Tensor]]:
    """(C,N,2) of `SPLATS`: for each pixel a backward pass of its own, by absolute value; and the weights of the loss."""
    output = render(SPLATS, CAMERAS, "oracle", antialiased=antialiased).output
    weights = weights_of(output, ~undecided_pixels(SPLATS, CAMERAS, antialiased=antialiased), parts)
    total = torch.zeros_like(output.means2d)
    for c, y, x in np.ndindex(*output.alphas.shape):
        loss = sum((getattr(output, part)[c, y, x] * weight[c, y, x]).sum() for part, weight in weights.items())
        assert isinstance(loss, Tensor)
        total += torch.autograd.grad(loss, output.means2d, retain_graph=True)[0].abs()
    return total, weights


def backward(rendered: Rendered, weights: dict[str, Tensor]) -> Rendered:
    loss = sum((getattr(rendered.output, part) * weight.to(getattr(rendered.output, part))).sum() for part, weight in weights.items())
    assert isinstance(loss, Tensor)
    loss.backward()
    return rendered


def absgrad_of(rendered: Rendered) -> Tensor:
    assert rendered.output.absgrad is not None
    return rendered.output.absgrad.cpu().double()


@on_every_backend
@pytest.mark.parametrize(("parts", "antialiased"), [(("images",), False), (PICTURES, True)])
def test_the_sum_is_that_of_one_backward_pass_for_each_pixel(backend: str, parts: tuple[str, ...], antialiased: bool) -> None:
    truth, weights = absolute_by_pixel(parts, antialiased)
    got = backward(render(SPLATS, CAMERAS, backend, antialiased=antialiased, absgrad=True), weights)
    # Centres of float32 are 1e-6 px coarse at 18 px, gradients of some 10 Gaussians deep.
    torch.testing.assert_close(absgrad_of(got), truth, rtol=1e-4, atol=1e-5 * float(truth.max()))
    # Signed sums cancel: the test would not tell one from the other otherwise.
    assert got.output.means2d.grad is not None
    signed = got.output.means2d.grad.cpu().double().abs()
    assert (signed <= truth * (1 + 1e-4) + 1e-5 * truth.max()).all()
    assert (signed < 0.8 * truth)[truth > 0].double().mean() > 0.3


def test_the_reference_in_float64_is_exact() -> None:
    truth, weights = absolute_by_pixel(PICTURES, True)
    got = backward(render(SPLATS, CAMERAS, "oracle", antialiased=True, absgrad=True), weights)
    torch.testing.assert_close(absgrad_of(got), truth, rtol=1e-10, atol=1e-12 * float(truth.max()))


@on_every_native_build
def test_2000_gaussians_agree_with_the_reference(backend: str) -> None:
    splats, cameras = gaussians.regular(2000, seed=5), gaussians.off_centre_cameras(128, 96, focal_px=110)
    keep = ~undecided_pixels(splats, cameras)
    exact, got = (render(splats, cameras, name, absgrad=True) for name in ("oracle", backend))
    for rendered in (exact, got):
        random_loss(rendered.output, ("images",), keep).backward()
    truth = absgrad_of(exact)
    errors = (absgrad_of(got) - truth).norm(dim=-1) / truth.norm(dim=-1).clamp_min(1e-6 * float(truth.max()))
    assert errors.max() <= 1e-4


@on_every_backend
def test_asking_for_it_moves_no_bit_of_pictures_and_gradients(backend: str) -> None:
    splats, cameras = gaussians.regular(2000, seed=5), gaussians.off_centre_cameras(128, 96, count=2, focal_px=110)
    without, with_it = (render(splats, cameras, backend, absgrad=absgrad) for absgrad in (False, True))
    assert without.output.absgrad is None
    for rendered in (without, with_it):
        random_loss(rendered.output, ("images", "alphas")).backward()
    for part in ("images", "alphas", "depths", "radii_px", "means2d"):
        assert torch.equal(getattr(with_it.output, part), getattr(without.output, part)), part
    for name, gradient in with_it.gradients().items():
        assert torch.equal(gradient, without.gradients()[name]), name
    assert without.output.means2d.grad is not None and with_it.output.means2d.grad is not None
    assert torch.equal(with_it.output.means2d.grad, without.output.means2d.grad)


@on_every_native_build
def test_blocks_that_are_left_out_because_a_mask_hides_them_move_no_bit(backend: str) -> None:
    # Where weights are asked for, none is left out: they count pixels without a gradient too.
    splats, cameras = gaussians.regular(2000, seed=5), gaussians.off_centre_cameras(125, 93, focal_px=110)
    keep = torch.ones(1, 93, 125, dtype=torch.bool)
    keep[:, :50, 30:] = keep[:, :, 70:] = False
    left_out, walked, whole = (render(splats, cameras, backend, weights=weights) for weights in (False, True, True))
    for rendered, kept in ((left_out, keep), (walked, keep), (whole, None)):
        random_loss(rendered.output, ("images", "alphas"), kept).backward()
    for name, gradient in walked.gradients().items():
        assert torch.equal(gradient, left_out.gradients()[name]), name
        assert not torch.equal(gradient, whole.gradients()[name]), name
    assert walked.output.weights is not None and whole.output.weights is not None
    assert torch.equal(walked.output.weights, whole.output.weights)


@on_every_native_build
def test_beside_gradients_of_depths_the_others_stay_within_rounding(backend: str) -> None:
    # Under -ffast-math the compiler may add four registers to a sum in another order there: gcc 12
    # does in the portable build.
    splats, cameras = gaussians.regular(2000, seed=5), gaussians.off_centre_cameras(128, 96, focal_px=110)
    without, with_it = (render(splats, cameras, backend, absgrad=absgrad) for absgrad in (False, True))
    for rendered in (without, with_it):
        random_loss(rendered.output).backward()
    for name, gradient in with_it.gradients().items():
        torch.testing.assert_close(gradient, without.gradients()[name], rtol=0, atol=2e-6 * float(gradient.abs().max()), msg=name)


@on_every_native_build
def test_the_same_bits_for_1_2_and_16_threads_and_from_run_to_run(backend: str) -> None:
    # More than 4 chunks of 1,024 Gaussians.
    splats, cameras = gaussians.regular(5000, seed=9), gaussians.off_centre_cameras(150, 100, count=2, focal_px=130)
    renderings = [render(splats, cameras, backend, threads=threads, absgrad=True) for threads in (1, 2, 16, 2)]
    for rendered in renderings:
        random_loss(rendered.output, ("images",)).backward()
    first = absgrad_of(renderings[0])
    assert (first > 0).any() and all(torch.equal(absgrad_of(other), first) for other in renderings[1:])


@on_every_backend
def test_it_is_there_when_the_gradient_of_means2d_arrives_and_of_the_last_pass(backend: str) -> None:
    rendered = render(gaussians.regular(200), gaussians.off_centre_cameras(40, 30, focal_px=40), backend, absgrad=True)
    assert not absgrad_of(rendered).any()
    seen: list[Tensor] = []
    rendered.output.means2d.register_hook(lambda _: seen.append(absgrad_of(rendered).clone()))
    for factor in (1.0, 2.0):
        (factor * rendered.output.images.sum()).backward(retain_graph=True)
    assert len(seen) == 2 and seen[0].any()
    torch.testing.assert_close(seen[1], 2 * seen[0], rtol=1e-6, atol=0)


def behind(splats: Splats) -> Splats:
    return replace(splats, means=splats.means - np.float32([0, 0, 100]))


@on_every_backend
def test_what_is_not_seen_gets_zero(backend: str) -> None:
    cameras = gaussians.off_centre_cameras(20, 20)
    half = gaussians.regular(60)
    means = half.means.copy()
    means[::2] = behind(half).means[::2]
    for splats, hidden in (
        (behind(half), np.ones(60, bool)),
        (replace(half, means=means), np.arange(60) % 2 == 0),
        (half.select(np.zeros(0, dtype=int)), np.zeros(0, bool)),
    ):
        # The same memory twice over, so that nothing that another model left in it is taken for a
        # gradient.
        for _ in range(2):
            rendered = render(splats, cameras, backend, absgrad=True)
            rendered.output.images.sum().backward()
            assert absgrad_of(rendered).shape == (1, len(splats), 2)
            assert not absgrad_of(rendered)[:, torch.from_numpy(hidden)].any()
            render(half, cameras, backend, absgrad=True).output.images.sum().backward()


@on_every_backend
def test_degenerate_gaussians_and_huge_gradients_leave_no_nan(backend: str) -> None:
    splats, cameras = gaussians.degenerate(2000), gaussians.off_centre_cameras(48, 32, focal_px=50)
    rendered = render(splats, cameras, backend, absgrad=True)
    random_loss(rendered.output).backward()
    assert torch.isfinite(absgrad_of(rendered)).all() and (absgrad_of(rendered) >= 0).all()


@on_every_native_build
def test_a_gradient_that_is_no_number_stays_none_where_it_was(backend: str) -> None:
    rendered = render(gaussians.regular(200), gaussians.off_centre_cameras(32, 32, focal_px=30), backend, absgrad=True)
    poison = torch.ones_like(rendered.output.images)
    poison[0, 10, 10, 0] = torch.nan
    rendered.output.images.backward(poison)
    assert rendered.output.means2d.grad is not None
    lost = absgrad_of(rendered).isnan()
    assert lost.any() and not lost.all()
    assert torch.equal(lost, rendered.output.means2d.grad.isnan())


@on_every_backend
def test_without_gradients_there_are_none(backend: str) -> None:
    with torch.no_grad():
        rendered = render(gaussians.regular(20), gaussians.off_centre_cameras(16, 16), backend, absgrad=True)
    assert not absgrad_of(rendered).any()


def test_a_camera_more_changes_nothing_for_the_first() -> None:
    splats, cameras = gaussians.regular(300), gaussians.off_centre_cameras(40, 30, count=2, focal_px=40)
    one = Cameras(names=("one",), Ks=cameras.Ks[:1], cam_from_world=cameras.cam_from_world[:1], sizes_wh=cameras.sizes_wh[:1])
    both, first = (render(splats, views, NATIVE[0], absgrad=True) for views in (cameras, one))
    for rendered in (both, first):
        rendered.output.images.square().sum().backward()
    assert torch.equal(absgrad_of(both)[0], absgrad_of(first)[0])


@on_every_backend
def test_weights_are_the_pixels_that_each_gaussian_makes(backend: str) -> None:
    splats, cameras = gaussians.regular(2000, seed=5), gaussians.off_centre_cameras(128, 96, count=2, focal_px=110)
    exact, got = (render(splats, cameras, name, weights=True) for name in ("oracle", backend))
    random_loss(got.output, ("images",)).backward()
    assert exact.output.weights is not None and got.output.weights is not None and got.output.absgrad is None
    weights = got.output.weights.cpu().double()
    # Together they make what the picture shows, whatever the loss was.
    torch.testing.assert_close(weights.sum(1), got.output.alphas.double().sum((1, 2)), rtol=1e-5, atol=0)
    # One pixel in 70 has a Gaussian within rounding of α_min, which counts 1/255 of a pixel.
    errors = (weights - exact.output.weights).abs() - 1e-4 * exact.output.weights
    assert errors.max() < 0.02 and (errors < 1e-4).double().mean() > 0.95


@on_every_native_build
def test_weights_are_of_the_picture_alone_not_of_the_loss(backend: str) -> None:
    drawn = [render(SPLATS, CAMERAS, backend, weights=True, absgrad=absgrad) for absgrad in (False, True)]
    for factor, rendered in zip((1.0, -3.0), drawn, strict=True):
        (factor * rendered.output.images.sum()).backward()
    assert drawn[0].output.weights is not None and drawn[1].output.weights is not None
    assert torch.equal(drawn[0].output.weights, drawn[1].output.weights) and drawn[0].output.weights.sum() > 10


@on_every_backend
def test_one_gaussian_alone_makes_what_alpha_shows(backend: str) -> None:
    rendered = render(large(1, seed=2), CAMERAS, backend, weights=True)
    rendered.output.images.sum().backward()
    assert rendered.output.weights is not None
    weights, alphas = rendered.output.weights.cpu()[:, 0].double(), rendered.output.alphas.sum((1, 2)).double()
    torch.testing.assert_close(weights, alphas, rtol=1e-5, atol=1e-6)
