"""A surface model of a made-up block on flat ground has its heights, and holes where nothing was seen."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import open3d as o3d
import pytest

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.geometry.open3d_ops import Mesh
from radiant_core.geometry.surface import Surface, extract_surface
from radiant_core.render.trajectories import Lens, cameras_looking_at
from radiant_core.splats import SH_C0, Splats

SHIFT = np.array([300.0, -200.0, 50.0])
BLOCK_M, HEIGHT_M = 3.0, 4.0


@cache
def block() -> Splats:
    """Ground of 24 × 24 m with a block of 6 × 6 × 4 m, opaque discs 0.3 m apart, haze above."""
    rng = np.random.default_rng(0)
    xy = np.stack(np.meshgrid(np.arange(-12, 12.1, 0.3), np.arange(-12, 12.1, 0.3)), axis=-1).reshape(-1, 2)
    roof = (np.abs(xy) <= BLOCK_M).all(axis=1)
    surface = np.column_stack([xy, np.where(roof, HEIGHT_M, 0.0)])
    haze = rng.uniform([-12, -12, 6], [12, 12, 10], (400, 3))
    means = np.concatenate([surface, haze]) + SHIFT
    flat, count = np.log([0.25, 0.25, 0.01]), len(means)
    return Splats(
        means=means,
        quats=np.tile([1.0, 0, 0, 0], (count, 1)),
        log_scales=np.concatenate([np.tile(flat, (len(surface), 1)), np.full((400, 3), np.log(0.6))]),
        logit_opacities=np.concatenate([np.full(len(surface), 4.0), np.full(400, -2.5)]),
        sh0=np.full((count, 1, 3), 0.2 / SH_C0),
        shN=np.zeros((count, 0, 3)),
    )


@cache
def flight() -> Cameras:
    xy = np.stack(np.meshgrid([-6, 0, 6], [-6, 0, 6]), axis=-1).reshape(-1, 2)
    stands = np.column_stack([xy, np.full(9, 20.0)]) + SHIFT
    return cameras_looking_at(stands, stands * [1, 1, 0] + [0.0, 0.0, SHIFT[2]], Lens(size_wh=(192, 144), field_of_view_deg=60))


@cache
def surface() -> Surface:
    return extract_surface(block(), flight(), resolution=0.2)


def heights_from_above(mesh: Mesh, places: np.ndarray) -> np.ndarray:
    """Height (P,) of the topmost surface over places (P,2), NaN where there is none."""
    tensor: Any = o3d.core.Tensor
    scene, top = o3d.t.geometry.RaycastingScene(), float(mesh.vertices[:, 2].max()) + 1.0
    scene.add_triangles(tensor(mesh.vertices.astype(np.float32)), tensor(mesh.triangles.astype(np.uint32)))
    rays = np.tile(np.array([0, 0, top, 0, 0, -1], np.float32), (len(places), 1))
    rays[:, :2] = places
    distances = scene.cast_rays(tensor(rays))["t_hit"].numpy().astype(np.float64)
    return np.where(np.isfinite(distances), top - distances, np.nan)


def test_heights_of_ground_and_roof_are_right_and_what_nobody_saw_has_none() -> None:
    mesh = replace(surface().mesh, vertices=surface().mesh.vertices - SHIFT)
    x, y = np.meshgrid(np.arange(-11, 11.1, 0.5), np.arange(-11, 11.1, 0.5))
    places = np.column_stack([x.ravel(), y.ravel()])
    reach = np.abs(places).max(axis=1)
    heights = heights_from_above(mesh, places)
    roof, ground = heights[reach < BLOCK_M - 0.5], heights[(reach > BLOCK_M + 1.5) & (reach < 10)]
    assert np.isfinite(roof).all()
    assert np.isfinite(ground).mean() > 0.98
    # A voxel is 0.2 m; haze of 8 % opacity 6 to 10 m above would lift a mean depth by decimetres.
    for found, truth in ((roof, HEIGHT_M), (ground, 0.0)):
        assert np.nanmedian(np.abs(found - truth)) < 0.03
        assert np.nanquantile(np.abs(found - truth), 0.95) < 0.15
    assert np.isnan(heights_from_above(mesh, np.array([[40.0, 0.0]]))).all()
    # The block's edge lies within a voxel.
    east = np.arange(BLOCK_M - 2, BLOCK_M + 2, 0.05)
    high = heights_from_above(mesh, np.column_stack([east, np.zeros(len(east))])) > HEIGHT_M / 2
    assert abs(east[high].max() - BLOCK_M) < 0.25


def test_bad_input_says_what_to_do() -> None:
    with pytest.raises(BadInput, match="no camera"):
        extract_surface(block(), flight().select([]))
    with pytest.raises(BadInput, match="coarser"):
        extract_surface(block(), flight(), resolution=1e-4)
    away = replace(block(), means=block().means + np.float32(1e4))
    with pytest.raises(BadInput, match="sees the model"):
        extract_surface(away, flight())
