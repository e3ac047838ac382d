"""Partitions side by side: the region of each camera by each method, above one bar per region with
its predicted time; an even row of bars is a balanced plan. Once per comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_viewer.layers.palette import category_colors
from radiant_viewer.layers.region_layer import duration_text
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, SOFT_COLOR, axes_at, figure_image, new_figure

COLUMNS, CELL_PX, GAP_PX, BARS_PX, HEAD_PX, TITLE_PX, FOOT_PX = 4, 300, 24, 124, 46, 76, 30
MAX_DOTS = 6000
MAX_NAMED = 8
"""With more regions bars have no names and figures."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Partition:
    """edge_of_camera (C,), −1 for a camera in no region; edge_time_s (E,) predicted."""

    name: str
    edge_of_camera: NDArray[np.int64]
    edge_time_s: FloatArray
    note: str = ""


def partitions_picture(
    positions: FloatArray, partitions: Sequence[Partition], edge_ids: Sequence[str], title: str, unit: str = "m"
) -> Image:
    """Return maps and bars (H,W,3) of partitions of the same cameras (C,2); BadInput without any,
    or for other cameras or edges."""
    positions = check_array("positions", positions, (None, 2))
    if not partitions or not len(positions):
        raise BadInput("there is no partition to draw: give at least one method and one camera.")
    for partition in partitions:
        if len(partition.edge_of_camera) != len(positions) or len(partition.edge_time_s) != len(edge_ids):
            raise BadInput(f"partition {partition.name!r} is of other cameras or edges than the positions: compare one plan's.")
    columns = min(COLUMNS, len(partitions))
    rows = -(-len(partitions) // columns)
    low, high = positions.min(axis=0), positions.max(axis=0)
    aspect = float(np.clip((high - low)[1] / max(float((high - low)[0]), 1e-9), 0.35, 1.2))
    map_px = round(CELL_PX * aspect)
    row_px = HEAD_PX + map_px + BARS_PX + FOOT_PX
    width, height = GAP_PX + columns * (CELL_PX + GAP_PX), TITLE_PX + rows * row_px
    figure = new_figure((width, height))
    side, slowest_s = float((high - low).max()), max(float(partition.edge_time_s.max()) for partition in partitions)
    unit_s, unit_name = (1.0, "s") if slowest_s < 100 else (60.0, "min") if slowest_s < 6000 else (3600.0, "h")
    subtitle = f"Maps are {side:.3g} {unit} on their longer side; bars: time of each region in {unit_name}, dashed: their mean"
    figure.text(GAP_PX / width, 1 - 36 / height, subtitle, size=9, color=SOFT_COLOR, va="top")
    figure.text(GAP_PX / width, 1 - 14 / height, title, size=13, weight="bold", color=INK_COLOR, va="top")
    for index, partition in enumerate(partitions):
        left = GAP_PX + index % columns * (CELL_PX + GAP_PX)
        top = height - TITLE_PX - index // columns * row_px
        figure.text(left / width, top / height, partition.name, size=11, weight="bold", color=INK_COLOR, va="top")
        note = f"makespan {duration_text(float(partition.edge_time_s.max()))}" + (f", {partition.note}" if partition.note else "")
        figure.text(left / width, (top - 19) / height, note, size=9, color=SOFT_COLOR, va="top")
        _draw_map(axes_at(figure, (left, top - HEAD_PX - map_px, CELL_PX, map_px)), positions, partition, len(edge_ids), (low, high))
        bars = axes_at(figure, (left, top - HEAD_PX - map_px - BARS_PX, CELL_PX, BARS_PX - 22))
        _draw_bars(bars, partition.edge_time_s / unit_s, edge_ids, slowest_s / unit_s)
    return figure_image(figure)


def _draw_map(axes: Axes, positions: FloatArray, partition: Partition, num_edges: int, box: tuple[FloatArray, FloatArray]) -> None:
    thinned = slice(None, None, -(-len(positions) // MAX_DOTS))
    dots, owners = positions[thinned], partition.edge_of_camera[thinned]
    size = float(np.clip(9000 / len(dots), 1.5, 28))
    owned = owners >= 0
    axes.scatter(*dots[owned].T, s=size, c=category_colors(num_edges)[owners[owned]] / 255, linewidths=0)
    orphans = int((partition.edge_of_camera < 0).sum())
    if orphans:
        axes.scatter(*dots[~owned].T, s=size * 1.5, c="black", marker="x", linewidths=0.8)
        patch = {"facecolor": "white", "alpha": 0.85, "pad": 1.5, "linewidth": 0}
        text = f"× {orphans} in no region"
        axes.text(0.99, 0.01, text, transform=axes.transAxes, size=8, ha="right", va="bottom", color="black", bbox=patch)
    low, high = box
    margin = 0.04 * max(float((high - low).max()), 1e-9)
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), xticks=[], yticks=[])
    axes.set_aspect("equal", adjustable="box", anchor="NW")
    for spine in axes.spines.values():
        spine.set_color("#d9dce1")


def _draw_bars(axes: Axes, times: FloatArray, edge_ids: Sequence[str], slowest: float) -> None:
    count = len(times)
    axes.bar(np.arange(count), times, width=0.72, color=category_colors(count) / 255)
    axes.axhline(float(times.mean()), color=SOFT_COLOR, linewidth=0.8, linestyle=(0, (4, 3)))
    axes.set(xlim=(-0.6, count - 0.4), ylim=(0, slowest * 1.35), yticks=[])
    if count <= MAX_NAMED:
        axes.set_xticks(range(count), [name if len(name) <= 12 else name[:11] + "…" for name in edge_ids], size=8, color=INK_COLOR)
        for index, value in enumerate(times.tolist()):
            axes.text(
                index, max(value, float(times.mean())) + 0.05 * slowest, f"{value:.3g}", size=8, ha="center", va="bottom", color=INK_COLOR
            )
    else:
        axes.set_xticks([])
        axes.set_xlabel(f"{count} regions", size=8, color=SOFT_COLOR)
    axes.tick_params(axis="x", length=0)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.spines["bottom"].set_color(SOFT_COLOR)
