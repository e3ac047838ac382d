"""`ModelRenderer`: a model drawn again and again, colour and depth in one picture.

Once per frame of a view. The model is checked and copied once, not per picture: that costs as much
as drawing 100,000 Gaussians. What is done to whole pictures is numpy's: torch's threads would spin
on after each operation and take a core from the rasterizer and from the window.
"""

from __future__ import annotations

import numpy as np
import torch

from radiant_core.cameras import Cameras
from radiant_core.render.backends import device_of, resolve_backend
from radiant_core.render.contract import SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.render.reach import Reach
from radiant_core.splats import Splats
from radiant_viewer.layers.depth_picture import OPAQUE, Rgbd


class ModelRenderer:
    """Renders one model by our rasterizer (gsplat where it can be used)."""

    def __init__(self, splats: Splats) -> None:
        backend = resolve_backend("auto")
        self._sh_degree, self._reach = splats.sh_degree, Reach.of(splats)
        self._tensors = SplatTensors.from_splats(splats, device=device_of(backend))

    def draw(self, camera: Cameras, background: tuple[int, int, int], into: Rgbd) -> None:
        """Write the picture of one camera over a background (0 to 255): (H,W,4) float32, colours 0
        to 1 and depth in metres, 0 where the model fills less than `OPAQUE`. What lies far before
        the scene is left out."""
        width, height = (int(side) for side in camera.sizes_wh[0])
        behind = torch.tensor(background, dtype=torch.float32) / 255
        viewmats, Ks = torch.tensor(camera.cam_from_world), torch.tensor(camera.Ks)
        with torch.no_grad():
            near_m = float(self._reach.near_m(camera)[0])
            output = rasterize(self._tensors, viewmats, Ks, width, height, sh_degree=self._sh_degree, background=behind, near_m=near_m)
        colors, alphas, depths = (images[0].cpu().numpy() for images in (output.images, output.alphas, output.depths))
        np.clip(colors, 0, 1, out=into[..., :3])
        into[..., 3] = np.where(alphas >= OPAQUE, depths, 0.0)
