"""The GPS positions of a device's photographs beside the camera centres of its own structure from
motion, from above and from the south on one scale. Once per device."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_viewer.layers.palette import BLUE, ORANGE, VERMILLION, unit_rgb
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.page import SOFT_COLOR, axes_at, figure_image, style_axes, titled_figure

WIDTH_PX, HEIGHT_PX, TOP_PX, LEFT_PX, FOOT_PX = 1100, 560, 76, 72, 52
FAR_SHARE = 0.1
"""Lines longer than this share of the GPS positions' extent are red."""


def frame_picture(gps_m: FloatArray, cameras_m: FloatArray, title: str, detail: str) -> Image:
    """Draw GPS positions (P,3) m east, north, up, joined to camera centres (P,3) after the fit;
    BadInput without any."""
    gps_m = check_array("gps_m", gps_m, (None, 3))
    cameras_m = check_array("cameras_m", cameras_m, (len(gps_m), 3))
    if not len(gps_m):
        raise BadInput("a frame without GPS positions cannot be drawn: give at least one.")
    figure = titled_figure((WIDTH_PX, HEIGHT_PX), title, detail)
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
        style_axes(axes, *labels, grid=False)
        if panel == 0:
            axes.legend(loc="upper left", fontsize=9, frameon=False)
    return figure_image(figure)


def _draw(axes: Axes, gps: FloatArray, cameras: FloatArray, far: np.ndarray) -> None:
    for start, stop, is_far in zip(gps, cameras, far, strict=True):
        axes.plot(*np.stack([start, stop], axis=1), color=unit_rgb(VERMILLION) if is_far else SOFT_COLOR, linewidth=1, zorder=1)
    axes.scatter(*gps.T, s=34, facecolors="none", edgecolors=[unit_rgb(ORANGE)], linewidths=1.5, label="GPS", zorder=2)
    axes.scatter(*cameras.T, s=12, color=[unit_rgb(BLUE)], label="Own structure from motion, fitted to it", zorder=3)
