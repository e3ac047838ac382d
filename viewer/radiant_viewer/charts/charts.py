"""The timeline of devices and edges, and photograph, render and difference side by side.

Once per report or screenshot, with matplotlib's own rasteriser.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from radiant_core.errors import BadInput
from radiant_viewer.layers.palette import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILLION, WHITE, YELLOW, tint, unit_rgb
from radiant_viewer.layers.region_layer import duration_text
from radiant_viewer.layers.themes import LIGHT, Theme, hex_color
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, axes_at, figure_image, new_figure, titled_figure

ROW_PX, TOP_PX, FOOT_PX, LABEL_PX, RIGHT_PX = 26, 92, 52, 150, 96
STAGE_COLORS = {"initialise": SKY, "train": BLUE, "send": ORANGE, "aggregate": GREEN, "merge": PURPLE, "evaluate": YELLOW, "whole": GREY}
"""Colours of the stages of every run; other stages take the remaining colours in order."""
OTHER_COLORS = (VERMILLION, GREY, tint(BLUE, WHITE, 0.55), tint(GREEN, WHITE, 0.55), tint(PURPLE, WHITE, 0.55))


@dataclass(frozen=True, kw_only=True)
class TimelineSpan:
    """One stage of a device, an edge or the cloud; BadInput unless 0 ≤ start ≤ stop < ∞."""

    stage: str
    start_s: float
    stop_s: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.start_s) and np.isfinite(self.stop_s) and 0 <= self.start_s <= self.stop_s):
            raise BadInput(f"stage {self.stage!r} lasts from {self.start_s} to {self.stop_s} s, expected 0 ≤ start ≤ stop.")


@dataclass(frozen=True, kw_only=True)
class TimelineRow:
    """One line of the timeline: a name and its spans."""

    name: str
    spans: tuple[TimelineSpan, ...]
    strong: bool = False
    """Whether it is an edge or the cloud, set in bold above its devices."""


def timeline_picture(rows: Sequence[TimelineRow], title: str = "Timeline", width_px: int = 1280) -> Image:
    """Return the timeline (H,width_px,3), a bar per span, a total per row; BadInput if empty."""
    if not any(row.spans for row in rows):
        raise BadInput("there is no timeline to draw: no device or edge has a stage with a time.")
    if width_px < 640:
        raise BadInput(f"a timeline of {width_px} px was asked for, expected at least 640 px.")
    label_px = min(width_px // 3, max(LABEL_PX, 24 + int(7.2 * max(len(row.name) for row in rows))))
    height_px = TOP_PX + ROW_PX * len(rows) + FOOT_PX
    figure = titled_figure((width_px, height_px), title)
    axes = axes_at(figure, (label_px, FOOT_PX, width_px - label_px - RIGHT_PX, ROW_PX * len(rows)))
    end_s = max(span.stop_s for row in rows for span in row.spans)
    unit_s, unit = time_unit(end_s)
    colors = stage_colors(dict.fromkeys(span.stage for row in rows for span in row.spans))
    for index, row in enumerate(rows):
        _draw_row(axes, index, row, unit_s, colors)
    style_time_axes(axes, [(row.name, row.strong) for row in rows], max(end_s / unit_s, 1e-9), f"Time ({unit})")
    _draw_keys(figure_axes=axes_at(figure, (16, height_px - TOP_PX + 8, width_px - 32, 34)), width_px=width_px - 32, colors=colors)
    return figure_image(figure)


def comparison_picture(photo: Image, render: Image, difference: Image | None = None, title: str = "", width_px: int | None = None) -> Image:
    """Return photograph, render and difference, by default |photo − render| × 3, each (H,W,3), side
    by side, 380 to 560 px wide each or `width_px` together; BadInput where sizes differ."""
    if difference is None:
        _require_same_size(photo, render)
        difference = np.minimum(255, 3 * np.abs(photo.astype(np.int16) - render)).astype(np.uint8)
    pictures = (photo, render, difference)
    for picture in pictures:
        _require_same_size(photo, picture)
    texts = ("Photograph", "Render", "Difference × 3")
    height, width = photo.shape[:2]
    gap, head, foot = 14, 44 if title else 14, 38
    scale = max(380 / width, min(1.0, 560 / width)) if width_px is None else max(160, (width_px - 4 * gap) // 3) / width
    shown_w, shown_h = round(width * scale), round(height * scale)
    page_wh = (3 * shown_w + 4 * gap, shown_h + head + foot)
    figure = new_figure(page_wh)
    figure.text(gap / page_wh[0], 1 - 14 / page_wh[1], title, size=13, weight="bold", color=INK_COLOR, va="top")
    for index, (picture, text) in enumerate(zip(pictures, texts, strict=False)):
        left = gap + index * (shown_w + gap)
        axes = axes_at(figure, (left, foot, shown_w, shown_h))
        axes.imshow(picture, aspect="auto", interpolation="antialiased")
        axes.set_axis_off()
        figure.text(left / page_wh[0], (foot - 8) / page_wh[1], text, size=10, color=INK_COLOR, va="top")
    return figure_image(figure)


def _draw_row(axes: Axes, index: int, row: TimelineRow, unit_s: float, colors: dict[str, tuple[float, float, float]]) -> None:
    for span in row.spans:
        start, length = span.start_s / unit_s, (span.stop_s - span.start_s) / unit_s
        axes.barh(index, length, left=start, height=0.68, color=colors[span.stage], edgecolor="white", linewidth=0.6)
    if row.spans:
        stop_s = max(span.stop_s for span in row.spans)
        text = duration_text(sum(span.stop_s - span.start_s for span in row.spans))
        axes.annotate(text, (stop_s / unit_s, index), xytext=(6, 0), textcoords="offset points", size=9, va="center", color=INK_COLOR)


def time_unit(end_s: float) -> tuple[float, str]:
    """Return the unit of an axis up to `end_s`: its seconds and its name."""
    return (1.0, "s") if end_s < 100 else (60.0, "min") if end_s < 6000 else (3600.0, "h")


def style_time_axes(axes: Axes, rows: Sequence[tuple[str, bool]], end: float, label: str, theme: Theme = LIGHT) -> None:
    """Style a time axis from 0 to `end` with rows from the top down: name, whether it is bold."""
    ink, soft = hex_color(theme.ink), hex_color(theme.soft_text)
    axes.set(xlim=(0, end * 1.01), ylim=(len(rows) - 0.4, -0.6))
    axes.set_facecolor("none")
    axes.set_yticks(range(len(rows)), [name for name, _ in rows], size=9.5, color=ink)
    for text, (_, strong) in zip(axes.get_yticklabels(), rows, strict=True):
        text.set_fontweight("bold" if strong else "normal")
    axes.set_xlabel(label, size=9.5, color=ink)
    axes.tick_params(axis="x", labelsize=9, color=soft, labelcolor=ink)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color=hex_color(theme.line), linewidth=0.8)
    axes.set_axisbelow(True)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(soft)


def _draw_keys(*, figure_axes: Axes, width_px: int, colors: dict[str, tuple[float, float, float]]) -> None:
    figure_axes.set(xlim=(0, width_px), ylim=(0, 34))
    figure_axes.set_axis_off()
    x = 0.0
    for stage, color in colors.items():
        figure_axes.barh(17, 16, left=x, height=12, color=color)
        figure_axes.text(x + 22, 17, stage, size=9.5, color=INK_COLOR, va="center")
        x += key_width_px(stage)


def key_width_px(text: str) -> float:
    """Return the width of one entry of the key."""
    return 22 + 7.4 * len(text) + 26


def stage_colors(stage_names: Iterable[str]) -> dict[str, tuple[float, float, float]]:
    """Return the colour of each stage of a chart, in the order of the key."""
    stage_names = list(stage_names)
    stages = [stage for stage in STAGE_COLORS if stage in stage_names] + [stage for stage in stage_names if stage not in STAGE_COLORS]
    others = [stage for stage in stages if stage not in STAGE_COLORS]
    chosen = {stage: OTHER_COLORS[index % len(OTHER_COLORS)] for index, stage in enumerate(others)}
    return {stage: unit_rgb({**STAGE_COLORS, **chosen}[stage]) for stage in stages}


def _require_same_size(photo: Image, picture: Image) -> None:
    if photo.shape != picture.shape or photo.ndim != 3 or photo.shape[2] != 3 or 0 in photo.shape:
        raise BadInput(f"a photograph of shape {photo.shape} is set beside a picture of {picture.shape}, expected equal (H, W, 3).")
