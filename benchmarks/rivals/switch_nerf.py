"""Switch-NeRF-style: a learnt gate sends each place to one of 8 expert σ networks.

    p        = softmax(gate(h))                            gate 2 × 64, h the grid's features
    e        = argmax p,  (s, code) = p_e · expert_e(h)    top 1, output times gate
    capacity   1.0: of N places an expert takes N / 8, those with the largest p; the rest get zeros
    penalty  = 5e-4 · 8 Σ_e f_e · mean p_e                 f_e: share of places with argmax e

Capacity and penalty are of the training; afterwards no place is turned away. The centralised split:
one machine holds all photographs. What differs from the publication (Mi and Xu 2023), and why:
- Experts are σ networks 2 × 64 behind one hash grid, where theirs are 7 layers of 256 behind
  frequencies; the colour network is shared, as theirs is.
- Their gate has a LayerNorm; features of a grid begin at 1e-4, which it would blow up into noise.
- Which places are turned away is theirs to choose by order of arrival; ours by the gate.
- The background is a shell of the same grid (`fields/bounds.py`); no appearance vector.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from benchmarks.fields.field import FieldConfig, RadianceField, color_network, small_network
from benchmarks.fields.hash_grid import HashGrid
from radiant_core.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class SwitchConfig:
    """Experts and how they share the places."""

    num_experts: int = 8
    capacity: float = 1.0
    """What an expert takes at most, in equal shares."""
    balance: float = 5e-4
    """Weight of the penalty on uneven shares."""

    def __post_init__(self) -> None:
        if self.num_experts < 1 or not (0 < self.capacity < math.inf and 0 <= self.balance < math.inf):
            raise BadInput(f"Switch-NeRF was given {self}: expected at least one expert, a capacity above 0 and balance ≥ 0.")


class SwitchNetwork(nn.Module):
    """Density and code (N,1+C) of features (N,F), with the penalty."""

    def __init__(self, num_features: int, sizes: FieldConfig, config: SwitchConfig, generator: torch.Generator) -> None:
        super().__init__()
        hidden = [num_features, *[sizes.width] * 2]
        self.gate = small_network([*hidden, config.num_experts], generator)
        self.experts = nn.ModuleList(small_network([*hidden, 1 + sizes.num_codes], generator) for _ in range(config.num_experts))
        self.num_outputs, self.config = 1 + sizes.num_codes, config

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        shares = torch.softmax(self.gate(features), dim=1)
        gates, chosen = shares.max(dim=1)
        learns = self.training and torch.is_grad_enabled()
        output = features.new_zeros(len(features), self.num_outputs)
        for number, expert in enumerate(self.experts):
            rows = self._within_room(torch.nonzero(chosen == number).squeeze(1), gates, limited=learns)
            output = output.index_put((rows,), gates[rows, None] * expert(features[rows]))
        if not learns:
            return output, features.new_zeros(())
        counts = torch.bincount(chosen, minlength=len(self.experts)) / len(chosen)
        return output, self.config.balance * len(self.experts) * (counts * shares.mean(dim=0)).sum()

    def _within_room(self, rows: Tensor, gates: Tensor, *, limited: bool) -> Tensor:
        """Of an expert's places those that it has room for."""
        room = math.ceil(self.config.capacity * len(gates) / len(self.experts))
        if not limited or len(rows) <= room:
            return rows
        return rows[gates[rows].topk(room).indices]


def make_switch_field(sizes: FieldConfig, config: SwitchConfig, seed: int) -> RadianceField:
    """The field, not trained yet: fit it as the single one."""
    generator = torch.Generator().manual_seed(seed)
    grid = HashGrid(sizes.grid, generator)
    return RadianceField(grid, SwitchNetwork(grid.num_features, sizes, config, generator), color_network(sizes, generator))
