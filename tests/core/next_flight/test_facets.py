"""Facets of a block: their areas and normals, and what hides them."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.next_flight.facets import LIFT_CELLS, TOLERANCE_CELLS, Facets, facets_of
from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import MEASURED, UNKNOWN, HeightMap
from radiant_core.survey.map_grid import MapGrid
from tests.core.next_flight.block import HEIGHT, SIDE, block_facets


def test_walls_have_the_area_of_the_block_and_look_outwards() -> None:
    facets = block_facets()
    # The median of 3 × 3 cells rounds the four corners of the block by a cell each: the way around
    # it stays as long.
    assert facets.areas[facets.is_wall].sum() == pytest.approx(4 * SIDE * HEIGHT)
    assert facets.areas[~facets.is_wall].sum() == pytest.approx(1600.0)
    away = facets.places[facets.is_wall, :2]
    outward = (away * facets.normals[facets.is_wall, :2]).sum(axis=1)
    assert (outward > 0).all()
    assert np.allclose(np.linalg.norm(facets.normals, axis=1), 1)
    # The cell that a wall faces is the lower one.
    heights = facets.surface.heights[tuple(facets.cells[facets.is_wall].T)]
    assert (heights == 0).all()


@pytest.mark.parametrize("eye", [(30.0, 3.0, 6.0), (-12.0, 31.0, 20.0), (2.0, -25.0, 15.0), (0.5, 0.5, 40.0)])
def test_a_block_hides_what_a_ray_through_it_says(eye: tuple[float, float, float]) -> None:
    facets = block_facets(0.5)
    rows = np.arange(len(facets))
    seen = facets.seen_from(np.array(eye), rows)
    # The slow twin: the slab test of the box against the segment from facet to eye.
    start = facets.places + 0.05 * facets.normals
    ahead = np.array(eye) - start
    low, high = np.array([-SIDE / 2, -SIDE / 2, 0.0]), np.array([SIDE / 2, SIDE / 2, HEIGHT])
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(low - start) / ahead, (high - start) / ahead])
    near, far = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
    expected = ~((near < far) & (far > 0) & (near < 1))
    faced = ((np.array(eye) - facets.places) * facets.normals).sum(axis=1) > 0
    # Steps of a cell graze edges within a cell: a facet in twenty lies there.
    assert (seen == expected)[faced].mean() > 0.95
    assert 0 < expected[faced].mean() <= 1


@pytest.mark.parametrize("eye", [(31.0, 3.0, 9.0), (-2.0, -3.0, 7.0), (10.3, 17.1, 90.0), (-300.0, 40.0, 12.0)])
def test_rays_followed_together_say_what_each_alone_says(eye: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(5)
    grid = MapGrid(north_west=np.array([-12.0, 15.0]), cell=0.7, rows=43, columns=35, epsg=None)
    towers = np.where(rng.random((15, 12)) < 0.2, rng.uniform(2, 9, (15, 12)), 0.0)
    heights = np.kron(towers, np.ones((3, 3)))[: grid.rows, : grid.columns] + rng.uniform(0, 0.3, grid.shape)
    source = np.full(grid.shape, MEASURED, np.uint8)
    source[5:12, 20:28] = UNKNOWN
    facets = facets_of(HeightMap(grid=grid, heights=heights, sigma=np.ones(grid.shape, np.float32), source=source))
    rows = rng.permutation(len(facets))[:700]
    seen = facets.seen_from(np.array(eye), rows)
    assert seen.tolist() == [_seen_alone(facets, np.array(eye), row) for row in rows.tolist()]
    assert 35 < seen.sum() < 665
    assert facets.seen_from(np.array(eye), rows[:0]).shape == (0,)


def _seen_alone(facets: Facets, eye: FloatArray, row: int) -> bool:
    """One ray, from cell to cell."""
    grid, heights = facets.surface.grid, facets.surface.heights
    at = facets.places[row] + LIFT_CELLS * grid.cell * facets.normals[row]
    ahead = eye - at
    level = np.hypot(*ahead[:2])
    step = ahead / level * grid.cell
    for _ in range(int(level / grid.cell)):
        at = at + step
        line, column = np.floor(grid.cells_of(at[None, :2])[0]).astype(int)
        if 0 <= line < grid.rows and 0 <= column < grid.columns and heights[line, column] > at[2] + TOLERANCE_CELLS * grid.cell:
            return False
    return True


def test_without_heights_there_are_no_facets() -> None:
    grid = MapGrid(north_west=np.zeros(2), cell=1.0, rows=3, columns=3, epsg=None)
    nothing = HeightMap(grid=grid, heights=np.full((3, 3), np.nan), sigma=np.zeros((3, 3), np.float32), source=np.zeros((3, 3), np.uint8))
    with pytest.raises(BadInput, match="no height"):
        facets_of(nothing)
