"""A device's frame at a glance: where GPS says that its photographs were taken, and where its own structure from motion puts them.

From above and from the south, on one scale. Drawn once per device, beside its photographs.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, checked_array
from radiant_viewer.layers.palette import BLUE, ORANGE, VERMILLION
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import INK_COLOR, SOFT_COLOR, axes_at, figure_image, new_figure

WIDTH_PX, HEIGHT_PX, TOP_PX, LEFT_PX, FOOT_PX = 1100, 560, 76, 72, 52
FAR_SHARE = 0.1
"""A line longer than this share of the GPS positions' extent is drawn in the colour of warnings."""


def frame_picture(gps_m: FloatArray, cameras_m: FloatArray, title: str, detail: str) -> Image:
    """GPS positions (P,3) m east, north, up and camera centres (P,3) after the fit, joined by lines; BadInput without any."""
    gps_m = checked_array("gps_m", gps_m, (None, 3))
    cameras_m = checked_array("cameras_m", cameras_m, (len(gps_m), 3))
    if not len(gps_m):
        raise BadInput("a frame without GPS positions cannot be drawn: give at least one.")
    figure = new_figure((WIDTH_PX, HEIGHT_PX))
    figure.text(16 / WIDTH_PX, 1 - 14 / HEIGHT_PX, title, size=14, weight="bold", color=INK_COLOR, va="top")
    figure.text(16 / WIDTH_PX, 1 - 40 / HEIGHT_PX, detail, size=10, color=SOFT_COLOR, va="top")
    side_px = WIDTH_PX // 2 - LEFT_PX - 16
    both = np.concatenate([gps_m, cameras_m])
    half = 0.55 * max(1e-6, float(np.ptp(both, axis=0).max()))
    middle = (both.min(axis=0) + both.max(axis=0)) / 2
    far = np.linalg.norm(gps_m - cameras_m, axis=1) > FAR_SHARE * float(np.linalg.norm(np.ptp(gps_m, axis=0)))
    for panel, (across, up, labels) in enumerate(((0, 1, ("East (m)", "North (m)")), (0, 2, ("East (m)", "Up (m)")))):
        axes = axes_at(figure, (LEFT_PX + panel * WIDTH_PX // 2, FOOT_PX, side_px, HEIGHT_PX - TOP_PX - FOOT_PX))
        ratio = (HEIGHT_PX - TOP_PX - FOOT_PX) / side_px
        axes.set_xlim(middle[across] - half / min(1, ratio), middle[across] + half / min(1, ratio))
        axes.set_ylim(middle[up] - half * ratio / min(1, ratio), middle[up] + half * ratio / min(1, ratio))
        _draw(axes, gps_m[:, [across, up]], cameras_m[:, [across, up]], far)
        axes.set_xlabel(labels[0], color=SOFT_COLOR)
        axes.set_ylabel(labels[1], color=SOFT_COLOR)
        axes.tick_params(colors=SOFT_COLOR, labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
        if panel == 0:
            axes.legend(loc="upper left", fontsize=9, frameon=False)
    return figure_image(figure)


def _draw(axes: Axes, gps: FloatArray, cameras: FloatArray, far: np.ndarray) -> None:
    for start, stop, is_far in zip(gps, cameras, far, strict=True):
        axes.plot(*np.stack([start, stop], axis=1), color=_unit(VERMILLION) if is_far else SOFT_COLOR, linewidth=1, zorder=1)
    axes.scatter(*gps.T, s=34, facecolors="none", edgecolors=[_unit(ORANGE)], linewidths=1.5, label="GPS", zorder=2)
    axes.scatter(*cameras.T, s=12, color=[_unit(BLUE)], label="Own structure from motion, fitted to it", zorder=3)


def _unit(rgb: tuple[int, int, int]) -> tuple[float, float, float]:
    return rgb[0] / 255, rgb[1] / 255, rgb[2] / 255
