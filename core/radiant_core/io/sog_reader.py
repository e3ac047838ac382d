"""SOG files of strangers as models, one strict reader for the zip and the folder. Once per file.

The format is described in `export.sog`, which writes it. The count is held against the bytes of
the file, what a zip says of its members against the count, and a texture's size against it before
it is decoded, so that a short file cannot ask for much memory.
"""

from __future__ import annotations

import io
import math
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from pydantic import Field, ValidationError
from scipy.special import logit  # pyright: ignore[reportMissingTypeStubs]

from radiant_core.errors import BadInput
from radiant_core.io.claimed_counts import require_believable
from radiant_core.io.run_store import parse_json, read_bounded
from radiant_core.io.stored_gaussians import END_OPACITY, StoredGaussians, checked
from radiant_core.io.strict import Strict, problem_sentence
from radiant_core.splats import SH_BASES, Splats

META_NAME = "meta.json"
MAX_META_BYTES, MAX_BUNDLE_BYTES = 1 << 20, 1 << 32
MAX_COUNT = 16383**2
ROWS_PER_LINE = 64
MAX_SPARE_PX = 1 << 16
"""Pixels that a texture may have beyond four times what its Gaussians need."""
_STORED_COMPONENTS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
MAX_PX_BYTES = 6
"""Of a texture's pixel as WebP or PNG, which hold four bytes of noise in little more."""
FileReader = Callable[[str, int], bytes]
"""Bytes of a file by its name, of which it may have at most so many."""


class _Means(Strict):
    mins: tuple[float, float, float]
    maxs: tuple[float, float, float]
    files: tuple[str, str]


class _Codebook(Strict):
    codebook: list[float] = Field(min_length=256, max_length=256)
    files: tuple[str]


class _Quats(Strict):
    files: tuple[str]


class _Harmonics(Strict):
    count: int = Field(ge=1, le=1 << 16)
    bands: int = Field(ge=1, le=3)
    codebook: list[float] = Field(min_length=256, max_length=256)
    files: tuple[str, str]


class _Meta(Strict):
    version: Literal[2]
    asset: dict[str, Any] | None = None
    count: int = Field(ge=1, le=MAX_COUNT)
    antialias: bool = False
    model: str | None = None
    means: _Means
    scales: _Codebook
    quats: _Quats
    sh0: _Codebook
    shN: _Harmonics | None = None


def load_sog(path: Path) -> Splats:
    """The Gaussians of a .sog, or of a folder's meta.json, in the order of the file.

    Raises BadInput for what is no SOG of version 2, names files elsewhere, or does not hold what it
    says; the message names it.
    """
    gaussians = read_sog(path)
    try:
        return checked(gaussians)
    except BadInput as error:
        raise BadInput(f"cannot use {path}: {error}") from error


def read_sog(path: Path, count: int | None = None) -> StoredGaussians:
    """As `load_sog`, the values unchecked; BadInput too where it does not say just `count`."""
    try:
        if path.name == META_NAME:
            return _loose(path, count)
        data = read_bounded(path, MAX_BUNDLE_BYTES)
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _decoded(lambda name, most: _member(archive, name, most), len(data), count)
    except (zipfile.BadZipFile, NotImplementedError, EOFError, RuntimeError, ValueError) as error:
        # zipfile raises RuntimeError for an encrypted member, and zlib.error is turned to it below.
        raise BadInput(f"cannot use {path}: {str(error).rstrip('.')}: export it as SOG of version 2.") from error


def _loose(meta: Path, count: int | None) -> StoredGaussians:
    """The model of a meta.json with textures beside it."""

    def read_bytes(name: str, most: int) -> bytes:
        return read_bounded(meta.with_name(name), most)

    names = _texture_names(_meta(read_bytes(META_NAME, MAX_META_BYTES)))
    return _decoded(read_bytes, sum(meta.with_name(name).stat().st_size for name in set(names) if meta.with_name(name).is_file()), count)


def _member(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    import zlib

    try:
        about = archive.getinfo(name)
        if about.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise BadInput(f"its file {name} is packed in a way that SOG does not have")
        if about.file_size > most:
            raise BadInput(f"its file {name} has {about.file_size:,} bytes, expected at most {most:,}")
        # What is unpacked ends at the size that was said, and its checksum is then compared.
        return archive.read(about)
    except (KeyError, zlib.error) as error:
        raise BadInput(f"its file {name} is missing or damaged") from error


def _decoded(read_bytes: FileReader, num_bytes: int, expected: int | None) -> StoredGaussians:
    """The model of files that have so many bytes in all."""
    meta = _meta(read_bytes(META_NAME, MAX_META_BYTES))
    count = meta.count
    if expected is not None and count != expected:
        raise BadInput(f"it says {count:,} Gaussians, its lod-meta.json {expected:,}")
    require_believable(count, num_bytes)
    low, high = (_pixels(read_bytes, name, count)[:, :3].astype(np.float64) for name in meta.means.files)
    ends = np.array([meta.means.mins, meta.means.maxs])
    # Beyond e⁸⁸ there is no float32; the bounds are those of signed logarithms.
    if np.abs(ends).max() > 88:
        raise BadInput(f"its centres reach to e^{np.abs(ends).max():.3g}, beyond any coordinate")
    logs = ends[0] + (256 * high + low) / 65535 * (ends[1] - ends[0])
    colors = _pixels(read_bytes, meta.sh0.files[0], count)
    opacities = np.clip(colors[:, 3] / 255, END_OPACITY, 1 - END_OPACITY)
    return StoredGaussians(
        means=np.sign(logs) * np.expm1(np.abs(logs)),
        quats=_quats(_pixels(read_bytes, meta.quats.files[0], count)),
        log_scales=np.array(meta.scales.codebook)[_pixels(read_bytes, meta.scales.files[0], count)[:, :3]],
        logit_opacities=logit(opacities),
        sh0=np.array(meta.sh0.codebook)[colors[:, None, :3]],
        shN=_harmonics(read_bytes, meta.shN, count),
        antialiased=meta.antialias or meta.model == "antialiased",
    )


def _meta(data: bytes) -> _Meta:
    if len(data) > MAX_META_BYTES:
        raise BadInput(f"its {META_NAME} has {len(data)} bytes, expected at most {MAX_META_BYTES}")
    try:
        record = parse_json(data)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"its {META_NAME} is no JSON ({error})") from error
    try:
        # Through JSON's rules, by which a list may be a tuple.
        meta = _Meta.model_validate_json(data)
    except ValidationError as error:
        raise BadInput(problem_sentence(error, "SOG file", data=record)) from error
    for name in _texture_names(meta):
        if not name or "/" in name or "\\" in name or name.startswith(".") or not name.isprintable():
            raise BadInput(f"its texture {name[:60]!r} does not lie beside its {META_NAME}")
    return meta


def _texture_names(meta: _Meta) -> list[str]:
    return [*meta.means.files, *meta.scales.files, *meta.quats.files, *meta.sh0.files, *(meta.shN.files if meta.shN else ())]


def _pixels(read_bytes: FileReader, name: str, count: int) -> NDArray[np.uint8]:
    """The first `count` pixels (N,4) of a texture."""
    return _texture(read_bytes, name, count).reshape(-1, 4)[:count]


def _texture(read_bytes: FileReader, name: str, count: int) -> NDArray[np.uint8]:
    """A texture (H,W,4) of at least `count` pixels."""
    most_px = 4 * count + MAX_SPARE_PX
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            data = read_bytes(name, MAX_PX_BYTES * most_px + MAX_SPARE_PX)
            with Image.open(io.BytesIO(data), formats=("WEBP", "PNG")) as image:
                num_px = image.width * image.height
                if not count <= num_px <= most_px:
                    raise BadInput(f"its texture {name} has {image.width} x {image.height} pixels for {count} Gaussians")
                return np.asarray(image.convert("RGBA"), np.uint8)
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise BadInput(f"its texture {name} is no picture that can be read") from error


def _quats(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    if (pixels[:, 3] < 252).any():
        raise BadInput("a rotation does not say which of its components is left out")
    components = (pixels[:, :3] / 255 - 0.5) * math.sqrt(2)
    largest = pixels[:, 3].astype(np.int64) - 252
    quats = np.empty((len(pixels), 4))
    rows = np.arange(len(pixels))
    quats[rows[:, None], _STORED_COMPONENTS[largest]] = components
    quats[rows, largest] = np.sqrt(np.maximum(0.0, 1 - (components**2).sum(axis=1)))
    return quats.astype(np.float32)


def _harmonics(read_bytes: FileReader, meta: _Harmonics | None, count: int) -> NDArray[np.float32]:
    if meta is None:
        return np.zeros((count, 0, 3), np.float32)
    bases = SH_BASES[meta.bands] - 1
    lines = -(-meta.count // ROWS_PER_LINE)
    palette = _texture(read_bytes, meta.files[0], lines * ROWS_PER_LINE * bases)
    if palette.shape[1] != ROWS_PER_LINE * bases:
        raise BadInput(f"its texture {meta.files[0]} is {palette.shape[1]} pixels wide, expected {ROWS_PER_LINE * bases}")
    labels = _pixels(read_bytes, meta.files[1], count).astype(np.int64)
    label = labels[:, 0] + 256 * labels[:, 1]
    if label.max() >= meta.count:
        raise BadInput(f"a label is {label.max()}, expected less than the {meta.count} rows of its palette")
    codes = palette.reshape(-1, bases, 4)[label, :, :3]
    return np.array(meta.codebook, np.float32)[codes]
