"""Models as SOG (Spatially Ordered Gaussians 2): lossless WebP textures in a zip or a folder. Once
per model.

Of Gaussian i of N, pixel i of each W × H texture, rows first:
    means_l, means_u   low and high byte of round(65535 (m − min) / (max − min)),
                       m = sign(x) ln(|x| + 1) per axis
    quats              three components in [−1/√2, 1/√2] of 255 steps, alpha 252 + which of w x y z
                       was the largest and is left out
    scales, sh0        per channel one of 256 values; alpha of sh0 is the opacity in 255 steps
    shN                16-bit label of one of 65,536 rows at most, of one of 256 values each
The values are chosen by Lloyd's iteration; rows by splitting at the mean of the widest axis until
there are enough. Coordinates stay those of the 3DGS PLY. Source: PlayCanvas, "The SOG Format".
"""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from radiant_core import __version__
from radiant_core.errors import BadInput, CannotWrite
from radiant_core.io.run_store import write_atomic
from radiant_core.numerics import FloatArray, unit_quats
from radiant_core.splats import Splats, morton_order

CODES = 256
MAX_ROWS = 1 << 16
ROWS_PER_LINE = 64
MAX_SIDE_PX = 16383
"""WebP's limit of a side."""
LLOYD_ROUNDS = 12
HISTOGRAM_BINS = 1 << 14
SIZE_POWER = 1.25
"""An error of ln scale counts by the scale to this power: large Gaussians fill more pixels. Of
four runs' models three views each are 0.2 to 5.4 dB nearer than with 0, from their own cameras
(demo 52.7, 51.1, 51.5 to 53.7, 52.1, 52.0; lewis 52.6, 48.1, 53.1 to 55.6, 53.5, 54.1)."""
USUAL_SHARE, BEYOND_USUAL = 0.999, 1.5
"""Scales more than e^1.5 above this share of all count as much as those."""
FINE_M = 1e-3
"""How near to its place a file in a map's coordinates should keep a centre."""
SHIFT_STEP, MAX_SHIFTS = 100.0, 21
_STORED_COMPONENTS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])


@dataclass(frozen=True, kw_only=True)
class SogErrors:
    """How far the stored values are from the model's: greatest error of a centre, and root mean
    square errors of ln scales, which count by their size, of sh0 and shN."""

    position_max_m: float
    log_scale_rms: float
    sh0_rms: float
    shN_rms: float


def save_sog(path: Path, splats: Splats) -> SogErrors:
    """Write at least one Gaussian to `path`, atomically, along a Z curve; BadInput without any, or
    when it cannot be written."""
    if not len(splats):
        raise BadInput(f"cannot write {path}: the model has no Gaussians, and SOG cannot say so.")
    files, errors = sog_files(splats.select(morton_order(splats.means)))
    write_atomic(path, zipped(files))
    return errors


def zipped(files: dict[str, bytes]) -> bytes:
    """Files by name in one zip, stored: the bundled form."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_STORED) as archive:
        for name, data in files.items():
            # A fixed time: the same model gives the same bytes.
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data)
    return content.getvalue()


def save_sog_folder(folder: Path, splats: Splats) -> SogErrors:
    """Write at least one Gaussian as meta.json and textures into the new `folder`, in the given
    order: the unbundled form. The same model gives the same bytes. Raises as `save_sog`."""
    if not len(splats):
        raise BadInput(f"cannot write {folder}: the model has no Gaussians, and SOG cannot say so.")
    files, errors = sog_files(splats)
    try:
        folder.mkdir()
    except OSError as error:
        raise CannotWrite(f"cannot make {folder}: {error.strerror or error}: choose another output folder.") from error
    for name, data in files.items():
        write_atomic(folder / name, data)
    return errors


def sog_files(splats: Splats) -> tuple[dict[str, bytes], SogErrors]:
    """The files by name of at least one Gaussian, in the given order."""
    textures, meta, errors = _encode(splats)
    return {"meta.json": json.dumps(meta).encode(), **{name: _webp(image) for name, image in textures.items()}}, errors


def _encode(splats: Splats) -> tuple[dict[str, NDArray[np.uint8]], dict[str, Any], SogErrors]:
    count = len(splats)
    shape = _texture_shape(count)
    means = splats.means.astype(np.float64)
    steps, low, span = _mean_steps(means)
    stored = low + span * (steps / 65535)
    log_scales = splats.log_scales.astype(np.float64)
    # Capped: beside one huge Gaussian, seen or not, all others would count for nothing.
    most = float(np.quantile(log_scales, USUAL_SHARE, method="lower")) + BEYOND_USUAL
    sizes = np.exp(SIZE_POWER * (np.minimum(log_scales, most) - most))
    scale_codes, scale_book = _quantize(log_scales, sizes)
    color_codes, color_book = _quantize(splats.sh0[:, 0].astype(np.float64))
    opacities = np.rint(255 * splats.opacities).astype(np.uint8)
    textures = {
        "means_l.webp": _texture(steps & 0xFF, shape),
        "means_u.webp": _texture(steps >> 8, shape),
        "quats.webp": _texture(_quat_bytes(splats.quats), shape),
        "scales.webp": _texture(scale_codes, shape),
        "sh0.webp": _texture(np.column_stack([color_codes, opacities]), shape),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": f"radiant {__version__}"},
        "count": count,
        # The first is of the specification, the second what PlayCanvas's own tools write and read.
        "antialias": splats.antialiased,
        **({"model": "antialiased"} if splats.antialiased else {}),
        "means": {"mins": low.tolist(), "maxs": (low + span).tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_book.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": color_book.tolist(), "files": ["sh0.webp"]},
    }
    rest_rms = _add_harmonics(splats, shape, textures, meta) if splats.sh_degree else 0.0
    errors = SogErrors(
        position_max_m=float(np.abs(_means_of(stored) - means).max()),
        log_scale_rms=float(np.sqrt(np.average((scale_book[scale_codes] - log_scales) ** 2, weights=sizes))),
        sh0_rms=_rms(color_book[color_codes] - splats.sh0[:, 0]),
        shN_rms=rest_rms,
    )
    return textures, meta, errors


def _mean_steps(means: FloatArray) -> tuple[NDArray[np.uint16], FloatArray, FloatArray]:
    """Steps (N,3) of centres, and the least of their signed logarithms and how far those go
    (3,)."""
    logs = np.sign(means) * np.log1p(np.abs(means))
    low, high = logs.min(axis=0), logs.max(axis=0)
    span = np.where(high > low, high - low, 1.0)
    return np.rint(65535 * (logs - low) / span).astype(np.uint16), low, span


def _means_of(logs: FloatArray) -> FloatArray:
    return np.sign(logs) * np.expm1(np.abs(logs))


def moved_sentence(splats: Splats) -> str:
    """A warning where 16 bits an axis move Gaussians visibly, by more than half of their longest
    standard deviation; empty where they do not."""
    if not len(splats):
        return ""
    means = splats.means.astype(np.float64)
    steps, low, span = _mean_steps(means)
    moved = np.linalg.norm(_means_of(low + span * (steps / 65535)) - means, axis=1)
    is_far = moved > 0.5 * np.exp(splats.log_scales.max(axis=1).astype(np.float64))
    if not is_far.any():
        return ""
    return (
        f"SOG has 16 bits for a coordinate: {int(is_far.sum()):,} of {len(splats):,} Gaussians move by more than half of their size, up to "
        f"{moved[is_far].max():.3g} units; clean the model of what lies far out, or write --lod or PLY."
    )


def finer_shift(means: FloatArray, limit: float) -> FloatArray:
    """What to add to centres (N,3) so that 16 bits keep each coordinate within `limit`: the fewest
    whole hundreds an axis (3,), since ln(1 + |x|) is straighter the farther out x lies. Zeros where
    no shift is needed, and where none is enough."""
    shifts = np.arange(MAX_SHIFTS, dtype=np.float64) * SHIFT_STEP
    ends = np.stack([means.min(axis=0), means.max(axis=0)]) + shifts[:, None, None]
    logs = np.sign(ends) * np.log1p(np.abs(ends))
    # Half a step of the logarithm, where a coordinate is largest.
    errors = np.ptp(logs, axis=1) / (2 * 65535) * (1 + np.abs(ends).max(axis=1))
    is_fine = errors <= limit
    fewest = np.where(is_fine.any(axis=0).all(), is_fine.argmax(axis=0), 0)
    return np.asarray(shifts[fewest], np.float64)


def _add_harmonics(splats: Splats, shape: tuple[int, int], textures: dict[str, NDArray[np.uint8]], meta: dict[str, Any]) -> float:
    """Put the harmonics above degree 0 into textures and meta; returns their RMS error."""
    bases = splats.shN.shape[1]
    flat = splats.shN.reshape(len(splats), 3 * bases)
    labels, rows = _row_palette(flat)
    codes, book = _quantize(rows)
    lines = -(-len(rows) // ROWS_PER_LINE)
    palette = np.zeros((lines * ROWS_PER_LINE, bases, 3), np.uint8)
    palette[: len(rows)] = codes.reshape(len(rows), bases, 3)
    textures["shN_centroids.webp"] = palette.reshape(lines, ROWS_PER_LINE * bases, 3)
    textures["shN_labels.webp"] = _texture(np.column_stack([labels & 0xFF, labels >> 8, np.zeros_like(labels)]), shape)
    files = ["shN_centroids.webp", "shN_labels.webp"]
    meta["shN"] = {"count": len(rows), "bands": splats.sh_degree, "codebook": book.tolist(), "files": files}
    return _rms(book[codes][labels] - flat)


def _rms(errors: FloatArray) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _texture_shape(count: int) -> tuple[int, int]:
    """Rows and columns of a nearly square texture, both multiples of 4."""
    width = 4 * int(np.ceil(np.sqrt(count) / 4))
    height = 4 * int(np.ceil(count / width / 4))
    if max(width, height) > MAX_SIDE_PX:
        raise BadInput(f"{count:,} Gaussians do not fit into SOG's textures of {MAX_SIDE_PX}² pixels: write PLY or SPZ.")
    return height, width


def _texture(values: NDArray[Any], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Bytes (N,3) or (N,4) as a texture (H,W,3) or (H,W,4), filled up with the last ones."""
    pad = shape[0] * shape[1] - len(values)
    filled = np.concatenate([values.astype(np.uint8), np.repeat(values[-1:].astype(np.uint8), pad, axis=0)])
    return filled.reshape(*shape, values.shape[1])


def _webp(texture: NDArray[np.uint8]) -> bytes:
    content = io.BytesIO()
    # Exact: else bytes under an alpha of 0 are dropped, as OpenCV's encoder does. Method 4 takes
    # four times as long as 2 for files as large.
    Image.fromarray(texture).save(content, "WEBP", lossless=True, exact=True, quality=50, method=2)
    return content.getvalue()


def _quat_bytes(quats: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Bytes (N,4) of rotations (N,4) wxyz."""
    unit = unit_quats(quats)
    largest = np.abs(unit).argmax(axis=1)
    rows = np.arange(len(unit))
    unit = np.where(unit[rows, largest, None] < 0, -unit, unit)
    components = unit[rows[:, None], _STORED_COMPONENTS[largest]]
    return np.column_stack([np.clip(np.rint(255 * (0.5 + components / np.sqrt(2))), 0, 255), 252 + largest]).astype(np.uint8)


def _quantize(values: FloatArray, worth: FloatArray | None = None) -> tuple[NDArray[np.uint8], FloatArray]:
    """Codes of the shape of `values`, and 256 rising values: Lloyd's iteration on a histogram, of
    what each is worth if that is given, begun with a density ∝ f^⅓."""
    low, high = float(values.min()), float(values.max())
    if high <= low:
        return np.zeros(values.shape, np.uint8), np.full(CODES, low)
    counts, edges = np.histogram(values, HISTOGRAM_BINS, (low, high), weights=worth)
    middles = (edges[:-1] + edges[1:]) / 2
    mass = np.cumsum(np.cbrt(counts) + 1e-9)
    book = np.interp((np.arange(CODES) + 0.5) / CODES * mass[-1], mass, middles)
    for _ in range(LLOYD_ROUNDS):
        owner = np.searchsorted((book[:-1] + book[1:]) / 2, middles)
        weights = np.bincount(owner, counts, CODES)
        sums = np.bincount(owner, counts * middles, CODES)
        book = np.maximum.accumulate(np.divide(sums, weights, out=book.copy(), where=weights > 0))
    codes = np.searchsorted((book[:-1] + book[1:]) / 2, values)
    worth = np.ones_like(values) if worth is None else worth
    sizes, sums = np.bincount(codes.ravel(), worth.ravel(), CODES), np.bincount(codes.ravel(), (worth * values).ravel(), CODES)
    return codes.astype(np.uint8), np.divide(sums, sizes, out=book, where=sizes > 0)


def _row_palette(rows: NDArray[np.float32]) -> tuple[NDArray[np.int64], FloatArray]:
    """Labels (N,) and palette (R,F), R ≤ 65,536, of rows (N,F): the rows where they are few."""
    if len(rows) <= MAX_ROWS:
        return np.arange(len(rows)), rows.astype(np.float64)
    labels = np.zeros(len(rows), np.int64)
    for _ in range(int(np.log2(MAX_ROWS))):
        count = int(labels.max()) + 1
        means = _group_means(rows, labels, count)
        spread = _group_means((rows - means[labels]) ** 2, labels, count)
        axis = spread.argmax(axis=1)[labels]
        every = np.arange(len(rows))
        above = rows[every, axis] > means[labels, axis]
        # Groups of equal rows are not split: their numbers stay free.
        labels = 2 * labels + above
        is_used = np.bincount(labels) > 0
        labels = (np.cumsum(is_used) - 1)[labels]
    return labels, _group_means(rows, labels, int(labels.max()) + 1)


def _group_means(rows: NDArray[Any], labels: NDArray[np.int64], count: int) -> FloatArray:
    sizes = np.bincount(labels, minlength=count)
    return np.stack([np.bincount(labels, column, count) for column in rows.T], axis=1) / sizes[:, None]
