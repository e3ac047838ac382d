"""Layers and the model as Open3D draws them. Once per window or picture.

    model      Gaussians with Open3D's own splat shader, harmonics up to degree 2
    points     unlit points
    segments   unlit lines
    polygons   their outlines

Coordinates are relative to an origin, for Open3D keeps float32. Open3D has no layers in front of
all others, so those that ask for it, such as borders, are lifted above the ground's model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.io.open3d_formats import open3d_point_cloud
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_viewer.layers.layer import CLOUD_SIZE, Layer, outline_segments
from radiant_viewer.pictures.splat_picture import Ground

MODEL = "Model"
TILES_PER_SPLAT = 4096
"""Splats over more tiles of the picture are not drawn; Open3D's own limit loses the near ones."""
LIFTED_TO = 0.9
"""Share of the ground's Gaussians below layers that are drawn in front."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """A geometry of Open3D with its material; parts of one layer share its name."""

    layer: str
    name: str
    geometry: Any
    material: Any


def model_part(splats: Splats, origin: FloatArray) -> Part:
    """The Gaussians, to be drawn as splats."""
    moved = replace(splats, means=(splats.means.astype(np.float64) - origin).astype(np.float32))
    material = _material("gaussianSplat")
    material.gaussian_splat_max_tiles_per_splat = TILES_PER_SPLAT
    return Part(layer=MODEL, name=MODEL, geometry=open3d_point_cloud(moved), material=material)


def layer_parts(layer: Layer, origin: FloatArray, lift: float = 0.0) -> Iterator[Part]:
    """What of a layer Open3D can draw, moved up by `lift` where it is to be in front of all."""
    shift = np.array([0.0, 0.0, lift if layer.in_front else 0.0]) - origin
    if layer.polygons:
        sides = [outline_segments([polygon]) for polygon in layer.polygons]
        colors = np.repeat(layer.polygon_colors, [len(one) for one in sides], axis=0)
        yield _lines(layer, "outlines", np.concatenate(sides) + shift, colors)
    if len(layer.segments):
        yield _lines(layer, "lines", layer.segments + shift, layer.segment_colors)
    if len(layer.points):
        yield _points(layer, layer.points + shift)


def lift_of(splats: Splats | None, layers: Sequence[Layer]) -> float:
    """How far layers in front are lifted, so that they lie on roofs and trees instead of below
    them."""
    heights = [layer.segments[..., 2].min() for layer in layers if layer.in_front and len(layer.segments)]
    if splats is None or not len(splats) or not heights:
        return 0.0
    ground = Ground.of(splats)
    low = splats.means[splats.means[:, 2] < ground.ceiling, 2]
    return max(0.0, float(np.quantile(low, LIFTED_TO)) - float(min(heights))) if len(low) else 0.0


def _lines(layer: Layer, kind: str, segments: FloatArray, colors: NDArray[np.uint8]) -> Part:
    import open3d as o3d

    ends = o3d.utility.Vector3dVector(np.array(segments.reshape(-1, 3)))
    lines = o3d.geometry.LineSet(ends, o3d.utility.Vector2iVector(np.arange(2 * len(segments), dtype=np.int32).reshape(-1, 2)))
    lines.colors = o3d.utility.Vector3dVector(colors / 255)
    material = _material("unlitLine")
    material.line_width = max(1.0, layer.line_width_px)
    return Part(layer=layer.name, name=f"{layer.name}: {kind}", geometry=lines, material=material)


def _points(layer: Layer, places: FloatArray) -> Part:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(places)))
    cloud.colors = o3d.utility.Vector3dVector(layer.point_colors / 255)
    material = _material("defaultUnlit")
    material.point_size = layer.point_size_px if len(layer.points) >= CLOUD_SIZE else max(6.0, layer.point_size_px)
    return Part(layer=layer.name, name=f"{layer.name}: points", geometry=cloud, material=material)


def _material(shader: str) -> Any:
    from open3d.visualization import rendering

    material: Any = rendering.MaterialRecord()
    material.shader = shader
    return material
