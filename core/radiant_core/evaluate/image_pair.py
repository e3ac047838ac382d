"""What every image error asks of a render and its photograph. Once per image and figure."""

from __future__ import annotations

from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, checked_array


def checked_image_pair(render: ArrayLike, photograph: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Both images (H,W,3) as float64; BadInput when shapes differ, there are no pixels, or a value is not finite or outside 0..1."""
    pair = [checked_array(name, image, (None, None, 3)) for name, image in (("render", render), ("photograph", photograph))]
    if pair[0].shape != pair[1].shape:
        raise BadInput(f"a render {pair[0].shape} is compared with a photograph {pair[1].shape}: give them the same size.")
    if pair[0].size == 0:
        raise BadInput("an image without pixels cannot be compared.")
    for name, image in zip(("render", "photograph"), pair, strict=True):
        if image.min() < 0 or image.max() > 1:
            raise BadInput(f"the {name} has values {image.min():.3g} to {image.max():.3g}, expected 0 to 1: clamp it first.")
    return pair[0], pair[1]
