"""Puts a `Layer` into a pyvista plotter: the only place that turns layers into VTK geometry, for windows and pictures alike.

VTK keeps float32 on the graphics side, so every coordinate is taken relative to a float64 origin first: at UTM eastings
float32 steps are 6 cm, near a local origin they are micrometres. Once per layer; O(N + S + R).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray
from radiant_viewer.detail import is_thinned
from radiant_viewer.layers import Layer
from radiant_viewer.palette import INK
from radiant_viewer.point_detail import PointDetail, local_cloud, point_mesh

SLOTS_PER_LAYER = 4
"""Heights that a flattened layer takes on a map: polygons, segments, rims, points."""
ROUND_SHADER = "//VTK::Color::Impl\n  vec2 off = gl_PointCoord - vec2(0.5); if (dot(off, off) > 0.25) { discard; }\n"
"""Flat discs: VTK draws square points, and its spheres reach towards the viewer and cover what lies above them on a map."""
FRONT_SHADER = "//VTK::Depth::Impl\n  gl_FragDepth = 0.001 * gl_FragCoord.z;\n"
"""Depths a thousand times nearer: in front of all else, in their own order."""


def add_layer(
    plotter: pv.Plotter,
    layer: Layer,
    origin: FloatArray,
    *,
    line_scale: float = 1.0,
    flat_height: float | None = None,
    detail: PointDetail | None = None,
) -> list[pv.Actor]:
    """Draw one layer relative to `origin` (3,) and return its actors, to hide and show it.

    `line_scale` multiplies widths in pixels; `flat_height` lays everything on a map from that height on, in painter's order;
    `detail` decides what is drawn of a large cloud.
    """
    slots = [None if flat_height is None else flat_height + slot for slot in range(SLOTS_PER_LAYER)]
    actors = []
    if layer.polygons:
        actors.append(_add(plotter, _polygon_mesh(layer, origin, slots[0])))
        actors[-1].prop.opacity = 0.4 if flat_height is None else 1.0
    if len(layer.segments):
        ends = _placed(layer.segments.reshape(-1, 3), origin, slots[1])
        mesh = pv.PolyData(ends, lines=_cells(np.arange(len(ends)).reshape(-1, 2)))
        mesh.cell_data["colors"] = layer.segment_colors
        actors.append(_add(plotter, mesh))
        actors[-1].prop.line_width = layer.line_width_px * line_scale
    if len(layer.points):
        if detail is not None and is_thinned(layer):
            actors.append(_add_cloud(plotter, layer, origin, line_scale, slots[3], detail))
        else:
            actors += _add_points(plotter, layer, origin, line_scale, slots[2:])
    for actor in actors if layer.in_front and flat_height is None else []:
        actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::Depth::Impl", True, FRONT_SHADER, False)
    return actors


def _add_cloud(
    plotter: pv.Plotter, layer: Layer, origin: FloatArray, line_scale: float, height: float | None, detail: PointDetail
) -> pv.Actor:
    # What it draws is chosen before the first frame.
    actor = _add(plotter, point_mesh(_placed(layer.points[:1], origin, height), layer.point_colors[:1]))
    actor.prop.point_size = layer.point_size_px * line_scale
    if not layer.square_points:
        actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::Color::Impl", True, ROUND_SHADER, False)
    detail.add(local_cloud(layer, origin), height, layer.point_colors, actor)
    return actor


def _add_points(
    plotter: pv.Plotter, layer: Layer, origin: FloatArray, line_scale: float, heights: Sequence[float | None]
) -> list[pv.Actor]:
    parts = [(layer.point_colors, layer.point_size_px, heights[1])]
    if layer.point_rim:
        dark = np.tile(np.array(INK, np.uint8), (len(layer.points), 1))
        # Drawn first: the dot has the same depth and covers the middle of its rim.
        parts.insert(0, (dark, layer.point_size_px + 3.5, heights[0]))
    actors = []
    for colors, size_px, height in parts:
        actor = _add(plotter, point_mesh(_placed(layer.points, origin, height), colors))
        actor.prop.point_size = size_px * line_scale
        if not layer.square_points:
            actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::Color::Impl", True, ROUND_SHADER, False)
        actors.append(actor)
    return actors


def _add(plotter: pv.Plotter, mesh: pv.PolyData) -> pv.Actor:
    # Unlit: a region's colour on the picture is its colour in the legend.
    return plotter.add_mesh(mesh, scalars="colors", rgb=True, lighting=False, show_scalar_bar=False, reset_camera=False, render=False)


def _polygon_mesh(layer: Layer, origin: FloatArray, height: float | None) -> pv.PolyData:
    corners = _placed(np.concatenate(layer.polygons), origin, height)
    sizes = [len(polygon) for polygon in layer.polygons]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    faces = np.concatenate([[size, *range(start, start + size)] for start, size in zip(starts, sizes, strict=False)])
    mesh = pv.PolyData(corners, faces=faces.astype(np.int64))
    mesh.cell_data["colors"] = layer.polygon_colors
    # Triangulated by cutting ears: a strip cut by a concave border is no convex polygon.
    triangles = mesh.triangulate()
    assert isinstance(triangles, pv.PolyData)
    return triangles


def _placed(positions: FloatArray, origin: FloatArray, height: float | None) -> NDArray[np.float32]:
    local = positions - origin
    if height is not None:
        local[:, 2] = height
    return local.astype(np.float32)


def _cells(indices: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.column_stack([np.full(len(indices), indices.shape[1]), indices]).ravel()
