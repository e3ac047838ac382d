"""Layers of cameras: dots and pyramids, coloured by region, device, split or error. The pyramid of
camera c has its tip at −Rᵀt, its base where image corners lie at one depth. Once per picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_viewer.layers.camera_roles import CameraRoles
from radiant_viewer.layers.layer import HeatScale, Layer, LegendEntry
from radiant_viewer.layers.palette import BLUE, GREY, VERMILLION, WHITE, ColorArray, category_colors, heat_colors, shade_colors

Coloring = Literal["region", "device", "split", "psnr"]
"""region: the edge's colour; device: a shade of it; split: trained or held out; psnr: the error of
held-out photographs."""


def camera_layer(
    cameras: Cameras, roles: CameraRoles, coloring: Coloring, psnr_db: Mapping[str, float] | None = None, *, pyramids: bool = True
) -> Layer:
    """Return all C cameras as dots with pyramids; by region as dots alone if `pyramids` is False.
    Raises BadInput for an unknown colouring, or "psnr" without figures."""
    if coloring == "region":
        return _layer(cameras, "Cameras by region", _region_colors(roles), _held_out_legend(roles), pyramids=pyramids)
    if coloring == "device":
        return _layer(cameras, "Cameras by device", _device_colors(roles), _held_out_legend(roles))
    if coloring == "split":
        colors = np.where(roles.held_out[:, None], np.array(VERMILLION, np.uint8), np.array(BLUE, np.uint8))
        return _layer(cameras, "Cameras by split", colors, _split_legend(roles))
    if coloring == "psnr":
        return _psnr_layer(cameras, psnr_db or {})
    raise BadInput(f"cameras cannot be coloured by {coloring!r}: use region, device, split or psnr.")


def highlight_layer(cameras: Cameras, index: int) -> Layer:
    """Return a ring about one camera and its pyramid, enlarged, as the mark of a selection:
    vermillion is a colour of regions too, but no camera is a ring."""
    one = cameras.select([index])
    size = _pyramid_depth(cameras)
    segments = pyramid_segments(one, 2 * size)
    return Layer(
        name="Selected camera",
        points=one.centers,
        point_colors=np.array([VERMILLION], np.uint8),
        point_size_px=18,
        point_rim=True,
        ring_points=True,
        segments=segments,
        segment_colors=np.tile(np.array(VERMILLION, np.uint8), (len(segments), 1)),
        line_width_px=3,
    )


def pyramid_segments(cameras: Cameras, depth: float) -> FloatArray:
    """Return eight lines per camera (8C,2,3): from the centre to the image corners at `depth`, and
    around them."""
    widths, heights = cameras.sizes_wh.astype(np.float64).T
    zero = np.zeros_like(widths)
    corners_px = np.stack([np.stack([zero, widths, widths, zero]), np.stack([zero, zero, heights, heights]), np.ones((4, len(cameras)))])
    rays = np.einsum("cij,jkc->cki", np.linalg.inv(cameras.Ks), corners_px)
    rotations = cameras.cam_from_world[:, :3, :3]
    centers = np.repeat(cameras.centers[:, None], 4, axis=1)
    corners = centers + depth * np.einsum("cji,ckj->cki", rotations, rays)
    lines = np.concatenate([np.stack([centers, corners], 2), np.stack([corners, np.roll(corners, -1, 1)], 2)], axis=1)
    return lines.reshape(-1, 2, 3)


def _layer(
    cameras: Cameras,
    name: str,
    colors: ColorArray,
    legend: tuple[LegendEntry, ...],
    heat: HeatScale | None = None,
    *,
    pyramids: bool = True,
) -> Layer:
    # White stands for "not trained" and would vanish as a thin line on white ground.
    strokes = np.where((colors == 255).all(axis=1, keepdims=True), np.array(GREY, np.uint8), colors)
    return Layer(
        name=name,
        points=cameras.centers,
        point_colors=colors,
        # Dots shrink with their number: 2,000 cameras would hide the map under 7 px each.
        point_size_px=float(np.clip(100 / np.sqrt(max(len(cameras), 1)), 3.0, 7.0)),
        point_rim=True,
        segments=pyramid_segments(cameras, _pyramid_depth(cameras)) if pyramids else np.zeros((0, 2, 3)),
        segment_colors=np.repeat(strokes, 8, axis=0) if pyramids else strokes[:0],
        line_width_px=1.1,
        legend=legend,
        heat=heat,
    )


def _psnr_layer(cameras: Cameras, psnr_db: Mapping[str, float]) -> Layer:
    values = np.array([psnr_db.get(name, np.nan) for name in cameras.names], dtype=np.float64)
    has_psnr = np.isfinite(values)
    if not has_psnr.any():
        raise BadInput("no camera has a PSNR: evaluate the run first, or colour cameras by region, device or split.")
    low = float(np.floor(values[has_psnr].min()))
    high = max(float(np.ceil(values[has_psnr].max())), low + 1)
    colors = np.tile(np.array(WHITE, np.uint8), (len(cameras), 1))
    colors[has_psnr] = heat_colors(values[has_psnr], low, high)
    unknown = int((~has_psnr).sum())
    legend = (LegendEntry(text=f"Camera without PSNR ({unknown})", color=WHITE, marker="ring"),) if unknown else ()
    heat = HeatScale(label="PSNR of held-out photographs (dB)", low=low, high=high)
    return _layer(cameras, "Cameras by PSNR", colors, legend, heat)


def _region_colors(roles: CameraRoles) -> ColorArray:
    colors = np.concatenate([category_colors(len(roles.edge_ids)), np.array([WHITE], np.uint8)])
    return np.where(roles.held_out[:, None], np.array(WHITE, np.uint8), colors[roles.edge_of_camera])


def _device_colors(roles: CameraRoles) -> ColorArray:
    edge_colors = category_colors(len(roles.edge_ids))
    colors = np.tile(np.array(WHITE, np.uint8), (len(roles.device_ids) + 1, 1))
    for edge, color in enumerate(edge_colors):
        devices = np.flatnonzero(roles.edge_of_device == edge)
        if len(devices):
            colors[devices] = shade_colors(color, len(devices))
    return np.where(roles.held_out[:, None], np.array(WHITE, np.uint8), colors[roles.device_of_camera])


def _held_out_legend(roles: CameraRoles) -> tuple[LegendEntry, ...]:
    trained = LegendEntry(text="Camera, in its region's colour", color=BLUE, marker="ring")
    count = int(roles.held_out.sum())
    return (trained, LegendEntry(text=f"Held-out camera ({count})", color=WHITE, marker="ring")) if count else (trained,)


def _split_legend(roles: CameraRoles) -> tuple[LegendEntry, ...]:
    held_out = int(roles.held_out.sum())
    return (
        LegendEntry(text=f"Training camera ({len(roles.held_out) - held_out})", color=BLUE, marker="ring"),
        LegendEntry(text=f"Held-out camera ({held_out})", color=VERMILLION, marker="ring"),
    )


def _pyramid_depth(cameras: Cameras) -> float:
    """Half the median distance to the nearest camera, so that pyramids do not hide each other."""
    if len(cameras) < 2:
        return 1.0
    from scipy.spatial import KDTree

    nearest = np.median(KDTree(cameras.centers).query(cameras.centers, k=2)[0][:, 1])
    spread = float(np.ptp(cameras.centers, axis=0).max())
    return 0.5 * float(nearest) if nearest > 1e-4 * spread else max(0.02 * spread, 1e-3)
