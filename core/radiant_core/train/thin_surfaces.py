"""Thin, opaque surfaces instead of clouds of half-transparent Gaussians. Once per model, per step.

From the flown views a cloud shows what a surface shows; from beside it, it is haze. Three measures:

    start      the first Gaussians lie flat (`initialize.lie_flat`)
    thickness  loss + a · mean of ln σ_min, of those with σ_min > σ_mid / 10
    spread     loss + b · mean over pixels of α √(Σ w z² / Σ w − z̄²) / z̄,  z̄ = Σ w z / Σ w, for
               depths z of the Gaussians' centres, blended like colours in a second, smaller
               rendering of every fourth step: what a pixel blends lies at one depth (after the
               distortion of mip-NeRF 360, Barron 2022, Eqn. 15, with a variance for its pairs)

The gradient of depth itself is left out of the spread: it moves Gaussians by their weights alone.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from radiant_core.render.contract import Backend, RenderOutput, SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import SH_C0
from radiant_core.train.config import TrainConfig
from radiant_core.train.parts import Moment, Part
from radiant_core.train.views import TrainingViews

THINNEST = 0.1
"""A shortest axis below this share of the second one is not made shorter."""
SPREAD_EVERY = 4
SPREAD_SCALE = 0.5
"""Steps between two renderings of depth, and their size as a share of the step's."""
FARTHEST = 4.0
"""Depths count up to this many times a view's median: the sky would outweigh everything."""
MIN_SPREAD = 1e-3
"""Added to the spread, in quadrature: the root has no slope at zero."""


class ThinSurfaces(Part):
    """Adds the gradients of thickness and spread to those of the photographs."""

    name = "thin"

    def __init__(self, views: TrainingViews, config: TrainConfig, backend: Backend) -> None:
        self._views, self._config = views, config
        self._backend: Backend = backend
        self._step, self._view, self._size_wh = 0, 0, (1, 1)

    def before_backward(self, moment: Moment, output: RenderOutput) -> None:
        """Remember the view and its size."""
        height, width = output.images.shape[1:3]
        self._step, self._view, self._size_wh = moment.step, moment.view, (int(width), int(height))

    def after_backward(self, splats: SplatTensors) -> None:
        """Add the gradients, where the weights are not 0."""
        config = self._config
        if config.thickness_weight > 0 and splats.log_scales.grad is not None:
            splats.log_scales.grad += config.thickness_weight * thickness_gradient(splats.log_scales)
        if config.depth_spread_weight > 0 and self._step % SPREAD_EVERY == 0:
            loss = SPREAD_EVERY * config.depth_spread_weight * self._spread(splats)
            if loss.requires_grad and bool(torch.isfinite(loss)):
                loss.backward()

    def _spread(self, splats: SplatTensors) -> Tensor:
        camera = self._views.cameras.select([self._view]).scaled(max(1, round(SPREAD_SCALE * max(self._size_wh))))
        width, height = (int(side) for side in camera.sizes_wh[0])
        viewmats, Ks = torch.tensor(camera.cam_from_world), torch.tensor(camera.Ks)
        return depth_spread(splats, viewmats, Ks, (width, height), self._backend)


@torch.no_grad()
def thickness_gradient(log_scales: Tensor) -> Tensor:
    """Gradient (N,3) of the mean logarithm of the shortest axes, 0 for those thin enough."""
    ordered = log_scales.sort(dim=1).values
    thick = ordered[:, :1] > ordered[:, 1:2] + math.log(THINNEST)
    gradient = torch.zeros_like(log_scales)
    gradient.scatter_(1, log_scales.argmin(dim=1, keepdim=True), thick.to(log_scales) / max(1, len(log_scales)))
    return gradient


def depth_spread(splats: SplatTensors, viewmats: Tensor, Ks: Tensor, size_wh: tuple[int, int], backend: Backend = "auto") -> Tensor:
    """Mean over the pixels of one view (1,4,4), (1,3,3) of the relative standard deviation of the
    depths that a pixel blends, weighted by its cover; 0 where there is nothing."""
    with torch.no_grad():
        pose = viewmats[0].to(splats.means)
        depths = splats.means @ pose[2, :3] + pose[2, 3]
        front = depths[depths > 0]
        if not len(front):
            return torch.zeros(())
        shares = (depths / (FARTHEST * front.median())).clamp(0, 1)
        sh0 = ((torch.stack([shares, shares**2, torch.ones_like(shares)], dim=1) - 0.5) / SH_C0)[:, None]
    model = replace(splats, sh0=sh0.contiguous(), shN=splats.shN.new_zeros(len(splats), 0, 3))
    image = rasterize(model, viewmats, Ks, *size_wh, sh_degree=0, backend=backend).images[0]
    cover = image[..., 2]
    solid = cover.clamp_min(1e-4)
    mean = image[..., 0] / solid
    variance = (image[..., 1] / solid - mean**2).clamp_min(0) / (mean**2).clamp_min(1e-6)
    return ((variance + MIN_SPREAD**2).sqrt() * cover.detach()).mean()
