"""Where a look meets the surface, against geometry by hand."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.survey.heights import MEASURED, HeightMap
from radiant_core.survey.map_grid import MapGrid
from radiant_core.survey.sight import first_hit

CELL = 0.25


def surface(heights: np.ndarray) -> HeightMap:
    """A raster from north-west (0, 20) on."""
    grid = MapGrid(north_west=np.array([0.0, 20.0]), cell=CELL, rows=80, columns=80, epsg=None)
    sigma = np.where(np.isfinite(heights), 0.05, np.nan).astype(np.float32)
    return HeightMap(grid=grid, heights=heights, sigma=sigma, source=np.where(np.isfinite(heights), MEASURED, 0).astype(np.uint8))


def house() -> HeightMap:
    """Flat ground at 2 and a box of height 6 over it, 8 to 12 east and north."""
    east, north = np.meshgrid((np.arange(80) + 0.5) * CELL, 20 - (np.arange(80) + 0.5) * CELL)
    return surface(np.where((abs(east - 10) < 2) & (abs(north - 10) < 2), 8.0, 2.0))


def test_looks_meet_ground_roof_and_wall() -> None:
    eye = np.array([10.0, -10.0, 14.0])
    # The ray falls by 12 over 12 m: it is at 2 where north is 2.
    np.testing.assert_allclose(first_hit(house(), eye, np.array([10.0, -4, 8])), [10, 2, 2], atol=1e-5)
    # By 6 over 20 m: the roof's middle; what was clicked may be haze on the way.
    np.testing.assert_allclose(first_hit(house(), eye, np.array([10.0, -5, 12.5])), [10, 10, 8], atol=1e-5)
    # By 9 over 18 m: at 5 where the wall stands, north 8.
    np.testing.assert_allclose(first_hit(house(), eye, np.array([10.0, 0, 9])), [10, 8, 5], atol=1e-5)
    np.testing.assert_allclose(first_hit(house(), np.array([10.0, 10, 50]), np.array([10.0, 10, 40])), [10, 10, 8], atol=1e-5)


def test_looks_that_meet_nothing_say_so() -> None:
    eye = np.array([10.0, -10.0, 14.0])
    assert np.isnan(first_hit(house(), eye, np.array([10.0, -9, 14.1]))).all(), "into the sky"
    assert np.isnan(first_hit(house(), eye, np.array([10.0, -11, 13]))).all(), "away from it"
    assert np.isnan(first_hit(house(), np.array([10.0, 10, 4]), np.array([10.0, 11, 4]))).all(), "from inside of the house"
    assert np.isnan(first_hit(house(), np.array([10.0, -1, 5]), np.array([10.0, -1, 0]))).all(), "beside the raster"
    assert np.isnan(first_hit(surface(np.full((80, 80), np.nan)), eye, np.array([10.0, -9, 13]))).all()


def test_cells_that_are_not_known_are_looked_through() -> None:
    heights = house().heights.copy()
    heights[heights > 2] = np.nan
    eye, open_ground = np.array([10.0, -10, 14]), surface(heights)
    # The roof is unknown: behind it the ray, which falls by 12 over 23 m, meets the ground.
    np.testing.assert_allclose(first_hit(open_ground, eye, np.array([10.0, 13, 2])), [10, 13, 2], atol=1e-5)
    assert np.isnan(first_hit(open_ground, eye, np.array([10.0, 10, 2]))).all(), "what is under the roof is not known"


@pytest.mark.parametrize("seed", range(3))
def test_every_hit_lies_on_the_ray_and_on_the_surface(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ground = surface(rng.normal(2, 0.02, (80, 80)))
    for _ in range(20):
        eye, through = np.append(rng.uniform(-30, 50, 2), 20.0), np.append(rng.uniform(1, 19, 2), 2.0)
        hit = first_hit(ground, eye, through)
        assert np.linalg.norm(np.cross(hit - eye, through - eye)) < 1e-6 * np.linalg.norm(through - eye) ** 2
        assert abs(hit[2] - 2) < 0.1  # five σ of the roughness


def test_a_look_without_direction_is_refused() -> None:
    with pytest.raises(BadInput, match="no direction"):
        first_hit(house(), np.ones(3), np.ones(3))
    with pytest.raises(BadInput):
        first_hit(house(), np.array([0, np.nan, 1]), np.ones(3))
