"""GeoTIFFs as Cloud-Optimised ones: the order that GDAL's validator asks for, and overviews as GDAL reads them."""

from __future__ import annotations

import struct
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import rasterio
import tifffile

from radiant_core.export import geotiff
from radiant_core.export.geotiff import NO_DATA, TiledRaster, cut_tiles, halved, save_tiles
from radiant_core.survey.map_grid import MapGrid

ROWS, COLUMNS, TILE = 150, 201, 32


def raster(bands: tuple[str, ...], **about: object) -> TiledRaster:
    grid = MapGrid(north_west=np.array([465300.5, 5246400.25]), cell=0.25, rows=ROWS, columns=COLUMNS, epsg=32632, vertical_epsg=None)
    return TiledRaster(place=grid, shape=grid.shape, bands=bands, tile_px=TILE, **about)  # pyright: ignore[reportArgumentType]


def heights() -> np.ndarray:
    """A slope with a wall of 20 m, a hole, a standard deviation and a class."""
    values = np.zeros((ROWS, COLUMNS, 3), np.float32)
    values[..., 0] = 400 + 0.01 * np.arange(COLUMNS) + np.where(np.arange(ROWS) > 70, 20, 0)[:, None]
    values[..., 1] = 0.05
    values[..., 2] = np.where(np.arange(COLUMNS) > 100, 2, 1)
    values[10:40, 20:61] = NO_DATA
    return values


def save_heights(path: Path) -> None:
    with_classes = raster(("height", "standard deviation", "class"), dtype=np.float32, no_data=NO_DATA, classes=(2,))
    save_tiles(path, with_classes, cut_tiles(heights(), TILE, NO_DATA))


def directories(path: Path) -> list[tuple[int, dict[int, list[int]]]]:
    """Place and tags of each directory, by a reader of bytes: the layout of TIFF 6.0 and BigTIFF, whole numbers alone."""
    data = path.read_bytes()
    big = struct.unpack_from("<H", data, 2)[0] == 43
    (at,) = struct.unpack_from("<Q", data, 8) if big else struct.unpack_from("<I", data, 4)
    listed = []
    while at:
        (count,) = struct.unpack_from("<Q" if big else "<H", data, at)
        row, first = (20, at + 8) if big else (12, at + 2)
        tags = {}
        for place in range(first, first + count * row, row):
            code, kind, number = struct.unpack_from("<HHQ" if big else "<HHI", data, place)
            if kind not in (3, 4, 16):
                continue
            form = f"<{number}{({3: 'H', 4: 'I', 16: 'Q'})[kind]}"
            value_at = place + row - (8 if big else 4)
            if struct.calcsize(form) > (8 if big else 4):
                (value_at,) = struct.unpack_from("<Q" if big else "<I", data, value_at)
            tags[code] = list(struct.unpack_from(form, data, value_at))
        listed.append((at, tags))
        (at,) = struct.unpack_from("<Q" if big else "<I", data, first + count * row)
    return listed


@pytest.mark.parametrize("big", [False, True])
def test_directories_come_first_and_tiles_from_the_smallest_level_on(big: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What validate_cloud_optimized_geotiff of GDAL checks: tiles, overviews, their sizes, and the order of everything."""
    if big:
        monkeypatch.setattr(geotiff, "_BIG_BYTES", 0)
    save_heights(tmp_path / "a.tif")
    assert [path.name for path in tmp_path.iterdir()] == ["a.tif"]
    listed = directories(tmp_path / "a.tif")
    assert listed[0][0] == (16 if big else 8), "the first directory follows the header"
    places = [at for at, _ in listed]
    assert places == sorted(places)
    sizes = [(tags[256][0], tags[257][0]) for _, tags in listed]
    assert sizes == [(201, 150), (101, 75), (51, 38), (26, 19)], "until one fits into a tile"
    assert [tags[254] for _, tags in listed] == [[0], [1], [1], [1]]
    assert all(tags[322] == [TILE] == tags[323] for _, tags in listed)
    first_tiles = [min(tags[324]) for _, tags in listed]
    assert first_tiles == sorted(first_tiles, reverse=True) and first_tiles[-1] > places[-1]
    spans = sorted((offset, offset + size) for _, tags in listed for offset, size in zip(tags[324], tags[325], strict=True))
    assert all(end == begin for (_, end), (begin, _) in pairwise(spans)), "no gap between two tiles"
    assert spans[-1][1] == (tmp_path / "a.tif").stat().st_size


def test_gdal_reads_every_level_and_leaves_out_what_is_unknown(tmp_path: Path) -> None:
    save_heights(tmp_path / "a.tif")
    values = heights()
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.overviews(1) == [2, 4, 8] and file.profile["tiled"] and file.crs.to_epsg() == 32632
        assert file.descriptions == ("height", "standard deviation", "class")
        assert file.tags(ns="IMAGE_STRUCTURE")["COMPRESSION"] == "DEFLATE"
        np.testing.assert_array_equal(file.read(), values.transpose(2, 0, 1))
    with rasterio.open(tmp_path / "a.tif", overview_level=0) as half:
        coarse = half.read()
    # Without its wall and its hole the slope's mean is its middle, to float32.
    expected = 400 + 0.01 * (2 * np.arange(100) + 0.5)
    np.testing.assert_allclose(coarse[0, 0, :100], expected, rtol=1e-6)
    known = coarse[0] != NO_DATA
    assert coarse[0][known].min() >= 400 and coarse[0][known].max() <= values[..., 0].max(), "means lie between what they are of"
    assert (coarse[0, 5:20, 10:30] == NO_DATA).all() and known[5:20, 30].all(), "a cell of which half is known is known"
    assert set(np.unique(coarse[2][known])) == {1.0, 2.0}, "classes are not mixed"


def test_colours_are_weighed_by_alpha_at_the_edge_of_what_is_seen(tmp_path: Path) -> None:
    image = np.zeros((ROWS, COLUMNS, 5), np.uint8)
    image[:, :101] = (200, 100, 50, 255, 3)
    save_tiles(
        tmp_path / "o.tif",
        raster(("red", "green", "blue", "alpha", "views"), dtype=np.uint8, colors=True, classes=(4,)),
        cut_tiles(image, TILE),
    )
    with rasterio.open(tmp_path / "o.tif", overview_level=0) as half:
        coarse = half.read()
    np.testing.assert_array_equal(coarse[:, 7, 49], (200, 100, 50, 255, 3))
    # Half of this cell is seen: its colour is that of the seen half.
    np.testing.assert_array_equal(coarse[:, 7, 50], (200, 100, 50, 128, 3))
    np.testing.assert_array_equal(coarse[:, 7, 51], 0)
    with tifffile.TiffFile(tmp_path / "o.tif") as file:
        assert [page.shape for page in file.pages] == [(150, 201, 5), (75, 101, 5), (38, 51, 5), (19, 26, 5)]


def test_a_raster_of_one_tile_has_no_overview_and_halving_keeps_means(tmp_path: Path) -> None:
    grid = MapGrid(north_west=np.zeros(2), cell=1.0, rows=20, columns=30, epsg=None, vertical_epsg=None)
    small = TiledRaster(place=grid, shape=grid.shape, bands=("height",), tile_px=32, dtype=np.float32)
    save_tiles(tmp_path / "a.tif", small, cut_tiles(np.ones((20, 30), np.float32), 32))
    assert len(directories(tmp_path / "a.tif")) == 1
    fine = np.random.default_rng(0).normal(size=(64, 64, 1)).astype(np.float32)
    np.testing.assert_allclose(halved(fine, small)[..., 0], fine[..., 0].reshape(32, 2, 32, 2).mean(axis=(1, 3)), atol=1e-6)
