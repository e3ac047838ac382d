"""Facets of a block: their areas and normals, and what hides them."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.next_flight.facets import facets_of
from radiant_core.survey.heights import HeightMap
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


def test_without_heights_there_are_no_facets() -> None:
    grid = MapGrid(north_west=np.zeros(2), cell=1.0, rows=3, columns=3, epsg=None)
    nothing = HeightMap(grid=grid, heights=np.full((3, 3), np.nan), sigma=np.zeros((3, 3), np.float32), source=np.zeros((3, 3), np.uint8))
    with pytest.raises(BadInput, match="no height"):
        facets_of(nothing)
