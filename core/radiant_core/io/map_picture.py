"""A picture on a map, read from a GeoTIFF of any program, thinned to a size that a window shows.

Tile after tile, so that a file of gigabytes takes the memory of one tile and the picture. What is
read is checked: files come from strangers.
"""

from __future__ import annotations

import lzma
import zlib
from dataclasses import dataclass
from pathlib import Path
from struct import error as struct_error
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray

if TYPE_CHECKING:
    from tifffile import TiffPage

MAX_SIDE = 1 << 20
MAX_SEGMENT_BYTES = 1 << 28
_PIXEL_SCALE, _TIEPOINT, _ALPHA = 33550, 33922, (1, 2)
_DEFLATE, _LZMA, _PACKBITS, _ZSTD = (8, 32946), 34925, 32773, 50000
_DEFLATE_RATIO, _PACKBITS_RATIO = 1032, 64
"""What a packed byte unpacks to at most."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MapPicture:
    """image (H,W,4) uint8, alpha 0 where nothing is known, over the box of corners north_west and
    south_east (2,) of the map; epsg None where it names none."""

    image: NDArray[np.uint8]
    north_west: FloatArray
    south_east: FloatArray
    epsg: int | None


def load_map_picture(path: Path, max_px: int) -> MapPicture:
    """Read a picture of 8 bits, at most `max_px` wide and high: every K-th cell of a larger one.

    Raises BadInput for a file that is no such picture, or has no place on a map.
    """
    import tifffile

    # What tifffile and its decoders raise on files that are cut or spoilt.
    spoilt = (ValueError, KeyError, IndexError, TypeError, AttributeError, ArithmeticError, RuntimeError, OSError, struct_error)
    spoilt = (*spoilt, zlib.error, lzma.LZMAError)
    if not path.is_file():
        raise BadInput(f"there is no file {path}: give an orthophoto, a GeoTIFF.")
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages[0]
            assert isinstance(page, tifffile.TiffPage)
            corner, cell_wh = _place(page, path)
            height, width = _shape(page, path)
            _require_to_fit(page, path)
            step = -(-max(height, width) // max_px)
            image = _thinned(page, step)
            epsg = _epsg(page)
    except BadInput:
        raise
    except (tifffile.TiffFileError, *spoilt) as error:
        raise BadInput(f"{path} cannot be read as an orthophoto: {error}.") from None
    covered = np.array([image.shape[1], -image.shape[0]]) * step * cell_wh
    return MapPicture(image=image, north_west=corner, south_east=corner + covered, epsg=epsg)


def _shape(page: TiffPage, path: Path) -> tuple[int, int]:
    height, width, depth = int(page.imagelength), int(page.imagewidth), int(page.samplesperpixel)
    if page.dtype != np.uint8 or depth < 3 or int(page.planarconfig) != 1:
        raise BadInput(f"{path} is no picture in red, green and blue of 8 bits: export one with --format ortho.")
    segment = _segment_bytes(page)
    if not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE and 0 < segment <= MAX_SEGMENT_BYTES):
        raise BadInput(f"{path} promises {width} × {height} cells in parts of {segment:,} bytes: write it in tiles.")
    # A part much larger packed than unpacked would fill the memory by itself.
    if max(page.databytecounts, default=0) > _most(segment):
        raise BadInput(f"{path} has parts of {max(page.databytecounts):,} bytes for {segment:,}: write it anew.")
    return height, width


def _segment_bytes(page: TiffPage) -> int:
    """Bytes of an unpacked tile or strip, as the file promises them."""
    height, width = int(page.imagelength), int(page.imagewidth)
    return int((page.tilelength or page.rowsperstrip or height) * (page.tilewidth or width) * page.samplesperpixel)


def _most(segment: int) -> int:
    return 2 * segment + 4096


def _require_to_fit(page: TiffPage, path: Path) -> None:
    """Raise BadInput where a part unpacks to more than it promises, before anything decodes it.
    Small parts cannot unpack to more than `MAX_SEGMENT_BYTES`."""
    packing, most = int(page.compression), _most(_segment_bytes(page))
    if packing == _ZSTD:
        raise BadInput(f"{path} is packed with Zstandard, which is not read here: write it with deflate.")
    ratio = {**dict.fromkeys(_DEFLATE, _DEFLATE_RATIO), _PACKBITS: _PACKBITS_RATIO, _LZMA: MAX_SEGMENT_BYTES}.get(packing, 1)
    for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True):
        if count * ratio <= MAX_SEGMENT_BYTES:
            continue
        page.parent.filehandle.seek(offset)
        if _unpacks_to_more(page.parent.filehandle.read(count), packing, most):
            raise BadInput(f"{path} has a part that unpacks to more than the {_segment_bytes(page):,} bytes it promises: write it anew.")


def _unpacks_to_more(data: bytes, packing: int, most: int) -> bool:
    if packing in _DEFLATE:
        return len(zlib.decompressobj().decompress(data, most + 1)) > most
    if packing == _LZMA:
        return len(lzma.LZMADecompressor().decompress(data, most + 1)) > most
    return len(data) * _PACKBITS_RATIO > max(most, MAX_SEGMENT_BYTES)


def _place(page: TiffPage, path: Path) -> tuple[FloatArray, FloatArray]:
    """The outer corner (2,) and the cell's width and height (2,)."""
    if _PIXEL_SCALE not in page.tags or _TIEPOINT not in page.tags:
        raise BadInput(f"{path} does not say where it lies on a map: give a GeoTIFF that is north up.")
    scale = np.array(page.tags[_PIXEL_SCALE].value[:2], np.float64)
    tie = np.array(page.tags[_TIEPOINT].value[:6], np.float64)
    if scale.shape != (2,) or tie.shape != (6,) or not (np.isfinite(tie).all() and np.isfinite(scale).all() and (scale > 0).all()):
        raise BadInput(f"{path} has no usable place on a map: write it anew.")
    return tie[3:5] + tie[:2] * scale * [-1, 1], scale


def _epsg(page: TiffPage) -> int | None:
    tags: dict[str, Any] = page.geotiff_tags or {}
    code = tags.get("ProjectedCSTypeGeoKey")
    return None if code is None or int(code) >= 32767 else int(code)


def _thinned(page: TiffPage, step: int) -> NDArray[np.uint8]:
    """Every step-th cell as red, green, blue, alpha (H,W,4)."""
    height, width = int(page.imagelength), int(page.imagewidth)
    image = np.zeros((-(-height // step), -(-width // step), 4), np.uint8)
    has_alpha = bool(page.extrasamples) and int(page.extrasamples[0]) in _ALPHA
    for segment, index, shape in page.segments():
        first_row, first_column = int(index[-3]), int(index[-2])
        if segment is None:
            continue
        part = np.asarray(segment)[0, : min(shape[1], height - first_row), : min(shape[2], width - first_column)]
        rows, columns = -(-first_row // step), -(-first_column // step)
        cells = part[rows * step - first_row :: step, columns * step - first_column :: step]
        target = image[rows : rows + cells.shape[0], columns : columns + cells.shape[1]]
        target[..., :3] = cells[..., :3]
        target[..., 3] = cells[..., 3] if has_alpha else 255
    return image
