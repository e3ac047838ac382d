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
from radiant_viewer.layers import Layer
from radiant_viewer.palette import INK, ColorArray

SLOTS_PER_LAYER = 4
"""Heights that a flattened layer takes on a map: polygons, segments, rims, points."""


def add_layer(
    plotter: pv.Plotter, layer: Layer, origin: FloatArray, *, line_scale: float = 1.0, flat_height: float | None = None
) -> list[pv.Actor]:
    """Draw one layer relative to `origin` (3,) and return its actors, to hide and show it.

    `line_scale` multiplies widths in pixels; `flat_height` lays everything on a map from that height on, in painter's order.
    """
    slots: list[float | None] = [None] * SLOTS_PER_LAYER if flat_height is None else [flat_height + slot for slot in range(SLOTS_PER_LAYER)]
    actors = []
    if layer.polygons:
        mesh = _polygon_mesh(layer, origin, slots[0])
        actors.append(_add(plotter, mesh, opacity=1.0 if flat_height is not None else 0.4))
    if len(layer.segments):
        ends = _placed(layer.segments.reshape(-1, 3), origin, slots[1])
        mesh = pv.PolyData(ends, lines=_cells(np.arange(len(ends)).reshape(-1, 2)))
        mesh.cell_data["colors"] = layer.segment_colors
        actors.append(_add(plotter, mesh, line_width=layer.line_width_px * line_scale))
    if len(layer.points):
        actors += _add_points(plotter, layer, origin, line_scale, slots[2:])
    return actors


def _add_points(
    plotter: pv.Plotter, layer: Layer, origin: FloatArray, line_scale: float, slots: Sequence[float | None]
) -> list[pv.Actor]:
    actors = []
    if layer.point_rim:
        dark = np.tile(np.array(INK, np.uint8), (len(layer.points), 1))
        mesh = _point_mesh(_placed(layer.points, origin, slots[0]), dark)
        actors.append(_add(plotter, mesh, point_size=(layer.point_size_px + 3.5) * line_scale, render_points_as_spheres=True))
    mesh = _point_mesh(_placed(layer.points, origin, slots[1]), layer.point_colors)
    actor = _add(plotter, mesh, point_size=layer.point_size_px * line_scale, render_points_as_spheres=True)
    if layer.point_rim:
        # Rim and dot share one place in a 3D view: the dot is drawn as if slightly nearer.
        actor.mapper.SetResolveCoincidentTopologyToPolygonOffset()
        actor.mapper.SetRelativeCoincidentTopologyPointOffsetParameter(-40)
    return [*actors, actor]


def _add(plotter: pv.Plotter, mesh: pv.PolyData, **style: float | bool) -> pv.Actor:
    # Unlit: a region's colour on the picture is its colour in the legend.
    return plotter.add_mesh(
        mesh, scalars="colors", rgb=True, lighting=False, show_scalar_bar=False, reset_camera=False, render=False, **style
    )


def _polygon_mesh(layer: Layer, origin: FloatArray, height: float | None) -> pv.PolyData:
    corners = _placed(np.concatenate(layer.polygons), origin, height)
    sizes = [len(polygon) for polygon in layer.polygons]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    faces = np.concatenate([[size, *range(start, start + size)] for start, size in zip(starts, sizes, strict=False)])
    mesh = pv.PolyData(corners, faces=faces.astype(np.int64))
    mesh.cell_data["colors"] = layer.polygon_colors
    # Triangulated by cutting ears: a strip cut by a concave border is no convex polygon.
    return mesh.triangulate()


def _point_mesh(positions: NDArray[np.float32], colors: ColorArray) -> pv.PolyData:
    mesh = pv.PolyData(positions, verts=_cells(np.arange(len(positions))[:, None]))
    mesh.point_data["colors"] = colors
    return mesh


def _placed(positions: FloatArray, origin: FloatArray, height: float | None) -> NDArray[np.float32]:
    local = positions - origin
    if height is not None:
        local[:, 2] = height
    return local.astype(np.float32)


def _cells(indices: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.column_stack([np.full(len(indices), indices.shape[1]), indices]).ravel()
