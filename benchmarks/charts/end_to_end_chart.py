"""End-to-end latency of methods, a panel per system: solid bars are emulated, by phase, outlined
ones simulated, and beside each stands the quality that it was reached with. Once per comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from radiant_core.errors import BadInput
from radiant_viewer.layers.palette import BLUE, GREEN, GREY, ORANGE, PURPLE, unit_rgb
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, SOFT_COLOR, axes_at, figure_image, titled_figure

PANEL_PX, LABEL_PX, NOTE_PX, ROW_PX, TOP_PX, HEAD_PX, FOOT_PX = 620, 250, 190, 46, 62, 30, 46
KEYS_PX = 52
COLORS = tuple(map(unit_rgb, (BLUE, ORANGE, GREEN, PURPLE)))
"""Of the phases in turn."""


@dataclass(frozen=True, kw_only=True)
class MethodLatency:
    """ends_s: when each phase ends, rising; simulated_s: until the end of `simulated_phases` of
    them, None where nothing was simulated. BadInput for times that fall or are not finite."""

    name: str
    ends_s: tuple[float, ...]
    simulated_s: float | None
    note: str

    def __post_init__(self) -> None:
        times_s = np.array([0.0, *self.ends_s, *([] if self.simulated_s is None else [self.simulated_s])])
        if not np.isfinite(times_s).all() or times_s.min() < 0 or (np.diff([0.0, *self.ends_s]) < 0).any():
            raise BadInput(f"{self.name!r} has phases that end at {self.ends_s} s and {self.simulated_s} s, expected rising times.")


@dataclass(frozen=True, kw_only=True)
class SystemLatency:
    """A system's methods from the top down."""

    name: str
    methods: tuple[MethodLatency, ...]


def end_to_end_picture(systems: Sequence[SystemLatency], phases: Sequence[str], simulated: str, title: str, detail: str) -> Image:
    """Return the systems' panels below each other (H,W,3), on one time axis; `simulated` says what
    the outlined bars are. BadInput without a system or method."""
    if not systems or not all(system.methods for system in systems):
        raise BadInput("there is no latency to draw: give at least one system, each with at least one method.")
    heights = [HEAD_PX + len(system.methods) * ROW_PX + FOOT_PX for system in systems]
    width, height = LABEL_PX + PANEL_PX + NOTE_PX, TOP_PX + sum(heights) + KEYS_PX
    figure = titled_figure((width, height), title, detail)
    methods = [method for system in systems for method in system.methods]
    longest_s = max(max(*method.ends_s, method.simulated_s or 0.0) for method in methods) or 1.0
    top = height - TOP_PX
    for system, own_px in zip(systems, heights, strict=True):
        figure.text(16 / width, (top - 8) / height, system.name, size=11, weight="bold", color=INK_COLOR, va="top")
        top -= own_px
        axes = axes_at(figure, (LABEL_PX, top + FOOT_PX, PANEL_PX, len(system.methods) * ROW_PX))
        _draw_system(axes, system, longest_s)
    keys = axes_at(figure, (LABEL_PX, 4, PANEL_PX, KEYS_PX - 8))
    keys.set(ylim=(0, 1))
    keys.set_axis_off()
    for phase, color in zip(phases, COLORS, strict=False):
        keys.barh([-9], [0], color=color, label=phase)
    keys.barh([-9], [0], facecolor="white", edgecolor=unit_rgb(GREY), linewidth=1, label=simulated)
    keys.legend(fontsize=8.5, frameon=False, loc="center left", ncols=(len(phases) + 2) // 2, borderpad=0)
    return figure_image(figure)


def _draw_system(axes: Axes, system: SystemLatency, longest_s: float) -> None:
    for row, method in enumerate(system.methods):
        begun_s = 0.0
        for end_s, color in zip(method.ends_s, COLORS, strict=False):
            axes.barh(row - 0.12, end_s - begun_s, left=begun_s, height=0.44, color=color)
            begun_s = end_s
        axes.annotate(
            f"{begun_s:.1f} s, {method.note}", (begun_s, row - 0.12), xytext=(6, 0), textcoords="offset points", size=9, va="center"
        )
        if method.simulated_s is not None:
            axes.barh(row + 0.24, method.simulated_s, height=0.2, facecolor="white", edgecolor=unit_rgb(GREY), linewidth=1)
    axes.set(xlim=(0, longest_s), ylim=(len(system.methods) - 0.45, -0.55))
    axes.set_yticks(range(len(system.methods)), [method.name for method in system.methods], size=9, color=INK_COLOR)
    axes.set_xlabel("Time since the devices began (s)", size=9.5, color=SOFT_COLOR)
    axes.tick_params(axis="x", colors=SOFT_COLOR, labelsize=9)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=True, axis="x", color=SOFT_COLOR, alpha=0.15)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
