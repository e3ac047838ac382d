"""Where a field lies: the inverted sphere is one to one, rays begin above and end below the scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.fields.bounds import MAX_FAR, SHELL, FieldBounds, grid_places
from radiant_core.errors import BadInput
from tests.bench.fields.floor import bounds_of, floor_scene


def test_the_background_is_an_inverted_sphere_in_a_shell() -> None:
    directions = torch.nn.functional.normalize(torch.randn(50, 3, generator=torch.Generator().manual_seed(0)).double())
    lengths = torch.tensor([0.0, 0.5, 1.0, 1.0 + 1e-9, 2.0, 10.0, 1e6], dtype=torch.float64)
    found = torch.stack([(grid_places(length * directions) - 0.5).norm(dim=1) * 2 * (1 + SHELL) for length in lengths])
    wanted = torch.where(lengths <= 1, lengths, 1 + SHELL - SHELL / lengths.clamp(min=1))
    torch.testing.assert_close(found, wanted[:, None].expand_as(found))
    assert (found[1:] > found[:-1]).all() and found.max() < 1 + SHELL
    # Without the background's rule, what is beyond the sphere would leave the grid.
    far = grid_places(100 * directions)
    assert ((far > 0) & (far < 1)).all()


def test_rays_begin_over_and_end_under_the_points() -> None:
    scene, _ = floor_scene()
    bounds = bounds_of(scene)
    origins = torch.from_numpy(bounds.unit(scene.cameras.centers))
    down = torch.tensor([[0.1, 0.2, -1.0]], dtype=torch.float64).expand(len(origins), 3) / np.sqrt(1.05)
    near, far = bounds.span(origins, down)
    heights = lambda distance: bounds.center[2] + bounds.radius_m * (origins + distance[:, None] * down)[:, 2]  # noqa: E731
    np.testing.assert_allclose(heights(near), bounds.high_m)
    np.testing.assert_allclose(heights(far), bounds.low_m)
    assert bounds.low_m < scene.points[:, 2].min() and bounds.high_m > scene.points[:, 2].max()
    # Up, level, from among the houses: still a way to go.
    odd = torch.tensor([[0, 0, 1.0], [1, 0, 0], [1, 0, -1e-9], [0, 0, -1]], dtype=torch.float64)
    starts = torch.tensor([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]], dtype=torch.float64)
    near, far = bounds.span(starts, odd)
    assert (near > 0).all() and (far > near).all() and (far <= MAX_FAR).all() and torch.isfinite(near + far).all()


def test_stray_points_do_not_move_it_and_too_few_are_named() -> None:
    scene, _ = floor_scene()
    many = np.tile(scene.points, (10, 1))
    plain = FieldBounds.of(replace(scene, points=many, colors=np.tile(scene.colors, (10, 1))))
    stray = np.concatenate([many, [[0, 0, -1e6]]])
    strayed = FieldBounds.of(replace(scene, points=stray, colors=np.zeros((len(stray), 3), np.uint8)))
    assert strayed.radius_m == pytest.approx(plain.radius_m, rel=0.02) and strayed.low_m == pytest.approx(plain.low_m, abs=0.05)
    few = replace(scene, points=scene.points[:7], colors=scene.colors[:7], observations=np.zeros((0, 2), np.int64))
    with pytest.raises(BadInput, match="has 7 points, a field needs at least 8"):
        FieldBounds.of(few)
    with pytest.raises(BadInput, match="radius nan m"):
        FieldBounds(center=np.zeros(3), radius_m=float("nan"), low_m=0, high_m=1)
    flat = replace(few, points=np.zeros((9, 3)), colors=np.zeros((9, 3), np.uint8))
    assert FieldBounds.of(flat).radius_m > 0
