"""Errors of the rasterizer's image and gradients against float64 on the benchmark's scene."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from radiant_core import __version__
from radiant_core.cameras import Cameras
from radiant_core.render.contract import Backend, RenderOutput, SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import Splats

NUM_TILES = 64
TILE_PX = 16
SEED = zlib.crc32(__version__.encode())
"""Selects the tiles on which errors are measured; it changes with the version of the project."""
UNDECIDED = 1e-5
"""A pair whose ln α is this close to α_min or the cut of transmittance is on either side of it."""


@dataclass(frozen=True, kw_only=True)
class TileErrors:
    """Errors of image and gradients against float64 on 64 tiles."""

    image_max: float
    """Largest error over pixels without an undecided pair."""
    image_rms: float
    """Root mean square over the same pixels and all three channels."""
    undecided_max: float
    """Largest error over the other pixels."""
    gradient: float
    """Largest ‖g − g64‖ / ‖g64‖ over the six tensors."""


def render(leaves: SplatTensors, cameras: Cameras, backend: Backend = "auto") -> RenderOutput:
    """Render the scene's one view with SH degree 3 on a black background."""
    width, height = (int(side) for side in cameras.sizes_wh[0])
    viewmats, Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
    return rasterize(leaves, viewmats, Ks, width, height, sh_degree=3, backend=backend)


def image_gradient(cameras: Cameras) -> Tensor:
    """∂loss/∂image (1,H,W,3): fixed random numbers of the magnitude that a mean over pixels has."""
    width, height = (int(side) for side in cameras.sizes_wh[0])
    return torch.rand(1, height, width, 3, generator=torch.Generator().manual_seed(0)) / (width * height)


def num_pairs(splats: Splats, cameras: Cameras) -> int:
    """Pairs of pixel and Gaussian that forward and backward each process."""
    from radiant_core.render.native_backend import count_pairs

    width, height = (int(side) for side in cameras.sizes_wh[0])
    return count_pairs(SplatTensors.from_splats(splats), cameras.cam_from_world[0], cameras.Ks[0], width, height)


def tile_errors(splats: Splats, cameras: Cameras, backend: Backend = "auto") -> TileErrors:
    """Errors of one rendering and its gradients on 64 random tiles.

    Only Gaussians whose box overlaps these tiles are rendered; no other one contributes to their
    pixels. A pixel is undecided where it jumps when all ln opacities change by ±1e-5, which is
    detected by the second difference.
    """
    keep = _random_tiles(cameras)
    with torch.no_grad():
        chosen = splats.select(_mask_touching(render(SplatTensors.from_splats(splats), cameras), keep))
    exact = SplatTensors.from_splats(chosen, torch.float64)
    low, middle, high = (render(_shift_opacities(exact, shift), cameras, "reference").images for shift in (-UNDECIDED, 0.0, UNDECIDED))
    jumps = (low - 2 * middle + high).abs().amax(-1)[0] > 1e-6
    decided = keep & ~jumps
    leaves = SplatTensors.from_splats(chosen)
    images = []
    renderings: tuple[tuple[SplatTensors, Backend], ...] = ((leaves, backend), (exact, "reference"))
    for tensors, name in renderings:
        for leaf in tensors.tensors().values():
            leaf.requires_grad_()
        output = render(tensors, cameras, name)
        output.images.backward((image_gradient(cameras) * decided[None, ..., None]).to(output.images))
        images.append(output.images.detach().double())
    errors = (images[0] - images[1]).abs()[0]
    error = errors.amax(-1)
    gradients = [
        float((leaf.grad.double() - true.grad).norm() / true.grad.norm())
        for leaf, true in zip(leaves.tensors().values(), exact.tensors().values(), strict=True)
        if leaf.grad is not None and true.grad is not None
    ]
    return TileErrors(
        image_max=float(error[decided].max()),
        image_rms=float(errors[decided].square().mean().sqrt()),
        undecided_max=float((error * (keep & jumps)).max()),
        gradient=max(gradients),
    )


def _shift_opacities(tensors: SplatTensors, shift: float) -> SplatTensors:
    """The model with ln opacities changed by `shift`, by less where opacity exceeds 0.99."""
    logits = tensors.logit_opacities
    return replace(tensors, logit_opacities=logits + shift / torch.sigmoid(-logits).clamp_min(1e-2))


def _random_tiles(cameras: Cameras) -> Tensor:
    """Mask (H,W) of 64 tiles of 16 × 16 px."""
    width, height = (int(side) for side in cameras.sizes_wh[0])
    rows, columns = -(-height // TILE_PX), -(-width // TILE_PX)
    tiles = torch.zeros(rows * columns, dtype=torch.bool)
    tiles[torch.randperm(rows * columns, generator=torch.Generator().manual_seed(SEED))[:NUM_TILES]] = True
    return tiles.reshape(rows, columns).repeat_interleave(TILE_PX, 0).repeat_interleave(TILE_PX, 1)[:height, :width]


def _mask_touching(output: RenderOutput, keep: Tensor) -> np.ndarray:
    """Mask (N,) of Gaussians whose box of half side `radii_px` + 1 covers a kept pixel."""
    height, width = keep.shape
    counts = torch.zeros(height + 1, width + 1, dtype=torch.int64)
    counts[1:, 1:] = keep.long().cumsum(0).cumsum(1)
    means, radii = output.means2d[0], output.radii_px[0, :, None] + 1
    limit = torch.tensor([width, height])
    low, high = ((means + sign * radii).floor().clamp_min(0).minimum(limit).long() for sign in (-1, 1))
    total = counts[high[:, 1], high[:, 0]] - counts[low[:, 1], high[:, 0]] - counts[high[:, 1], low[:, 0]] + counts[low[:, 1], low[:, 0]]
    return ((total > 0) & (output.radii_px[0] > 0)).numpy()
