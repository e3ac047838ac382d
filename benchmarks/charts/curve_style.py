"""Curves that are told apart by colour, dash and marker, also in grey. Once per curve."""

from __future__ import annotations

from dataclasses import dataclass

from radiant_viewer.layers.palette import CURVE_COLORS, unit_rgb

DASHES = ("-", "--", ":", "-.")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "h", "<", ">")


@dataclass(frozen=True, kw_only=True)
class CurveStyle:
    """How a curve is drawn: colour, channels in 0..1, matplotlib's names of dash and marker."""

    color: tuple[float, float, float]
    dash: str
    marker: str


def curve_style(index: int) -> CurveStyle:
    """Return the style of curve `index` ≥ 0; styles repeat after 308 curves, markers after 11."""
    dash = DASHES[index // len(CURVE_COLORS) % len(DASHES)]
    return CurveStyle(color=unit_rgb(CURVE_COLORS[index % len(CURVE_COLORS)]), dash=dash, marker=MARKERS[index % len(MARKERS)])
