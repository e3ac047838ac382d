"""Synthetic views: what a trained model shows at given cameras, the edge's only teacher (paper Sec. III-D). Once per device and edge.

A teacher knows nothing where it is transparent: each pixel weighs as much as the model's alpha there.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.views import TrainingViews


def synthetic_views(splats: Splats, cameras: Cameras, backend: Backend = "auto") -> TrainingViews:
    """Render `splats` at all `cameras` at their sizes: images (H,W,3) uint8, weights (H,W) uint8 from alpha."""
    rendered = list(views_in_bytes(splats, cameras, backend))
    return TrainingViews(cameras=cameras, images=tuple(image for image, _ in rendered), weights=tuple(weight for _, weight in rendered))


def views_in_bytes(splats: Splats, cameras: Cameras, backend: Backend = "auto") -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Image (H,W,3) and weight (H,W) of every camera, uint8, one view in memory at a time."""
    for view in render_views(splats, cameras, backend):
        yield view.image_bytes, (view.alpha * 255).round().astype(np.uint8)
