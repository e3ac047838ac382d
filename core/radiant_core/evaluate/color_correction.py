"""The part of a render's error that one colour transform removes. Once per held-out image.

A photograph's exposure and white balance are unknown to a model not trained on it. The corrected
render is clip(M x + b), M (3,3), b (3,) = argmin Σ over pixels ‖M x + b − y‖² + λ ‖M − I‖² for
colours x of the render and y of the photograph. RawNeRF (Mildenhall et al. 2022) scores so with a
diagonal M; the quadratic terms of mip-NeRF 360 are left out. Fitted to the very photograph it is
scored on, its figures flatter and stand beside the plain ones. The term with λ keeps M = I where a
flat image leaves M open. Since M = I, b = 0 is allowed, the squared error never rises.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.evaluate.image_pair import Used, check_image_pair, check_used
from radiant_core.numerics import FloatArray

MIN_SPREAD = 1e-4
"""√(λ per pixel): a render whose colours vary by less than this, a fortieth of an 8-bit step, says
nothing about M."""


def correct_colors(render: ArrayLike, photograph: ArrayLike, used: Used = None) -> FloatArray:
    """The render (H,W,3) corrected towards the photograph (H,W,3) by its `used` pixels, all in
    0..1; BadInput on other shapes or values."""
    render, photograph = check_image_pair(render, photograph)
    x, missing, count = render, photograph - render, render[..., 0].size
    if used is not None:
        chosen = check_used(used, render)
        x, missing, count = np.where(chosen[..., None], x, 0), np.where(chosen[..., None], missing, 0), int(chosen.sum())
    x_mean, missing_mean = (part.sum(axis=0).sum(axis=0) / count for part in (x, missing))
    # Line by line: BLAS would share larger products out to threads, which spin on.
    lines = x.transpose(0, 2, 1)
    gram, shift = ((lines @ part).sum(axis=0) / count - np.outer(x_mean, mean) for part, mean in ((x, x_mean), (missing, missing_mean)))
    # λ is far above their rounding.
    change = np.linalg.solve(gram + MIN_SPREAD**2 * np.eye(3), shift)
    corrected = render @ (np.eye(3) + change)
    corrected += missing_mean - x_mean @ change
    return np.clip(corrected, 0, 1, out=corrected)
