"""How many pixels each Gaussian makes. One render and its backward per view.

    shown of Gaussian i = Σ over views and pixels of T_i α_i,  Σ_i shown = Σ over pixels of alpha

the derivative of all pixels' sum by its colour.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from radiant_core.cameras import Cameras
from radiant_core.geometry.coverage import reached_by
from radiant_core.numerics import FloatArray
from radiant_core.render.backends import device_of, resolve_backend
from radiant_core.render.contract import Backend, SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import SH_C0, Splats

SHARES_SIDE_PX = 256
"""Longest side of the pictures in which shares are counted: it bounds what an edge renders; means
by larger ones were no better (docs/experiments/aggregation.md)."""


def count_shown_pixels(splats: Splats, cameras: Cameras, backend: Backend = "auto") -> FloatArray:
    """Pixels (N,) that each of N Gaussians makes in the pictures of C cameras."""
    # Grey, so that no colour is clamped, and with it the derivative.
    grey = replace(splats, sh0=np.zeros_like(splats.sh0), shN=np.zeros((len(splats), 0, 3), np.float32))
    tensors = SplatTensors.from_splats(grey, device=device_of(resolve_backend(backend)))
    tensors.sh0.requires_grad_()
    for index, (width, height) in enumerate(cameras.sizes_wh):
        one = slice(index, index + 1)
        viewmats, Ks = torch.tensor(cameras.cam_from_world[one]), torch.tensor(cameras.Ks[one])
        rasterize(tensors, viewmats, Ks, int(width), int(height), sh_degree=0, backend=backend).images[..., 0].sum().backward()
    num_pixels = np.zeros(len(splats)) if tensors.sh0.grad is None else tensors.sh0.grad[:, 0, 0].cpu().numpy().astype(np.float64)
    return num_pixels / SH_C0


def count_shown_photographs(splats: Splats, cameras: Cameras, backend: Backend = "auto") -> FloatArray:
    """What each of N Gaussians makes of the pictures of C cameras, (N,) from 0 to C, in pictures of
    the largest of them, which are rendered `SHARES_SIDE_PX` wide at most; Gaussians that no camera
    can see are not rendered."""
    cameras = cameras.scaled(SHARES_SIDE_PX)
    shares, rows = np.zeros(len(splats)), np.flatnonzero(reached_by(splats, cameras))
    if len(rows):
        shares[rows] = count_shown_pixels(splats.select(rows), cameras, backend) / cameras.sizes_wh.prod(axis=1).max()
    return shares
