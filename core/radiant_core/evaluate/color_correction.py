"""A render's error but for one colour transform of the whole image. Once per held-out image.

A photograph's exposure and white balance are unknown to a model not trained on it. Corrected:
    clip(M x + b),   M (3,3), b (3,) = argmin Σ over pixels ‖M x + b − y‖² + λ ‖M − I‖²
for colours x of the render and y of the photograph. RawNeRF (Mildenhall et al. 2022) scores so with
a diagonal M; the quadratic terms of mip-NeRF 360 are left out. Fitted to the very photograph it is
scored on, its figures flatter and stand beside the plain ones. The term with λ keeps M = I where a
flat image leaves M open. Since M = I, b = 0 is allowed, the squared error never rises.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.evaluate.image_pair import Used, check_image_pair, check_used
from radiant_core.numerics import FloatArray

MIN_SPREAD = 1e-4
"""√(λ per pixel): colours that vary by less than this, a fortieth of 1/255, do not fix M."""


def correct_colors(render: ArrayLike, photograph: ArrayLike, used: Used = None) -> FloatArray:
    """The render (H,W,3) corrected to the photograph by its `used` pixels, in 0..1, or BadInput."""
    render, photograph = check_image_pair(render, photograph)
    chosen = slice(None) if used is None else check_used(used, render).ravel()
    x, y = render.reshape(-1, 3)[chosen], photograph.reshape(-1, 3)[chosen]
    x_mean = x.mean(axis=0)
    centred = x - x_mean
    missing = y - x
    missing_mean = missing.mean(axis=0)
    gram = centred.T @ centred / len(x) + MIN_SPREAD**2 * np.eye(3)
    change = np.linalg.solve(gram, centred.T @ (missing - missing_mean) / len(x))
    return np.clip(render + missing_mean + ((render.reshape(-1, 3) - x_mean) @ change).reshape(render.shape), 0, 1)
