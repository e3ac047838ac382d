"""A GeoTIFF as tifffile's own reader of geographic tags sees it, and a mesh as Open3D does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d as o3d
import pyproj
import pytest
import rasterio
import tifffile

from radiant_core.errors import BadInput
from radiant_core.export.geotiff import NO_DATA, TiledRaster, cut_tiles, save_tiles
from radiant_core.export.mesh_ply import save_mesh
from radiant_core.survey.map_grid import MapGrid


def heights() -> np.ndarray:
    values = np.add.outer(np.linspace(400, 410, 70), np.linspace(0, 5, 90)).astype(np.float32)
    values[3:9, 5:20] = NO_DATA
    return values


def save(path: Path, epsg: int | None = 32632, vertical_epsg: int | None = None) -> None:
    """70 × 90 heights with a hole as a GeoTIFF."""
    place = MapGrid(north_west=np.array([465300.5, 5246400.25]), cell=0.25, rows=70, columns=90, epsg=epsg, vertical_epsg=vertical_epsg)
    raster = TiledRaster(place=place, shape=place.shape, bands=("height",), tile_px=32, dtype=np.float32, no_data=NO_DATA)
    save_tiles(path, raster, cut_tiles(heights(), 32, NO_DATA))


def test_place_scale_system_and_heights_come_back(tmp_path: Path) -> None:
    save(tmp_path / "a.tif")
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage)
        values, tags = page.asarray(), page.geotiff_tags
    assert tags is not None and tags["ProjectedCSTypeGeoKey"] == 32632
    assert int(tags["GTRasterTypeGeoKey"]) == 1, "a pixel is an area, its corner is the tie point"
    assert list(tags["ModelPixelScale"])[:2] == [0.25, 0.25]
    assert list(tags["ModelTiepoint"]) == [0, 0, 0, 465300.5, 5246400.25, 0]
    np.testing.assert_array_equal(values, heights())
    save(tmp_path / "b.tif", None)
    with tifffile.TiffFile(tmp_path / "b.tif") as file:
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage)
        assert page.geotiff_tags is not None and "ProjectedCSTypeGeoKey" not in page.geotiff_tags


@pytest.mark.parametrize(("epsg", "vertical_epsg"), [(25832, 7837), (2056, 5728), (32632, 5773)])
def test_rasterio_reads_the_map_and_the_datum_of_its_heights(tmp_path: Path, epsg: int, vertical_epsg: int) -> None:
    save(tmp_path / "a.tif", epsg, vertical_epsg)
    with rasterio.open(tmp_path / "a.tif") as file:
        parts = pyproj.CRS(file.crs.to_wkt()).sub_crs_list
        assert [part.to_epsg() for part in parts] == [epsg, vertical_epsg]
        assert file.nodata == NO_DATA and tuple(file.bounds) == (465300.5, 5246400.25 - 17.5, 465300.5 + 22.5, 5246400.25)


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


def test_the_tags_are_those_of_the_standard(tmp_path: Path) -> None:
    """OGC 19-008: GeoKeyDirectory version 1.1.0, then key, place 0, one value; model type 1
    projected or 32767 its own, metres 9001."""
    for epsg, keys in ((32632, [1, 1, 0, 4, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32632, 3076, 0, 1, 9001]),
                       (None, [1, 1, 0, 2, 1024, 0, 1, 32767, 1025, 0, 1, 1])):  # fmt: skip
        save(tmp_path / "a.tif", epsg)
        with tifffile.TiffFile(tmp_path / "a.tif") as file:
            page = file.pages[0]
            assert isinstance(page, tifffile.TiffPage)
            assert list(page.tags[34735].value) == keys and page.tags[34735].dtype == tifffile.DATATYPE.SHORT
            assert page.tags[33550].value == (0.25, 0.25, 0) and page.tags[33922].value == (0, 0, 0, 465300.5, 5246400.25, 0)
            assert page.tags[42113].value == "-9999" and page.asarray()[3, 5] == -9999
            assert page.tags[42113].dtype == tifffile.DATATYPE.ASCII and page.tags[33550].dtype == tifffile.DATATYPE.DOUBLE
            assert (page.compression, page.tilewidth, page.photometric) == (8, 32, 1) and page.software.startswith("radiant ")


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
