"""The effect of slack: distance and border length over the makespan. Once per plan, on request."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from radiant_core.errors import BadInput
from radiant_core.plan.counts.slack_curve import SlackPoint
from radiant_viewer.layers.palette import BLUE, ORANGE, unit_rgb
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, axes_at, figure_image, style_axes, titled_figure

WIDTH_PX, HEIGHT_PX, TOP_PX, LEFT_PX, FOOT_PX = 1100, 460, 76, 72, 58
MIN_GAP = 0.05
"""Least distance of two labels along the makespan, as a share of the axis."""


def slack_picture(points: Sequence[SlackPoint], unit: str = "m") -> Image:
    """Return two panels over the makespan (H,W,3), a dot per slack, lengths in `unit`; BadInput
    without points."""
    if not points:
        raise BadInput("there is no slack curve to draw: give at least one point.")
    detail = "Each dot is the plan of least Σ distance² whose makespan is at most slack times the shortest"
    figure = titled_figure((WIDTH_PX, HEIGHT_PX), "What slack buys", detail)
    distance, border = f"Distance from camera to edge, rms ({unit})", f"Borders between regions ({unit})"
    panels = (("rms_distance_m", distance, BLUE), ("border_m", border, ORANGE))
    for panel, (name, label, color) in enumerate(panels):
        axes = axes_at(figure, (LEFT_PX + panel * WIDTH_PX // 2, FOOT_PX, WIDTH_PX // 2 - LEFT_PX - 20, HEIGHT_PX - TOP_PX - FOOT_PX))
        _draw(axes, points, name, unit_rgb(color))
        style_axes(axes, "Predicted makespan (s)", label)
    return figure_image(figure)


def _draw(axes: Axes, points: Sequence[SlackPoint], name: str, color: tuple[float, float, float]) -> None:
    makespans = np.array([point.makespan_s for point in points])
    values = np.array([float(getattr(point, name)) for point in points])
    axes.plot(makespans, values, color=color, linewidth=1.8, marker="o", markersize=5)
    width = float(np.ptp(makespans)) or 1.0
    labelled = -np.inf
    for point, makespan_s, value in zip(points, makespans, values, strict=True):
        if makespan_s - labelled >= MIN_GAP * width:
            text = f"{point.slack:g}×"
            axes.annotate(text, (makespan_s, value), xytext=(5, 6), textcoords="offset points", size=8.5, color=INK_COLOR)
            labelled = makespan_s
    axes.margins(x=0.08, y=0.15)
    axes.xaxis.set_major_locator(MaxNLocator(6))
    axes.yaxis.set_major_locator(MaxNLocator(6))
