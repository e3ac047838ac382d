"""Models as PLY files in the layout of the original 3DGS code. Once per model.

Written: one binary little-endian float32 record per Gaussian: x y z, nx ny nz (zero), f_dc_0..2,
f_rest_* (all bases of red, then of green, then of blue), opacity (logit), scale_0..2 (ln m),
rot_0..3 (wxyz). An antialiased model says so in two comments: ours, and "SplatRenderMode: mip",
which Brush and PlayCanvas's tools read; Postshot's "antialiased 1" is read too. Layout: Kerbl et
al., 3D Gaussian Splatting (2023), its published models.

Read: the element "vertex" of any PLY (`io.ply_elements`), ASCII and big endian too, or PlayCanvas's
compressed layout (`io.compressed_ply`). PLY files come from strangers.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.compressed_ply import PACKED, ROWS_OF, gaussians_of_chunks
from radiant_core.io.ply_elements import PlyHeader, Table, read_elements
from radiant_core.io.run_store import atomic_writer
from radiant_core.io.stored_gaussians import StoredGaussians, checked
from radiant_core.splats import Splats

ANTIALIASED, RENDER_MODE = "antialiased", "SplatRenderMode:"
CHUNK_ROWS = 65536
"""Gaussians written at a time: 16 MB, so that writing takes no second copy of a large model."""

MEANS = ("x", "y", "z")
SH0 = ("f_dc_0", "f_dc_1", "f_dc_2")
LOG_SCALES = ("scale_0", "scale_1", "scale_2")
QUATS = ("rot_0", "rot_1", "rot_2", "rot_3")

VERTEX = "vertex"
NUMS_REST = (0, 9, 24, 45, 72)
"""Properties f_rest_* of degree 0 to 4."""


def save_ply(path: Path, splats: Splats, comments: Sequence[str] = ()) -> None:
    """Write N Gaussians to `path`, atomically, with lines of text in the header; BadInput when it
    cannot be written."""
    higher_bands = tuple(f"f_rest_{index}" for index in range(3 * splats.shN.shape[1]))
    names = (*MEANS, "nx", "ny", "nz", *SH0, *higher_bands, "opacity", *LOG_SCALES, *QUATS)
    properties = "".join(f"property float {name}\n" for name in names)
    lines = ((ANTIALIASED, f"{RENDER_MODE} mip") if splats.antialiased else ()) + tuple(comments)
    comment = "".join(f"comment {line}\n" for line in lines)
    with atomic_writer(path) as file:
        file.write(f"ply\nformat binary_little_endian 1.0\n{comment}element vertex {len(splats)}\n{properties}end_header\n".encode())
        for start in range(0, len(splats), CHUNK_ROWS):
            rows = _rows(splats.select(np.arange(start, min(start + CHUNK_ROWS, len(splats)))))
            file.write(np.asarray(rows, "<f4").tobytes())


def load_ply(path: Path) -> Splats:
    """Read the Gaussians of a PLY file, all or none of them; other properties and elements are
    passed over.

    Args:
        path: a file, such as the scene.ply of a run.

    Returns:
        The Gaussians before activation, in the order of the file.

    Raises:
        BadInput: the file is missing, no such PLY, of another length than its header says, or has
            values that are not finite; the message names it.
    """
    try:
        gaussians = read_ply(path)
    except BadInput as error:
        raise BadInput(f"cannot use {path}: {str(error).rstrip('.')}: export it as a binary 3DGS PLY file.") from error
    except OSError as error:
        raise BadInput(f"cannot read {path}: {error.strerror or error}: check the path.") from error
    try:
        return checked(gaussians)
    except BadInput as error:
        reason = str(error).removesuffix(": remove them first.")
        raise BadInput(f"cannot use {path}: {reason}: 'radiant export {path} NEW.ply' leaves such Gaussians out.") from error


def read_ply(path: Path) -> StoredGaussians:
    """The Gaussians of a PLY file, unchecked; BadInput, which does not name the file, as
    `load_ply` for all but the values, and OSError as `open`."""
    header, tables = read_elements(path, {VERTEX: "Gaussians", **ROWS_OF})
    if VERTEX not in tables:
        names = ", ".join(element.name for element in header.elements)
        raise BadInput(f"it has no element 'vertex', only {names[:80]!r}")
    is_antialiased = _is_antialiased(header)
    if all(tables[VERTEX].has(name, "iu") for name in PACKED):
        return gaussians_of_chunks(tables, antialiased=is_antialiased)
    return _gaussians(tables[VERTEX], antialiased=is_antialiased)


def _is_antialiased(header: PlyHeader) -> bool:
    marks = {(ANTIALIASED,), (ANTIALIASED, "1"), (RENDER_MODE, "mip")}
    return any(words in marks for words in header.comments)


def _gaussians(vertices: Table, *, antialiased: bool) -> StoredGaussians:
    num_rest = sum(name.startswith("f_rest_") for name in vertices.element.properties)
    if num_rest not in NUMS_REST:
        raise BadInput(f"it has {num_rest} f_rest properties, expected 0, 9, 24 or 45 (degree 0 to 3)")
    higher_bands = [f"f_rest_{index}" for index in range(num_rest)]
    missing = [name for name in (*MEANS, *SH0, *higher_bands, "opacity", *LOG_SCALES, *QUATS) if not vertices.has(name, "f")]
    if missing:
        raise BadInput(f"it has no property {missing[0]!r} of a floating type, which Gaussians have and points and meshes have not")
    return StoredGaussians(
        means=vertices.columns(MEANS),
        quats=vertices.columns(QUATS),
        log_scales=vertices.columns(LOG_SCALES),
        logit_opacities=vertices.columns(("opacity",))[:, 0],
        sh0=vertices.columns(SH0)[:, None, :],
        shN=vertices.columns(higher_bands).reshape(len(vertices), 3, num_rest // 3).transpose(0, 2, 1),
        antialiased=antialiased,
    )


def _rows(splats: Splats) -> NDArray[np.float32]:
    """One row of floats per Gaussian (N,14+3K), in the order of the properties."""
    count = len(splats)
    red_green_blue = splats.shN.transpose(2, 0, 1)
    normals = np.zeros((count, 3), np.float32)
    opacities = splats.logit_opacities[:, None]
    return np.hstack([splats.means, normals, splats.sh0[:, 0], *red_green_blue, opacities, splats.log_scales, splats.quats])
