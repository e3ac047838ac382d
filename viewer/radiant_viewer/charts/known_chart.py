"""What is known of a surface beside the next flight over it. Once per map, with matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch
from numpy.typing import NDArray

from radiant_core.export.geotiff import NO_DATA
from radiant_core.next_flight.layers import KnownMap
from radiant_core.numerics import FloatArray
from radiant_viewer.layers.known_layer import KINDS
from radiant_viewer.layers.palette import GREY, unit_rgb
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, axes_at, figure_image, style_axes, titled_figure

PANEL_PX, TOP_PX, LEFT_PX, FOOT_PX, BAR_PX = 570, 78, 90, 110, 70
KIND_COLORS = tuple(unit_rgb(color) for _, color in KINDS)
MOST_VIEWS = 12


@dataclass(frozen=True, kw_only=True, eq=False)
class FlownLine:
    """One device's way (Q,3) on the map, its photographs' places (P,3) and where they look."""

    name: str
    way: FloatArray
    places: FloatArray
    aims: FloatArray


def known_picture(known_map: KnownMap, unit: str, flights: Sequence[FlownLine] = ()) -> Image:
    """Return three panels (H,W,3): photographs per cell, predicted error, and what is weak under
    the proposed flights."""
    grid, bands = known_map.facets.surface.grid, known_map.bands(NO_DATA).astype(np.float64)
    bands[bands == NO_DATA] = np.nan
    height_px = int(np.clip((PANEL_PX - LEFT_PX - BAR_PX) * grid.rows / grid.columns, 180, 900))
    figure = titled_figure((3 * PANEL_PX, height_px + TOP_PX + FOOT_PX), "What is known of the surface")
    panels = [axes_at(figure, (LEFT_PX + index * PANEL_PX, FOOT_PX, PANEL_PX - LEFT_PX - BAR_PX, height_px)) for index in range(3)]
    corner = grid.north_west
    extent = (corner[0], corner[0] + grid.columns * grid.cell, corner[1] - grid.rows * grid.cell, corner[1])
    bars = (
        ("Photographs", bands[..., 0], "viridis", (0, MOST_VIEWS)),
        ("PSNR predicted for such views (dB)", bands[..., 4], "magma", None),
    )
    for axes, (label, values, colors, limits) in zip(panels, bars, strict=False):
        low, high = limits or (tuple(np.nanquantile(values, [0.02, 0.98])) if np.isfinite(values).any() else (0.0, 1.0))
        picture = axes.imshow(values, extent=extent, cmap=colors, vmin=low, vmax=high, interpolation="none", aspect="equal")
        axes.set_title(label, fontsize=10, color=INK_COLOR, loc="left")
        if not np.isfinite(values).any():
            axes.text(0.5, 0.5, "no prediction", transform=axes.transAxes, ha="center", color=INK_COLOR)
            continue
        # Beside its panel, which stays as wide as the others.
        bar = figure.colorbar(picture, cax=axes.inset_axes((1.02, 0, 0.04, 1)))
        bar.ax.tick_params(labelsize=8)
    draw_kinds(panels[2], bands, extent)
    title = "What is weak, and the next flight" if flights else "What is weak"
    panels[2].set_title(title, fontsize=10, color=INK_COLOR, loc="left")
    for line in flights:
        _draw_flight(panels[2], line)
    for axes in panels:
        style_axes(axes, f"East ({unit})", f"North ({unit})")
        axes.set(xlim=_span(extent[:2], flights, 0), ylim=_span(extent[2:], flights, 1))
        axes.ticklabel_format(useOffset=False, style="plain")
        axes.locator_params(axis="x", nbins=5)
    return figure_image(figure)


def kinds_image(known_map: KnownMap) -> NDArray[np.uint8]:
    """Return the kinds of the cells in their colours (H,W,4), rows southwards; alpha 0 where
    nothing is known."""
    bands = known_map.bands(NO_DATA)
    kinds = np.where(bands[..., 6] == NO_DATA, 0, bands[..., 6]).astype(np.int64)
    kinds = np.where(bands[..., 8] > 0, len(KINDS), kinds)
    colors = np.array([(0, 0, 0, 0), *((*color, 255) for _, color in KINDS)], np.uint8)
    return colors[kinds]


def _span(ends: tuple[float, float], flights: Sequence[FlownLine], axis: int) -> tuple[float, float]:
    values = np.concatenate([np.array(ends), *(line.way[:, axis] for line in flights)])
    margin = 0.02 * float(np.ptp(values))
    return float(values.min()) - margin, float(values.max()) + margin


def draw_kinds(axes: Axes, bands: FloatArray, extent: tuple[float, float, float, float]) -> None:
    """Draw which cells are known, weak or holes, by the bands (H,W,9) of a map, and name the
    colours below."""
    colors = ListedColormap(KIND_COLORS[:3])
    axes.imshow(bands[..., 6], extent=extent, cmap=colors, norm=BoundaryNorm([0.5, 1.5, 2.5, 3.5], 3), interpolation="none", aspect="equal")
    walls = np.where(bands[..., 8] > 0, 1.0, np.nan)
    axes.imshow(walls, extent=extent, cmap=ListedColormap(KIND_COLORS[3:]), interpolation="none", aspect="equal")
    handles = [Patch(color=color, label=name) for color, (name, _) in zip(KIND_COLORS, KINDS, strict=True)]
    axes.legend(handles=handles, fontsize=7, loc="upper left", bbox_to_anchor=(0, -0.16), ncols=2, frameon=False)


def _draw_flight(axes: Axes, line: FlownLine) -> None:
    axes.plot(line.way[:, 0], line.way[:, 1], color=unit_rgb(GREY), linewidth=1.0)
    ahead = line.aims[:, :2] - line.places[:, :2]
    axes.plot(line.places[:, 0], line.places[:, 1], color=INK_COLOR, marker="o", markersize=3.5, linestyle="none")
    axes.quiver(*line.places[:, :2].T, *ahead.T, angles="xy", scale_units="xy", scale=3, width=0.004, color=INK_COLOR)
    for number, place in enumerate(line.places, 1):
        axes.annotate(str(number), place[:2], xytext=(3, 3), textcoords="offset points", fontsize=7, color=INK_COLOR)
