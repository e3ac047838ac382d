"""A GeoTIFF as tifffile's own reader of geographic tags sees it, and a mesh as Open3D does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import tifffile

from radiant_core.errors import BadInput
from radiant_core.io.export.geotiff import NO_DATA, HeightGrid, save_geotiff
from radiant_core.io.export.mesh_ply import save_mesh


def grid(epsg: int | None = 32632) -> HeightGrid:
    heights = np.add.outer(np.linspace(400, 410, 70), np.linspace(0, 5, 90))
    heights[3:9, 5:20] = np.nan
    return HeightGrid(heights=heights, north_west=np.array([465300.5, 5246400.25]), cell=0.25, epsg=epsg)


def test_place_scale_system_and_heights_come_back(tmp_path: Path) -> None:
    save_geotiff(tmp_path / "a.tif", grid())
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage)
        values, tags = page.asarray(), page.geotiff_tags
        assert float(page.tags[42113].value) == NO_DATA
    assert tags is not None and tags["ProjectedCSTypeGeoKey"] == 32632
    assert int(tags["GTRasterTypeGeoKey"]) == 1, "a pixel is an area, its corner is the tie point"
    assert list(tags["ModelPixelScale"])[:2] == [0.25, 0.25]
    assert list(tags["ModelTiepoint"]) == [0, 0, 0, 465300.5, 5246400.25, 0]
    assert values.dtype == np.float32
    known = np.isfinite(grid().heights)
    assert (values[~known] == NO_DATA).all()
    assert np.abs(values[known] - grid().heights[known]).max() < 2e-5
    save_geotiff(tmp_path / "b.tif", grid(None))
    with tifffile.TiffFile(tmp_path / "b.tif") as file:
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage)
        assert page.geotiff_tags is not None and "ProjectedCSTypeGeoKey" not in page.geotiff_tags


def test_a_datum_of_heights_stands_in_the_file(tmp_path: Path) -> None:
    save_geotiff(tmp_path / "a.tif", replace(grid(), vertical_epsg=5773))
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage) and page.geotiff_tags is not None
        assert int(page.geotiff_tags["VerticalCSTypeGeoKey"]) == 5773
        assert int(page.geotiff_tags["VerticalUnitsGeoKey"]) == 9001
        assert page.geotiff_tags["ProjectedCSTypeGeoKey"] == 32632


def test_a_place_finds_its_cell_and_none_outside() -> None:
    rows, columns = np.array([0, 69, 30]), np.array([0, 89, 41])
    places = grid().north_west + np.column_stack([columns + 0.5, -(rows + 0.5)]) * 0.25
    np.testing.assert_array_equal(grid().at(places), grid().heights[rows, columns])
    assert np.isnan(grid().at(places + 1000)).all()
    assert np.isnan(grid().at(grid().north_west[None] + np.array([6 * 0.25, -4 * 0.25]))).all()


@pytest.mark.parametrize(
    ("heights", "cell"), [(np.zeros((0, 3)), 1.0), (np.zeros(4), 1.0), (np.full((2, 2), np.inf), 1.0), (np.zeros((2, 2)), 0.0)]
)
def test_what_is_no_grid_is_refused(heights: np.ndarray, cell: float) -> None:
    with pytest.raises(BadInput, match="expected"):
        HeightGrid(heights=heights, north_west=np.zeros(2), cell=cell, epsg=None)


def test_open3d_reads_the_mesh_as_it_is(tmp_path: Path) -> None:
    vertices = np.array([[465300.123456, 5246400.5, 1], [465301, 5246400, 2], [465300, 5246401, 3.0]])
    colors = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255]])
    save_mesh(tmp_path / "a.ply", vertices, [[0, 1, 2]], colors)
    mesh = o3d.io.read_triangle_mesh(str(tmp_path / "a.ply"))
    np.testing.assert_array_equal(np.asarray(mesh.vertices), vertices)
    np.testing.assert_array_equal(np.asarray(mesh.triangles), [[0, 1, 2]])
    np.testing.assert_array_equal(np.rint(255 * np.asarray(mesh.vertex_colors)), colors)
    with pytest.raises(BadInput, match="vertex 3 of 3"):
        save_mesh(tmp_path / "b.ply", vertices, [[0, 1, 3]], colors)


def test_a_place_on_the_rim_belongs_to_the_cell_east_and_south_of_it() -> None:
    surface = HeightGrid(heights=np.arange(6.0).reshape(2, 3), north_west=np.array([10.0, 50.0]), cell=2.0, epsg=None)
    places = [[10, 50], [9.99, 50], [10, 50.01], [15.99, 50], [16, 50], [10, 46.01], [10, 46], [12, 48]]
    np.testing.assert_array_equal(surface.at(np.array(places)), [0, np.nan, np.nan, 2, np.nan, 3, np.nan, 4])
    assert surface.known == 1 and grid().known == pytest.approx(1 - 6 * 15 / 6300)


def test_the_tags_are_those_of_the_standard(tmp_path: Path) -> None:
    """OGC 19-008: GeoKeyDirectory version 1.1.0, then key, place 0, one value; model type 1
    projected or 32767 its own, metres 9001."""
    for epsg, keys in ((32632, [1, 1, 0, 4, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32632, 3076, 0, 1, 9001]),
                       (None, [1, 1, 0, 2, 1024, 0, 1, 32767, 1025, 0, 1, 1])):  # fmt: skip
        save_geotiff(tmp_path / "a.tif", grid(epsg))
        with tifffile.TiffFile(tmp_path / "a.tif") as file:
            page = file.pages[0]
            assert isinstance(page, tifffile.TiffPage)
            assert list(page.tags[34735].value) == keys and page.tags[34735].dtype == tifffile.DATATYPE.SHORT
            assert page.tags[33550].value == (0.25, 0.25, 0) and page.tags[33922].value == (0, 0, 0, 465300.5, 5246400.25, 0)
            assert page.tags[42113].value == "-9999" and page.asarray()[3, 5] == -9999
            assert page.tags[42113].dtype == tifffile.DATATYPE.ASCII and page.tags[33550].dtype == tifffile.DATATYPE.DOUBLE
            assert (page.compression, page.rowsperstrip, page.photometric) == (8, 64, 1) and page.software.startswith("radiant ")


@pytest.mark.parametrize(
    ("vertices", "triangles", "colors", "told"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], np.zeros((3, 3)), "vertices has shape"),
        (np.zeros((3, 3)), [[0, 1]], np.zeros((3, 3)), "triangles has shape"),
        (np.zeros((3, 3)), [[0, 1, 2]], np.zeros((2, 3)), "colors has shape"),
        (np.zeros((3, 3)), [[-1, 1, 2]], np.zeros((3, 3)), "a triangle names vertex 2 of 3"),
    ],
)
def test_a_mesh_that_does_not_fit_together_is_refused(
    tmp_path: Path, vertices: np.ndarray, triangles: list, colors: np.ndarray, told: str
) -> None:
    with pytest.raises(BadInput, match=told):
        save_mesh(tmp_path / "m.ply", vertices, triangles, colors)


@pytest.mark.parametrize(
    ("north_west", "cell", "told"),
    [
        ((np.nan, 0), 1.0, "cells of 1.0 from"),
        ((0, np.inf), 1.0, "expected finite"),
        ((0, 0), np.nan, "cells of nan"),
        ((0, 0), -1.0, "above zero"),
    ],
)
def test_a_grid_stands_somewhere_and_has_cells(north_west: tuple, cell: float, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        HeightGrid(heights=np.zeros((2, 2)), north_west=np.array(north_west, float), cell=cell, epsg=None)
