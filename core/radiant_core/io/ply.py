"""Models as PLY files in the layout of the original 3DGS code. Once per model.

One binary little-endian float32 record per Gaussian: x y z, nx ny nz (zero), f_dc_0..2, f_rest_*
(all bases of red, then of green, then of blue), opacity (logit), scale_0..2 (ln m), rot_0..3
(wxyz). An antialiased model says so in two comments: ours, and "SplatRenderMode: mip", which Brush
and PlayCanvas's tools read; Postshot's "antialiased 1" is read too. Layout: Kerbl et al., 3D
Gaussian Splatting (2023), its published models. The reader is strict: PLY files come from
strangers.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.run_store import atomic_writer, open_without_waiting
from radiant_core.splats import Splats

MAX_HEADER_LINES = 2000
MAX_LINE_BYTES = 1000
ANTIALIASED, RENDER_MODE = "antialiased", "SplatRenderMode:"
CHUNK_ROWS = 65536
"""Gaussians written at a time: 16 MB, so that writing takes no second copy of a large model."""
CACHED_ROWS = 4096
"""Gaussians taken apart at a time, which a core's cache holds."""

MEANS = ("x", "y", "z")
SH0 = ("f_dc_0", "f_dc_1", "f_dc_2")
LOG_SCALES = ("scale_0", "scale_1", "scale_2")
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")

SCALAR_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "<i2", "int16": "<i2", "ushort": "<u2", "uint16": "<u2",
    "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4",
    "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip


def save_ply(path: Path, splats: Splats, comments: Sequence[str] = ()) -> None:
    """Write N Gaussians to `path`, atomically, with lines of text in the header; BadInput when it
    cannot be written."""
    rest = tuple(f"f_rest_{index}" for index in range(3 * splats.shN.shape[1]))
    names = (*MEANS, "nx", "ny", "nz", *SH0, *rest, "opacity", *LOG_SCALES, *QUATS)
    properties = "".join(f"property float {name}\n" for name in names)
    lines = ((ANTIALIASED, f"{RENDER_MODE} mip") if splats.antialiased else ()) + tuple(comments)
    comment = "".join(f"comment {line}\n" for line in lines)
    with atomic_writer(path) as file:
        file.write(f"ply\nformat binary_little_endian 1.0\n{comment}element vertex {len(splats)}\n{properties}end_header\n".encode())
        for start in range(0, len(splats), CHUNK_ROWS):
            rows = _rows(splats.select(np.arange(start, min(start + CHUNK_ROWS, len(splats)))))
            file.write(np.asarray(rows, "<f4").tobytes())


def load_ply(path: Path) -> Splats:
    """Read the Gaussians of a 3DGS PLY file; other scalar properties are skipped.

    Args:
        path: a binary little-endian file, such as the scene.ply of a run.

    Returns:
        The Gaussians before activation, in the order of the file.

    Raises:
        BadInput: the file is missing, no such PLY, of another length than its header says, or has
            values that are not finite; the message names it.
    """
    try:
        with open(path, "rb", opener=open_without_waiting) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise BadInput("it is no regular file")
            count, dtype, antialiased = _read_header(file)
            num_bytes = os.fstat(file.fileno()).st_size - file.tell()
            if num_bytes != count * dtype.itemsize:
                raise BadInput(f"it has {num_bytes} bytes after the header, expected {count} Gaussians of {dtype.itemsize} bytes")
            rows = np.fromfile(file, dtype, count)
            if len(rows) != count:
                raise BadInput(f"it ends after {len(rows)} of {count} Gaussians")
            return _splats(rows, antialiased)
    except OSError as error:
        raise BadInput(f"cannot read {path}: {error.strerror or error}: check the path.") from error
    except BadInput as error:
        raise BadInput(f"cannot use {path}: {str(error).rstrip('.')}: export it as a binary 3DGS PLY file.") from error


def _rows(splats: Splats) -> NDArray[np.float32]:
    """One row of floats per Gaussian (N,14+3K), in the order of the properties."""
    count = len(splats)
    red_green_blue = splats.shN.transpose(2, 0, 1)
    normals = np.zeros((count, 3), np.float32)
    opacities = splats.logit_opacities[:, None]
    return np.hstack([splats.means, normals, splats.sh0[:, 0], *red_green_blue, opacities, splats.log_scales, splats.quats])


def _read_header(file: IO[bytes]) -> tuple[int, np.dtype, bool]:
    """Number of Gaussians, the type of one record, and whether the model is antialiased; the file
    stands behind the header."""
    if _header_words(file) != ["ply"] or _header_words(file) != ["format", "binary_little_endian", "1.0"]:
        raise BadInput("it does not begin as a binary little-endian PLY file of version 1.0")
    count: int | None = None
    properties: dict[str, str] = {}
    antialiased = False
    for _ in range(MAX_HEADER_LINES):
        match _header_words(file):
            case ["comment", *words] if words in ([ANTIALIASED], [ANTIALIASED, "1"], [RENDER_MODE, "mip"]):
                antialiased = True
            case ["comment" | "obj_info", *_]:
                pass
            case ["element", "vertex", digits] if count is None and re.fullmatch("[0-9]{1,15}", digits):
                count = int(digits)
            case ["property", scalar, name] if count is not None and scalar in SCALAR_TYPES and name not in properties:
                properties[name] = SCALAR_TYPES[scalar]
            case ["end_header"] if count is not None and properties:
                return count, np.dtype(list(properties.items())), antialiased
            case words:
                raise BadInput(f"its header line {' '.join(words)[:80]!r} is not one of a 3DGS PLY file")
    raise BadInput(f"its header has over {MAX_HEADER_LINES} lines")


def _header_words(file: IO[bytes]) -> list[str]:
    line = file.readline(MAX_LINE_BYTES)
    if not line.endswith(b"\n"):
        raise BadInput(f"its header ends early or has a line of over {MAX_LINE_BYTES} bytes")
    return line.decode("latin-1").split()


def _splats(rows: NDArray[np.void], antialiased: bool) -> Splats:
    names = rows.dtype.names or ()
    num_rest = sum(name.startswith("f_rest_") for name in names)
    if num_rest not in (0, 9, 24, 45):
        raise BadInput(f"it has {num_rest} f_rest properties, expected 0, 9, 24 or 45 (degree 0 to 3)")
    wanted = (*MEANS, *SH0, *(f"f_rest_{index}" for index in range(num_rest)), "opacity", *LOG_SCALES, *QUATS)
    missing = [name for name in wanted if name not in names or rows.dtype[name].kind != "f"]
    if missing:
        raise BadInput(f"it has no property {missing[0]!r} of a floating type")
    return Splats(
        means=_columns(rows, MEANS),
        quats=_columns(rows, QUATS),
        log_scales=_columns(rows, LOG_SCALES),
        logit_opacities=_columns(rows, ("opacity",))[:, 0],
        sh0=_columns(rows, SH0)[:, None, :],
        shN=_columns(rows, wanted[6 : 6 + num_rest]).reshape(len(rows), 3, num_rest // 3).transpose(0, 2, 1),
        antialiased=antialiased,
    )


def _columns(rows: NDArray[np.void], names: Sequence[str]) -> NDArray[np.float32]:
    """The named properties as (N,len(names)); a double beyond float32 is refused as infinite."""
    columns = np.empty((len(rows), len(names)), np.float32)
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        # Rows that fit the cache: property after property would read the whole file for each.
        for start in range(0, len(rows), CACHED_ROWS):
            part = slice(start, start + CACHED_ROWS)
            for column, name in zip(columns[part].T, names, strict=True):
                column[:] = rows[part][name]
    return columns
