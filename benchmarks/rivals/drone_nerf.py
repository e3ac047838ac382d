"""Drone-NeRF-style: uniform blocks, a field each with its poses refined, fused by a small network.

    block     a camera is of the block in whose box it stands, and of every one in which at least a
              quarter of the points lie that it observes              (position, visibility)
    train     each block apart; beside its field a small move of each of its cameras
    fuse      (s, code) = network 2 × 64 of [ log σ_b, code_b, distance to b ] over all blocks b;
              it and a colour network of its own are trained on all photographs, the blocks fixed

There is no public code: this is from the abstract (Jia 2023, arXiv 2308.15733) alone, which says
that the scene is divided uniformly by camera position and depth visibility, that sub-scenes are
trained in parallel with poses refined, and that a fusion puts them together. What it leaves open is
chosen here: the share of a quarter, points of structure from motion for depth, the inputs and size
of the fusion network, and that it takes a quarter of all steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmarks.fields.bounds import SHELL, FieldBounds
from benchmarks.fields.field import FieldConfig, RadianceField, color_network, make_field, small_network
from benchmarks.fields.fit import PLAIN, FitFieldConfig, FitFieldOptions, fit_field
from benchmarks.fields.poses import CameraMoves
from benchmarks.fields.rays import PixelRays
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene


@dataclass(frozen=True, kw_only=True)
class DroneConfig:
    """Blocks, poses and fusion."""

    columns: int = 2
    rows: int = 2
    min_visible: float = 0.25
    """Share of a camera's points in a block's box from which on it is the block's too."""
    pose_rate: float = 1e-4
    """Adam's rate of the cameras' moves, in radians and radii; 0 leaves poses as they are."""
    fusion_share: float = 0.25
    """Share of all steps that the fusion network takes."""

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 1 or not (0 < self.min_visible <= 1 and 0 <= self.pose_rate < 1 and 0 < self.fusion_share < 1):
            raise BadInput(f"Drone-NeRF was given {self}: expected counts of at least 1, shares in 0 to 1 and a pose rate of 0 or more.")


class BlockCodes(nn.Module):
    """What the fixed blocks say of places (N,3) in 0..1: (N, B (2 + C))."""

    def __init__(self, blocks: Sequence[RadianceField], boxes: Tensor) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(blocks).requires_grad_(False)
        self.register_buffer("boxes", boxes)

    def forward(self, places: Tensor) -> Tensor:
        with torch.no_grad():
            xy = (places[:, :2] - 0.5) * (2 * (1 + SHELL))
            return torch.cat([torch.cat([output, _outside(xy, box)], dim=1) for output, box in self._outputs(places)], dim=1)

    def _outputs(self, places: Tensor) -> list[tuple[Tensor, Tensor]]:
        outputs: list[tuple[Tensor, Tensor]] = []
        for block, box in zip(self.blocks, torch.as_tensor(self.boxes), strict=True):
            assert isinstance(block, RadianceField)
            outputs.append((block.sigma(block.encoding(places)), box))
        return outputs


@dataclass(frozen=True, kw_only=True, eq=False)
class DroneFit:
    """The fused field and what was refined on the way."""

    field: RadianceField
    moves: tuple[Tensor, ...]
    """(V,6) of each block: how far its cameras were moved."""


def drone_boxes(bounds: FieldBounds, centers: FloatArray, config: DroneConfig) -> Tensor:
    """(B,2,2) low and high xy of the blocks in unit coordinates, column by column."""
    xy = bounds.unit(centers)[:, :2]
    low, size = xy.min(axis=0), np.ptp(xy, axis=0)
    cells = np.array([(i, j) for i in range(config.columns) for j in range(config.rows)], float)
    counts = np.array([config.columns, config.rows])
    return torch.from_numpy(np.stack([low + cells / counts * size, low + (cells + 1) / counts * size], axis=1)).float()


def cameras_of_blocks(scene: SfmScene, bounds: FieldBounds, boxes: Tensor, min_visible: float) -> NDArray[np.bool_]:
    """(C,B): by position each camera is of one block at least, by what it sees of more."""
    is_inside = _outside(torch.from_numpy(bounds.unit(scene.cameras.centers)[:, :2]).float()[:, None], boxes).squeeze(2).numpy() <= 1e-6
    inside = _outside(torch.from_numpy(bounds.unit(scene.points)[:, :2]).float()[:, None], boxes).squeeze(2).numpy() <= 0
    points, cameras = scene.observations.T
    num_visible = np.stack([np.bincount(cameras, inside[points, b], len(scene.cameras)) for b in range(len(boxes))], axis=1)
    total = np.bincount(cameras, minlength=len(scene.cameras))[:, None]
    return is_inside | ((num_visible >= min_visible * total) & (total > 0))


def fit_drone(
    scene: SfmScene,
    pixels: PixelRays,
    sizes: FieldConfig,
    fit: FitFieldConfig,
    config: DroneConfig,
    options: FitFieldOptions = PLAIN,
) -> DroneFit:
    """Train the blocks apart and the fusion over them; `pixels` are of the cameras of `scene`.
    BadInput where a block has no camera."""
    boxes = drone_boxes(pixels.bounds, scene.cameras.centers, config)
    members = cameras_of_blocks(scene, pixels.bounds, boxes, config.min_visible)
    num_steps = max(1, round(fit.num_steps * (1 - config.fusion_share) / len(boxes)))
    blocks, moves = [], []
    for b in range(len(boxes)):
        if not members[:, b].any():
            raise BadInput(f"block {b} of {config.columns} × {config.rows} has no camera: use fewer blocks.")
        block, moved = make_field(sizes, fit.seed + b), CameraMoves(len(scene.cameras))
        refined = options
        if config.pose_rate > 0:
            refined = replace(options, moved=moved, extra_parameters=((moved.values, config.pose_rate),))
        fit_field(block, pixels.of_views(np.flatnonzero(members[:, b])), replace(fit, num_steps=num_steps, seed=fit.seed + b), refined)
        blocks.append(block)
        moves.append(moved.values.detach())
    fused = fused_field(blocks, boxes, sizes, fit.seed)
    fit_field(fused, pixels, replace(fit, num_steps=max(1, round(fit.num_steps * config.fusion_share))), options)
    return DroneFit(field=fused, moves=tuple(moves))


def fused_field(blocks: Sequence[RadianceField], boxes: Tensor, sizes: FieldConfig, seed: int) -> RadianceField:
    """The fusion network over the codes of `blocks`, not trained yet."""
    generator = torch.Generator().manual_seed(seed)
    num_inputs = len(blocks) * (2 + sizes.num_codes)
    sigma = small_network([num_inputs, *[sizes.width] * 2, 1 + sizes.num_codes], generator)
    return RadianceField(BlockCodes(blocks, boxes), sigma, color_network(sizes, generator))


def _outside(xy: Tensor, box: Tensor) -> Tensor:
    """(…,1) how far places (…,2) lie outside boxes (…,2,2); 0 inside."""
    low, high = box[..., 0, :], box[..., 1, :]
    return torch.maximum(low - xy, xy - high).clamp(min=0).norm(dim=-1, keepdim=True)
