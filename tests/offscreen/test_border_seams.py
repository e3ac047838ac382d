"""A brighter region is seen on its own side of the border, by Open3D and by pyvista: checked for
what stands where, not for pixels."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from radiant_core.aggregate.crop_merge import crop_merge
from radiant_core.cameras import Cameras
from radiant_core.io.ply import save_ply
from radiant_core.numerics import FloatArray
from radiant_core.splats import SH_C0, Splats
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.splat_layer import splat_layer
from radiant_viewer.pictures.offscreen import draw_map
from tests.offscreen.open3d_splats import render_open3d_splats
from tests.offscreen.test_open3d_parity import needs_vulkan

SITES, WEIGHTS = np.array([[3.0, -12.0], [-3.0, 12.0]]), np.zeros(2)
"""The border runs through the origin, across the line between the sites; the second region is on its left."""
ALONG = np.array([24.0, 6.0]) / np.hypot(24.0, 6.0)
ENDS: FloatArray = np.stack([-18 * ALONG, 18 * ALONG])


@cache
def street() -> Splats:
    """One model of 52 × 36 m: lawn and paving with texture in patches, hills of 0.2 m, some 9,000 Gaussians."""
    rng = np.random.default_rng(7)
    x, y = np.meshgrid(np.arange(-26, 26, 0.45), np.arange(-18, 18, 0.45))
    xy = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-0.15, 0.15, (x.size, 2))
    patches = np.sin(0.9 * xy[:, :1] + 0.4 * xy[:, 1:]) * np.cos(0.7 * xy[:, 1:])
    color = np.array([0.42, 0.45, 0.36]) + patches * [0.05, 0.08, 0.04] + rng.normal(0, 0.012, (len(xy), 3))
    height = 0.1 * np.sin(0.3 * xy[:, 0]) + 0.1 * np.cos(0.4 * xy[:, 1]) + rng.normal(0, 0.01, len(xy))
    return Splats(
        means=np.column_stack([xy, height]),
        quats=np.tile([1.0, 0, 0, 0], (len(xy), 1)),
        log_scales=np.log([0.3, 0.3, 0.05]) + rng.normal(0, 0.05, (len(xy), 3)),
        logit_opacities=np.full(len(xy), 3.0),
        sh0=((color - 0.5) / SH_C0)[:, None],
        shN=np.zeros((len(xy), 0, 3)),
    )


def merged(second: Splats) -> Splats:
    """Two regions' models crop-merged at the border, the first one being the street itself."""
    return crop_merge([street(), second], SITES, WEIGHTS)


def brighter(levels: float) -> Splats:
    return replace(street(), sh0=street().sh0 + levels / 255 / SH_C0)


def camera_over_border() -> Cameras:
    """20 m above the middle of the border, image x along it: the left region fills the upper half."""
    pose = np.eye(4)
    pose[:3, :3] = [[*ALONG, 0], [ALONG[1], -ALONG[0], 0], [0, 0, -1]]
    pose[2, 3] = 20.0
    K = np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]])
    return Cameras(names=("border",), Ks=K[None], cam_from_world=pose[None], sizes_wh=np.array([[320, 240]]))


@needs_vulkan
def test_open3d_shows_the_brighter_region_on_its_side_of_the_border(tmp_path: Path) -> None:
    save_ply(tmp_path / "scene.ply", merged(brighter(60)))
    frames = render_open3d_splats(tmp_path / "scene.ply", camera_over_border(), num_frames=3)
    rows = np.median(frames, axis=0).mean(axis=(1, 2))
    assert rows.min() > 60, "the ground fills the picture"
    # Steepest within 3 pixels, 0.2 m, of the middle row; by at least a third of what was planted.
    rises = rows[:-6] - rows[6:]
    assert abs(int(rises.argmax()) + 3 - 120) <= 3
    assert rises.max() > 20


def test_pyvista_shows_the_brighter_region_on_its_side_of_the_border() -> None:
    ends = np.column_stack([ENDS, [9.0, 9.0]])
    line = Layer(name="border", segments=ends[None], segment_colors=np.array([[255, 0, 0]], np.uint8))
    drawing = draw_map([splat_layer(merged(brighter(60))), line], (320, 240))
    assert drawing.extent is not None
    x_min, x_max, y_min, y_max = drawing.extent
    x, y = np.meshgrid(np.linspace(x_min, x_max, 640)[1::2], np.linspace(y_max, y_min, 480)[1::2])
    across = x * -ALONG[1] + y * ALONG[0]
    inside = (np.abs(x) < 12) & (np.abs(y) < 12)
    red = (drawing.image[..., 0] > 200) & (drawing.image[..., 1] < 60)
    assert red.sum() > 50
    assert np.abs(across[red]).max() < 1.0
    level = drawing.image.astype(float).mean(axis=2)
    upper, lower = (np.median(level[inside & side]) for side in (across > 1, across < -1))
    assert upper - lower == pytest.approx(60, abs=20)
