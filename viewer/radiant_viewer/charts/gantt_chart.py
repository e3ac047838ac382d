"""A plan as bars over time, one line per device and edge: the predicted bars, pale with an outline,
above the measured ones. Once per plan and once per report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes

from radiant_core.errors import BadInput
from radiant_viewer.charts.charts import LABEL_PX, RIGHT_PX, TimelineSpan, key_width_px, stage_colors, style_time_axes, time_unit
from radiant_viewer.layers.palette import unit_rgb
from radiant_viewer.layers.region_layer import duration_text
from radiant_viewer.layers.themes import LIGHT, Theme, hex_color
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import axes_at, figure_image, new_figure

ROW_PX, TOP_PX, FOOT_PX = 34, 108, 52
TITLE_PX = 34
"""Height of a title."""
MAX_ROWS = 300
"""Most lines, the slowest machines; more would make a picture taller than 10,000 px."""
PALE = 0.28
"""Opacity of predicted bars."""
Color = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class GanttRow:
    """One machine: its predicted and measured stages; strong: an edge or the cloud, in bold."""

    name: str
    predicted: tuple[TimelineSpan, ...] = ()
    measured: tuple[TimelineSpan, ...] = ()
    strong: bool = False
    note: str = ""
    """Text after its bars; the end times where empty."""

    @property
    def stop_s(self) -> float:
        """End of its last bar."""
        return max((span.stop_s for span in (*self.predicted, *self.measured)), default=0.0)


def gantt_picture(rows: Sequence[GanttRow], title: str, detail: str = "", width_px: int = 1280, theme: Theme = LIGHT) -> Image:
    """Return the Gantt chart (H,width_px,3) of the slowest `MAX_ROWS` machines; an empty title
    takes no space. Raises BadInput without any span."""
    spans = [span for row in rows for span in (*row.predicted, *row.measured)]
    if not spans:
        raise BadInput("there is no Gantt chart to draw: no machine has a stage with a time.")
    if width_px < 640:
        raise BadInput(f"a Gantt chart of {width_px} px was asked for, expected at least 640 px.")
    slowest = _slowest_rows(rows)
    if len(slowest) < len(rows):
        detail = f"{detail}   ·   the {len(slowest)} slowest of {len(rows)} machines".lstrip(" ·")
    both = any(row.measured for row in rows) and any(row.predicted for row in rows)
    label_px = min(width_px // 3, max(LABEL_PX, 24 + int(7.2 * max(len(row.name) for row in slowest))))
    right_px = max(RIGHT_PX, 18 + int(6.6 * max(len(_note(row)) for row in slowest)))
    top_px = TOP_PX if title else TOP_PX - TITLE_PX
    height_px = top_px + ROW_PX * len(slowest) + FOOT_PX
    figure = new_figure((width_px, height_px))
    figure.set_facecolor(hex_color(theme.field))
    figure.text(16 / width_px, 1 - 14 / height_px, title, size=14, weight="bold", color=hex_color(theme.ink), va="top")
    detail_px = top_px - TOP_PX + 40
    figure.text(16 / width_px, 1 - detail_px / height_px, detail, size=9.5, color=hex_color(theme.soft_text), va="top")
    axes = axes_at(figure, (label_px, FOOT_PX, width_px - label_px - right_px, ROW_PX * len(slowest)))
    end_s = max(span.stop_s for span in spans)
    unit_s, unit = time_unit(end_s)
    colors = stage_colors(dict.fromkeys(span.stage for span in spans))
    for index, row in enumerate(slowest):
        _draw_row(axes, index, row, unit_s, colors, theme)
    names = [(row.name, row.strong) for row in slowest]
    style_time_axes(axes, names, max(end_s / unit_s, 1e-9), f"Time since the devices began ({unit})", theme)
    keys = axes_at(figure, (16, height_px - top_px + 8, width_px - 32, 34))
    kinds = ("predicted", "measured") if both else ("predicted",) if any(row.predicted for row in rows) else ("measured",)
    _draw_keys(keys, width_px - 32, colors, kinds, theme)
    return figure_image(figure)


def _slowest_rows(rows: Sequence[GanttRow]) -> list[GanttRow]:
    if len(rows) <= MAX_ROWS:
        return list(rows)
    slowest = set(sorted(range(len(rows)), key=lambda index: -rows[index].stop_s)[:MAX_ROWS])
    return [row for index, row in enumerate(rows) if index in slowest]


def _note(row: GanttRow) -> str:
    if row.note:
        return row.note
    spent = [sum(span.stop_s - span.start_s for span in spans) for spans in (row.predicted, row.measured) if spans]
    return " → ".join(duration_text(seconds) for seconds in spent)


def _draw_row(axes: Axes, index: int, row: GanttRow, unit_s: float, colors: dict[str, Color], theme: Theme) -> None:
    ground = hex_color(theme.field)
    halves = ((row.predicted, True), (row.measured, False))
    bars = [(spans, is_plan) for spans, is_plan in halves if spans]
    height = 0.62 if len(bars) == 1 else 0.36
    for place, (spans, is_plan) in enumerate(bars):
        middle = index if len(bars) == 1 else index + (place - 0.5) * 0.4
        for span in spans:
            start, length = span.start_s / unit_s, (span.stop_s - span.start_s) / unit_s
            color = colors[span.stage]
            face = (*color[:3], PALE) if is_plan else color
            axes.barh(middle, length, left=start, height=height, color=face, edgecolor=color if is_plan else ground, linewidth=0.8)
    if bars:
        place, ink = (row.stop_s / unit_s, index), hex_color(theme.ink)
        axes.annotate(_note(row), place, xytext=(6, 0), textcoords="offset points", size=9, va="center", color=ink)


def _draw_keys(axes: Axes, width_px: int, colors: dict[str, Color], kinds: Sequence[str], theme: Theme) -> None:
    ink, grey = hex_color(theme.ink), unit_rgb(theme.soft_text)
    axes.set(xlim=(0, width_px), ylim=(0, 34))
    axes.set_axis_off()
    x = 0.0
    for stage, color in colors.items():
        axes.barh(17, 16, left=x, height=12, color=color)
        axes.text(x + 22, 17, stage, size=9.5, color=ink, va="center")
        x += key_width_px(stage)
    x = max(x + 16, width_px - sum(key_width_px(kind) for kind in kinds))
    for kind in kinds:
        axes.barh(17, 16, left=x, height=12, color=(*grey, PALE) if kind == "predicted" else grey, edgecolor=grey, linewidth=0.8)
        axes.text(x + 22, 17, kind, size=9.5, color=ink, va="center")
        x += key_width_px(kind)
