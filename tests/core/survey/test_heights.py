"""Rasters of heights from points with strays and walls, fills that say so, terrain, contours, and what other programs read of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import open3d as o3d
import pytest
import trimesh

from radiant_core.errors import BadInput
from radiant_core.export.mesh_glb import save_glb
from radiant_core.export.point_cloud import GROUND, save_laz
from radiant_core.frames import Frame
from radiant_core.survey.geojson import coordinates_of, polygon_feature
from radiant_core.survey.height_mesh import height_mesh
from radiant_core.survey.heights import FILLED, MEASURED, UNKNOWN, HeightMap, filled, height_map, push_pull
from radiant_core.survey.map_grid import MapGrid, map_frame_of
from radiant_core.survey.terrain import contours, terrain

GRID = MapGrid(north_west=np.array([500_000.0, 5_200_060.0]), cell=0.5, rows=120, columns=160, epsg=32632)
GSD = 0.25


def hill(places: np.ndarray) -> np.ndarray:
    return 400 + 3 * np.sin((places[:, 0] - 500_000) / 15) + 0.05 * (places[:, 1] - 5_200_000)


def house(places: np.ndarray) -> np.ndarray:
    x, y = places[:, 0] - 500_000, places[:, 1] - 5_200_000
    return (np.abs(x - 40) < 5) & (np.abs(y - 30) < 4)


def sampled(count: int = 120_000, noise: float = 0.05, strays: float = 0.02) -> np.ndarray:
    """Points of a hill with a house of 7 m, noisy, some far above and below."""
    rng = np.random.default_rng(0)
    places = np.array([500_000.0, 5_200_000.0]) + rng.uniform(0, 1, (count, 2)) * [80, 60]
    heights = hill(places) + 7 * house(places) + rng.normal(0, noise, count)
    wrong = rng.random(count) < strays
    heights[wrong] += rng.uniform(-20, 20, wrong.sum())
    return np.column_stack([places, heights])


def middles() -> np.ndarray:
    east, north = np.meshgrid(*GRID.centers())
    return np.column_stack([east.ravel(), north.ravel()])


def test_heights_are_those_of_the_topmost_surface_whatever_strays() -> None:
    found = height_map(sampled(), GRID, GSD)
    truth = (hill(middles()) + 7 * house(middles())).reshape(GRID.shape)
    errors = np.abs(found.heights - truth)[found.source == MEASURED]
    assert found.measured > 0.98 and np.median(errors) < 0.05 and np.quantile(errors, 0.95) < 0.3
    # Nine of ten errors within two σ: noise alone, without what neighbours share, is far below it.
    within = errors < 2 * found.sigma[found.source == MEASURED]
    assert within.mean() > 0.9


def test_the_order_of_points_changes_nothing_and_a_shift_moves_the_raster() -> None:
    points = sampled(20_000)
    one = height_map(points, GRID, GSD)
    other = height_map(points[np.random.default_rng(1).permutation(len(points))], GRID, GSD)
    np.testing.assert_allclose(one.heights, other.heights, rtol=0, atol=1e-9)
    higher = height_map(points + np.array([0, 0, 100.0]), GRID, GSD)
    # 1e-9: sums of heights about the top of their cell, not of 400 m.
    np.testing.assert_allclose(higher.heights, one.heights + 100, rtol=0, atol=1e-9)


def test_many_cells_are_sorted_as_few_are() -> None:
    """Cells that 16 bits count, and a grid of more with the same land in it."""
    points = sampled(20_000)
    wide = MapGrid(north_west=GRID.north_west, cell=GRID.cell, rows=400, columns=400, epsg=32632)
    few, many = height_map(points, GRID, GSD), height_map(points, wide, GSD)
    np.testing.assert_array_equal(many.source[:120, :160], few.source)
    np.testing.assert_allclose(many.heights[:120, :160], few.heights, rtol=0, atol=1e-9)


def test_a_fill_is_marked_less_certain_and_never_reaches_far() -> None:
    points = sampled(strays=0)
    hole = (np.abs(points[:, 0] - 500_020) < 5) & (np.abs(points[:, 1] - 5_200_030) < 5)
    gone = points[:, 0] > 500_060
    found = height_map(points[~hole & ~gone], GRID, GSD)
    closed = filled(found, None, 12)
    np.testing.assert_array_equal(closed.heights[found.source == MEASURED], found.heights[found.source == MEASURED])
    inside = ((np.abs(middles()[:, 0] - 500_020) < 4.5) & (np.abs(middles()[:, 1] - 5_200_030) < 4.5)).reshape(GRID.shape)
    assert (closed.source[inside] == FILLED).all() and np.median(closed.sigma[inside]) > 2 * np.median(
        found.sigma[found.source == MEASURED]
    )
    # A hole of 10 m on a wave of 15 m radius: half of its height.
    assert np.abs(closed.heights - hill(middles()).reshape(GRID.shape))[inside].max() < 1.5
    assert (closed.source[:, 140:] == UNKNOWN).all() and (closed.source != UNKNOWN).mean() < 0.85
    kept = filled(found, np.zeros(GRID.shape, bool))
    np.testing.assert_array_equal(kept.source, found.source)


def test_push_and_pull_keeps_what_is_known_and_a_constant() -> None:
    rng = np.random.default_rng(2)
    values, known = rng.normal(size=(37, 53)).astype(np.float32), rng.random((37, 53)) < 0.3
    result = push_pull(values, known)
    np.testing.assert_allclose(result[known], values[known], atol=1e-5)
    assert values[known].min() - 1e-4 <= result.min() and result.max() <= values[known].max() + 1e-4
    np.testing.assert_allclose(push_pull(np.full((9, 5), 2.5, np.float32), known[:9, :5]), 2.5, atol=1e-5)
    assert not push_pull(values, np.zeros_like(known)).any()


def test_what_is_no_cloud_is_refused_and_places_outside_are_unknown() -> None:
    for points in (np.full((5, 3), np.nan), np.full((5, 3), np.inf), np.zeros((5, 2))):
        with pytest.raises(BadInput):
            height_map(points, GRID, GSD)
    for points in (np.zeros((0, 3)), np.full((5, 3), 1e9)):
        with pytest.raises(BadInput, match="agree on no surface"):
            height_map(points, GRID, GSD)
    heights, sigma = height_map(sampled(20_000), GRID, GSD).at(np.array([[0.0, 0.0], [1e9, -1e9]]))
    assert np.isnan(heights).all() and np.isnan(sigma).all()


def test_terrain_leaves_the_house_and_keeps_the_hill() -> None:
    surface = filled(height_map(sampled(), GRID, GSD))
    ground = terrain(surface, GSD)
    inside = house(middles()).reshape(GRID.shape)
    truth = hill(middles()).reshape(GRID.shape)
    assert (ground.source[inside] == FILLED).all()
    assert np.abs(ground.heights - truth)[inside].max() < 1.0
    away = ~inside & (ground.source == MEASURED)
    assert away.mean() > 0.85 and np.quantile(np.abs(ground.heights - truth)[away], 0.99) < 0.3
    nothing = HeightMap(
        grid=GRID, heights=np.full(GRID.shape, np.nan), sigma=np.full(GRID.shape, np.nan, np.float32), source=np.zeros(GRID.shape, np.uint8)
    )
    with pytest.raises(BadInput, match="no terrain"):
        terrain(nothing, GSD)
    assert contours(nothing, 1.0) == [] and not len(height_mesh(nothing, np.zeros(3)).triangles)


def cone() -> HeightMap:
    away = np.linalg.norm(middles() - [500_040, 5_200_030], axis=1).reshape(GRID.shape)
    return HeightMap(grid=GRID, heights=500 - away / 2, sigma=np.full(GRID.shape, 0.1, np.float32), source=np.ones(GRID.shape, np.uint8))


def test_contours_of_a_cone_are_circles_at_whole_heights() -> None:
    lines = contours(cone(), 2.0)
    assert {line.height for line in lines} <= {470.0 + 2 * k for k in range(16)} and len(lines) >= 10
    for line in lines:
        radius = np.linalg.norm(line.line - [500_040, 5_200_030], axis=1)
        # Between middles of cells 0.5 m apart a circle is off by its sagitta.
        assert np.abs(radius - 2 * (500 - line.height)).max() < 0.1
    with pytest.raises(BadInput, match="levels"):
        contours(cone(), 1e-3)
    for interval in (0.0, -1.0, np.nan):
        with pytest.raises(BadInput, match="above zero"):
            contours(cone(), interval)


def test_laspy_reads_points_colours_classes_and_the_system(tmp_path: Path) -> None:
    points = sampled(5_000)
    colors = np.random.default_rng(3).integers(0, 256, (len(points), 3)).astype(np.uint8)
    ground = ~house(points)
    save_laz(tmp_path / "a.laz", points, colors, ground, 32632)
    read: Any = laspy.read(tmp_path / "a.laz")
    # Half of the step of a millimetre.
    assert np.abs(np.column_stack([np.asarray(read[axis]) for axis in ("x", "y", "z")]) - points).max() <= 0.0005 + 1e-9
    np.testing.assert_array_equal(np.column_stack([np.asarray(read[channel]) for channel in ("red", "green", "blue")]) // 257, colors)
    np.testing.assert_array_equal(np.asarray(read.classification) == GROUND, ground)
    keys = getattr(read.header.vlrs.get("GeoKeyDirectoryVlr")[0], "geo_keys")  # noqa: B009, laspy types its records too widely
    assert 32632 in {key.value_offset for key in keys} and 4096 not in {key.id for key in keys}
    save_laz(tmp_path / "a.laz", points, colors, ground, 25832, 7837)
    keys = getattr(laspy.read(tmp_path / "a.laz").header.vlrs.get("GeoKeyDirectoryVlr")[0], "geo_keys")  # noqa: B009
    # Map, metres, DHHN2016, metres.
    assert {key.id: key.value_offset for key in keys} == {1024: 1, 3072: 25832, 3076: 9001, 4096: 7837, 4099: 9001}
    with pytest.raises(BadInput, match="no points"):
        save_laz(tmp_path / "b.laz", np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros(0, bool), None)
    with pytest.raises(BadInput, match="2,000 km"):
        save_laz(tmp_path / "b.laz", np.array([[0.0, 0, 0], [1e7, 0, 0]]), np.zeros((2, 3), np.uint8), np.zeros(2, bool), None)
    assert [path.name for path in tmp_path.iterdir()] == ["a.laz"]


def test_open3d_and_trimesh_read_the_textured_mesh(tmp_path: Path) -> None:
    surface = cone()
    offset = np.array([500_000.0, 5_200_000, 0])
    mesh = height_mesh(surface, offset, max_vertices=2_000)
    first = offset + mesh.vertices[0]
    np.testing.assert_allclose(first[2], surface.at(first[None, :2])[0][0], atol=1e-9)
    assert mesh.step == 4 and len(mesh.vertices) <= 2_000
    corners = mesh.vertices[mesh.triangles]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all(), "seen from above"
    picture = np.zeros((60, 80, 3), np.uint8)
    picture[:30] = [255, 0, 0]
    save_glb(tmp_path / "a.glb", mesh.vertices, mesh.triangles, mesh.uv, picture, {"crs": "EPSG:32632"})
    read = o3d.io.read_triangle_mesh(str(tmp_path / "a.glb"))
    assert len(read.triangles) == len(mesh.triangles) and read.has_triangle_uvs()
    # y is up.
    assert np.asarray(read.vertices)[:, 1].max() == pytest.approx(mesh.vertices[:, 2].max(), abs=1e-4)
    scene = trimesh.load(tmp_path / "a.glb")
    geometry = next(iter(scene.geometry.values()))  # pyright: ignore[reportAttributeAccessIssue]
    texture = np.asarray(geometry.visual.material.baseColorTexture)
    north = geometry.vertices[:, 2] < np.median(geometry.vertices[:, 2]) - 10
    v = geometry.visual.uv[north, 1]
    assert texture.shape[:2] == (60, 80) and (v > 0.5).all() and texture[0, 0, 0] > 200, "the north of the picture is its top"
    with pytest.raises(BadInput, match="no triangle"):
        save_glb(tmp_path / "b.glb", mesh.vertices, mesh.triangles[:0], mesh.uv, picture, {})


def test_geojson_is_longitude_and_latitude_where_the_map_is_on_the_globe() -> None:
    map_frame = map_frame_of(Frame(kind="metric", origin_lat_lon_alt=np.array([46.9, 9.0, 400.0])))
    at = coordinates_of(map_frame, map_frame.from_world(np.zeros((1, 3))))[0]
    assert at == pytest.approx([9.0, 46.9, 400.0], abs=1e-8)
    ring = polygon_feature(map_frame, np.array([[500_000, 5_200_000], [500_000, 5_200_010], [500_010, 5_200_010.0]]), {})
    corners = np.array(ring["geometry"]["coordinates"][0])
    assert (corners[0] == corners[-1]).all()
    x, y = (corners - corners[0]).T
    assert np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) > 0, "counter-clockwise, whatever way it was given"
