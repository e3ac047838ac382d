"""The reference rasterizer against an independent one, finite differences, and poison."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.render.contract import SplatTensors
from radiant_core.render.harmonics import basis_values, colors_from_sh
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import Splats

from .brute_force import brute_force_image

BACKGROUND = np.array([0.1, 0.4, 0.7])


def random_splats(count: int, seed: int = 0, *, bases: int = 1) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats(
        means=rng.uniform([-2, -1.5, -1], [2, 1.5, 1], (count, 3)),
        quats=rng.normal(size=(count, 4)),
        log_scales=rng.uniform(-3.5, -0.5, (count, 3)),
        logit_opacities=rng.normal(0, 2, count),
        sh0=rng.normal(0, 1, (count, 1, 3)),
        shN=rng.normal(0, 0.3, (count, bases - 1, 3)),
    )


def camera(width: int = 37, height: int = 26, *, offset_px: float = 0.0) -> Cameras:
    pose = np.eye(4)
    pose[2, 3] = 4.0
    K = [[30.0, 0, width / 2 + offset_px], [0, 32.0, height / 2 - offset_px], [0, 0, 1]]
    return Cameras(names=("only",), Ks=[K], cam_from_world=[pose], sizes_wh=[[width, height]])


def render(splats: Splats, cameras: Cameras, dtype: torch.dtype = torch.float64, **options):
    tensors = SplatTensors.from_splats(splats, dtype)
    width, height = (int(side) for side in cameras.sizes_wh[0])
    options = {"sh_degree": splats.sh_degree, "background": torch.tensor(BACKGROUND, dtype=dtype), **options}
    return rasterize(tensors, torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks), width, height, **options)


@pytest.mark.parametrize("offset_px", [0.0, 9.0])
def test_random_cloud_matches_pixel_by_pixel_rendering(offset_px: float) -> None:
    splats, cameras = random_splats(25), camera(21, 16, offset_px=offset_px)
    image, alpha, depth = brute_force_image(splats, cameras, BACKGROUND)
    output = render(splats, cameras)
    # Both are float64 from the same float32 parameters; only rounding of different orders of
    # operations is left.
    np.testing.assert_allclose(output.images[0], image, atol=1e-9)
    np.testing.assert_allclose(output.alphas[0], alpha, atol=1e-9)
    np.testing.assert_allclose(output.depths[0], depth, atol=1e-8)


def test_float32_stays_near_float64() -> None:
    splats, cameras = random_splats(500, seed=1, bases=16), camera(64, 48)
    difference = (render(splats, cameras).images - render(splats, cameras, torch.float32).images).abs()
    # A pair within rounding of α_min or of the cut may fall on either side: one 8-bit step of one
    # Gaussian. All else is rounding.
    assert difference.max() < 5e-3
    assert difference.square().mean().sqrt() < 1e-5


# x/z, y/z of Gaussians as shares of the half image from its centre: inside; between the image's
# edge and where the Jacobian is clamped (1.3 of the half image); beyond that in one coordinate, and
# in both.
PLACES = {
    "inside the image": [(-0.8, 0.5), (0.6, 0.7), (0.0, -0.4), (0.3, 0.1)],
    "at the frustum's edge": [(-1.15, 0.5), (1.1, 0.2), (0.3, -1.2), (1.2, 1.15)],
    "under the clamp": [(-2.0, 0.5), (1.6, 0.2), (0.3, -1.8), (1.7, 1.9)],
}


@pytest.mark.parametrize(
    ("place", "offset_px", "antialiased"),
    [
        ("inside the image", 0.0, False),
        ("inside the image", 3.0, True),
        ("at the frustum's edge", 3.0, False),
        ("under the clamp", 0.0, False),
        ("under the clamp", 3.0, True),
    ],
)
def test_gradients_agree_with_finite_differences(place: str, offset_px: float, antialiased: bool) -> None:
    # Four Gaussians so wide that all of the image lies well above α_min: decisions have no
    # derivative.
    rng, cameras = np.random.default_rng(3), camera(9, 8, offset_px=offset_px)
    degree, bases = (3, 16) if place == "inside the image" else (1, 4)
    pixels = np.array([4.5, 4.0]) * (1 + np.array(PLACES[place]))
    depths = rng.uniform(3.6, 4.4, 4)
    means = np.column_stack([(pixels - cameras.Ks[0, :2, 2]) / cameras.Ks[0, [0, 1], [0, 1]] * depths[:, None], depths - 4.0])
    splats = Splats(
        means=means,
        quats=rng.normal(size=(4, 4)),
        log_scales=rng.uniform(0.0, 0.5, (4, 3)),
        logit_opacities=rng.uniform(-1, 0, 4),
        sh0=rng.uniform(0, 1, (4, 1, 3)),
        shN=rng.normal(0, 0.05, (4, bases - 1, 3)),
    )
    tensors = SplatTensors.from_splats(splats, torch.float64)
    for tensor in tensors.tensors().values():
        tensor.requires_grad_()
    weights = torch.rand(1, 8, 9, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    viewmats, Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)

    def loss(*values: torch.Tensor) -> torch.Tensor:
        current = SplatTensors(**dict(zip(tensors.tensors(), values, strict=True)))
        output = rasterize(current, viewmats, Ks, 9, 8, sh_degree=degree, antialiased=antialiased)
        return (output.images * weights).sum() + output.depths.sum() + output.alphas.square().sum()

    assert torch.autograd.gradcheck(loss, tuple(tensors.tensors().values()), eps=1e-6, atol=1e-6, rtol=1e-4)


def test_order_of_gaussians_does_not_matter() -> None:
    splats, cameras = random_splats(200, seed=2, bases=4), camera()
    shuffled = splats.select(np.random.default_rng(0).permutation(200))
    # Depths differ for all pairs here, so the blending order is the same: only matrix products
    # round differently.
    torch.testing.assert_close(render(splats, cameras).images, render(shuffled, cameras).images, atol=1e-12, rtol=0)


def test_moving_world_and_camera_together_changes_nothing() -> None:
    splats, cameras = random_splats(100, seed=4), camera()
    shift = np.array([3.0, -5.0, 2.0])
    pose = cameras.cam_from_world[0].copy()
    pose[:3, 3] -= pose[:3, :3] @ shift
    moved = Splats(**{**splats.arrays(), "means": splats.means + shift.astype(np.float32)})
    moved_camera = Cameras(names=cameras.names, Ks=cameras.Ks, cam_from_world=[pose], sizes_wh=cameras.sizes_wh)
    # means are stored in float32: 8 ulp of 5 m is 4e-6 m, 3e-5 px at this focal length and depth.
    torch.testing.assert_close(render(splats, cameras).images, render(moved, moved_camera).images, atol=1e-4, rtol=0)


def test_means2d_gradient_is_the_gradient_of_a_shift_in_pixels() -> None:
    splats, cameras = random_splats(30, seed=5), camera()
    tensors = SplatTensors.from_splats(splats, torch.float64)
    tensors.means.requires_grad_()
    output = rasterize(tensors, torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks), 37, 26, sh_degree=0)
    output.means2d.retain_grad()
    output.images.sum().backward()
    step = 1e-6
    K = cameras.Ks.copy()
    K[0, 0, 2] += step
    moved = rasterize(
        SplatTensors.from_splats(splats, torch.float64), torch.tensor(cameras.cam_from_world), torch.tensor(K), 37, 26, sh_degree=0
    )
    # Moving the principal point moves all means2d by one step in x; the clamp window moves too, but
    # no splat here reaches it.
    finite_difference = float((moved.images.sum() - output.images.detach().sum()) / step)
    assert output.means2d.grad is not None
    assert float(output.means2d.grad[..., 0].sum()) == pytest.approx(finite_difference, rel=1e-3, abs=1e-3)


def test_antialiasing_dims_a_gaussian_far_below_a_pixel() -> None:
    tiny = Splats(
        means=[[0, 0, 0]],
        quats=[[1, 0, 0, 0]],
        log_scales=[[-7.0] * 3],
        logit_opacities=[3.0],
        sh0=np.ones((1, 1, 3)),
        shN=np.zeros((1, 0, 3)),
    )
    plain, compensated = render(tiny, camera()), render(tiny, camera(), antialiased=True)
    assert plain.alphas.max() > 0.3
    assert compensated.alphas.max() < 0.01


def test_harmonics_agree_with_scipy() -> None:
    directions = np.random.default_rng(6).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    theta, phi = np.arccos(directions[:, 2]), np.arctan2(directions[:, 1], directions[:, 0])
    expected = []
    for degree in range(4):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), theta, phi)
            # 3DGS keeps the Condon-Shortley sign that scipy's complex harmonics carry.
            expected.append(np.sqrt(2) * value.imag if order < 0 else np.sqrt(2) * value.real if order > 0 else value.real)
    got = basis_values(torch.tensor(directions), 3)
    np.testing.assert_allclose(got, np.stack(expected, axis=1), atol=1e-12)


def test_colours_are_never_negative() -> None:
    directions = torch.nn.functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    colors = colors_from_sh(directions, torch.full((50, 1, 3), -9.0), torch.zeros(50, 15, 3), 3)
    assert (colors == 0).all()


@pytest.mark.parametrize("name", ["means", "quats", "log_scales", "logit_opacities", "sh0", "shN"])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_poison_is_named(name: str, value: float) -> None:
    tensors = SplatTensors.from_splats(random_splats(10, bases=4))
    tensors.tensors()[name].view(10, -1)[7, 0] = value
    cameras = camera()
    with pytest.raises(BadInput, match=rf"{name} has 1 values .* index \(7"):
        rasterize(tensors, torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks), 20, 20, sh_degree=1)


def test_degenerate_gaussians_leave_image_and_gradients_finite() -> None:
    rng = np.random.default_rng(7)
    count = 400
    splats = Splats(
        means=np.where(rng.random((count, 1)) < 0.3, [0, 0, -4.0], rng.normal(0, 3, (count, 3))),
        quats=rng.choice([0.0, 1e-30, 1.0, 1e18], (count, 4)),
        log_scales=rng.choice([-60.0, -5.0, 0.0, 20.0, 60.0], (count, 3)),
        logit_opacities=rng.choice([-100.0, -5.0, 0.0, 100.0], count),
        sh0=rng.normal(0, 1, (count, 1, 3)),
        shN=np.zeros((count, 0, 3)),
    )
    tensors = SplatTensors.from_splats(splats)
    for tensor in tensors.tensors().values():
        tensor.requires_grad_()
    cameras = camera()
    output = rasterize(tensors, torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks), 37, 26, sh_degree=0)
    (output.images.sum() + output.depths.sum()).backward()
    assert torch.isfinite(output.images).all() and torch.isfinite(output.depths).all()
    for name, tensor in tensors.tensors().items():
        assert tensor.grad is None or torch.isfinite(tensor.grad).all(), name


def test_nothing_to_see_gives_the_background() -> None:
    behind = random_splats(5)
    behind = Splats(**{**behind.arrays(), "means": behind.means - np.float32([0, 0, 50])})
    output = render(behind, camera())
    np.testing.assert_allclose(output.images[0], np.broadcast_to(BACKGROUND, (26, 37, 3)))
    assert (output.radii_px == 0).all() and (output.alphas == 0).all()


def test_wrong_shape_and_degree_are_named() -> None:
    tensors, cameras = SplatTensors.from_splats(random_splats(3)), camera()
    pose, K = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
    with pytest.raises(BadInput, match="sh_degree is 2"):
        rasterize(tensors, pose, K, 10, 10, sh_degree=2)
    with pytest.raises(BadInput, match="viewmats has shape"):
        rasterize(tensors, pose[:, :3], K, 10, 10, sh_degree=0)
    with pytest.raises(BadInput, match="backend 'fast'"):
        rasterize(tensors, pose, K, 10, 10, sh_degree=0, backend="fast")  # type: ignore[arg-type]
