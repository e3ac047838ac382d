"""Lines and dots over one axis, such as quality against epochs. Once per benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from benchmarks.charts.curve_style import CurveStyle, curve_style
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import axes_at, figure_image, style_axes, titled_figure

PANEL_WH, LEFT_PX, FOOT_PX, TOP_PX, GAP_PX = (520, 400), 76, 58, 76, 30


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """x, y (K,) finite; `dotted`: dots without a line; `marked`: dots on the line."""

    name: str
    x: FloatArray
    y: FloatArray
    dotted: bool = False
    marked: bool = False
    style: int | None = None
    """Index for `curve_style`; by the order of names where None."""

    def __post_init__(self) -> None:
        x = check_array(f"x of {self.name}", self.x, (None,))
        object.__setattr__(self, "x", x)
        object.__setattr__(self, "y", check_array(f"y of {self.name}", self.y, (len(x),)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """Lines over one pair of axes whose labels name quantity and unit."""

    lines: tuple[Line, ...]
    x_label: str
    y_label: str
    y_range: tuple[float, float] | None = None
    """None: from 0 to a little above the highest value."""
    x_ticks: tuple[float, ...] = ()
    """Labels of the horizontal axis; automatic where empty."""


def line_picture(panels: Sequence[Panel], title: str, detail: str = "", panel_wh: tuple[int, int] = PANEL_WH) -> Image:
    """Return panels side by side (H,W,3), each `panel_wh` px; BadInput without any value."""
    if not any(len(line.x) for panel in panels for line in panel.lines):
        raise BadInput("there is no line to draw: give at least one value.")
    width = len(panels) * (LEFT_PX + panel_wh[0] + GAP_PX)
    height = TOP_PX + panel_wh[1] + FOOT_PX
    figure = titled_figure((width, height), title, detail)
    styles = {name: curve_style(index) for index, name in enumerate(dict.fromkeys(line.name for panel in panels for line in panel.lines))}
    for index, panel in enumerate(panels):
        _draw_panel(axes_at(figure, (LEFT_PX + index * (LEFT_PX + panel_wh[0] + GAP_PX), FOOT_PX, *panel_wh)), panel, styles)
    return figure_image(figure)


def _draw_panel(axes: Axes, panel: Panel, styles: dict[str, CurveStyle]) -> None:
    for number, line in enumerate(panel.lines):
        style = styles[line.name] if line.style is None else curve_style(line.style)
        dots = line.dotted or len(line.x) == 1
        # Wider below, so that overlapping lines stay visible.
        width = 1.8 + 1.6 * (len(panel.lines) - 1 - number) if not line.marked else 1.8
        marker, dash = (style.marker if dots or line.marked else ""), ("none" if dots else style.dash)
        axes.plot(line.x, line.y, color=style.color, label=line.name, marker=marker, linestyle=dash, linewidth=width)
    style_axes(axes, panel.x_label, panel.y_label)
    axes.set_ylim(panel.y_range or (0, 1.08 * max(float(np.max(line.y, initial=0.0)) for line in panel.lines) or 1.0))
    if panel.x_ticks:
        axes.set_xticks(panel.x_ticks, [f"{tick:g}" for tick in panel.x_ticks])
    axes.legend(fontsize=9, frameon=False)
