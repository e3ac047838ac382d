"""Rasters on a map as Cloud-Optimised GeoTIFF (OGC 19-008, 21-026), north up, in tiles of any
bands, written one after another. Once per raster.

Overviews of half the size each follow until one fits into a tile: a cell is the mean of the known
ones of its four, of colours by their alpha, and of classes the first of them.

Cell (row, column) covers east₀ + column · cell … + cell and north₀ − row · cell … − cell. With an
EPSG code the grid is that projected system's; without one it stands in the model's own coordinates.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Protocol
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from radiant_core import __version__
from radiant_core.errors import BadInput, CannotWrite, way_to_write
from radiant_core.export.cog import write_cog
from radiant_core.numerics import FloatArray

if TYPE_CHECKING:
    from tifffile import TiffPage

NO_DATA = -9999.0
_PIXEL_SCALE, _TIEPOINT, _GEO_KEYS, _GDAL_METADATA, _GDAL_NODATA = 33550, 33922, 34735, 42112, 42113
_MODEL_TYPE, _RASTER_TYPE, _PROJECTED_CRS, _LINEAR_UNITS = 1024, 1025, 3072, 3076
_VERTICAL_CRS, _VERTICAL_UNITS = 4096, 4099
_PROJECTED, _USER_DEFINED, _PIXEL_IS_AREA, _METRE = 1, 32767, 1, 9001
_SHORT, _DOUBLE, _ASCII = 3, 12, 2
_BIG_BYTES = 2**31
"""From so many bytes on, before compression, the file is a BigTIFF: a plain one ends at 4 GiB."""


class Placed(Protocol):
    """What says where a raster lies: corner (2,), size of a cell, EPSG code or None."""

    @property
    def north_west(self) -> FloatArray:
        """Outer corner (2,), east and north."""
        ...

    @property
    def cell(self) -> float:
        """Side of a cell."""
        ...

    @property
    def epsg(self) -> int | None:
        """Code of the map, None for the model's own coordinates."""
        ...

    @property
    def vertical_epsg(self) -> int | None:
        """Code of the datum that heights count from, None where it has none."""
        ...


@dataclass(frozen=True, kw_only=True)
class TiledRaster:
    """Rows × columns of bands of one type, in tiles of tile_px, a multiple of 16; colors: the first
    four bands are red, green, blue and alpha; no_data: what stands where nothing is known."""

    place: Placed
    shape: tuple[int, int]
    bands: tuple[str, ...]
    tile_px: int
    dtype: type[np.uint8] | type[np.float32]
    colors: bool = False
    no_data: float | None = None
    classes: tuple[int, ...] = ()
    """Bands whose values are names: between two of them lies none."""

    def __post_init__(self) -> None:
        if self.tile_px < 16 or self.tile_px % 16:
            raise BadInput(f"tiles of {self.tile_px} px came, but TIFF has tiles of a multiple of 16: choose one, such as 512.")

    @property
    def num_bytes(self) -> int:
        """Of its cells before they are packed."""
        return self.shape[0] * self.shape[1] * len(self.bands) * np.dtype(self.dtype).itemsize


def save_tiles(path: Path, raster: TiledRaster, tiles: Iterable[NDArray[Any]]) -> None:
    """Write tiles (T,T,B) row by row from the north-west as they come, and overviews, atomically:
    what is held is five tiles. Those at the east and the south reach beyond the raster. CannotWrite
    if it fails."""
    big = raster.num_bytes * 4 // 3 > _BIG_BYTES
    try:
        with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
            levels = [Path(folder) / "0.tif"]
            _save_level(levels[0], raster, tiles, big=big)
            while max(raster.shape) > raster.tile_px:
                levels.append(Path(folder) / f"{len(levels)}.tif")
                raster = _save_half(levels[-2], levels[-1], raster, big=big)
            write_cog(path, levels, big=big)
    except OSError as error:
        raise CannotWrite(f"cannot write {path}: {error.strerror or error}: {way_to_write(error)}.") from error


def _save_level(path: Path, raster: TiledRaster, tiles: Iterable[NDArray[Any]], *, big: bool) -> None:
    import tifffile

    height, width = raster.shape
    depth = len(raster.bands)
    with tifffile.TiffWriter(path, bigtiff=big, byteorder="<") as file:
        file.write(
            (np.ascontiguousarray(tile, raster.dtype) for tile in tiles),
            shape=(height, width, depth) if depth > 1 else (height, width),
            dtype=raster.dtype,
            tile=(raster.tile_px, raster.tile_px),
            photometric="rgb" if raster.colors else "minisblack",
            planarconfig="contig" if depth > 1 else None,
            extrasamples=_extra_samples(raster),
            compression="zlib",
            predictor=raster.dtype is np.uint8,
            metadata=None,
            software=f"radiant {__version__}",
            extratags=[*_place_tags(raster.place), *_band_tags(raster)],
        )


def _save_half(from_path: Path, to_path: Path, raster: TiledRaster, *, big: bool) -> TiledRaster:
    """Write the level of half the size of the one in a file; the raster that it is."""
    import tifffile

    half = replace(raster, shape=(-(-raster.shape[0] // 2), -(-raster.shape[1] // 2)))
    with tifffile.TiffFile(from_path) as file:
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage)
        _save_level(to_path, half, _halved_tiles(page, raster, half), big=big)
    return half


def _halved_tiles(page: TiffPage, raster: TiledRaster, half: TiledRaster) -> Iterator[NDArray[Any]]:
    side = raster.tile_px
    across, down = -(-raster.shape[1] // side), -(-raster.shape[0] // side)
    for row in range(-(-half.shape[0] // side)):
        for column in range(-(-half.shape[1] // side)):
            fine = np.full((2 * side, 2 * side, len(raster.bands)), raster.no_data or 0, raster.dtype)
            for y, x in product((0, 1), (0, 1)):
                if 2 * row + y < down and 2 * column + x < across:
                    tile = _tile_of(page, (2 * row + y) * across + 2 * column + x)
                    fine[y * side : y * side + tile.shape[0], x * side : x * side + tile.shape[1]] = tile
            # What reaches beyond the raster is no part of it.
            fine[max(0, raster.shape[0] - 2 * row * side) :] = raster.no_data or 0
            fine[:, max(0, raster.shape[1] - 2 * column * side) :] = raster.no_data or 0
            tile = halved(fine, raster)
            yield tile if len(raster.bands) > 1 else tile[..., 0]


def halved(fine: NDArray[Any], raster: TiledRaster) -> NDArray[Any]:
    """Cells (2T,2T,B) of a raster at half the size (T,T,B), by what is known of each four."""
    fours = [fine[y::2, x::2].astype(np.float64) for y, x in product((0, 1), (0, 1))]
    known = [_is_known(cells, raster) for cells in fours]
    total, weighted = np.zeros_like(fours[0]), np.zeros_like(fours[0])
    for cells, is_known in zip(fours, known, strict=True):
        weights = np.repeat(is_known[..., None].astype(np.float64), cells.shape[2], axis=2)
        if raster.colors:
            weights[..., :3] *= cells[..., 3:4]
            weights[..., 3] = 1.0
        total += weights
        weighted += weights * cells
    coarse = np.divide(weighted, total, out=np.zeros_like(total), where=total > 0)
    for band in raster.classes:
        coarse[..., band] = np.select(known, [cells[..., band] for cells in fours], fours[0][..., band])
    if raster.no_data is not None:
        coarse[~np.logical_or.reduce(known)] = raster.no_data
    return np.rint(coarse).astype(raster.dtype) if raster.dtype is np.uint8 else coarse.astype(raster.dtype)


def _is_known(cells: NDArray[np.float64], raster: TiledRaster) -> NDArray[np.bool_]:
    is_known = cells[..., 3] > 0 if raster.colors else np.ones(cells.shape[:2], bool)
    return is_known if raster.no_data is None else is_known & (cells[..., 0] != raster.no_data)


def _tile_of(page: TiffPage, index: int) -> NDArray[Any]:
    """One tile (h,w,B) of a page, cut to the raster."""
    page.parent.filehandle.seek(page.dataoffsets[index])
    data = page.parent.filehandle.read(page.databytecounts[index])
    return np.asarray(page.decode(data, index)[0])[0]


def cut_tiles(values: NDArray[Any], tile_px: int, fill: float = 0) -> Iterable[NDArray[Any]]:
    """The tiles (T,T,…) of an array (H,W,…) that is there as a whole, row by row."""
    height, width = values.shape[:2]
    for row in range(0, height, tile_px):
        for column in range(0, width, tile_px):
            tile = np.full((tile_px, tile_px, *values.shape[2:]), fill, values.dtype)
            part = values[row : row + tile_px, column : column + tile_px]
            tile[: part.shape[0], : part.shape[1]] = part
            yield tile


def _extra_samples(raster: TiledRaster) -> list[str] | None:
    if raster.colors:
        return ["unassalpha", *["unspecified"] * (len(raster.bands) - 4)]
    return ["unspecified"] * (len(raster.bands) - 1) or None


def _band_tags(raster: TiledRaster) -> list[tuple[int, int, int, object, bool]]:
    """Names of the bands as GDAL keeps them, and what stands for nothing."""
    items = [
        f'<Item name="DESCRIPTION" sample="{index}" role="description">{escape(name)}</Item>' for index, name in enumerate(raster.bands)
    ]
    tags: list[tuple[int, int, int, object, bool]] = [(_GDAL_METADATA, _ASCII, 0, f"<GDALMetadata>{''.join(items)}</GDALMetadata>", True)]
    return tags if raster.no_data is None else [*tags, (_GDAL_NODATA, _ASCII, 0, f"{raster.no_data:.0f}", True)]


def _place_tags(grid: Placed) -> list[tuple[int, int, int, object, bool]]:
    keys = [(_MODEL_TYPE, _PROJECTED if grid.epsg else _USER_DEFINED), (_RASTER_TYPE, _PIXEL_IS_AREA)]
    if grid.epsg:
        keys += [(_PROJECTED_CRS, grid.epsg), (_LINEAR_UNITS, _METRE)]
    if grid.epsg and grid.vertical_epsg:
        keys += [(_VERTICAL_CRS, grid.vertical_epsg), (_VERTICAL_UNITS, _METRE)]
    # 1.1 of the standard: its vertical keys are EPSG's codes.
    directory = [1, 1, 1 if grid.vertical_epsg else 0, len(keys), *(number for key, value in keys for number in (key, 0, 1, value))]
    tiepoint = (0.0, 0.0, 0.0, float(grid.north_west[0]), float(grid.north_west[1]), 0.0)
    return [
        (_PIXEL_SCALE, _DOUBLE, 3, (grid.cell, grid.cell, 0.0), True),
        (_TIEPOINT, _DOUBLE, 6, tiepoint, True),
        (_GEO_KEYS, _SHORT, len(directory), tuple(directory), True),
    ]
