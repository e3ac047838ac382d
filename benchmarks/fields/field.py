"""One small radiance field: density and colour of places. Once per step for every sample.

    h          = encoding of the grid's place            16 levels × 2
    (s, code)  = σ network, 2 × 64, of h                 1 + 15
    σ          = exp(s), held at e¹¹
    colour     = sigmoid(colour network, 3 × 64, of code and Y(direction))

Layers are ReLU, without a bias, as in instant-ngp; Y are the 16 spherical harmonics of degree 3.
What other rules change is the encoding or the σ network: both are given to `RadianceField`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple, Protocol

import torch
from torch import Tensor, nn

from benchmarks.fields.bounds import grid_places
from benchmarks.fields.hash_grid import GridConfig, HashGrid
from radiant_core.errors import BadInput
from radiant_core.render.harmonics import basis_values

SH_DEGREE = 3
MAX_LOG_DENSITY = 11.0
"""e¹¹ per radius is opaque within a thousandth of it."""


class Sampled(NamedTuple):
    """A field at N places."""

    densities: Tensor
    """(N,) per radius."""
    colors: Tensor
    """(N,3) in 0..1."""
    penalty: Tensor
    """() what the field adds to the loss, 0 for most."""


class Field(Protocol):
    """What can be rendered: places are unit coordinates (N,3) of `FieldBounds`."""

    def densities(self, places: Tensor) -> Tensor:
        """(N,) per radius."""
        ...

    def __call__(self, places: Tensor, directions: Tensor) -> Sampled:
        """Densities and colours seen along unit directions (N,3)."""
        ...


@dataclass(frozen=True, kw_only=True)
class FieldConfig:
    """The size of a field."""

    grid: GridConfig = field(default_factory=GridConfig)
    width: int = 64
    """Neurons of a hidden layer."""
    num_codes: int = 15
    """What the σ network hands to the colour network beside the density."""

    def __post_init__(self) -> None:
        if not (1 <= self.width <= 1024 and 1 <= self.num_codes <= 256):
            raise BadInput(f"a field was given {self}: expected a width of 1 to 1024 and 1 to 256 codes.")


class RadianceField(nn.Module):
    """The field of an encoding, a σ network and a colour network."""

    def __init__(self, encoding: nn.Module, sigma: nn.Module, color: nn.Module) -> None:
        super().__init__()
        self.encoding, self.sigma, self.color = encoding, sigma, color

    def codes(self, places: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Density (N,), code (N,C) and the penalty of places (N,3)."""
        output = self.sigma(self.encoding(grid_places(places)))
        out, penalty = output if isinstance(output, tuple) else (output, output.new_zeros(()))
        return density_of(out[:, 0]), out[:, 1:], penalty

    def densities(self, places: Tensor) -> Tensor:
        return self.codes(places)[0]

    def forward(self, places: Tensor, directions: Tensor) -> Sampled:
        densities, codes, penalty = self.codes(places)
        return Sampled(densities, color_of(self.color, codes, directions), penalty)


def density_of(logits: Tensor) -> Tensor:
    """exp, held at e¹¹; the gradient goes on there, so that what is too dense can thin out."""
    return torch.exp(logits + (logits.clamp(max=MAX_LOG_DENSITY) - logits).detach())


def color_of(network: nn.Module, codes: Tensor, directions: Tensor) -> Tensor:
    """Colours (N,3) in 0..1 of codes (N,C) along unit directions (N,3)."""
    return torch.sigmoid(network(torch.cat([codes, basis_values(directions, SH_DEGREE)], dim=1)))


def small_network(widths: Sequence[int], generator: torch.Generator | None) -> nn.Sequential:
    """Linear layers without bias from width to width, ReLU between them, He's first weights."""
    layers: list[nn.Module] = []
    for fan_in, out in pairwise(widths):
        linear = nn.Linear(fan_in, out, bias=False)
        with torch.no_grad():
            linear.weight.uniform_(-((6 / fan_in) ** 0.5), (6 / fan_in) ** 0.5, generator=generator)
        layers += [linear, nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def color_network(config: FieldConfig, generator: torch.Generator | None) -> nn.Sequential:
    """The colour network, 3 × width."""
    fan_in = config.num_codes + (SH_DEGREE + 1) ** 2
    return small_network([fan_in, *[config.width] * 3, 3], generator)


def make_field(config: FieldConfig, seed: int) -> RadianceField:
    """The single field, not trained yet; the same bits for the same seed."""
    generator = torch.Generator().manual_seed(seed)
    grid = HashGrid(config.grid, generator)
    sigma = small_network([grid.num_features, *[config.width] * 2, 1 + config.num_codes], generator)
    return RadianceField(grid, sigma, color_network(config, generator))


def num_parameters(field: nn.Module) -> int:
    """How many numbers a field has."""
    return sum(parameter.numel() for parameter in field.parameters())
