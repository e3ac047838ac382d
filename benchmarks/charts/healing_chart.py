"""A border as several ways of joining leave it, beside the photograph, above their errors. Once per
benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, SOFT_COLOR, axes_at, figure_image, new_figure

CELL_PX, GAP_PX, TOP_PX, CAPTION_PX, FOOT_PX = 330, 12, 68, 26, 12
GAIN = 3
"""Factor by which differences are brightened."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Healed:
    """The render (H,W,3) uint8 of one way of joining, and its caption."""

    caption: str
    image: Image


def healing_picture(photograph: Image, band: NDArray[np.bool_], healed: Sequence[Healed], title: str, detail: str = "") -> Image:
    """Return the photograph (H,W,3) and the renders, above the band (H,W) and the differences × 3;
    BadInput without renders, or where sizes differ."""
    if not healed or 0 in photograph.shape:
        raise BadInput("there is no border to draw: give a photograph and at least one picture of it.")
    for name, shape in (("the band", (*band.shape, 3)), *((one.caption, one.image.shape) for one in healed)):
        if shape != photograph.shape:
            raise BadInput(f"{name} is of {shape[1]} × {shape[0]} px, the photograph of {photograph.shape[1]} × {photograph.shape[0]}.")
    cell_h = round(CELL_PX * photograph.shape[0] / photograph.shape[1])
    width = GAP_PX + (len(healed) + 1) * (CELL_PX + GAP_PX)
    height = TOP_PX + 2 * (cell_h + CAPTION_PX) + FOOT_PX
    figure = new_figure((width, height))
    figure.text(GAP_PX / width, 1 - 12 / height, title, size=14, weight="bold", color=INK_COLOR, va="top")
    figure.text(GAP_PX / width, 1 - 38 / height, detail, size=9.5, color=SOFT_COLOR, va="top")
    top = height - TOP_PX - cell_h
    for column, (caption, image) in enumerate([("Photograph", photograph), *((one.caption, one.image) for one in healed)]):
        left = GAP_PX + column * (CELL_PX + GAP_PX)
        axes = axes_at(figure, (left, top, CELL_PX, cell_h))
        _draw(axes, image)
        figure.text(left / width, (top - 6) / height, caption, size=9.5, color=INK_COLOR, va="top")
        below = axes_at(figure, (left, top - cell_h - CAPTION_PX, CELL_PX, cell_h))
        if column:
            _draw(below, np.minimum(255, GAIN * np.abs(image.astype(np.int16) - photograph)).astype(np.uint8))
            continue
        _draw(below, np.where(band[..., None], photograph, (255 - (255 - photograph.astype(np.int16)) // 4).astype(np.uint8)))
        _outline(below, band)
    under = (FOOT_PX + CAPTION_PX - 6) / height
    figure.text(GAP_PX / width, under, "The band beside the border", size=9.5, color=INK_COLOR, va="top")
    text = f"Differences from the photograph × {GAIN}: black is equal"
    figure.text((2 * GAP_PX + CELL_PX) / width, under, text, size=9.5, color=INK_COLOR, va="top")
    return figure_image(figure)


def _draw(axes: Axes, image: Image) -> None:
    axes.imshow(image, aspect="auto", interpolation="antialiased")
    axes.set_axis_off()


def _outline(axes: Axes, band: NDArray[np.bool_]) -> None:
    """Draw white on black, visible on bright and on dark ground."""
    if band.any() and not band.all():
        axes.contour(band.astype(float), levels=[0.5], colors="black", linewidths=2.2)
        axes.contour(band.astype(float), levels=[0.5], colors="white", linewidths=1.0)
