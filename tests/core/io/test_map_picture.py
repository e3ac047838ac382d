"""Orthophotos read back as pictures on a map: our own and other programs' files, and what is none."""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from radiant_core.errors import BadInput
from radiant_core.export.geotiff import TiledRaster, cut_tiles, save_tiles
from radiant_core.io.map_picture import load_map_picture
from radiant_core.survey.map_grid import MapGrid

PLACE = [(33550, "d", 3, (0.5, 0.25, 0.0), True), (33922, "d", 6, (2.0, 4.0, 0.0, 1000.0, 2000.0, 0.0), True)]


def bands(rows: int, columns: int) -> np.ndarray:
    """Red is the row, green the column, alpha 0 in a corner."""
    values = np.zeros((rows, columns, 5), np.uint8)
    values[..., 0], values[..., 1] = np.arange(rows)[:, None] % 256, np.arange(columns) % 256
    values[..., 3] = 255
    values[:10, :10, 3] = 0
    return values


def test_our_own_orthophoto_comes_back(tmp_path: Path) -> None:
    values = bands(90, 70)
    grid = MapGrid(north_west=np.array([465300.5, 5246400.25]), cell=0.25, rows=90, columns=70, epsg=32632)
    raster = TiledRaster(place=grid, shape=grid.shape, bands=("r", "g", "b", "a", "n"), tile_px=32, dtype=np.uint8, colors=True)
    save_tiles(tmp_path / "a.tif", raster, cut_tiles(values, 32))
    picture = load_map_picture(tmp_path / "a.tif", 4096)
    np.testing.assert_array_equal(picture.image, values[..., :4])
    assert picture.epsg == 32632
    np.testing.assert_allclose(picture.north_west, [465300.5, 5246400.25])
    np.testing.assert_allclose(picture.south_east, [465300.5 + 70 / 4, 5246400.25 - 90 / 4])
    # Every third cell, whose box reaches to the end of the third.
    small = load_map_picture(tmp_path / "a.tif", 30)
    np.testing.assert_array_equal(small.image, values[::3, ::3, :4])
    np.testing.assert_allclose(small.south_east, [465300.5 + 24 * 0.75, 5246400.25 - 30 * 0.75])


def test_files_in_strips_without_alpha_are_read(tmp_path: Path) -> None:
    values = bands(50, 40)[..., :3]
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="rgb", rowsperstrip=7, compression="zlib", extratags=PLACE)
    picture = load_map_picture(tmp_path / "a.tif", 25)
    np.testing.assert_array_equal(picture.image[..., :3], values[::2, ::2])
    assert (picture.image[..., 3] == 255).all() and picture.epsg is None
    # The tie point is cell (2, 4), a metre east and south of the corner.
    np.testing.assert_allclose(picture.north_west, [999, 2001])


@pytest.mark.parametrize(
    ("values", "tags", "said"),
    [
        (np.zeros((20, 20), np.uint8), PLACE, "no picture in red"),
        (np.zeros((20, 20, 3), np.uint16), PLACE, "no picture in red"),
        (np.zeros((20, 20, 3), np.uint8), [], "does not say where"),
        (np.zeros((20, 20, 3), np.uint8), [(33550, "d", 3, (0.0, 1.0, 0.0), True), PLACE[1]], "no usable place"),
        (np.zeros((20, 20, 3), np.uint8), [(33550, "d", 3, (float("nan"), 1.0, 0.0), True), PLACE[1]], "no usable place"),
    ],
)
def test_what_is_no_orthophoto_is_refused(tmp_path: Path, values: np.ndarray, tags: list, said: str) -> None:
    tifffile.imwrite(tmp_path / "a.tif", values, extratags=tags)
    with pytest.raises(BadInput, match=said):
        load_map_picture(tmp_path / "a.tif", 100)


def test_cut_and_empty_files_are_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "a.tif", bands(64, 64)[..., :3], photometric="rgb", compression="zlib", extratags=PLACE)
    whole = (tmp_path / "a.tif").read_bytes()
    rng = np.random.default_rng(0)
    for number, content in enumerate((b"", whole[:8], whole[: len(whole) // 2], b"II*\0" + rng.bytes(300), whole[:-20])):
        (tmp_path / f"{number}.tif").write_bytes(content)
        with pytest.raises(BadInput):
            load_map_picture(tmp_path / f"{number}.tif", 100)
    with pytest.raises(BadInput, match="no file"):
        load_map_picture(tmp_path / "none.tif", 100)
    for _ in range(60):
        spoilt = bytearray(whole)
        for at in rng.integers(0, len(whole), 4):
            spoilt[at] = rng.integers(256)
        (tmp_path / "b.tif").write_bytes(bytes(spoilt))
        try:
            found = load_map_picture(tmp_path / "b.tif", 100)
        except BadInput:
            continue
        assert max(found.image.shape[:2]) <= 100


@pytest.mark.parametrize(("packing", "pack"), [("zlib", zlib.compress), ("lzma", lzma.compress)])
def test_parts_that_unpack_to_more_than_they_promise_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, packing: str, pack: Callable[[bytes], bytes]
) -> None:
    # Of parts that may be 1 MB one of 30 kB unpacks to 8 MB, and is smaller than it may be packed.
    monkeypatch.setattr("radiant_core.io.map_picture.MAX_SEGMENT_BYTES", 1 << 20)
    monkeypatch.setattr("tifffile.TiffPage.segments", lambda _: pytest.fail("it was unpacked"))
    values = np.zeros((90, 120, 3), np.uint8)
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="rgb", rowsperstrip=90, compression=packing, extratags=PLACE)
    more = pack(bytes(8 << 20))
    assert len(more) < 2 * values.size
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+b") as file:
        page, end = file.pages[0], file.filehandle.seek(0, 2)
        file.filehandle.write(more)
        assert isinstance(page, tifffile.TiffPage)
        page.tags["StripOffsets"].overwrite([end])
        page.tags["StripByteCounts"].overwrite([len(more)])
    with pytest.raises(BadInput, match="unpacks to more than the 32,400 bytes"):
        load_map_picture(tmp_path / "a.tif", 100)
