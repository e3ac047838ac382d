"""Cells partition the outline, agree with `assign`, and move as the weights say."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.regions.power_diagram import assign, bounds, cell_polygons, clip_polygon, polygon_area_m2, rectangle
from tests.seeds import for_seeds

OUTLINE = rectangle(np.array([0.0, 0.0]), np.array([500.0, 250.0]))
# Clipping rounds corners by about 1e-13 m; times 500 m of border and a few borders.
AREA_TOLERANCE_M2 = 1e-8


def random_diagram(seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    num_sites = int(rng.integers(1, 20))
    return rng.random((num_sites, 2)) * [600.0, 300.0] - 50.0, rng.normal(size=num_sites) * 4000.0


def is_convex_counter_clockwise(polygon: FloatArray) -> bool:
    sides = np.roll(polygon, -1, axis=0) - polygon
    following = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * following[:, 1] - sides[:, 1] * following[:, 0]
    return bool((turns >= -AREA_TOLERANCE_M2).all())


@for_seeds(30)
def test_cells_cover_the_outline_without_overlap(seed: int) -> None:
    sites, weights = random_diagram(seed)
    cells = cell_polygons(sites, weights, OUTLINE)
    assert all(is_convex_counter_clockwise(cell) for cell in cells if len(cell))
    assert sum(polygon_area_m2(cell) for cell in cells) == pytest.approx(500 * 250, abs=AREA_TOLERANCE_M2)
    whole = shapely.union_all([shapely.Polygon(cell) for cell in cells if len(cell)])
    # Disjoint cells have as much area together as their union.
    assert whole.area == pytest.approx(500 * 250, abs=1e-6)


@for_seeds(30)
def test_points_lie_in_the_polygon_of_their_cell(seed: int) -> None:
    sites, weights = random_diagram(seed)
    points = np.random.default_rng(seed).random((300, 2)) * [500.0, 250.0]
    cells = cell_polygons(sites, weights, OUTLINE)
    for point, owner in zip(points, assign(points, sites, weights), strict=True):
        assert shapely.Polygon(cells[owner]).distance(shapely.Point(point)) < 1e-9  # metres


@for_seeds(10)
def test_utm_coordinates_give_the_same_cells_to_a_micrometre(seed: int) -> None:
    sites, weights = random_diagram(seed)
    utm_m = np.array([500_000.0, 9_999_000.0])
    cells, moved_cells = cell_polygons(sites, weights, OUTLINE), cell_polygons(sites + utm_m, weights, OUTLINE + utm_m)
    for cell, moved in zip(cells, moved_cells, strict=True):
        assert cell.shape == moved.shape
        np.testing.assert_allclose(moved - utm_m, cell, atol=1e-6)


def test_a_weight_moves_the_border_by_half_its_share_of_the_distance() -> None:
    sites = np.array([[100.0, 125.0], [350.0, 125.0]])
    border_m = [cell_polygons(sites, [weight, 0.0], OUTLINE)[0][:, 0].max() for weight in (0.0, 5000.0)]
    assert border_m[0] == pytest.approx(225.0, abs=1e-9)
    assert border_m[1] - border_m[0] == pytest.approx(5000.0 / (2 * 250.0), abs=1e-9)


def test_of_sites_at_one_spot_the_heaviest_then_the_first_has_the_cell() -> None:
    sites = np.array([[100.0, 100.0], [100.0, 100.0], [100.0, 100.0], [400.0, 100.0]])
    for weights, owner in (([0.0, 0.0, 0.0, 0.0], 0), ([0.0, 5.0, 5.0, 0.0], 1)):
        cells = cell_polygons(sites, weights, OUTLINE)
        assert [len(cell) > 0 for cell in cells] == [index in (owner, 3) for index in range(4)]
        assert sum(polygon_area_m2(cell) for cell in cells) == pytest.approx(500 * 250, abs=AREA_TOLERANCE_M2)


def test_a_site_without_weight_enough_has_an_empty_cell() -> None:
    cells = cell_polygons([[100.0, 100.0], [110.0, 100.0]], [0.0, -1e6], OUTLINE)
    assert cells[1].shape == (0, 2)
    assert polygon_area_m2(cells[0]) == pytest.approx(500 * 250, abs=AREA_TOLERANCE_M2)


def test_both_sides_of_a_cut_make_the_whole() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        normal, offset = rng.normal(size=2), float(rng.normal() * 300.0)
        sides = clip_polygon(OUTLINE, normal, offset), clip_polygon(OUTLINE, -normal, -offset)
        assert sum(polygon_area_m2(side) for side in sides) == pytest.approx(500 * 250, abs=AREA_TOLERANCE_M2)


def test_a_cut_along_a_side_keeps_all_or_nothing() -> None:
    assert polygon_area_m2(clip_polygon(OUTLINE, np.array([1.0, 0.0]), 500.0)) == 500 * 250
    assert clip_polygon(OUTLINE, np.array([1.0, 0.0]), 0.0).shape == (0, 2)


@pytest.mark.parametrize(("sites", "weights"), [([[np.nan, 0.0]], [0.0]), ([[0.0, 0.0]], [np.inf]), ([[0.0, 0.0]], [0.0, 1.0])])
def test_poisoned_sites_and_weights_are_refused(sites: list, weights: list) -> None:
    with pytest.raises(BadInput):
        cell_polygons(sites, weights, OUTLINE)


@for_seeds(20)
def test_a_cut_polygon_is_what_shapely_cuts(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 7))
    polygon = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    normal, offset = rng.normal(size=2), float(rng.normal() * 0.5)
    along = np.array([-normal[1], normal[0]])
    foot = normal * offset / (normal @ normal)
    half = shapely.Polygon([foot + 9 * along, foot - 9 * along, foot - 9 * along - 9 * normal, foot + 9 * along - 9 * normal])
    expected = shapely.Polygon(polygon).intersection(half)
    cut = clip_polygon(polygon, normal, offset)
    assert (expected.area < 1e-9) if not len(cut) else shapely.Polygon(cut).symmetric_difference(expected).area < 1e-9
    assert polygon_area_m2(polygon) == pytest.approx(shapely.Polygon(polygon).area) == pytest.approx(-polygon_area_m2(polygon[::-1]))


def test_a_cut_through_a_corner_and_figures_without_area() -> None:
    square = np.array([[0.0, 0.0], [2, 0], [2, 2], [0, 2]])
    np.testing.assert_array_equal(clip_polygon(square, np.array([1.0, 1.0]), 2.0), [[0, 0], [2, 0], [0, 2]])
    assert clip_polygon(square, np.array([1.0, 1.0]), 0.0).shape == (0, 2)
    assert polygon_area_m2(square[:2]) == polygon_area_m2(square[:0]) == 0.0 and polygon_area_m2(square[:3]) == 2.0
    low, high = bounds(np.array([[3.0, -1], [2, 5], [9, 0]]))
    assert (low.tolist(), high.tolist()) == ([2, -1], [9, 5])
    np.testing.assert_array_equal(rectangle(low, high), [[2, -1], [9, -1], [9, 5], [2, 5]])
