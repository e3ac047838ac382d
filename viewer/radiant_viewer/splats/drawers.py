"""The painter of a name, for the process that draws. Ours loads neither VTK nor Open3D, which take
a second."""

from __future__ import annotations

from typing import Protocol

from radiant_core.cameras import Cameras
from radiant_core.choices import Painter
from radiant_core.splats import Splats
from radiant_viewer.layers.depth_picture import Rgbd
from radiant_viewer.splats.rgbd import ModelRenderer


class Drawer(Protocol):
    """Draws one model again and again."""

    def draw(self, camera: Cameras, background: tuple[int, int, int], into: Rgbd) -> None:
        """Write the picture of one camera over a background (0 to 255): (H,W,4) float32, colours 0
        to 1 and depth in metres, 0 where nothing is."""
        ...


def make_drawer(painter: Painter, splats: Splats) -> Drawer:
    """What draws these by that painter."""
    if painter == "vtk":
        from radiant_viewer.splats.vtk_rgbd import VtkRenderer

        return VtkRenderer(splats)
    if painter == "open3d":
        from radiant_viewer.splats.open3d_rgbd import Open3DRenderer

        return Open3DRenderer(splats)
    return ModelRenderer(splats)
