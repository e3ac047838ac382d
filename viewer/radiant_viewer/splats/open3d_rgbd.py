"""`Open3DRenderer`: a model drawn by Open3D's scene, colour and depth in one picture, as
`ModelRenderer` draws it. Once per frame of a view, where `choosing` found it to be the faster one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.io.open3d_formats import open3d_point_cloud
from radiant_core.render.reach import Reach
from radiant_core.splats import Splats
from radiant_viewer.layers.depth_picture import Rgbd
from radiant_viewer.splats.rgbd import ModelRenderer

TILES_PER_SPLAT = 4096
"""Splats over more tiles of the picture are not drawn; Open3D's own limit loses the near ones."""
_NAME = "model"


class Open3DRenderer:
    """Renders one model by Open3D, about its middle: Open3D keeps float32."""

    def __init__(self, splats: Splats) -> None:
        self._origin = splats.means.astype(np.float64).mean(axis=0)
        self._cloud = open3d_point_cloud(replace(splats, means=(splats.means - self._origin).astype(np.float32)))
        self._of_size: dict[tuple[int, int], Any] = {}
        self._splats, self._reach, self._ours = splats, Reach.of(splats), None

    def draw(self, camera: Cameras, background: tuple[int, int, int], into: Rgbd) -> None:
        """Write the picture of one camera over a background (0 to 255): (H,W,4) float32, colours 0
        to 1 and depth in metres, 0 where nothing is. Where something lies far before the scene, our
        renderer draws, which leaves it out."""
        if not self._reach.hides(self._splats, camera)[0]:
            self.draw_all(camera, background, into)
            return
        self._ours = self._ours or ModelRenderer(self._splats)
        self._ours.draw(camera, background, into)

    def draw_all(self, camera: Cameras, background: tuple[int, int, int], into: Rgbd) -> None:
        """The same, of all that is before the camera."""
        width, height = (int(side) for side in camera.sizes_wh[0])
        renderer = self._renderer(width, height)
        renderer.scene.set_background(np.array([*background, 255]) / 255)
        pose = camera.cam_from_world[0].copy()
        pose[:3, 3] += pose[:3, :3] @ self._origin
        renderer.setup_camera(camera.Ks[0], pose, width, height)
        into[..., :3] = np.asarray(renderer.render_to_image()) / np.float32(255)
        depths = np.asarray(renderer.render_to_depth_image(z_in_view_space=True))
        into[..., 3] = np.where(np.isfinite(depths), depths, 0)

    def _renderer(self, width: int, height: int) -> Any:
        """The renderer of a size, which Open3D cannot change; a view has a full and some coarse
        ones."""
        from open3d.visualization import rendering

        if (width, height) not in self._of_size:
            renderer: Any = rendering.OffscreenRenderer(width, height)
            material: Any = rendering.MaterialRecord()
            material.shader = "gaussianSplat"
            material.gaussian_splat_max_tiles_per_splat = TILES_PER_SPLAT
            renderer.scene.add_geometry(_NAME, self._cloud, material)
            self._of_size[width, height] = renderer
        return self._of_size[width, height]
