"""A picture by Open3D without a window. Once per process, which holds one renderer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_viewer.open3d_window.content import Content
from radiant_viewer.open3d_window.parts import Part
from radiant_viewer.pictures.images import Image

DRAWS = 3
"""Open3D's splats are now and then wrong in single tiles: a picture is the median of so many."""


def draw_picture(content: Content, size_wh: tuple[int, int], photograph: str | None) -> Image:
    """The layers that are not hidden, (H,W,3), without a window."""
    parts = [part for layer in content.layers if layer.name not in content.hidden for part in content.parts(layer)]
    model = content.model()
    return draw_parts([*([] if model is None else [model]), *parts], content.view(size_wh, photograph), content.origin)


def draw_parts(parts: Sequence[Part], camera: Cameras, origin: FloatArray) -> Image:
    """Geometries relative to `origin` (3,) as a camera of the world sees them, (H,W,3), over
    white."""
    from open3d.visualization import rendering

    size_wh = (int(camera.sizes_wh[0, 0]), int(camera.sizes_wh[0, 1]))
    renderer: Any = rendering.OffscreenRenderer(*size_wh)
    renderer.scene.set_background(np.ones(4))
    for part in parts:
        renderer.scene.add_geometry(part.name, part.geometry, part.material)
    pose = camera.cam_from_world[0].copy()
    pose[:3, 3] += pose[:3, :3] @ origin
    renderer.setup_camera(camera.Ks[0], pose, *size_wh)
    draws = [np.asarray(renderer.render_to_image()) for _ in range(DRAWS)]
    return np.rint(np.median(draws, axis=0)).astype(np.uint8)
