"""PSNR against CPU seconds and against Gaussians, one line per variant. Once per benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullFormatter

from benchmarks.charts.curve_style import CurveStyle, curve_style
from radiant_core.errors import BadInput
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import axes_at, figure_image, style_axes, titled_figure

WIDTH_PX, HEIGHT_PX, TOP_PX, LEFT_PX, FOOT_PX = 1100, 520, 76, 72, 58
MIN_LABEL_GAP = 0.14
"""Least distance of two labels, as a share of the axis."""


@dataclass(frozen=True, kw_only=True)
class CurvePoint:
    """One trained model: CPU seconds, Gaussians, PSNR in dB; BadInput unless finite and > 0."""

    cpu_s: float
    num_gaussians: float
    psnr_db: float

    def __post_init__(self) -> None:
        if not all(np.isfinite(value) and value > 0 for value in (self.cpu_s, self.num_gaussians, self.psnr_db)):
            raise BadInput(f"a point of a curve is {self}, expected three positive numbers.")


def curve_picture(
    curves: Mapping[str, Sequence[CurvePoint]], title: str, detail: str, time_label: str = "CPU time of training (s)"
) -> Image:
    """Return all points (H,W,3), with lines through the means of points of about equal seconds;
    BadInput without points."""
    if not any(curves.values()):
        raise BadInput("there is no curve to draw: give at least one point.")
    figure = titled_figure((WIDTH_PX, HEIGHT_PX), title, detail)
    for panel, (name, label) in enumerate((("cpu_s", time_label), ("num_gaussians", "Gaussians"))):
        left_px = LEFT_PX + panel * WIDTH_PX // 2
        axes = axes_at(figure, (left_px, FOOT_PX, WIDTH_PX // 2 - LEFT_PX - 20, HEIGHT_PX - TOP_PX - FOOT_PX))
        for index, (variant, points) in enumerate(curves.items()):
            _draw(axes, points, name, variant, curve_style(index))
        style_axes(axes, label, "PSNR of held-out photographs (dB)")
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}" if value >= 1 else f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_major_locator(MaxNLocator(6))
        axes.set_xticks(_spread_labels([getattr(point, name) for points in curves.values() for point in points]))
        if panel == 0:
            axes.legend(fontsize=9, frameon=False, loc="lower right")
    return figure_image(figure)


def _spread_labels(values: Sequence[float]) -> list[float]:
    """Return rounded values, the smallest first, with space for labels on a logarithmic axis."""
    rounded = sorted({float(f"{value:.2g}") for value in values})
    labels = rounded[:1]
    for value in rounded[1:]:
        if np.log(value / labels[-1]) > MIN_LABEL_GAP * np.log(max(rounded[-1] / rounded[0], 1.01)):
            labels.append(value)
    return labels


def _draw(axes: Axes, points: Sequence[CurvePoint], name: str, label: str, style: CurveStyle) -> None:
    xs, ys = [getattr(point, name) for point in points], [point.psnr_db for point in points]
    axes.scatter(xs, ys, s=40, color=[style.color], marker=style.marker, zorder=3)
    groups: dict[float, list[CurvePoint]] = {}
    for point in points:
        groups.setdefault(float(f"{point.cpu_s:.2g}"), []).append(point)
    means = [
        (np.mean([getattr(point, name) for point in group]), np.mean([point.psnr_db for point in group]))
        for _, group in sorted(groups.items())
    ]
    axes.plot([mean[0] for mean in means], [mean[1] for mean in means], color=style.color, linestyle=style.dash, linewidth=1.8, zorder=2)
    dash = style.dash if len(means) > 1 else "none"
    axes.plot([], [], color=style.color, linestyle=dash, marker=style.marker, markersize=5, linewidth=1.8, label=label)
