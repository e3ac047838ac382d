"""Mega-NeRF-style: a field per cell of a grid, trained on the rays that pass near its centroid.

    centroids    the middles of columns × rows equal boxes around the cameras
    a ray is k's if  min over its places of  d_k / min_j d_j  ≤ 1.15
    joined       σ = Σ w_k σ_k,  c = Σ w_k c_k,  w_k ∝ 1 / d_k where d_k / min_j d_j ≤ 1.15, else 0

d are distances in the plane. With one cell every ray is its own and w = 1: the single field, bit
for bit. What differs from the publication (Turki 2022), and why:
- A cell is the small field of this room in place of 8 layers of 256 with frequencies; 64 + 64
  samples in place of 256 + 512.
- The background is the inverted sphere of `fields/bounds.py`, a shell of the same grid, where
  theirs has a network of its own in four coordinates.
- No appearance vector: it would be fitted to half of each held-out photograph.
- All cells together take the steps of the single field; theirs take as many each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmarks.fields.bounds import FieldBounds
from benchmarks.fields.field import FieldConfig, RadianceField, Sampled, make_field
from benchmarks.fields.fit import PLAIN, FitFieldConfig, FitFieldOptions, fit_field
from benchmarks.fields.rays import PixelRays, Rays
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput

PLACES_A_RAY = 16
"""Where a ray's distances are compared, evenly from near to far: it is straight."""
RAYS_AT_ONCE = 16_384
MIN_DISTANCE = 1e-6


@dataclass(frozen=True, kw_only=True)
class MegaConfig:
    """The grid of cells and how far beyond its own places a cell sees."""

    columns: int = 2
    rows: int = 2
    margin: float = 1.15
    """Largest ratio of a place's distance to the cell over that to the nearest one."""

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 1 or not 1 <= self.margin < np.inf:
            raise BadInput(f"Mega-NeRF was given {self}: expected at least one column and row and a margin of at least 1.")


class MegaField(nn.Module):
    """The fields of K cells, joined by inverse distance."""

    def __init__(self, cells: Sequence[RadianceField], centroids: Tensor, margin: float) -> None:
        super().__init__()
        self.cells = nn.ModuleList(cells)
        self.register_buffer("centroids", centroids)
        self.margin = margin

    def densities(self, places: Tensor) -> Tensor:
        total = places.new_zeros(len(places))
        for cell, rows, weights in self._shares(places):
            total[rows] += weights * cell.densities(places[rows])
        return total

    def forward(self, places: Tensor, directions: Tensor) -> Sampled:
        densities, colors = places.new_zeros(len(places)), places.new_zeros(len(places), 3)
        for cell, rows, weights in self._shares(places):
            sampled = cell(places[rows], directions[rows])
            densities[rows] += weights * sampled.densities
            colors[rows] += weights[:, None] * sampled.colors
        return Sampled(densities, colors, places.new_zeros(()))

    def _shares(self, places: Tensor) -> list[tuple[RadianceField, Tensor, Tensor]]:
        """Each cell with the rows of its places and their weights, where it has any."""
        weights = inverse_distance_weights(places, torch.as_tensor(self.centroids), self.margin)
        shares: list[tuple[RadianceField, Tensor, Tensor]] = []
        for k, cell in enumerate(self.cells):
            assert isinstance(cell, RadianceField)
            rows = torch.nonzero(weights[:, k]).squeeze(1)
            if len(rows):
                shares.append((cell, rows, weights[rows, k]))
        return shares


def mega_centroids(cameras: Cameras, bounds: FieldBounds, config: MegaConfig) -> Tensor:
    """(K,2) unit coordinates, column by column."""
    xy = bounds.unit(cameras.centers)[:, :2]
    low, size = xy.min(axis=0), np.ptp(xy, axis=0)
    shares = [((i + 0.5) / config.columns, (j + 0.5) / config.rows) for i in range(config.columns) for j in range(config.rows)]
    return torch.from_numpy(low + np.array(shares) * size).float()


def inverse_distance_weights(places: Tensor, centroids: Tensor, margin: float) -> Tensor:
    """(N,K), each row of sum 1; exactly 1 where one cell alone is within the margin."""
    distances = _distances(places, centroids)
    nearest = distances.amin(dim=1, keepdim=True)
    inverse = torch.where(distances <= margin * nearest, nearest / distances, torch.zeros_like(distances))
    return inverse / inverse.sum(dim=1, keepdim=True)


def rays_of_cells(rays: Rays, centroids: Tensor, margin: float) -> Tensor:
    """(R,K) bool: which rays belong to which cells; each to one at least."""
    distances = rays.near[:, None] + (rays.far - rays.near)[:, None] * torch.linspace(0, 1, PLACES_A_RAY)
    places = rays.origins[:, None] + distances[..., None] * rays.directions[:, None]
    apart = _distances(places.reshape(-1, 3), centroids).view(len(rays), PLACES_A_RAY, -1)
    return (apart / apart.amin(dim=2, keepdim=True)).amin(dim=1) <= margin


def pixels_of_cells(pixels: PixelRays, centroids: Tensor, margin: float) -> NDArray[np.bool_]:
    """(Q,K) the same of all pixels, some rays at a time."""
    starts = range(0, len(pixels), RAYS_AT_ONCE)
    batches = (pixels.batch(np.arange(start, min(start + RAYS_AT_ONCE, len(pixels))))[0] for start in starts)
    return np.concatenate([rays_of_cells(rays, centroids, margin).numpy() for rays in batches])


def fit_mega(pixels: PixelRays, sizes: FieldConfig, fit: FitFieldConfig, config: MegaConfig, options: FitFieldOptions = PLAIN) -> MegaField:
    """Train the cells one after another with an equal share of the steps, and join them. BadInput
    where a cell has no ray."""
    centroids = mega_centroids(pixels.cameras, pixels.bounds, config)
    owned = pixels_of_cells(pixels, centroids, config.margin)
    cells = []
    for k in range(len(centroids)):
        if not owned[:, k].any():
            raise BadInput(f"no ray passes near cell {k} of {config.columns} × {config.rows}: use fewer cells.")
        cell_fit = replace(fit, num_steps=max(1, round(fit.num_steps / len(centroids))), seed=fit.seed + k)
        cells.append(make_field(sizes, cell_fit.seed))
        fit_field(cells[-1], pixels.select(owned[:, k]), cell_fit, options)
    return MegaField(cells, centroids, config.margin)


def _distances(places: Tensor, centroids: Tensor) -> Tensor:
    """(N,K) in the plane, never 0."""
    return (places[:, None, :2] - centroids).norm(dim=2).clamp(min=MIN_DISTANCE)
