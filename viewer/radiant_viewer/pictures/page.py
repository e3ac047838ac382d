"""The page around a drawing: title, labels, axes and scale bar in the frame's unit, and legend.

Once per picture, with matplotlib's own rasteriser: the same pixels everywhere, no window. Labels
that would cover each other or leave the drawing are moved, and the less important ones dropped.
Texts are drawn as they are given (`parse_math`): photographs have $ in their names.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_viewer.layers.layer import HeatScale, Layer, LegendEntry
from radiant_viewer.layers.palette import INK, PALE, heat_table, unit_rgb
from radiant_viewer.pictures.images import Drawing, Image
from radiant_viewer.pictures.measure import scale_bar_length

DPI = 100
PANEL_PX, TITLE_PX, LEFT_PX, BOTTOM_PX, GAP_PX = 310, 62, 76, 58, 16
MIN_SIZE_WH = (640, 420)
PHONE_SIZE_WH, PHONE_LEGEND_PX, PHONE_LEFT_PX = (390, 680), 250, 62
"""A page for a phone, narrower than `MIN_SIZE_WH`, has its legend below the drawing."""
LINE_PX = 21
"""Height of one line of the legend."""
LABEL_STEPS = ((0, 1), (0, -1), (1, 0), (-1, 0), (0.6, 1), (-0.6, 1), (0.6, -1), (-0.6, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))
"""Positions of a label about its point, in half widths and half heights, best first."""
MARK_RADIUS_PX = 8
INK_COLOR = "#282c34"
SOFT_COLOR = "#6b7280"


@dataclass(frozen=True, kw_only=True)
class PageText:
    """The texts around a drawing."""

    title: str = ""
    subtitle: str = ""
    unit: str = "m"
    """Unit of the world coordinates: "m", or "units" where nothing fixes the scale."""


def drawing_size_wh(size_wh: tuple[int, int], *, is_map: bool, has_legend: bool = True) -> tuple[int, int]:
    """Return the px that a page of `size_wh` leaves for the drawing, without a legend up to the
    right margin; BadInput for a small page that is not `PHONE_SIZE_WH`."""
    if size_wh == PHONE_SIZE_WH:
        return size_wh[0] - PHONE_LEFT_PX - GAP_PX, size_wh[1] - TITLE_PX - BOTTOM_PX - PHONE_LEGEND_PX
    if size_wh[0] < MIN_SIZE_WH[0] or size_wh[1] < MIN_SIZE_WH[1]:
        raise BadInput(f"a page of {size_wh[0]} × {size_wh[1]} px was asked for, expected at least {MIN_SIZE_WH[0]} × {MIN_SIZE_WH[1]}.")
    left, bottom = (LEFT_PX, BOTTOM_PX) if is_map else (GAP_PX, GAP_PX)
    return size_wh[0] - PANEL_PX * has_legend - left - GAP_PX, size_wh[1] - TITLE_PX - bottom


def compose_page(drawing: Drawing, layers: Sequence[Layer], size_wh: tuple[int, int], text: PageText) -> Image:
    """Return the page (H,W,3) of `size_wh` around a drawing of the size from `drawing_size_wh`."""
    figure = new_figure(size_wh)
    height, width = drawing.image.shape[:2]
    left, bottom = (LEFT_PX, BOTTOM_PX) if drawing.extent is not None else (GAP_PX, GAP_PX)
    if is_phone := size_wh == PHONE_SIZE_WH:
        left, bottom = PHONE_LEFT_PX, BOTTOM_PX + PHONE_LEGEND_PX
    axes = axes_at(figure, (left, bottom, width, height))
    axes.imshow(drawing.image, extent=(0, width, height, 0), interpolation="none", aspect="auto")
    axes.set(xlim=(0, width), ylim=(height, 0))
    # On a phone the line below the title would be too small to be read.
    _add_title(figure, replace(text, subtitle="") if is_phone else text, left)
    occupied: list[Bbox] = []
    if drawing.extent is not None:
        _label_axes(axes, drawing.extent, text.unit)
        occupied.append(_add_scale_bar(axes, drawing.extent, text.unit))
    else:
        axes.set_axis_off()
    _add_labels(axes, drawing, layers, occupied)
    _add_legend(figure, layers, (0, PHONE_LEGEND_PX) if is_phone else (size_wh[0] - PANEL_PX, height + bottom))
    return figure_image(figure)


def new_figure(size_wh: tuple[int, int]) -> Figure:
    """Return an empty white figure of `size_wh` px without a window."""
    figure = Figure(figsize=(size_wh[0] / DPI, size_wh[1] / DPI), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def titled_figure(size_wh: tuple[int, int], title: str, detail: str = "") -> Figure:
    """Return a figure of `size_wh` px with a bold title and a line of detail at the upper left."""
    figure = new_figure(size_wh)
    figure.text(16 / size_wh[0], 1 - 14 / size_wh[1], title, size=14, weight="bold", color=INK_COLOR, va="top", parse_math=False)
    figure.text(16 / size_wh[0], 1 - 40 / size_wh[1], detail, size=9.5, color=SOFT_COLOR, va="top", parse_math=False)
    return figure


def style_axes(axes: Axes, x_label: str, y_label: str, *, grid: bool = True) -> None:
    """Label axes in the soft colour, without a box, with horizontal lines at the ticks."""
    axes.set_xlabel(x_label, color=SOFT_COLOR)
    axes.set_ylabel(y_label, color=SOFT_COLOR)
    axes.tick_params(colors=SOFT_COLOR, labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    if grid:
        axes.grid(visible=True, axis="y", color=SOFT_COLOR, alpha=0.15)


def axes_at(figure: Figure, box_px: tuple[float, float, float, float]) -> Axes:
    """Return axes at (left, bottom, width, height) in px of the figure."""
    width, height = figure.get_size_inches() * DPI
    return figure.add_axes((box_px[0] / width, box_px[1] / height, box_px[2] / width, box_px[3] / height))


def figure_image(figure: Figure) -> Image:
    """Return the figure as pixels (H,W,3)."""
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[:, :, :3].copy()


def _add_title(figure: Figure, text: PageText, left_px: int) -> None:
    width, height = figure.get_size_inches() * DPI
    title = figure.text(left_px / width, 1 - 14 / height, text.title, size=14, weight="bold", color=INK_COLOR, va="top", parse_math=False)
    line = figure.text(
        left_px / width, 1 - 39 / height, text.subtitle, size=9.5, color=SOFT_COLOR, va="top", linespacing=1.15, parse_math=False
    )
    canvas = figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    room = width - left_px - GAP_PX

    def share_of_room(subtitle: str) -> float:
        line.set_text(subtitle)
        return line.get_window_extent(canvas.get_renderer()).width / room

    if share_of_room(text.subtitle) > 1:
        title.set_y(1 - 8 / height)
        line.set_y(1 - 30 / height)
        subtitle, size = in_two_lines(text.subtitle, lambda half: share_of_room(half) <= 1), 9.5
        # What is too long even so is set smaller, not cut off; again and again, since letters are
        # whole pixels wide.
        while (share := share_of_room(subtitle)) > 1 and size > 1:
            size *= min(0.98, 1 / share)
            line.set_fontsize(size)


def in_two_lines(text: str, fits: Callable[[str], bool]) -> str:
    """A text broken where its sense breaks, if both lines fit there, else between any words; as it
    is without a space."""
    broken = text
    for mark, end in (("   ·   ", ""), ("; ", ";"), (", ", ","), (" ", "")):
        parts = text.split(mark)
        halves = [(mark.join(parts[:count]) + end, mark.join(parts[count:])) for count in range(1, len(parts))]
        if halves:
            shortest = min(halves, key=lambda lines: max(map(len, lines)))
            broken = "\n".join(shortest)
            if all(map(fits, shortest)):
                break
    return broken


def _label_axes(axes: Axes, extent: tuple[float, float, float, float], unit: str) -> None:
    x_min, x_max, y_min, y_max = extent
    width, height = axes.get_xlim()[1], axes.get_ylim()[0]
    names = ("East", "North") if unit == "m" else ("x", "y")
    for axis, name, low, high, length in (
        (axes.xaxis, names[0], x_min, x_max, width),
        (axes.yaxis, names[1], y_min, y_max, height),
    ):
        base = _axis_base(low, high)
        ticks = np.asarray(MaxNLocator(nbins=7, steps=[1, 2, 5, 10]).tick_values(low - base, high - base))
        ticks = ticks[(ticks >= low - base) & (ticks <= high - base)]
        shares = (ticks + base - low) / (high - low)
        axis.set_ticks(shares * length if axis is axes.xaxis else (1 - shares) * length)
        axis.set_major_formatter(FuncFormatter(_tick_text(ticks)))
        axis.set_label_text(f"{name} ({unit})" if base == 0 else f"{name} − {base:,.0f} ({unit})", size=9.5, color=INK_COLOR)
    axes.tick_params(labelsize=9, color=SOFT_COLOR, labelcolor=INK_COLOR)
    for spine in axes.spines.values():
        spine.set_color(SOFT_COLOR)


def _axis_base(low: float, high: float) -> float:
    """Return the offset of an axis' numbers: UTM eastings would fill it with equal digits."""
    if max(abs(low), abs(high)) < max(1e5, 20 * (high - low)):
        return 0.0
    step = 10.0 ** np.ceil(np.log10(high - low))
    return float(np.floor(low / step) * step)


def _tick_text(ticks: np.ndarray) -> Callable[[float, int | None], str]:
    texts = [f"{tick:,.10g}".replace("-", "−") for tick in ticks]
    return lambda _value, position: texts[position] if position is not None and position < len(texts) else ""


def _add_scale_bar(axes: Axes, extent: tuple[float, float, float, float], unit: str) -> Bbox:
    width, height = axes.get_xlim()[1], axes.get_ylim()[0]
    per_px = (extent[1] - extent[0]) / width
    length = scale_bar_length(0.22 * width * per_px)
    bar_px = length / per_px
    x, y = 16, height - 18
    box = Rectangle((x - 9, y - 25), bar_px + 18, 36, facecolor="white", edgecolor="none", alpha=0.85, zorder=4)
    axes.add_patch(box)
    axes.plot([x, x, x + bar_px, x + bar_px], [y - 5, y, y, y - 5], color=INK_COLOR, linewidth=1.6, zorder=5)
    axes.text(x + bar_px / 2, y - 6, f"{length:,g} {unit}", size=9, color=INK_COLOR, ha="center", va="bottom", zorder=5, parse_math=False)
    return Bbox.from_extents(x - 9, y - 25, x + bar_px + 9, y + 11)


def _add_labels(axes: Axes, drawing: Drawing, layers: Sequence[Layer], occupied: list[Bbox]) -> None:
    """Place labels, strong ones first, off other labels and, if possible, off markers."""
    labels = [label for layer in layers for label in layer.labels]
    order = sorted(range(len(labels)), key=lambda index: not labels[index].strong)
    height, width = drawing.image.shape[:2]
    canvas = axes.figure.canvas
    assert isinstance(canvas, FigureCanvasAgg)
    for index in order:
        x, y = drawing.label_px[index]
        if not (0 <= x <= width and 0 <= y <= height):
            continue
        style = {"size": 9.5, "weight": "bold"} if labels[index].strong else {"size": 8.5, "weight": "normal"}
        artist = axes.text(
            x, y, labels[index].text, color=INK_COLOR, ha="center", va="center", zorder=6, linespacing=1.25, parse_math=False, **style
        )
        artist.set_bbox({"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "none", "alpha": 0.8})
        size = artist.get_window_extent(canvas.get_renderer())
        place = _find_free_place((x, y), (size.width + 8, size.height + 6), (width, height), occupied, drawing.mark_px)
        if place is None:
            artist.remove()
            continue
        artist.set_position(((place.x0 + place.x1) / 2, (place.y0 + place.y1) / 2))
        occupied.append(place)


def _find_free_place(
    at: tuple[float, float], size: tuple[float, float], room: tuple[int, int], occupied: Sequence[Bbox], marks: NDArray[np.float64]
) -> Bbox | None:
    """Return the box near a point that covers no label and the fewest markers, nearest first."""
    best, fewest = None, np.inf
    for distance in (8, 20, 34):
        for step_x, step_y in LABEL_STEPS:
            x, y = at[0] + step_x * (size[0] / 2 + distance), at[1] + step_y * (size[1] / 2 + distance)
            box = Bbox.from_extents(x - size[0] / 2, y - size[1] / 2, x + size[0] / 2, y + size[1] / 2)
            inside = box.x0 >= 2 and box.y0 >= 2 and box.x1 <= room[0] - 2 and box.y1 <= room[1] - 2
            if not inside or any(box.overlaps(label) for label in occupied):
                continue
            covered = int(((np.abs(marks - (x, y)) <= np.array(size) / 2 + MARK_RADIUS_PX).all(axis=1)).sum())
            if covered < fewest:
                best, fewest = box, covered
    return best


def _add_legend(figure: Figure, layers: Sequence[Layer], corner_px: tuple[float, float]) -> None:
    """Draw the legend below an upper left corner, px from the page's lower left one, a heading per
    layer; entries beyond the space are counted."""
    left_px, top_px = corner_px
    axes = axes_at(figure, (left_px, 0, PANEL_PX, top_px))
    axes.set(xlim=(0, PANEL_PX), ylim=(top_px, 0))
    axes.set_axis_off()
    y = 8.0
    for layer in [layer for layer in layers if layer.legend or layer.heat]:
        if y + 2 * LINE_PX > top_px - LINE_PX:
            break
        axes.text(8, y, layer.name, size=10, weight="bold", color=INK_COLOR, va="center", parse_math=False)
        y += LINE_PX
        room = max(1, int((top_px - LINE_PX - y) // LINE_PX))
        entries = layer.legend if len(layer.legend) <= room else layer.legend[: room - 1]
        for entry in entries:
            _add_entry(axes, entry, y)
            y += LINE_PX
        if len(entries) < len(layer.legend):
            axes.text(38, y, f"… and {len(layer.legend) - len(entries)} more", size=9, color=SOFT_COLOR, va="center")
            y += LINE_PX
        if layer.heat is not None:
            y = _add_heat(axes, layer.heat, y)
        y += 0.5 * LINE_PX


def _add_entry(axes: Axes, entry: LegendEntry, y: float) -> None:
    color, edge = unit_rgb(entry.color), unit_rgb(INK)
    if entry.marker == "area":
        axes.add_patch(Rectangle((10, y - 7), 20, 13, facecolor=color, edgecolor=edge, linewidth=0.8))
    elif entry.marker == "line":
        if min(entry.color) > PALE:
            axes.plot([9, 31], [y, y], color=INK_COLOR, linewidth=4.5)
        axes.plot([10, 30], [y, y], color=color, linewidth=3)
    else:
        rim = 0.0 if entry.marker == "dot" else 1.4
        shape = "s" if entry.marker == "square" else "o"
        axes.plot([20], [y], marker=shape, markersize=7, markerfacecolor=color, markeredgecolor=edge, markeredgewidth=rim)
    axes.text(38, y, entry.text, size=9, color=INK_COLOR, va="center", parse_math=False)


def _add_heat(axes: Axes, heat: HeatScale, y: float) -> float:
    axes.text(10, y, heat.label, size=9, color=INK_COLOR, va="center", parse_math=False)
    left, right, top = 10, PANEL_PX - 60, y + 12
    axes.imshow(heat_table(heat.start)[None], extent=(left, right, top + 13, top), aspect="auto", interpolation="nearest", zorder=2)
    axes.set(xlim=(0, PANEL_PX), ylim=(axes.get_ylim()[0], 0))
    for share, align in ((0.0, "left"), (0.5, "center"), (1.0, "right")):
        value = heat.low + share * (heat.high - heat.low)
        axes.text(left + share * (right - left), top + 26, f"{value:.4g}", size=8.5, color=INK_COLOR, ha=align, va="center")
    return y + 12 + 13 + LINE_PX + 4
