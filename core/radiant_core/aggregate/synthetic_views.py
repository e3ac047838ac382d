"""Synthetic views: what a trained model shows at given cameras, an edge's only teacher (paper Sec.
III-D). Once per device and edge. Each pixel weighs as much as the model's alpha there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.stored_images import store_views
from radiant_core.train.views import TrainingViews

ViewBytes = tuple[NDArray[np.uint8], NDArray[np.uint8]]
"""Image (H,W,3) and weight (H,W)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Teacher:
    """A model and the cameras that it is asked at."""

    splats: Splats
    cameras: Cameras


def synthetic_views(splats: Splats, cameras: Cameras, backend: Backend = "auto", folder: Path | None = None) -> TrainingViews:
    """Images and weights of `splats` at `cameras`, 8 bits; in a file of `folder` if given."""
    images, weights = store_views(views_in_bytes(splats, cameras, backend), folder)
    return TrainingViews(cameras=cameras, images=images, weights=weights)


def views_in_bytes(splats: Splats, cameras: Cameras, backend: Backend = "auto") -> Iterator[ViewBytes]:
    """Render `splats` at all `cameras`, one view in memory at a time."""
    for view in render_views(splats, cameras, backend):
        yield view.image_bytes, (view.alpha * 255).round().astype(np.uint8)
