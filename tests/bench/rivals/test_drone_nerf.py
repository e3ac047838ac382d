"""Drone-NeRF-style: blocks by position and by what cameras see, poses refined, codes fused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.fields.bounds import grid_places
from benchmarks.fields.field import make_field
from benchmarks.fields.rays import PixelRays
from benchmarks.rivals.drone_nerf import BlockCodes, DroneConfig, cameras_of_blocks, drone_boxes, fit_drone, fused_field
from radiant_core.errors import BadInput
from tests.bench.fields.floor import FIT, SIZES, bounds_of, floor_scene

TWO = DroneConfig(columns=2, rows=1)


def test_a_camera_is_of_the_block_it_stands_in_and_of_those_it_sees() -> None:
    scene, _ = floor_scene()
    bounds = bounds_of(scene)
    boxes = drone_boxes(bounds, scene.cameras.centers, TWO)
    np.testing.assert_allclose(boxes[0, 1, 0].item() * bounds.radius_m + bounds.center[0], 0, atol=1e-5)
    by_place = cameras_of_blocks(scene, bounds, boxes, 1.0)
    west, middle, east = slice(0, 3), slice(3, 6), slice(6, 9)
    assert by_place[west, 0].all() and not by_place[west, 1].any() and by_place[east, 1].all() and by_place[middle].all()
    # Photographs of the west that look at the east, as their observations say.
    looking = replace(scene, observations=np.stack([scene.observations[:, 0], 8 - scene.observations[:, 1]], axis=1))
    seen = cameras_of_blocks(looking, bounds, boxes, 0.25)
    assert seen[west].all() and seen[east].all()
    blind = replace(scene, observations=np.zeros((0, 2), np.int64))
    assert np.array_equal(cameras_of_blocks(blind, bounds, boxes, 0.25), by_place)


def test_blocks_are_trained_apart_with_their_poses_and_then_fused() -> None:
    scene, views = floor_scene()
    pixels = PixelRays.of(views, bounds_of(scene))
    fit = replace(FIT, num_steps=40)
    fitted = fit_drone(scene, pixels, SIZES, fit, replace(TWO, min_visible=1.0))
    assert len(fitted.moves) == 2 and all(move.shape == (9, 6) for move in fitted.moves)
    moved = [(move != 0).any(dim=1) for move in fitted.moves]
    assert moved[0][:3].all() and not moved[0][6:].any() and moved[1][6:].all() and not moved[1][:3].any()
    still = fit_drone(scene, pixels, SIZES, replace(fit, num_steps=4), replace(TWO, pose_rate=0.0))
    assert all((move == 0).all() for move in still.moves)


def test_the_fusion_learns_over_fixed_blocks() -> None:
    scene, _views = floor_scene()
    bounds = bounds_of(scene)
    blocks = [make_field(SIZES, seed) for seed in (0, 1)]
    boxes = drone_boxes(bounds, scene.cameras.centers, TWO)
    fused = fused_field(blocks, boxes, SIZES, 0)
    codes = fused.encoding
    assert isinstance(codes, BlockCodes)
    learns = [name for name, parameter in fused.named_parameters() if parameter.requires_grad]
    assert learns and not any("blocks" in name for name in learns)
    places = torch.tensor([[0.0, 0, 0], [float(boxes[0, 0, 0]) - 0.25, 0, 0]])
    said = codes(grid_places(places))
    assert said.shape == (2, 2 * (2 + SIZES.num_codes))
    # The last number of each block: how far outside its box a place is.
    width = 2 + SIZES.num_codes
    distances = said[:, width - 1 :: width]
    half = float(boxes[1, 0, 0] - boxes[0, 0, 0])
    np.testing.assert_allclose(distances[0], [max(0, -float(boxes[0, 1, 0])), max(0, float(boxes[1, 0, 0]))], atol=1e-5)
    np.testing.assert_allclose(distances[1], [0.25, 0.25 + half], atol=1e-5)
    changed = fused_field([blocks[0], make_field(SIZES, 7)], boxes, SIZES, 0).encoding(grid_places(places))
    assert torch.equal(changed[:, :width], said[:, :width]) and not torch.equal(changed[:, width:], said[:, width:])


def test_a_block_without_cameras_is_named() -> None:
    scene, views = floor_scene()
    pixels = PixelRays.of(views, bounds_of(scene))
    with pytest.raises(BadInput, match="has no camera: use fewer blocks"):
        fit_drone(scene, pixels, SIZES, replace(FIT, num_steps=1), DroneConfig(columns=7, rows=7, min_visible=1.0))
    for wrong in ({"columns": 0}, {"min_visible": 0}, {"fusion_share": 1}, {"pose_rate": float("nan")}):
        with pytest.raises(BadInput, match="Drone-NeRF was given"):
            DroneConfig(**wrong)
