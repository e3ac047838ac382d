"""Every backend against gsplat's own float64 equations, those its CUDA kernels are tested against:
no CUDA device is needed.

What stands on gsplat's side here: projection, clamped Jacobian, dilation and compensation, conics,
spherical harmonics, and autograd through them. The blending between them is ours, every Gaussian at
every pixel. The kernels themselves are run by the contract test.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from radiant_core.cameras import Cameras
from radiant_core.render.contract import SplatTensors
from tests.contract import gaussians
from tests.contract.backends import BACKENDS, BACKGROUND, opacity_rounding, random_loss, relative_errors, render, undecided_pixels

equations = pytest.importorskip("gsplat.cuda._torch_impl", reason="the package gsplat is not installed")


@pytest.mark.parametrize("backend", ["oracle", *BACKENDS])
@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("scene", ["regular", "frustum edge"])
def test_pictures_and_gradients_are_those_of_gsplat(backend: str, antialiased: bool, scene: str) -> None:
    if scene == "regular":
        splats, cameras = gaussians.regular(300, seed=13), gaussians.off_centre_cameras(48, 36, count=2, focal_px=50)
    else:
        splats, cameras = gaussians.frustum_edge(150, seed=14), gaussians.off_centre_cameras(40, 30, focal_px=15)
    keep = ~undecided_pixels(splats, cameras, antialiased=antialiased)
    exact = SplatTensors.from_splats(splats, torch.float64)
    for leaf in exact.tensors().values():
        leaf.requires_grad_()
    images = gsplat_images(exact, cameras, antialiased)
    got = render(splats, cameras, backend, antialiased=antialiased)
    assert (images - got.output.images).detach().abs().amax(-1)[keep].max() <= (1e-9 if backend == "oracle" else 1e-4)

    for output in (got.output, replace(got.output, images=images)):
        random_loss(output, ("images",), keep).backward()
    truth = {name: leaf.grad.reshape(len(leaf), -1) for name, leaf in exact.tensors().items() if leaf.grad is not None}
    # Float32 PyTorch has centres 1e-5 px coarse, which costs it 20 times as much (tests/contract).
    limit = {"oracle": 1e-9, "reference": 2e-3}.get(backend, 1e-4)
    for name, gradient in got.gradients().items():
        rounding = limit / 1e-4 * opacity_rounding(splats, truth) if name == "logit_opacities" else 0.0
        assert relative_errors(gradient, truth[name], rounding).max() <= limit, name


def gsplat_images(splats: SplatTensors, cameras: Cameras, antialiased: bool) -> Tensor:
    """(C,H,W,3) by gsplat's equations, blended front to back per pixel, with its limits of α."""
    width, height = (int(side) for side in cameras.sizes_wh[0])
    viewmats, Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
    covariances, _ = equations._quat_scale_to_covar_preci(splats.quats, splats.log_scales.exp(), True, False)
    radii, means2d, depths, conics, compensations = equations._fully_fused_projection(
        splats.means, covariances, viewmats, Ks, width, height, calc_compensations=antialiased
    )
    directions = splats.means - torch.linalg.inv(viewmats)[:, None, :3, 3]
    coefficients = torch.cat([splats.sh0, splats.shN], dim=1).expand(len(viewmats), -1, -1, -1)
    colors = (equations._spherical_harmonics(3, directions, coefficients) + 0.5).clamp_min(0)
    opacities = splats.logit_opacities.sigmoid().expand(len(viewmats), -1)
    opacities = opacities * compensations if antialiased else opacities
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    pixels = torch.stack([columns, rows], dim=-1).double()
    seen = [(radii[camera] > 0).all(-1) for camera in range(len(viewmats))]
    parts = [[part[camera][seen[camera]] for part in (depths, means2d, conics, opacities, colors)] for camera in range(len(viewmats))]
    return torch.stack([_blended(pixels, *gaussians_seen) for gaussians_seen in parts])


def _blended(pixels: Tensor, depths: Tensor, means2d: Tensor, conics: Tensor, opacities: Tensor, colors: Tensor) -> Tensor:
    order = depths.argsort(stable=True)
    x, y = (pixels[:, :, None] - means2d[order]).unbind(-1)
    xx, xy, yy = conics[order].unbind(-1)
    alphas = (opacities[order] * torch.exp(-0.5 * (xx * x * x + yy * y * y) - xy * x * y)).clamp_max(0.999)
    alphas = torch.where(alphas < 1 / 255, 0.0, alphas)
    logs = torch.log1p(-alphas).cumsum(-1)
    alphas = torch.where(logs.detach() <= math.log(1e-4), 0.0, alphas)
    logs = torch.log1p(-alphas).cumsum(-1)
    weights = alphas * torch.exp(logs - torch.log1p(-alphas))
    return weights @ colors[order] + logs[..., -1:].exp() * torch.tensor(BACKGROUND, dtype=torch.float64)
