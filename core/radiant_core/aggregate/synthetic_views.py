"""Synthetic views: what a trained model shows at given cameras, an edge's only teacher (paper Sec.
III-D). Once per device and edge. Each pixel weighs as much as the model's alpha there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
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
Rendered = Mapping[int, ViewBytes]
"""Views that were rendered before, by the index of their camera."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Teacher:
    """A model, its cameras, and by index of the camera the views that are rendered already."""

    splats: Splats
    cameras: Cameras
    rendered: Rendered = field(default_factory=dict)


_NONE_RENDERED: Rendered = {}


def synthetic_views(
    splats: Splats,
    cameras: Cameras,
    backend: Backend = "auto",
    rendered: Rendered = _NONE_RENDERED,
    folder: Path | None = None,
) -> TrainingViews:
    """Images and weights of `splats` at `cameras`, 8 bits; none in `rendered` is rendered again.
    They lie in a file of `folder` where one is given."""
    fresh = views_in_bytes(splats, cameras.select([index for index in range(len(cameras)) if index not in rendered]), backend)
    views = (rendered[index] if index in rendered else next(fresh) for index in range(len(cameras)))
    images, weights = store_views(views, folder)
    return TrainingViews(cameras=cameras, images=images, weights=weights)


def views_in_bytes(splats: Splats, cameras: Cameras, backend: Backend = "auto") -> Iterator[ViewBytes]:
    """Render `splats` at all `cameras`, one view in memory at a time."""
    for view in render_views(splats, cameras, backend):
        yield view.image_bytes, (view.alpha * 255).round().astype(np.uint8)
