"""What every image error requires of a render and its photograph. Once per image and figure."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array

Used = NDArray[np.bool_] | None
"""Which pixels (H,W) of a photograph are compared; None: all of them."""


def check_image_pair(render: ArrayLike, photograph: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Both images (H,W,3) as float64; BadInput unless shapes agree and all values are in 0..1."""
    pair = [check_array(name, image, (None, None, 3)) for name, image in (("render", render), ("photograph", photograph))]
    if pair[0].shape != pair[1].shape:
        raise BadInput(f"a render {pair[0].shape} is compared with a photograph {pair[1].shape}: give them the same size.")
    if pair[0].size == 0:
        raise BadInput("an image without pixels cannot be compared.")
    for name, image in zip(("render", "photograph"), pair, strict=True):
        if image.min() < 0 or image.max() > 1:
            raise BadInput(f"the {name} has values {image.min():.3g} to {image.max():.3g}, expected 0 to 1: clamp it first.")
    return pair[0], pair[1]


def check_used(used: NDArray[np.bool_], image: FloatArray) -> NDArray[np.bool_]:
    """`used` (H,W) for an image (H,W,3); BadInput where it is of another size or leaves nothing."""
    used = check_array("used", used, image.shape[:2], np.bool_)
    if not used.any():
        raise BadInput("a mask leaves nothing of a photograph to compare: leave that photograph out.")
    return used


def replace_unused(render: ArrayLike, photograph: ArrayLike, used: Used) -> FloatArray:
    """The render (H,W,3), and the photograph where it is not `used`."""
    render = np.asarray(render)
    return render if used is None else np.where(check_used(used, render)[..., None], render, photograph)
