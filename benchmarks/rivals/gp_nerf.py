"""GP-NeRF-style: one field whose features come from a hash grid and three dense planes.

    h = [ hash(g), plane_xy(g), plane_xz(g), plane_yz(g) ]      4 levels × 2 features a plane,
                                                                128 to 1,024 cells a side, bilinear

Planes have no collisions, so that what the hash confuses can be told apart. One machine, no split.
What differs from the publication (Zhang 2023), and why:
- The grid's table is the small one of this room (2¹⁵ to 2¹⁷ entries in place of 2¹⁹) and rays have
  64 + 64 samples in place of 128 + 128.
- Its background has a grid of its own; here it is a shell of the same one (`fields/bounds.py`).
- No appearance vector: it would be fitted to half of each held-out photograph.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import grid_sample

from benchmarks.fields.field import FieldConfig, RadianceField, color_network, small_network
from benchmarks.fields.hash_grid import FIRST_SPREAD, HashGrid
from radiant_core.errors import BadInput

AXES = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True, kw_only=True)
class PlaneConfig:
    """The three planes beside the hash grid."""

    num_levels: int = 4
    num_features: int = 2
    """Of a level."""
    coarsest: int = 128
    """Cells a side of the first level."""
    finest: int = 1024

    def __post_init__(self) -> None:
        if min(self.num_levels, self.num_features, self.coarsest) < 1 or not self.coarsest <= self.finest <= 8192:
            raise BadInput(f"planes were given {self}: expected counts of at least 1 and coarsest ≤ finest ≤ 8192.")

    @property
    def resolutions(self) -> list[int]:
        """Cells a side, level by level."""
        return np.rint(np.geomspace(self.coarsest, self.finest, self.num_levels)).astype(int).tolist()


class DensePlanes(nn.Module):
    """Features (N, 3 planes × levels × F) of places (N,3) in 0..1."""

    def __init__(self, config: PlaneConfig, generator: torch.Generator) -> None:
        super().__init__()
        sides = [side + 1 for side in config.resolutions for _ in AXES]
        shapes = [(1, config.num_features, side, side) for side in sides]
        self.levels = nn.ParameterList(
            nn.Parameter(torch.empty(shape).uniform_(-FIRST_SPREAD, FIRST_SPREAD, generator=generator)) for shape in shapes
        )
        self.num_features = config.num_features * len(shapes)

    def forward(self, places: Tensor) -> Tensor:
        coordinates = [(2 * places[:, axes] - 1)[None, :, None] for axes in AXES]
        features = [
            grid_sample(level, coordinates[number % len(AXES)], padding_mode="border", align_corners=True)[0, :, :, 0]
            for number, level in enumerate(self.levels)
        ]
        return torch.cat(features).T


class GridAndPlanes(nn.Module):
    """Both encodings side by side."""

    def __init__(self, sizes: FieldConfig, config: PlaneConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.grid, self.planes = HashGrid(sizes.grid, generator), DensePlanes(config, generator)
        self.num_features = self.grid.num_features + self.planes.num_features

    def forward(self, places: Tensor) -> Tensor:
        return torch.cat([self.grid(places), self.planes(places)], dim=1)


def make_gp_field(sizes: FieldConfig, config: PlaneConfig, seed: int) -> RadianceField:
    """The field, not trained yet: fit it as the single one."""
    generator = torch.Generator().manual_seed(seed)
    encoding = GridAndPlanes(sizes, config, generator)
    sigma = small_network([encoding.num_features, *[sizes.width] * 2, 1 + sizes.num_codes], generator)
    return RadianceField(encoding, sigma, color_network(sizes, generator))
