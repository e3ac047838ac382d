"""Draws a `Layer` in a pyvista plotter: the only place that turns layers into VTK geometry.

VTK keeps float32 on the graphics side, so every coordinate is taken relative to a float64 origin
first: at UTM eastings float32 steps are 6 cm, near a local origin they are micrometres. Once per
layer; O(N + S + R).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkPolyDataMapper

from radiant_core.numerics import FloatArray
from radiant_viewer.layers.detail import is_thinned
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.palette import INK
from radiant_viewer.layers.point_detail import PointDetail, local_cloud, point_mesh

SLOTS_PER_LAYER = 4
"""Heights that a flattened layer takes on a map: polygons, segments, rims, points."""
RIM_PX = 3.5
_Kind = Literal["picture", "polygons", "segments", "rims", "points"]
RING_SHARE = 0.64
"""Of the width of a ring, its hole."""
FRONT_SHADER = "//VTK::Depth::Impl\n  gl_FragDepth = 0.001 * gl_FragCoord.z;\n"
"""Scale of depth for layers in front of all others, which keep their order."""
BEHIND_SHADER = "//VTK::Depth::Impl\n  gl_FragDepth = min(1.0, gl_FragCoord.z + 1e-5);\n"
"""A hundred roundings of float32: VTK rounds the same place differently for each actor."""


def add_layer(
    plotter: pv.Plotter,
    layer: Layer,
    origin: FloatArray,
    *,
    line_scale: float = 1.0,
    flat_height: float | None = None,
    detail: PointDetail | None = None,
) -> list[pv.Actor]:
    """Draw one layer relative to `origin` (3,) and return its actors; `line_scale` multiplies
    widths in pixels; `flat_height` flattens the layer for a map from that height on, in painter's
    order; `detail` thins large clouds."""
    if len(layer.points) and detail is not None and is_thinned(layer):
        flat = replace(layer, points=np.zeros((0, 3)), point_colors=np.zeros((0, 3), np.uint8))
        actors = [_add_part(plotter, layer, part, line_scale, flat_height) for part in _parts(flat, origin, flat_height)]
        height = None if flat_height is None else flat_height + SLOTS_PER_LAYER - 1
        actors.append(_add_cloud(plotter, layer, origin, line_scale, height, detail))
    else:
        actors = [_add_part(plotter, layer, part, line_scale, flat_height) for part in _parts(layer, origin, flat_height)]
    for shader in [FRONT_SHADER] * layer.in_front + [BEHIND_SHADER] * layer.behind if flat_height is None else []:
        for actor in actors:
            actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::Depth::Impl", True, shader, False)
    return actors


def update_layer(actors: Sequence[pv.Actor], layer: Layer, origin: FloatArray, flat_height: float | None = None) -> None:
    """Let a layer's actors draw another that `has_same_structure`, in a third of the time."""
    for actor, (_, mesh) in zip(actors, _parts(layer, origin, flat_height), strict=True):
        actor.mapper.SetInputData(mesh)


def has_same_structure(first: Layer, second: Layer) -> bool:
    """Return whether layers differ only in positions, colours, labels, and none is thinned; a
    picture is on the graphics card and has to be the same one."""
    styles = [
        (
            [bool(len(part)) for part in (one.polygons, one.segments, one.points)],
            (one.point_size_px, one.point_rim, one.square_points, one.ring_points, one.in_front, one.behind, one.line_width_px),
        )
        for one in (first, second)
    ]
    return styles[0] == styles[1] and first.picture is second.picture and not is_thinned(first) and not is_thinned(second)


def _parts(layer: Layer, origin: FloatArray, flat_height: float | None) -> list[tuple[_Kind, pv.PolyData]]:
    """Return the meshes of a layer in drawing order."""
    slots = [None if flat_height is None else flat_height + slot for slot in range(SLOTS_PER_LAYER)]
    parts: list[tuple[_Kind, pv.PolyData]] = []
    if layer.picture is not None and flat_height is not None:
        corners = pv.PolyData(_local_positions(layer.picture.corners, origin, slots[0]), faces=np.array([4, 0, 1, 2, 3]))
        corners.active_texture_coordinates = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
        parts.append(("picture", corners))
    if layer.polygons:
        parts.append(("polygons", _polygon_mesh(layer, origin, slots[0])))
    if len(layer.segments):
        ends = _local_positions(layer.segments.reshape(-1, 3), origin, slots[1])
        mesh = pv.PolyData(ends, lines=_cells(np.arange(len(ends)).reshape(-1, 2)))
        mesh.cell_data["colors"] = layer.segment_colors
        parts.append(("segments", mesh))
    if len(layer.points) and layer.point_rim:
        # Drawn first: the dot, at the same depth, covers the middle of its rim.
        dark = np.tile(np.array(INK, np.uint8), (len(layer.points), 1))
        parts.append(("rims", point_mesh(_local_positions(layer.points, origin, slots[2]), dark)))
    if len(layer.points):
        parts.append(("points", point_mesh(_local_positions(layer.points, origin, slots[3]), layer.point_colors)))
    return parts


def _add_part(plotter: pv.Plotter, layer: Layer, part: tuple[_Kind, pv.PolyData], line_scale: float, flat_height: float | None) -> pv.Actor:
    kind, mesh = part
    actor = _add(plotter, mesh)
    if kind == "picture":
        assert layer.picture is not None
        actor.texture = pv.Texture(layer.picture.image)
        actor.texture.interpolate = True
        # Else its colours are multiplied by those of pyvista's theme.
        actor.prop.color = "white"
    elif kind == "polygons":
        actor.prop.opacity = 0.4 if flat_height is None else 1.0
    elif kind == "segments":
        actor.prop.line_width = layer.line_width_px * line_scale
    else:
        size_px, hole_px = layer.point_size_px, RING_SHARE * layer.point_size_px if layer.ring_points else 0.0
        if kind == "rims":
            size_px, hole_px = size_px + RIM_PX, max(0.0, hole_px - RIM_PX)
        actor.prop.point_size = size_px * line_scale
        if not layer.square_points:
            actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::Color::Impl", True, _round_shader(hole_px / size_px), False)
    return actor


def _round_shader(hole: float) -> str:
    """Flat discs, or rings with a hole of this share of their width: VTK's points are square, and
    its spheres rise over higher layers of a map."""
    away = "vec2 off = gl_PointCoord - vec2(0.5); float away = dot(off, off);"
    return f"//VTK::Color::Impl\n  {away} if (away > 0.25 || away < {0.25 * hole**2:.6f}) {{ discard; }}\n"


def _add_cloud(
    plotter: pv.Plotter, layer: Layer, origin: FloatArray, line_scale: float, height: float | None, detail: PointDetail
) -> pv.Actor:
    # `detail` chooses its points before the first frame.
    first = point_mesh(_local_positions(layer.points[:1], origin, height), layer.point_colors[:1])
    actor = _add_part(plotter, layer, ("points", first), line_scale, height)
    detail.add(local_cloud(layer, origin), height, layer.point_colors, actor)
    return actor


def _add(plotter: pv.Plotter, mesh: pv.PolyData) -> pv.Actor:
    # Not by `add_mesh`, which spends 6 ms per mesh; a window has some thirty.
    mapper = vtkPolyDataMapper()
    mapper.SetInputData(mesh)
    mapper.SelectColorArray("colors")
    mapper.SetColorModeToDirectScalars()
    if mesh.n_points and "colors" in mesh.point_data:
        mapper.SetScalarModeToUsePointFieldData()
    else:
        mapper.SetScalarModeToUseCellFieldData()
    actor = pv.Actor(mapper=mapper)
    # Unlit, so that colours equal those of the legend.
    actor.prop.lighting = False
    plotter.renderer.AddActor(actor)
    return actor


def _polygon_mesh(layer: Layer, origin: FloatArray, height: float | None) -> pv.PolyData:
    corners = _local_positions(np.concatenate(layer.polygons), origin, height)
    sizes = [len(polygon) for polygon in layer.polygons]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    faces = np.concatenate([[size, *range(start, start + size)] for start, size in zip(starts, sizes, strict=False)])
    mesh = pv.PolyData(corners, faces=faces.astype(np.int64))
    mesh.cell_data["colors"] = layer.polygon_colors
    # Triangulated by ear clipping: a strip cut by a concave border is not convex.
    triangles = mesh.triangulate()
    assert isinstance(triangles, pv.PolyData)
    return triangles


def _local_positions(positions: FloatArray, origin: FloatArray, height: float | None) -> NDArray[np.float32]:
    local = positions - origin
    if height is not None:
        local[:, 2] = height
    return local.astype(np.float32)


def _cells(indices: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.column_stack([np.full(len(indices), indices.shape[1]), indices]).ravel()
