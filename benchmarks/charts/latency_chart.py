"""Training time of each device under one plan and another: solid bars are measured, outlined ones
predicted, the vertical line is the slowest device. Once per comparison of plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from radiant_core.errors import BadInput
from radiant_viewer.layers.palette import BLUE, ORANGE, unit_rgb
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, SOFT_COLOR, axes_at, figure_image, titled_figure

PANEL_PX, LABEL_PX, RIGHT_PX, ROW_PX, TOP_PX, HEAD_PX, FOOT_PX = 420, 176, 20, 40, 70, 46, 78
COLORS = tuple(map(unit_rgb, (ORANGE, BLUE)))
"""Colours of the plans, in turn."""


@dataclass(frozen=True, kw_only=True)
class DeviceLatency:
    """Seconds of one device, measured and predicted; BadInput where negative or not finite."""

    name: str
    measured_s: float
    predicted_s: float

    def __post_init__(self) -> None:
        if not all(np.isfinite(value) and value >= 0 for value in (self.measured_s, self.predicted_s)):
            raise BadInput(f"device {self.name!r} takes {self.measured_s} and {self.predicted_s} s, expected two times of 0 or more.")


@dataclass(frozen=True, kw_only=True)
class PlanLatency:
    """A plan's devices from the top down, and a note below its name."""

    name: str
    note: str
    devices: tuple[DeviceLatency, ...]

    @property
    def makespan_s(self) -> float:
        """Measured time of the slowest device."""
        return max(device.measured_s for device in self.devices)


def latency_picture(plans: Sequence[PlanLatency], title: str, detail: str) -> Image:
    """Return a panel of bars per plan (H,W,3), one time axis; BadInput without plans or devices."""
    if not plans or not all(plan.devices for plan in plans):
        raise BadInput("there is no latency to draw: give at least one plan, each with at least one device.")
    rows = max(len(plan.devices) for plan in plans)
    width, height = len(plans) * (LABEL_PX + PANEL_PX + RIGHT_PX), TOP_PX + HEAD_PX + rows * ROW_PX + FOOT_PX
    figure = titled_figure((width, height), title, detail)
    longest_s = max(max(device.measured_s, device.predicted_s) for plan in plans for device in plan.devices)
    for index, plan in enumerate(plans):
        left = LABEL_PX + index * (LABEL_PX + PANEL_PX + RIGHT_PX)
        axes = axes_at(figure, (left, FOOT_PX, PANEL_PX, rows * ROW_PX))
        _draw_plan(axes, plan, rows, max(longest_s, 1e-9), COLORS[index % len(COLORS)])
        top = (height - TOP_PX - 4) / height
        figure.text(left / width, top, plan.name, size=11, weight="bold", color=INK_COLOR, va="top")
        figure.text(left / width, top - 19 / height, plan.note, size=9, color=SOFT_COLOR, va="top")
    return figure_image(figure)


def _draw_plan(axes: Axes, plan: PlanLatency, rows: int, longest_s: float, color: tuple[float, float, float]) -> None:
    for row, device in enumerate(plan.devices):
        axes.barh(row - 0.17, device.measured_s, height=0.34, color=color)
        axes.barh(row + 0.17, device.predicted_s, height=0.28, facecolor=(*color, 0.18), edgecolor=color, linewidth=1)
        for value, place in ((device.measured_s, row - 0.17), (device.predicted_s, row + 0.17)):
            axes.annotate(f"{value:.1f}", (value, place), xytext=(4, 0), textcoords="offset points", size=8, va="center", color=INK_COLOR,
                          bbox={"facecolor": "white", "pad": 1.0, "linewidth": 0})  # fmt: skip
    axes.axvline(plan.makespan_s, color=INK_COLOR, linewidth=1, linestyle=(0, (4, 3)), zorder=0.5)
    axes.barh([-9], [0], color=color, label="measured")
    axes.barh([-9], [0], facecolor=(*color, 0.18), edgecolor=color, linewidth=1, label="predicted")
    axes.set(xlim=(0, 1.16 * longest_s), ylim=(rows - 0.45, -0.55))
    axes.set_yticks(range(len(plan.devices)), [device.name for device in plan.devices], size=9, color=INK_COLOR)
    axes.set_xlabel("Training time (s)", size=9.5, color=SOFT_COLOR)
    axes.tick_params(axis="x", colors=SOFT_COLOR, labelsize=9)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=True, axis="x", color=SOFT_COLOR, alpha=0.15)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.legend(fontsize=8.5, frameon=False, loc="upper right", bbox_to_anchor=(1.0, -0.5 * FOOT_PX / (rows * ROW_PX)), ncols=2)
