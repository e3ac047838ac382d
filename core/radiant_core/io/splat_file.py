"""Gaussians as .splat, the rows of antimatter15's viewer. Once per file.

32 bytes a Gaussian, without a header: 3 × float32 centre, 3 × float32 scale (linear), r g b and
opacity in 255 steps, rotation w x y z as round(128 q + 128). Colour is 0.5 + SH_C0 · sh0; there are
no harmonics above it. Source: gsplat 1.5.3 (`exporter.py`), checked against it and splat-transform.
"""

from __future__ import annotations

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.stored_gaussians import END_OPACITY, StoredGaussians
from radiant_core.splats import SH_C0

ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("quat", "u1", 4)])
MAX_SPLAT_BYTES = 1 << 32


def gaussians_of_splat(data: bytes) -> StoredGaussians:
    """The N Gaussians of a .splat, unchecked; BadInput where it is not rows of 32 bytes."""
    if not data or len(data) % ROW.itemsize:
        raise BadInput(f"it has {len(data)} bytes, expected a multiple of {ROW.itemsize}, as .splat has a Gaussian")
    rows = np.frombuffer(data, ROW)
    with np.errstate(divide="ignore", invalid="ignore"):
        # 0 becomes −∞, a Gaussian without thickness; a negative size is none.
        log_scales = np.log(rows["scale"].astype(np.float64))
    opacity = np.clip(rows["color"][:, 3] / 255, END_OPACITY, 1 - END_OPACITY)
    return StoredGaussians(
        means=rows["mean"],
        quats=(rows["quat"] - 128.0) / 128,
        log_scales=log_scales,
        logit_opacities=np.log(opacity) - np.log1p(-opacity),
        sh0=((rows["color"][:, :3] / 255 - 0.5) / SH_C0)[:, None, :],
        shN=np.zeros((len(rows), 0, 3)),
    )
