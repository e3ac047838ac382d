"""Thinned clouds: spread evenly while a view moves, complete in what can be seen at rest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import pyvista as pv

from radiant_core.errors import BadInput
from radiant_viewer.layers.detail import MOVING_POINTS, even_subset, is_thinned, moving_note, visible_subset
from radiant_viewer.layers.drawing import add_layer
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.point_detail import REST_S, PointDetail
from radiant_viewer.pictures.offscreen import draw_map, draw_view, egl_rendering


def ground_with_a_dense_spot(count: int, seed: int = 0) -> np.ndarray:
    """Nine tenths of the points on a thousandth of the ground."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([0, 0, 0], [100, 100, 1], (count, 3))
    points[: count * 9 // 10, :2] = rng.uniform(10, 13.2, (count * 9 // 10, 2))
    return points


def test_a_moving_cloud_keeps_sparse_ground_beside_a_dense_spot() -> None:
    points = ground_with_a_dense_spot(40_000)
    kept = points[even_subset(points, 2000)]
    assert 1900 <= len(kept) <= 2000
    squares = {tuple(cell) for cell in (points[:, :2] // 5).astype(int)}
    shown = {tuple(cell) for cell in (kept[:, :2] // 5).astype(int)}
    # All 400 squares of the ground hold a point; taking every 20th point would leave 235 of 400
    # without one.
    assert len(squares) == 400
    assert len(shown) == 400
    every = {tuple(cell) for cell in (points[::20, :2] // 5).astype(int)}
    assert len(every) < 250


def test_thinning_is_the_same_every_time_and_whole_where_all_fits() -> None:
    points = ground_with_a_dense_spot(5000)
    first, second = even_subset(points, 700), even_subset(points.copy(), 700)
    assert np.array_equal(first, second)
    assert (np.diff(first) > 0).all()
    assert np.array_equal(even_subset(points, 5000), np.arange(5000))


def test_thinning_bears_strays_equal_points_and_map_coordinates_and_refuses_poison() -> None:
    points = ground_with_a_dense_spot(6000)
    # The octree's cells move by a rounding, so single points differ; the number and the spread do
    # not.
    moved = even_subset(points + np.array([500_000.0, 5_400_000.0, 0]), 900)
    assert 850 <= len(moved) <= 900
    assert len({tuple(cell) for cell in (points[moved, :2] // 10).astype(int)}) == 100
    points[0] = (1e7, -1e7, 1e5)
    assert 0 in even_subset(points, 900)
    # A stray 1e7 m off leaves cells of 305 m: the rest is spread along the curve, and no limit is
    # broken.
    assert len(even_subset(points, 900)) <= 900
    assert len(even_subset(np.ones((50, 3)), 7)) == 7
    assert even_subset(np.zeros((0, 3)), 5).tolist() == []
    with pytest.raises(BadInput, match="finite"):
        even_subset(np.array([[0.0, np.nan, 0.0], [0, 0, 0]]), 1)
    with pytest.raises(BadInput, match="0 points"):
        even_subset(points, 0)


def nearest_by_loop(points: np.ndarray, matrix: np.ndarray, size_wh: tuple[int, int], cell_px: float) -> list[int]:
    best: dict[tuple[int, int], tuple[float, int]] = {}
    for index, point in enumerate(points.astype(np.float32)):
        x, y, z, w = (np.append(point, np.float32(1)) @ matrix.astype(np.float32).T).tolist()
        if w <= 0:
            continue
        cell = (int((x / w + 1) / 2 * size_wh[0] // cell_px), int((y / w + 1) / 2 * size_wh[1] // cell_px))
        if abs(x) < w and abs(y) < w and (z / w, index) < best.get(cell, (np.inf, 0)):
            best[cell] = (z / w, index)
    return sorted(index for _, index in best.values())


@pytest.mark.parametrize("perspective", [True, False])
def test_at_rest_the_nearest_point_of_every_cell_stays(perspective: bool) -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform([-3, -3, -6], [3, 3, 2], (3000, 3)).astype(np.float32)
    last = [0, 0, -1, 0] if perspective else [0, 0, 0, 4]
    matrix = np.array([[1.7, 0, 0, 0.1], [0, 2.1, 0, -0.2], [0, 0, -1.01, -0.2], last])
    kept = visible_subset(points, matrix, (60, 40), 2.5)
    twin = nearest_by_loop(points, matrix, (60, 40), 2.5)
    # 1 %: a point on the border of two cells falls into either, float32 against float64.
    assert len(set(kept.tolist()) ^ set(twin)) <= 0.01 * len(twin)
    assert len(kept) > 200
    assert visible_subset(np.zeros((0, 3), np.float32), matrix, (60, 40), 2.5).tolist() == []
    with pytest.raises(BadInput, match="cells of 0"):
        visible_subset(points, matrix, (60, 40), 0)


def test_a_picture_at_rest_is_that_of_all_points(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    count = 60_000
    points = np.column_stack([rng.uniform(-60, 60, count), rng.uniform(-40, 40, count), rng.uniform(0, 9, count)])
    shades = np.clip(128 + 90 * np.sin(points / 7), 0, 255).astype(np.uint8)
    shift = np.array([500_000.0, 5_400_000.0, 0])
    layers, moved = ([Layer(name="ground", points=points + by, point_colors=shades, point_size_px=2)] for by in (0 * shift, shift))
    for draw in (draw_map, draw_view):
        whole = draw(layers, (160, 100)).image
        with monkeypatch.context() as patch:
            patch.setattr("radiant_viewer.layers.point_detail.WHOLE_POINTS", 1000)
            thinned, far = draw(layers, (160, 100)).image, draw(moved, (160, 100)).image
        # 3 levels on average: of two points in one cell the farther one may have peeped out beside
        # the nearer. A map drew the last instead of the highest of all, whose shades differ by
        # their height alone.
        limit = 12 if draw is draw_map else 3
        assert np.abs(whole.astype(int) - thinned).mean() < limit
        # At UTM coordinates the same picture: no jitter.
        assert np.abs(far.astype(int) - thinned).mean() < 0.5


def test_a_view_that_moves_shows_few_points_and_all_when_it_rests() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-50, 50, (120_000, 3))
    layer = Layer(name="cloud", points=points, point_colors=np.full((120_000, 3), 90, np.uint8))
    assert is_thinned(layer)
    assert moving_note(layer) == "at most 50,000 while the view moves"
    waiting: list[tuple[float, Callable[[], None]]] = []
    with egl_rendering():
        plotter = pv.Plotter(off_screen=True, window_size=[160, 120])
    detail = PointDetail(plotter, later=lambda seconds, call: waiting.append((seconds, call)))
    (actor,) = add_layer(plotter, layer, np.zeros(3), detail=detail)
    assert actor.GetBounds() == pytest.approx(np.column_stack([points.min(axis=0), points.max(axis=0)]).ravel(), rel=1e-5)
    plotter.camera_position = "iso"
    plotter.show(auto_close=False, interactive=False)

    def drawn() -> int:
        plotter.render()
        return actor.mapper.GetInput().GetNumberOfPoints() - 6

    assert drawn() == MOVING_POINTS
    assert detail.is_moving
    seconds, rest = waiting[-1]
    assert seconds == REST_S
    rest()
    assert drawn() == 120_000
    plotter.camera.azimuth += 20
    assert drawn() == MOVING_POINTS
    rest()
    assert drawn() == MOVING_POINTS, "a rest that was overtaken by a move took effect"
    detail.refine()
    assert drawn() == 120_000
    actor.SetVisibility(False)
    plotter.camera.azimuth += 20
    plotter.render()
    actor.SetVisibility(True)
    plotter.close()
