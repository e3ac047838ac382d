"""Colours that stay apart for colour-blind readers, shades, and one perceptual heat scale; (3,)
uint8, sRGB. Once per layer.

The hues are those of Okabe and Ito (Color Universal Design, 2008), each moved by at most 16 of
CIELAB to where a search found the least difference of two of them the largest for deuteranopes,
with no less contrast to white and to a dark view than 3 : 1 or theirs, less 0.02."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

ColorArray = NDArray[np.uint8]

BLUE, ORANGE, GREEN = (15, 103, 183), (221, 153, 31), (22, 158, 108)
VERMILLION, PURPLE, SKY, YELLOW = (176, 65, 0), (178, 116, 166), (82, 179, 248), (254, 226, 0)
BLACK, GREY, WHITE, INK = (0, 0, 0), (150, 150, 150), (255, 255, 255), (40, 44, 52)

PALE = 200
"""A colour whose channels all exceed this is not seen on white: it gets a darker rim."""
CATEGORIES = (BLUE, ORANGE, GREEN, SKY, PURPLE, VERMILLION, YELLOW)
"""Colours of edges, in order: to deuteranopes (Machado et al. 2009) the first three differ by 55 of
CIELAB, all by 27; to protanopes all by 25."""

CURVE_COLORS = (BLUE, ORANGE, GREEN, PURPLE, VERMILLION, SKY, BLACK)
"""Colours of curves, in order: yellow is too faint for a thin line on white."""


def rgb(color: ColorArray) -> tuple[int, int, int]:
    """Return a colour (3,) as plain numbers."""
    return int(color[0]), int(color[1]), int(color[2])


def unit_rgb(color: Sequence[int]) -> tuple[float, float, float]:
    """Return a colour with channels in 0..1, as matplotlib takes it."""
    return color[0] / 255, color[1] / 255, color[2] / 255


def tint(color: ArrayLike, toward: ArrayLike, share: float) -> ColorArray:
    """Mix colours (…,3) with `share` (0 to 1) of `toward` (3,); returns uint8."""
    mixed = (1 - share) * np.asarray(color, np.float64) + share * np.asarray(toward, np.float64)
    return np.rint(mixed).astype(np.uint8)


def category_colors(count: int) -> ColorArray:
    """Return colours (count,3) of regions: seven hues, then lighter, then darker ones; they repeat
    from the 22nd on."""
    hues = np.array(CATEGORIES, np.uint8)
    shades = np.concatenate([hues, tint(hues, WHITE, 0.45), tint(hues, BLACK, 0.4)])
    return shades[np.arange(count) % len(shades)]


def shade_colors(color: ArrayLike, count: int) -> ColorArray:
    """Return shades (count,3) of one hue from dark to light, for the devices of an edge."""
    if count == 1:
        return np.asarray(color, np.uint8)[None]
    steps = np.linspace(-0.3, 0.5, count)
    return np.stack([tint(color, WHITE if step > 0 else BLACK, abs(step)) for step in steps])


def heat_table(start: float = 0.0) -> ColorArray:
    """Return 256 colours (256,3) of viridis from its share `start` on: dark violet to yellow,
    readable in grey and for every kind of colour vision."""
    from matplotlib import colormaps

    return np.rint(255 * colormaps["viridis"](np.linspace(start, 1, 256))[:, :3]).astype(np.uint8)


def trim_heat_colors(colors: ColorArray, start: float) -> ColorArray:
    """Map colours (N,3) of the whole scale to the one that begins at `start`; others stay."""
    packed, whole = (table.astype(np.int64) @ (1 << 16, 1 << 8, 1) for table in (colors, heat_table()))
    order = np.argsort(whole)
    places = order[np.clip(np.searchsorted(whole[order], packed), 0, len(order) - 1)]
    return np.where((whole[places] == packed)[:, None], heat_table(start)[places], colors)


def heat_colors(values: ArrayLike, low: float, high: float) -> ColorArray:
    """Return the colours (N,3) of finite values (N,), clipped to low … high."""
    span = high - low if high > low else 1.0
    shares = (np.clip(np.asarray(values, np.float64), low, low + span) - low) / span
    return heat_table()[np.rint(255 * shares).astype(np.int64)]
