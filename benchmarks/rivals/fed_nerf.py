"""FedNeRF-style: federated averaging fitted to what a field's inference uses, with poses aligned.

Per round, with the server's field F and for each client k of photographs of its own:
    1  align     a rigid move of k's cameras, fitted to F with F fixed       (from the second round)
    2  train     a copy of F on k's moved rays
    3  use       u_k[e] = Σ over samples of its rays of w · (share of entry e in the sample)
    4  average   entry e: Σ_k u_k[e] F_k[e] / Σ_k u_k[e], F's own where nobody used it;
                 networks: mean by the clients' numbers of pixels
A client sends its field and its use, and never a photograph. w are the weights that blend a ray, so
an entry is learnt from whom it showed something: plain averaging would pull it to those who never
looked at it.

There is no public code: this is from the abstract (Suzuki 2023, arXiv 2309.06030) alone, which says
that the aggregation of federated learning is fitted to NeRF so that it can be updated locally, and
that clients' noisy global poses are aligned before they are aggregated. The measure of use, the
rounds and the share of aligning are chosen here. It is not the FedNeRF of arXiv 2305.01163.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from benchmarks.fields.bounds import grid_places
from benchmarks.fields.field import FieldConfig, RadianceField, make_field, num_parameters
from benchmarks.fields.fit import PLAIN, FitFieldConfig, FitFieldOptions, fit_field
from benchmarks.fields.hash_grid import HashGrid
from benchmarks.fields.poses import SharedMove
from benchmarks.fields.rays import PixelRays
from benchmarks.fields.render import RAYS_A_PART, render_rays
from radiant_core.errors import BadInput

TABLE = "encoding.table"
BYTES_A_NUMBER = 4


@dataclass(frozen=True, kw_only=True)
class FedConfig:
    """Rounds, aligning and averaging."""

    num_rounds: int = 3
    align_share: float = 0.25
    """Share of a client's steps in each round but the first that align it; 0: none."""
    align_rate: float = 1e-3
    """Adam's rate of the move, in radians and radii."""
    num_probes: int = 2048
    """Rays of which a client measures what it uses."""

    def __post_init__(self) -> None:
        if min(self.num_rounds, self.num_probes) < 1 or not (0 <= self.align_share < 1 and 0 < self.align_rate < np.inf):
            raise BadInput(f"FedNeRF was given {self}: expected rounds and probes of at least 1, 0 ≤ align_share < 1, a rate above 0.")


@dataclass(frozen=True, kw_only=True, eq=False)
class FedFit:
    """The server's field and what went up to it."""

    field: RadianceField
    moves: tuple[Tensor, ...]
    """(6,) of each client: how far its cameras were moved in all."""
    sent_bytes_a_round: int
    """Of all clients together, up."""
    num_rounds: int


def fit_fed(
    clients: Sequence[PixelRays], sizes: FieldConfig, fit: FitFieldConfig, config: FedConfig, options: FitFieldOptions = PLAIN
) -> FedFit:
    """Train on all clients' pixels, `fit.num_steps` of all clients and rounds together, aligning
    among them. BadInput without a client."""
    if not clients:
        raise BadInput("FedNeRF was given no client: give the pixels of at least one device.")
    server, moves = make_field(sizes, fit.seed), [SharedMove() for _ in clients]
    num_steps = max(1, round(fit.num_steps / (config.num_rounds * len(clients))))
    for number in range(config.num_rounds):
        sent: list[RadianceField] = []
        used: list[Tensor] = []
        for k, pixels in enumerate(clients):
            num_aligning = round(config.align_share * num_steps) if number else 0
            local_fit = replace(fit, num_steps=num_steps - num_aligning, seed=fit.seed + k)
            if num_aligning:
                align_poses(server, pixels, moves[k], replace(local_fit, num_steps=num_aligning), config.align_rate)
            local = deepcopy(server)
            fit_field(local, pixels, local_fit, replace(options, moved=_fixed(moves[k]), first_step=number * num_steps))
            sent.append(local)
            used.append(entries_used(local, pixels, moves[k], local_fit, config.num_probes))
        average_fields(server, sent, used, [len(pixels) for pixels in clients])
    num_entries = server.get_parameter(TABLE)[..., 0].numel()
    sent_bytes = len(clients) * BYTES_A_NUMBER * (num_parameters(server) + num_entries)
    values = tuple(move.values.detach() for move in moves)
    return FedFit(field=server, moves=values, sent_bytes_a_round=sent_bytes, num_rounds=config.num_rounds)


def align_poses(field: RadianceField, pixels: PixelRays, move: SharedMove, fit: FitFieldConfig, rate: float) -> None:
    """Fit a client's `move`, in place, to what `field` shows; the field stays."""
    fixed = deepcopy(field).requires_grad_(False)
    fit_field(fixed, pixels, replace(fit, seed=fit.seed + 1), FitFieldOptions(moved=move, extra_parameters=((move.values, rate),)))


def entries_used(field: RadianceField, pixels: PixelRays, move: SharedMove, fit: FitFieldConfig, num_rays: int) -> Tensor:
    """(L,T) how much of what some rays show comes from each entry of the grid."""
    grid = field.encoding
    assert isinstance(grid, HashGrid)
    rows = np.sort(np.random.default_rng((fit.seed, 2)).integers(0, len(pixels), num_rays))
    rays = _fixed(move)(pixels.batch(rows)[0].to(grid.table.device))
    grid.table.grad = torch.zeros_like(grid.table)
    for start in range(0, len(rays), RAYS_A_PART):
        with torch.no_grad():
            rendered = render_rays(field, rays.select(slice(start, start + RAYS_A_PART)), fit.sampling)
        # The derivative of Σ w · feature by an entry is the sum of its shares, weighted.
        features = grid(grid_places(rendered.places.reshape(-1, 3)))
        (features * rendered.weights.reshape(-1, 1)).sum().backward()
    used, grid.table.grad = grid.table.grad[..., 0].clone(), None
    return used


def average_fields(server: RadianceField, sent: Sequence[RadianceField], used: Sequence[Tensor], num_pixels: Sequence[int]) -> None:
    """Put the clients' mean into `server`: entries by their use, networks by their pixels."""
    states = [field.state_dict() for field in sent]
    total = torch.stack(list(used)).sum(dim=0)
    mean = {name: _mean([state[name] for state in states], num_pixels) for name in states[0] if name != TABLE}
    weighted = torch.stack([state[TABLE] * use[..., None] for state, use in zip(states, used, strict=True)]).sum(dim=0)
    is_used = (total > 0)[..., None]
    mean[TABLE] = torch.where(is_used, weighted / total[..., None].clamp(min=1e-30), server.state_dict()[TABLE])
    server.load_state_dict(mean)


def _mean(values: Sequence[Tensor], weights: Sequence[int]) -> Tensor:
    return torch.stack([value * (weight / sum(weights)) for value, weight in zip(values, weights, strict=True)]).sum(dim=0)


def _fixed(move: SharedMove) -> SharedMove:
    """The move as it is now, which training does not change."""
    return deepcopy(move).requires_grad_(False)
