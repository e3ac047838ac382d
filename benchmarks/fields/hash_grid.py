"""A multiresolution hash grid (Müller et al. 2022): features of places, trilinear between corners.

    level l of L:  R_l = R_0 (R_{L−1} / R_0)^{l / (L−1)} cells a side, T entries of 2 features
    entry:         x + (R+1)(y + (R+1) z) where (R+1)³ ≤ T, else (x ^ π₂y ^ π₃z) mod T

Once per step for every sample. In float32 on the CPU by the native kernel, else by torch, which is
its plain twin: torch took 1.1 s for what the kernel does in 0.1 s (131,072 places, 16 levels).
"""

# pyright: reportIncompatibleMethodOverride=false
from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import _radiant_fields
import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from radiant_core.errors import BadInput

PRIMES = (1, 2654435761, 805459861)
FIRST_SPREAD = 1e-4
"""Entries begin uniform in ± this."""


@dataclass(frozen=True, kw_only=True)
class GridConfig:
    """How fine and how large a hash grid is."""

    num_levels: int = 16
    log2_entries: int = 17
    """Entries a level, as a power of two."""
    coarsest: int = 16
    """Cells a side of the first level."""
    finest: int = 2048
    """Cells a side of the last level."""

    def __post_init__(self) -> None:
        if not (1 <= self.num_levels <= 32 and 4 <= self.log2_entries <= 24 and 1 <= self.coarsest <= self.finest <= 65_535):
            raise BadInput(f"a hash grid was given {self}: expected 1 to 32 levels, 2⁴ to 2²⁴ entries, 1 ≤ coarsest ≤ finest ≤ 65535.")

    @property
    def resolutions(self) -> list[int]:
        """Cells a side, level by level."""
        return np.rint(np.geomspace(self.coarsest, self.finest, self.num_levels)).astype(int).tolist()


class HashGrid(nn.Module):
    """Features (N,2L) of places (N,3) in 0..1; places outside are taken to the nearest side.

    The native kernel adds the table's gradient into `table.grad` itself: a step renders its rays in
    parts, and a gradient of its own for each part would be 16 MB to clear and to add.
    """

    resolutions: Tensor

    def __init__(self, config: GridConfig, generator: torch.Generator | None = None) -> None:
        super().__init__()
        table = torch.empty(config.num_levels, 1 << config.log2_entries, 2)
        self.table = nn.Parameter(table.uniform_(-FIRST_SPREAD, FIRST_SPREAD, generator=generator))
        self.register_buffer("resolutions", torch.tensor(config.resolutions, dtype=torch.int32), persistent=False)
        self.num_features = 2 * config.num_levels

    def forward(self, places: Tensor) -> Tensor:
        if places.device.type == "cpu" and places.dtype == self.table.dtype == torch.float32:
            encoded: Tensor = _NativeEncode.apply(places, self.table, self.resolutions)
            return encoded
        return encode_places(places, self.table, self.resolutions)


class _NativeEncode(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, places: Tensor, table: Tensor, resolutions: Tensor) -> Tensor:
        columns = places.detach().T.contiguous()
        features = columns.new_empty(2 * len(resolutions), len(places))
        _radiant_fields.encode_places(columns, table.detach(), resolutions, features, torch.get_num_threads())
        ctx.save_for_backward(columns, resolutions)
        ctx.table = table
        return features.T

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, None, None]:
        columns, resolutions = ctx.saved_tensors
        of_places, of_table, _ = ctx.needs_input_grad
        table, none = ctx.table, columns.new_empty(0)
        if of_table and table.grad is None:
            table.grad = torch.zeros_like(table)
        place_gradients = torch.empty_like(columns) if of_places else none
        _radiant_fields.grid_gradients(
            columns,
            table.detach(),
            resolutions,
            grads[0].T.contiguous(),
            table.grad if of_table else none,
            place_gradients,
            torch.get_num_threads(),
        )
        if of_places:
            # Outside, a place is taken to the nearest side, whichever way it moves.
            place_gradients[(columns < 0) | (columns > 1)] = 0
        return (place_gradients.T if of_places else None), None, None


def encode_places(places: Tensor, table: Tensor, resolutions: Tensor) -> Tensor:
    """Features (N,2L) of places (N,3) from a table (L,T,2); any floating type, any device."""
    features = []
    for level, side in enumerate(resolutions.tolist()):
        scaled = places.clamp(0, 1) * side
        low = scaled.detach().floor().clamp(max=side - 1)
        shares, corner = scaled - low, low.long()
        total = places.new_zeros(len(places), 2)
        for offset in torch.cartesian_prod(*[torch.arange(2, device=places.device)] * 3):
            weight = torch.where(offset.bool(), shares, 1 - shares).prod(dim=1, keepdim=True)
            total = total + weight * table[level, entry_of(corner + offset, side, table.shape[1])]
        features.append(total)
    return torch.cat(features, dim=1)


def entry_of(corners: Tensor, side: int, num_entries: int) -> Tensor:
    """Rows (N,) of a level's table for corners (N,3) int64 of its cells."""
    x, y, z = corners.unbind(dim=1)
    if (side + 1) ** 3 <= num_entries:
        return x + (side + 1) * (y + (side + 1) * z)
    # The primes are of 32 bits: the low bits of an int64 product are those of the kernel's.
    return (x ^ (y * PRIMES[1]) ^ (z * PRIMES[2])) & (num_entries - 1)
