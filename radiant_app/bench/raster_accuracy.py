"""How far the rasterizer's picture and gradients of the benchmark's scene lie from float64, and how much work the scene is."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from radiant_core.cameras import Cameras
from radiant_core.render.contract import Backend, RenderOutput, SplatTensors, rasterize
from radiant_core.splats import Splats

NUM_TILES = 64
TILE_PX = 16
SEED = 1
"""Which tiles the error is measured on; raised with each version of the project."""


def render(leaves: SplatTensors, cameras: Cameras, backend: Backend = "auto") -> RenderOutput:
    """The one view of the scene, degree 3, black background."""
    width, height = (int(side) for side in cameras.sizes_wh[0])
    viewmats, Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
    return rasterize(leaves, viewmats, Ks, width, height, sh_degree=3, backend=backend)


def image_gradient(cameras: Cameras) -> Tensor:
    """∂loss/∂image (1,H,W,3), fixed random numbers of the size a mean over pixels has."""
    width, height = (int(side) for side in cameras.sizes_wh[0])
    return torch.rand(1, height, width, 3, generator=torch.Generator().manual_seed(0)) / (width * height)


def num_pairs(splats: Splats, cameras: Cameras) -> int:
    """Pixel–Gaussian pairs that forward and backward each go through."""
    from radiant_core.render.native_backend import count_pairs

    width, height = (int(side) for side in cameras.sizes_wh[0])
    return count_pairs(SplatTensors.from_splats(splats), cameras.cam_from_world[0], cameras.Ks[0], width, height)


def tile_errors(splats: Splats, cameras: Cameras, backend: Backend = "auto") -> tuple[float, float, float]:
    """Largest image error and ‖g − g64‖ / ‖g64‖ of the worst tensor on 64 random tiles, and the largest error of undecided pixels.

    Only Gaussians whose box touches those tiles take part; to the tiles' pixels that is the whole model. A pixel is undecided where a
    change of ln opacity by 1e-4 up and down makes it jump, which a second difference shows: some pair stands at α_min or at the cut.
    """
    keep = _random_tiles(cameras)
    with torch.no_grad():
        chosen = splats.select(_touching(render(SplatTensors.from_splats(splats), cameras), keep))
    exact = SplatTensors.from_splats(chosen, torch.float64)
    low, middle, high = (render(_shifted(exact, shift), cameras, "reference").images for shift in (-1e-4, 0.0, 1e-4))
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
    error = (images[0] - images[1]).abs().amax(-1)[0]
    gradients = [
        float((leaf.grad.double() - true.grad).norm() / true.grad.norm())
        for leaf, true in zip(leaves.tensors().values(), exact.tensors().values(), strict=True)
        if leaf.grad is not None and true.grad is not None
    ]
    return float(error[decided].max()), max(gradients), float((error * (keep & jumps)).max())


def _shifted(tensors: SplatTensors, shift: float) -> SplatTensors:
    return SplatTensors(**{**tensors.tensors(), "logit_opacities": tensors.logit_opacities + shift})


def _random_tiles(cameras: Cameras) -> Tensor:
    """Mask (H,W) of 64 tiles of 16 × 16 px."""
    width, height = (int(side) for side in cameras.sizes_wh[0])
    rows, columns = -(-height // TILE_PX), -(-width // TILE_PX)
    tiles = torch.zeros(rows * columns, dtype=torch.bool)
    tiles[torch.randperm(rows * columns, generator=torch.Generator().manual_seed(SEED))[:NUM_TILES]] = True
    return tiles.reshape(rows, columns).repeat_interleave(TILE_PX, 0).repeat_interleave(TILE_PX, 1)[:height, :width]


def _touching(output: RenderOutput, keep: Tensor) -> np.ndarray:
    """Mask (N,) of Gaussians whose box of half side `radii_px`, a pixel wider, covers a kept pixel."""
    height, width = keep.shape
    counts = torch.zeros(height + 1, width + 1, dtype=torch.int64)
    counts[1:, 1:] = keep.long().cumsum(0).cumsum(1)
    means, radii = output.means2d[0], output.radii_px[0, :, None] + 1
    limit = torch.tensor([width, height])
    low, high = ((means + sign * radii).floor().clamp_min(0).minimum(limit).long() for sign in (-1, 1))
    total = counts[high[:, 1], high[:, 0]] - counts[low[:, 1], high[:, 0]] - counts[high[:, 1], low[:, 0]] + counts[low[:, 1], low[:, 0]]
    return ((total > 0) & (output.radii_px[0] > 0)).numpy()
