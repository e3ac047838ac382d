"""One contract for every rasterizer: each feature and each gradient against the float64 reference,
and the same bits.

Limits are those the project set for its rasterizers: 1e-4 in the image where no pair is undecided,
5e-3 elsewhere (one 8-bit step of one Gaussian), RMS 1e-5; gradients 1e-4 for regular Gaussians,
5e-2 for needles, finite for degenerate ones.
"""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
import torch

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.render.backends import device_of
from radiant_core.render.contract import Backend, SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import Splats

from . import gaussians
from .backends import BACKENDS, FEATURES, NATIVE, Feature, opacity_rounding, random_loss, relative_errors, render, undecided_pixels

MAX_ERROR, MAX_ERROR_UNDECIDED, MAX_RMS = 1e-4, 5e-3, 1e-5

on_every_backend = pytest.mark.parametrize("backend", BACKENDS)
on_every_native_build = pytest.mark.parametrize("backend", NATIVE)


def assert_pictures_agree(splats: Splats, cameras: Cameras, backend: str, **options) -> None:
    exact, got = (render(splats, cameras, name, **options).output for name in ("oracle", backend))
    undecided = undecided_pixels(splats, cameras, 1e-5, **options)
    for part, unit in (("images", 1.0), ("alphas", 1.0), ("depths", 12.0)):
        error = (getattr(got, part).double() - getattr(exact, part)).detach().abs() / unit
        error = error.amax(-1) if part == "images" else error
        assert error[~undecided].max() <= MAX_ERROR, part
        # A pixel whose only Gaussian is undecided has all of its depth or none of it.
        assert part == "depths" or error.max() <= MAX_ERROR_UNDECIDED, part
        assert error[~undecided].square().mean().sqrt() <= MAX_RMS, part
    # float32 of some 100 px, and of extents that a radius is computed from.
    drawn = exact.radii_px > 0
    torch.testing.assert_close(got.means2d.cpu().double()[drawn], exact.means2d[drawn], rtol=1e-5, atol=1e-3)
    if backend == "gsplat":  # rounded up, and of Gaussians too faint to be drawn as well
        assert (got.radii_px.cpu()[drawn] >= exact.radii_px[drawn].float() - 1e-3).all()
    else:
        torch.testing.assert_close(got.radii_px.double(), exact.radii_px, rtol=1e-4, atol=1e-3)


@on_every_backend
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("antialiased", [False, True])
def test_small_picture_of_every_degree_and_filter(backend: str, degree: int, antialiased: bool) -> None:
    splats = gaussians.regular(600, seed=degree, bases=16)
    # 61 × 45 px: partial tiles and partial blocks on both sides.
    assert_pictures_agree(splats, gaussians.off_centre_cameras(61, 45, focal_px=60), backend, sh_degree=degree, antialiased=antialiased)


@on_every_backend
def test_several_cameras_equal_one_after_another_and_their_gradients_add_up(backend: str) -> None:
    splats, cameras = gaussians.regular(400), gaussians.off_centre_cameras(48, 32, count=3, focal_px=50)
    together = render(splats, cameras, backend)
    together.output.images.square().sum().backward()
    sums = {name: torch.zeros_like(gradient) for name, gradient in together.gradients().items()}
    for index in range(3):
        one = Cameras(
            names=("one",),
            Ks=cameras.Ks[[index]],
            cam_from_world=cameras.cam_from_world[[index]],
            sizes_wh=cameras.sizes_wh[[index]],
        )
        single = render(splats, one, backend)
        single.output.images.square().sum().backward()
        assert torch.equal(single.output.images[0], together.output.images[index])
        for name, gradient in single.gradients().items():
            sums[name] += gradient
    for name, gradient in together.gradients().items():
        torch.testing.assert_close(gradient, sums[name], rtol=1e-5, atol=1e-5 * float(gradient.abs().max()))


@on_every_backend
def test_near_and_far_cut_by_depth(backend: str) -> None:
    splats, cameras = gaussians.regular(500), gaussians.off_centre_cameras(48, 32, focal_px=50)
    depths = splats.means[:, 2] + 12.0
    within = (depths > 11.0) & (depths < 13.0)
    cut = render(splats, cameras, backend, near_m=11.0, far_m=13.0).output
    chosen = render(splats.select(within), cameras, backend).output
    torch.testing.assert_close(cut.images, chosen.images, rtol=0, atol=1e-6)
    assert (cut.radii_px[0, ~torch.from_numpy(within)] == 0).all()


@on_every_backend
@pytest.mark.parametrize("antialiased", [False, True])
def test_gradients_of_2000_regular_gaussians(backend: str, antialiased: bool) -> None:
    splats, cameras = gaussians.regular(2000, seed=5), gaussians.off_centre_cameras(128, 96, focal_px=110)
    assert_gradients_agree(splats, cameras, backend, antialiased=antialiased, limit=1e-4)


@on_every_native_build
@pytest.mark.parametrize("antialiased", [False, True])
def test_gradients_of_400_needles(backend: str, antialiased: bool) -> None:
    splats, cameras = gaussians.needles(400, seed=6), gaussians.off_centre_cameras(64, 48, focal_px=220)
    assert_gradients_agree(splats, cameras, backend, antialiased=antialiased, limit=5e-2)


@on_every_native_build
@pytest.mark.parametrize("focal_px", [15.0, 40.0])
@pytest.mark.parametrize("antialiased", [False, True])
def test_gradients_at_the_frustum_edge_and_under_the_clamped_jacobian(backend: str, focal_px: float, antialiased: bool) -> None:
    splats, cameras = gaussians.frustum_edge(150, seed=7), gaussians.off_centre_cameras(40, 30, focal_px=focal_px)
    output = render(splats, cameras, backend, antialiased=antialiased).output
    beyond = (output.means2d < -0.15 * torch.tensor([40, 30])) | (output.means2d > 1.15 * torch.tensor([40, 30]))
    assert (beyond.any(-1) & (output.radii_px > 0)).sum() >= 15
    assert_gradients_agree(splats, cameras, backend, antialiased=antialiased, limit=1e-4)


def assert_gradients_agree(splats: Splats, cameras: Cameras, backend: str, *, limit: float, antialiased: bool = False) -> None:
    """All gradients to `limit` per Gaussian, but for what opacities lose to float32.

    Float32 PyTorch and gsplat have centres 1e-5 px coarse, which costs them 20 times as much; the
    first is the oracle in float64 only.
    """
    slack = 1 if backend in NATIVE else 20
    keep = ~undecided_pixels(splats, cameras, antialiased=antialiased)
    exact, got = (render(splats, cameras, name, antialiased=antialiased) for name in ("oracle", backend))
    for rendered in (exact, got):
        random_loss(rendered.output, ("images",), keep).backward()
    truth = exact.gradients()
    for name, gradient in got.gradients().items():
        rounding = slack * opacity_rounding(splats, truth) if name == "logit_opacities" else 0.0
        errors = relative_errors(gradient, truth[name], rounding)
        assert errors.max() <= slack * limit, (name, float(errors.max()))
    assert exact.background.grad is not None and got.background.grad is not None
    torch.testing.assert_close(got.background.grad.double(), exact.background.grad, rtol=1e-5, atol=1e-5)


@on_every_backend
@pytest.mark.parametrize("parts", [("images",), ("alphas",), ("depths",), ("images", "alphas", "depths")])
def test_gradients_may_arrive_on_any_picture(backend: str, parts: tuple[str, ...]) -> None:
    splats, cameras = gaussians.regular(300, seed=8), gaussians.off_centre_cameras(40, 30, focal_px=40)
    keep = ~undecided_pixels(splats, cameras)
    exact, got = (render(splats, cameras, name) for name in ("oracle", backend))
    for rendered in (exact, got):
        random_loss(rendered.output, parts, keep).backward()
    for name, gradient in got.gradients().items():
        truth = exact.gradients()[name]
        assert (gradient - truth).norm() <= 1e-4 * truth.norm(), name
    assert exact.output.means2d.grad is not None and got.output.means2d.grad is not None
    assert (got.output.means2d.grad.cpu() - exact.output.means2d.grad).norm() <= 1e-4 * exact.output.means2d.grad.norm()


@on_every_backend
@pytest.mark.parametrize("part", ["images", "alphas", "depths"])
def test_gradients_of_a_picture_that_a_mask_hides_in_part(backend: str, part: str) -> None:
    # 0 in whole blocks, in parts of one, and beside the edge: what has no gradient may be left out.
    splats, cameras = gaussians.regular(300, seed=8), gaussians.off_centre_cameras(61, 45, focal_px=60)
    keep = ~undecided_pixels(splats, cameras)
    keep[:, :20, 18:] = keep[:, :, 18:40] = False
    exact, got = (render(splats, cameras, name) for name in ("oracle", backend))
    for rendered in (exact, got):
        random_loss(rendered.output, (part,), keep).backward()
    for name, gradient in got.gradients().items():
        truth = exact.gradients()[name]
        assert (gradient - truth).norm() <= 1e-4 * truth.norm(), name


@on_every_backend
def test_a_loss_on_means2d_reaches_the_means(backend: str) -> None:
    splats, cameras = gaussians.regular(50), gaussians.off_centre_cameras(40, 30, focal_px=40)
    exact, got = (render(splats, cameras, name) for name in ("oracle", backend))
    drawn = exact.output.radii_px > 0
    for rendered in (exact, got):
        rendered.output.means2d[drawn.to(rendered.output.means2d.device)].square().sum().backward()
    torch.testing.assert_close(got.gradients()["means"], exact.gradients()["means"], rtol=1e-5, atol=1e-3)


@on_every_backend
def test_degenerate_gaussians_leave_pictures_and_gradients_finite(backend: str) -> None:
    splats, cameras = gaussians.degenerate(2000 if backend == "reference" else 10_000), gaussians.off_centre_cameras(48, 32, focal_px=50)
    for antialiased in (False, True):
        rendered = render(splats, cameras, backend, antialiased=antialiased)
        random_loss(rendered.output).backward()
        assert all(torch.isfinite(getattr(rendered.output, part)).all() for part in ("images", "alphas", "depths", "radii_px", "means2d"))
        for name, gradient in rendered.gradients().items():
            assert torch.isfinite(gradient).all(), name


@on_every_native_build
def test_a_gradient_that_is_no_number_stays_none(backend: str) -> None:
    # Held within float32 like an overflow it would reach the optimiser as an ordinary, huge number.
    rendered = render(gaussians.regular(200), gaussians.off_centre_cameras(32, 32, focal_px=30), backend)
    poison = torch.ones_like(rendered.output.images)
    poison[0, 10, 10, 0] = torch.nan
    rendered.output.images.backward(poison)
    lost = [gradient.isnan().any(1) for gradient in rendered.gradients().values()]
    assert lost[0].any() and not lost[0].all()
    assert all(torch.equal(where, lost[0]) for where in lost)


@on_every_native_build
def test_the_same_bits_for_1_2_and_16_threads_and_from_run_to_run(backend: str) -> None:
    # More than 4 chunks of 1,024 Gaussians, so that the threads have something to disagree about.
    splats, cameras = gaussians.regular(5000, seed=9), gaussians.off_centre_cameras(150, 100, count=2, focal_px=130)
    renderings = [render(splats, cameras, backend, threads=threads) for threads in (1, 2, 16, 2)]
    for rendered in renderings:
        random_loss(rendered.output).backward()
    first = renderings[0]
    for other in renderings[1:]:
        for part in ("images", "alphas", "depths", "radii_px", "means2d"):
            assert torch.equal(getattr(other.output, part), getattr(first.output, part)), part
        for name, gradient in other.gradients().items():
            assert torch.equal(gradient, first.gradients()[name]), name


@pytest.mark.skipif("native-avx512" not in NATIVE, reason="this CPU has only one of the builds that round a product and a sum once")
@pytest.mark.parametrize("antialiased", [False, True])
def test_builds_with_fused_arithmetic_draw_the_same_bits(antialiased: bool) -> None:
    # Decisions at an opacity of 1/255 and a transmittance of 1e-4 depend on the last bit: 20,000 meet some of them.
    splats, cameras = gaussians.regular(20_000, bases=16), gaussians.off_centre_cameras(200, 150, focal_px=180)
    builds = ("native-avx512", "native-avx2")
    first, second = (render(splats, cameras, build, sh_degree=3, antialiased=antialiased).output for build in builds)
    for part in ("images", "alphas", "depths", "means2d", "radii_px"):
        assert torch.equal(getattr(first, part), getattr(second, part)), part


@on_every_backend
def test_the_order_of_the_gaussians_does_not_matter(backend: str) -> None:
    splats, cameras = gaussians.regular(1500, seed=10), gaussians.off_centre_cameras(96, 64, focal_px=80)
    permutation = np.random.default_rng(0).permutation(len(splats))
    straight, shuffled = (render(model, cameras, backend) for model in (splats, splats.select(permutation)))
    for rendered in (straight, shuffled):
        random_loss(rendered.output, ("images",)).backward()
    # Blending follows depth, not storage, and each Gaussian's sums have an order of their own:
    # natively the same bits. The reference pads its lists differently.
    slack = 0 if backend in NATIVE else 1
    torch.testing.assert_close(straight.output.images, shuffled.output.images, rtol=0, atol=slack * 1e-5)
    for name, gradient in straight.gradients().items():
        limits = {"rtol": slack * 1e-3, "atol": slack * 1e-5 * float(gradient.abs().max())}
        torch.testing.assert_close(gradient[permutation], shuffled.gradients()[name], **limits)


@on_every_native_build
@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_scaling_the_world_keeps_the_picture(backend: str, factor: float) -> None:
    splats, cameras = gaussians.regular(800, seed=11), gaussians.off_centre_cameras(64, 48, focal_px=60)
    poses = cameras.cam_from_world.copy()
    poses[:, :3, 3] *= factor
    scaled_cameras = Cameras(names=cameras.names, Ks=cameras.Ks, cam_from_world=poses, sizes_wh=cameras.sizes_wh)
    scaled = Splats(
        **{**splats.arrays(), "means": splats.means * np.float32(factor), "log_scales": splats.log_scales + np.float32(np.log(factor))}
    )
    undecided = undecided_pixels(splats, cameras)
    options = {"near_m": 0.01 * factor}
    difference = (render(splats, cameras, backend).output.images - render(scaled, scaled_cameras, backend, **options).output.images).abs()
    # Means and log-scales are rounded anew to float32: some 1e-6 of α for each of a few dozen
    # Gaussians.
    assert difference.amax(-1)[~undecided].max() <= MAX_ERROR


@on_every_native_build
def test_moving_the_world_a_thousand_kilometres_through_the_local_origin_keeps_the_picture(backend: str) -> None:
    splats, cameras = gaussians.regular(800, seed=12), gaussians.off_centre_cameras(64, 48, focal_px=60)
    shift_m = np.array([1e6, -1e6, 1e3])
    world = splats.means.astype(np.float64) + shift_m
    poses = cameras.cam_from_world.copy()
    poses[:, :3, 3] -= poses[:, :3, :3] @ shift_m
    # The local origin takes both back; the centre of a camera comes out of a float64 difference
    # near 1e6 m, 1e-10 m coarse.
    local_poses = poses.copy()
    local_poses[:, :3, 3] += local_poses[:, :3, :3] @ shift_m
    local = Splats(**{**splats.arrays(), "means": world - shift_m})
    local_cameras = Cameras(names=cameras.names, Ks=cameras.Ks, cam_from_world=local_poses, sizes_wh=cameras.sizes_wh)
    images = [render(model, views, backend).output.images for model, views in ((splats, cameras), (local, local_cameras))]
    torch.testing.assert_close(images[0], images[1], rtol=0, atol=MAX_ERROR)


@on_every_native_build
def test_equal_float32_depths_are_told_apart_as_in_float64(backend: str) -> None:
    # Two walls of opposite colours whose depths differ by 1e-8 m: equal in float32, not in the
    # float64 of the camera transform.
    count = 40
    means = np.zeros((count, 3))
    means[::2, 0] = 1e-8
    cameras = gaussians.off_centre_cameras(32, 32, count=2, focal_px=30)
    splats = Splats(
        means=means,
        quats=np.tile([1.0, 0, 0, 0], (count, 1)),
        log_scales=np.zeros((count, 3)),
        logit_opacities=np.full(count, -1.0),
        sh0=np.where((np.arange(count) % 2 == 0)[:, None, None], 1.0, -1.0) * np.ones((count, 1, 3)),
        shN=np.zeros((count, 15, 3)),
    )
    turned = Cameras(names=("turned",), Ks=cameras.Ks[1:], cam_from_world=cameras.cam_from_world[1:], sizes_wh=cameras.sizes_wh[1:])
    exact, got = (render(splats, turned, name).output.images for name in ("oracle", backend))
    assert (exact - got.double()).detach().abs().max() <= MAX_ERROR


@on_every_backend
@pytest.mark.parametrize("none", ["at all", "in view"])
def test_nothing_to_draw_is_the_background(none: str, backend: str) -> None:
    cameras = gaussians.off_centre_cameras(20, 20)
    three = gaussians.regular(3)
    if none == "at all":
        splats = three.select(np.zeros(0, dtype=int))
    else:
        splats = Splats(**{**three.arrays(), "means": three.means - np.float32([0, 0, 100])})
    rendered = render(splats, cameras, backend)
    rendered.output.images.sum().backward()
    torch.testing.assert_close(rendered.output.images[0, 0, 0].detach(), rendered.background.detach())
    assert (rendered.output.alphas == 0).all()
    assert all(leaf.grad is not None and (leaf.grad == 0).all() for leaf in rendered.leaves.tensors().values())


def probe(feature: Feature, name: Backend, dtype: torch.dtype) -> list[torch.Tensor]:
    """What `rasterize` gives for one feature: pictures or gradients, to be compared with the oracle's."""
    splats = SplatTensors.from_splats(gaussians.regular(60, seed=3), dtype, device_of(name))
    cameras = gaussians.off_centre_cameras(24, 20, count=3 if feature == "several cameras" else 1, focal_px=25)
    viewmats, Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
    background = torch.tensor([0.2, 0.5, 0.9], dtype=dtype, requires_grad=feature == "background")
    if feature == "camera gradients":
        viewmats.requires_grad_()
    if feature in ("2D-mean gradients", "absolute gradients"):
        splats.means.requires_grad_()
    options = {
        "background": background,
        "antialiased": feature == "antialiased",
        "backend": name,
        "absgrad": feature == "absolute gradients",
    }
    degrees = range(4) if feature == "SH 0-3" else (3,)
    outputs = [rasterize(splats, viewmats, Ks, 24, 20, sh_degree=degree, **options) for degree in degrees]
    loss = outputs[0].images.square().sum()
    if feature == "2D-mean gradients":
        return [*torch.autograd.grad(loss, outputs[0].means2d)]
    if feature == "absolute gradients":
        loss.backward()
        assert outputs[0].absgrad is not None
        return [outputs[0].absgrad]
    if feature == "camera gradients":
        return [*torch.autograd.grad(loss, viewmats)]
    if feature == "background":
        return [outputs[0].images, *torch.autograd.grad(loss, background)]
    if feature == "radii":
        return [outputs[0].radii_px > 0]
    return [picture for output in outputs for picture in (output.images, output.alphas, output.depths)]


@pytest.mark.parametrize("feature", get_args(Feature))
@pytest.mark.parametrize("name", sorted({"native" if backend in NATIVE else backend for backend in BACKENDS}))
def test_each_backend_can_what_the_table_says_and_refuses_the_rest(name: Backend, feature: Feature) -> None:
    dtype = torch.float64 if feature == "float64" else torch.float32
    if feature not in FEATURES[name]:
        with pytest.raises(BadInput, match=rf"backend '{name}'"):
            probe(feature, name, dtype)
        return
    for got, exact in zip(probe(feature, name, dtype), probe(feature, "reference", torch.float64), strict=True):
        assert feature != "float64" or got.dtype == torch.float64
        # Beyond rounding, a pair at α_min may fall on either side: less than an 8-bit step of one
        # pixel, in depth more.
        off = (got.detach().cpu().double() - exact.detach().double()).abs() > 1e-3 * (1 + exact.detach().double().abs())
        if (name, feature) == ("gsplat", "radii"):  # of Gaussians too faint to be drawn as well
            off &= exact
        assert off.double().mean() <= 0.01, feature


def test_the_table_of_features_names_every_backend_and_auto_picks_by_type() -> None:
    assert set(FEATURES) == set(get_args(Backend)) - {"auto"}
    splats, cameras = gaussians.regular(20), gaussians.off_centre_cameras(16, 16)
    pose, K = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
    for dtype in (torch.float32, torch.float64):
        output = rasterize(SplatTensors.from_splats(splats, dtype), pose, K, 16, 16, sh_degree=3)
        assert output.images.dtype == dtype
    exact = SplatTensors.from_splats(splats, torch.float64)
    with pytest.raises(BadInput, match=r"means is torch.float64 .*native"):
        rasterize(exact, pose, K, 16, 16, sh_degree=3, backend="native")
    with pytest.raises(BadInput, match="viewmats requires gradients"):
        rasterize(SplatTensors.from_splats(splats), pose.requires_grad_(), K, 16, 16, sh_degree=3, backend="native")


@pytest.mark.parametrize("seed", range(3))
def test_depths_at_the_end_of_float32_leave_gradients_finite(seed: int) -> None:
    rng = np.random.default_rng(seed)
    splats = gaussians.regular(40, seed)
    means = np.where(rng.random((40, 3)) < 0.4, rng.choice(np.float32([3e38, -3e38, 1e30, -1e20]), (40, 3)), splats.means)
    log_scales = np.where(rng.random((40, 3)) < 0.4, np.float32(88.0), splats.log_scales)
    leaves = SplatTensors.from_splats(Splats(**{**splats.arrays(), "means": means, "log_scales": log_scales}))
    for leaf in leaves.tensors().values():
        leaf.requires_grad_()
    K = torch.tensor([[[30.0, 0, 16], [0, 30, 16], [0, 0, 1]]])
    output = rasterize(leaves, torch.eye(4)[None], K, 32, 32, sh_degree=3, near_m=0.0, far_m=float("inf"), backend="native")
    random_loss(output).backward()
    for name, leaf in leaves.tensors().items():
        assert leaf.grad is not None and torch.isfinite(leaf.grad).all(), name


@on_every_native_build
def test_changing_a_tensor_between_the_passes_is_refused(backend: str) -> None:
    rendered = render(gaussians.regular(20), gaussians.off_centre_cameras(16, 16), backend)
    with torch.no_grad():
        rendered.leaves.means.add_(1.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        rendered.output.images.sum().backward()


@on_every_native_build
def test_a_second_backward_pass_gives_the_same_gradients_again(backend: str) -> None:
    rendered = render(gaussians.regular(200), gaussians.off_centre_cameras(32, 32, focal_px=30), backend)
    loss = rendered.output.images.sum()
    loss.backward(retain_graph=True)
    once = {name: gradient.clone() for name, gradient in rendered.gradients().items()}
    loss.backward()
    for name, gradient in rendered.gradients().items():
        torch.testing.assert_close(gradient, 2 * once[name], rtol=0, atol=0)


@on_every_backend
def test_a_pass_that_stops_at_means2d_leaves_nothing_for_the_next(backend: str) -> None:
    rendered = render(gaussians.regular(300), gaussians.off_centre_cameras(48, 32, focal_px=50), backend)
    output, means = rendered.output, rendered.leaves.means

    def by_means2d() -> torch.Tensor:
        return torch.autograd.grad(output.means2d.sum(), means, retain_graph=True)[0]

    alone = by_means2d()
    torch.autograd.grad(output.images.square().sum(), output.means2d, retain_graph=True)
    assert torch.equal(by_means2d(), alone)


@on_every_native_build
def test_two_renderings_may_live_at_once(backend: str) -> None:
    cameras = gaussians.off_centre_cameras(32, 32, focal_px=30)
    models = [gaussians.regular(200, seed=seed) for seed in range(4)]
    alone = []
    for model in models:
        rendered = render(model, cameras, backend)
        rendered.output.images.sum().backward()
        alone.append(rendered.gradients()["means"])
    together = [render(model, cameras, backend) for model in models]
    torch.stack([rendered.output.images.sum() for rendered in together]).sum().backward()
    for rendered, gradient in zip(together, alone, strict=True):
        assert torch.equal(rendered.gradients()["means"], gradient)
