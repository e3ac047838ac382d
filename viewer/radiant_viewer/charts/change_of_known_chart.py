"""What is known of a surface before and after photographs were added. Once per extension, with
matplotlib."""

from __future__ import annotations

import numpy as np

from radiant_core.export.geotiff import NO_DATA
from radiant_core.next_flight.layers import KnownMap
from radiant_core.numerics import FloatArray
from radiant_viewer.charts.known_chart import BAR_PX, FOOT_PX, LEFT_PX, PANEL_PX, TOP_PX, draw_kinds
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, axes_at, figure_image, style_axes, titled_figure

SPAN_DB = 6.0


def change_of_known_picture(before: KnownMap, after: KnownMap, unit: str) -> Image:
    """Return three panels (H,W,3): what is weak before and after, and the change of PSNR in the
    held-out photographs."""
    grid = after.facets.surface.grid
    maps = [_bands(known_map) for known_map in (before, after)]
    height_px = int(np.clip((PANEL_PX - LEFT_PX - BAR_PX) * grid.rows / grid.columns, 180, 900))
    figure = titled_figure((3 * PANEL_PX, height_px + TOP_PX + FOOT_PX), "What is known of the surface, before and after")
    panels = [axes_at(figure, (LEFT_PX + index * PANEL_PX, FOOT_PX, PANEL_PX - LEFT_PX - BAR_PX, height_px)) for index in range(3)]
    corner = grid.north_west
    extent = (corner[0], corner[0] + grid.columns * grid.cell, corner[1] - grid.rows * grid.cell, corner[1])
    for axes, bands, name in zip(panels, maps, ("Before", "After"), strict=False):
        draw_kinds(axes, bands, extent)
        axes.set_title(name, fontsize=10, color=INK_COLOR, loc="left")
    change = maps[1][..., 4] - maps[0][..., 4]
    picture = panels[2].imshow(
        change, extent=extent, cmap="RdBu", vmin=-SPAN_DB, vmax=SPAN_DB, interpolation="none", aspect="equal"
    )  # fmt: skip
    panels[2].set_title("Change of PSNR in held-out photographs (dB)", fontsize=10, color=INK_COLOR, loc="left")
    bar = axes_at(figure, (3 * PANEL_PX - BAR_PX + 12, FOOT_PX, 12, height_px))
    figure.colorbar(picture, cax=bar).ax.tick_params(labelsize=8)
    for axes in panels:
        style_axes(axes, f"East ({unit})", f"North ({unit})")
        axes.set(xlim=extent[:2], ylim=extent[2:])
        axes.ticklabel_format(useOffset=False, style="plain")
    return figure_image(figure)


def _bands(known_map: KnownMap) -> FloatArray:
    bands = known_map.bands(NO_DATA).astype(np.float64)
    bands[bands == NO_DATA] = np.nan
    return bands
