"""One rendered picture as numpy, without gradients, for views, scores and commands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.numerics import FloatArray
from radiant_core.render.backends import device_of, resolve_backend
from radiant_core.render.contract import Backend, SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.render.reach import NEAR_M
from radiant_core.splats import Splats


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderedView:
    """image (H,W,3), alpha (H,W) in 0..1; depth (H,W) m, 0 where nothing was hit; all float32."""

    name: str
    image: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]

    @property
    def image_bytes(self) -> NDArray[np.uint8]:
        """The image in 8 bits (H,W,3)."""
        return (self.image * 255).round().astype(np.uint8)


def render_views(splats: Splats, cameras: Cameras, backend: Backend = "auto", near_m: FloatArray | None = None) -> Iterator[RenderedView]:
    """Render every camera at its size, one picture in memory at a time.

    Use it for pictures in numpy; `rasterize` has gradients, in torch.

    Args:
        splats: the model.
        cameras: in the frame of the model.
        backend: the renderer; auto: gsplat where it can be used, else native.
        near_m: (C,) the depth from which on each camera shows Gaussians (`reach.py`); None: all
            that are before it.

    Yields:
        One picture per camera, in their order.

    Example:
        >>> scene, splats = radiant.load_scene("SCENE"), radiant.load_splats("model.ply")
        >>> view = next(radiant.render(splats, scene.cameras.select([0]).scaled(64)))
        >>> view.image.shape, view.depth.shape
        ((48, 64, 3), (48, 64))
    """
    near = np.full(len(cameras), NEAR_M) if near_m is None else np.asarray(near_m, np.float64)
    tensors = SplatTensors.from_splats(splats, device=device_of(resolve_backend(backend)))
    for index, (width, height) in enumerate(cameras.sizes_wh):
        one = slice(index, index + 1)
        viewmats, Ks = torch.tensor(cameras.cam_from_world[one]), torch.tensor(cameras.Ks[one])
        with torch.no_grad():
            output = rasterize(
                tensors, viewmats, Ks, int(width), int(height), sh_degree=splats.sh_degree, near_m=float(near[index]), backend=backend
            )
        yield RenderedView(
            name=cameras.names[index],
            image=output.images[0].clamp(0, 1).cpu().numpy(),
            alpha=output.alphas[0].clamp(0, 1).cpu().numpy(),
            depth=output.depths[0].cpu().numpy(),
        )
