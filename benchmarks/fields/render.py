"""Rendering a field: 64 samples find where a ray ends, 64 more are taken there and blended.

    coarse    t_i = near (far / near)^{(i + ξ) / 64}             densities alone, no gradient
    weights   w_i = T_i α_i,  α_i = 1 − exp(−σ_i δ_i),  T_i = Π_{j<i} (1 − α_j)
    fine      64 from the distribution ∝ w, its maxima widened by a neighbour, plus a floor
    colour    C = Σ w_i c_i over the fine samples; the last one is opaque

ξ is uniform in training, ½ else. Only the fine samples have gradients: the coarse ones steer, as
proposals do, and cost an eighth of them. The ray's end is opaque: under the lowest points there is
nothing to see through to. Once per step, in parts that stay in the cache.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from benchmarks.fields.bounds import FieldBounds
from benchmarks.fields.field import Field
from benchmarks.fields.rays import Rays, rays_of_image
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray

RAYS_A_PART = 256
"""16,384 samples: twice as fast as 131,072 at once, whose layers leave the cache."""


@dataclass(frozen=True, kw_only=True)
class Sampling:
    """How many samples a ray has."""

    num_coarse: int = 64
    num_fine: int = 64
    floor: float = 0.2
    """Share of the fine samples that is spread over the whole ray."""

    def __post_init__(self) -> None:
        if min(self.num_coarse, self.num_fine) < 2 or not 0 < self.floor <= 1:
            raise BadInput(f"a ray was given {self}: expected at least 2 coarse and 2 fine samples and 0 < floor ≤ 1.")


@dataclass(frozen=True, kw_only=True, eq=False)
class Rendered:
    """R rays of a field."""

    colors: Tensor
    """(R,3)."""
    depths: Tensor
    """(R,) mean distance of what is seen, in radii."""
    penalty: Tensor
    """() of the field itself."""
    places: Tensor
    """(R,S,3) the fine samples' unit coordinates."""
    weights: Tensor
    """(R,S) of the fine samples; their sum is 1."""


def render_rays(field: Field, rays: Rays, sampling: Sampling = Sampling(), generator: torch.Generator | None = None) -> Rendered:
    """Render some rays; samples are drawn by `generator`, else lie in their shares' middles."""
    with torch.no_grad():
        edges = _spread(rays, sampling.num_coarse)
        middles = _between(edges, _draw(rays, sampling.num_coarse, generator))
        densities = field.densities(_flat(_places(rays, middles))).view(middles.shape)
        weights = blend_weights(densities, edges.diff(dim=1))
        share = sampling.floor / sampling.num_coarse + (1 - sampling.floor) * _normalized(_widened(weights))
        distances = resample(edges, share, _draw(rays, sampling.num_fine, generator))
    places = _places(rays, distances)
    directions = rays.directions[:, None].expand_as(places)
    samples = field(_flat(places), _flat(directions))
    fine = blend_weights(samples.densities.view(distances.shape), _lengths(distances))
    colors = (fine[..., None] * samples.colors.view(places.shape)).sum(dim=1)
    depths = (fine.detach() * distances).sum(dim=1)
    return Rendered(colors=colors, depths=depths, penalty=samples.penalty, places=places, weights=fine)


def render_image(field: Field, cameras: Cameras, bounds: FieldBounds, view: int, sampling: Sampling = Sampling()) -> FloatArray:
    """Image (H,W,3) of one camera, in 0..1."""
    rays = rays_of_image(cameras, bounds, view)
    if isinstance(field, torch.nn.Module):
        rays = rays.to(next(field.parameters()).device)
    with torch.no_grad():
        parts = [
            render_rays(field, rays.select(slice(start, start + RAYS_A_PART)), sampling).colors
            for start in range(0, len(rays), RAYS_A_PART)
        ]
    width, height = cameras.sizes_wh[view]
    return np.clip(torch.cat(parts).double().cpu().numpy().reshape(height, width, 3), 0, 1)


def blend_weights(densities: Tensor, lengths: Tensor) -> Tensor:
    """w (R,S) of densities (R,S) over lengths (R,S); the last sample takes all that is left."""
    thickness = densities * lengths
    before = torch.cumsum(torch.nn.functional.pad(thickness, (1, 0))[:, :-1], dim=1)
    through = torch.exp(-before)
    return torch.cat([through[:, :-1] * -torch.expm1(-thickness[:, :-1]), through[:, -1:]], dim=1)


def resample(edges: Tensor, share: Tensor, quantiles: Tensor) -> Tensor:
    """Distances (R,F), ascending, at `quantiles` (R,F) of a distribution with so much
    `share` (R,B) between neighbouring `edges` (R,B+1)."""
    total = torch.nn.functional.pad(torch.cumsum(share, dim=1), (1, 0))
    total = total / total[:, -1:]
    right = torch.searchsorted(total, quantiles, right=True).clamp(1, edges.shape[1] - 1)
    low, high = total.gather(1, right - 1), total.gather(1, right)
    part = ((quantiles - low) / (high - low).clamp(min=1e-9)).clamp(0, 1)
    start, end = edges.gather(1, right - 1), edges.gather(1, right)
    return start + part * (end - start)


def _spread(rays: Rays, count: int) -> Tensor:
    """Edges (R,count+1) from near to far at equal ratios."""
    steps = torch.linspace(0, 1, count + 1, dtype=rays.near.dtype, device=rays.near.device)
    return rays.near[:, None] * (rays.far / rays.near)[:, None] ** steps


def _between(edges: Tensor, quantiles: Tensor) -> Tensor:
    # `quantiles` are quantiles of the whole ray: what is left of each is its place in its own bin.
    count = quantiles.shape[1]
    inside = quantiles * count - torch.arange(count, dtype=quantiles.dtype, device=quantiles.device)
    return edges[:, :-1] + inside * edges.diff(dim=1)


def _draw(rays: Rays, count: int, generator: torch.Generator | None) -> Tensor:
    """One quantile (R,count) in each of `count` equal shares of 0..1, drawn on the CPU: all devices
    get the same."""
    inside = torch.full((len(rays), count), 0.5) if generator is None else torch.rand(len(rays), count, generator=generator)
    return ((torch.arange(count) + inside) / count).to(rays.near)


def _places(rays: Rays, distances: Tensor) -> Tensor:
    return rays.origins[:, None] + distances[..., None] * rays.directions[:, None]


def _flat(places: Tensor) -> Tensor:
    return places.reshape(-1, 3)


def _lengths(distances: Tensor) -> Tensor:
    """How far each sample stands for: to the next one; the last one's does not count."""
    return torch.cat([distances.diff(dim=1), torch.ones_like(distances[:, :1])], dim=1)


def _widened(weights: Tensor) -> Tensor:
    """Mean of the maxima with either neighbour, as mip-NeRF widens its histogram."""
    padded = torch.nn.functional.pad(weights, (1, 1))
    largest = torch.maximum(padded[:, :-1], padded[:, 1:])
    return (largest[:, :-1] + largest[:, 1:]) / 2


def _normalized(weights: Tensor) -> Tensor:
    return weights / weights.sum(dim=1, keepdim=True).clamp(min=1e-9)
