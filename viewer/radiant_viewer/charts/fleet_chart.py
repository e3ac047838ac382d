"""Time of each method against the number of clients, one panel per system, with the band of its assumptions. Drawn once per benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.ticker import FuncFormatter, NullFormatter

from radiant_core.errors import BadInput
from radiant_viewer.layers.palette import CATEGORIES, unit_rgb
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, axes_at, figure_image, style_axes, titled_figure

WIDTH_PX, HEIGHT_PX, TOP_PX, LEFT_PX, FOOT_PX = 1100, 560, 104, 72, 58
Row = tuple[float, ...]


def fleet_picture(panels: Mapping[str, Mapping[str, Sequence[Row]]]) -> Image:
    """Draw panel → method → rows (clients, seconds, low, high) on logarithmic axes; BadInput without rows or for one not positive."""
    rows = [row for lines in panels.values() for line in lines.values() for row in line]
    if not rows:
        raise BadInput("there is no fleet to draw: give at least one row.")
    if not all(len(row) == 4 and np.isfinite(row).all() and min(row) > 0 for row in rows):
        raise BadInput("a row of a fleet is not four positive numbers: clients, seconds, low, high.")
    detail = "Bands: 5th to 95th percentile with every curve and uplink within ±30 %"
    figure = titled_figure((WIDTH_PX, HEIGHT_PX), "Time until the scene is whole, simulated", detail)
    names = list(dict.fromkeys(name for lines in panels.values() for name in lines))
    values = [value for row in rows for value in row[1:]]
    for index, (panel, lines) in enumerate(panels.items()):
        width_px = WIDTH_PX // len(panels)
        axes = axes_at(figure, (LEFT_PX + index * width_px, FOOT_PX, width_px - LEFT_PX - 20, HEIGHT_PX - TOP_PX - FOOT_PX))
        for name, line in lines.items():
            clients, seconds, low, high = np.array(sorted(line)).T
            color = unit_rgb(CATEGORIES[names.index(name) % len(CATEGORIES)])
            axes.plot(clients, seconds / 60, color=color, linewidth=1.8, marker="o", markersize=3.5, label=name)
            axes.fill_between(clients, low / 60, high / 60, color=color, alpha=0.15, linewidth=0)
        axes.set(xscale="log", yscale="log", ylim=(min(values) / 60 * 0.7, max(values) / 60 * 1.4))
        ticks = sorted({row[0] for line in lines.values() for row in line})
        axes.set_xticks(ticks[:: max(1, -(-len(ticks) // 6))])
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
            axis.set_minor_formatter(NullFormatter())
        axes.set_title(panel, size=11, color=INK_COLOR, loc="left")
        style_axes(axes, "Clients (devices)", "Time (min)")
        if index == 0:
            axes.legend(fontsize=8.5, frameon=False, loc="upper left")
    return figure_image(figure)
