"""Small rigid moves of cameras that are fitted beside a field: 6 numbers each. Once per step.

    direction' = exp([ω]×) direction        origin' = exp([ω]×) (origin − pivot) + pivot + t

ω in radians, t in radii. The pivot is the camera's own centre where every camera moves by itself,
and the middle of the scene (0) where all of a device move together.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn

from benchmarks.fields.rays import Rays


class CameraMoves(nn.Module):
    """A move for each of V cameras, none at first."""

    def __init__(self, num_cameras: int) -> None:
        super().__init__()
        self.values = nn.Parameter(torch.zeros(num_cameras, 6))

    def forward(self, rays: Rays) -> Rays:
        """The rays as the moved cameras see them."""
        moves = self.values[rays.views]
        turned = turn(moves[:, :3], rays.directions)
        return replace(rays, directions=turned, origins=rays.origins + moves[:, 3:])


class SharedMove(nn.Module):
    """One move for all cameras of a device, none at first."""

    def __init__(self) -> None:
        super().__init__()
        self.values = nn.Parameter(torch.zeros(6))

    def forward(self, rays: Rays) -> Rays:
        """The rays as the moved cameras see them."""
        turns = self.values[:3].expand(len(rays), 3)
        return replace(rays, directions=turn(turns, rays.directions), origins=turn(turns, rays.origins) + self.values[3:])


def turn(turns: Tensor, vectors: Tensor) -> Tensor:
    """Vectors (R,3) turned by ω (R,3) radians about its axis, Rodrigues' formula."""
    squared = turns.square().sum(dim=1, keepdim=True)
    # sin θ / θ and (1 − cos θ) / θ² by their series near 0, where the quotients have no gradient.
    near = squared < 1e-6
    angle = torch.where(near, torch.ones_like(squared), squared).sqrt()
    first = torch.where(near, 1 - squared / 6, angle.sin() / angle)
    second = torch.where(near, 0.5 - squared / 24, (1 - angle.cos()) / angle.square())
    across = torch.linalg.cross(turns, vectors)
    return vectors + first * across + second * torch.linalg.cross(turns, across)
