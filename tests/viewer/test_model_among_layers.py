"""Layers lie before and behind the model by depth, in the same way wherever both are drawn."""

from __future__ import annotations

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.splats import SH_C0, Splats
from radiant_viewer.layers.camera_layer import pyramid_segments
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.palette import VERMILLION
from radiant_viewer.pictures.splat_picture import draw_splat_view
from radiant_viewer.pictures.view_pose import ViewPose

SIZE_WH = (320, 240)
VIEW = ViewPose(position=np.array([0.0, -30, 4]), focal_point=np.array([0.0, 0, 4]), up=np.array([0.0, 0, 1]), angle_deg=40.0)


def house() -> Splats:
    """A grey block of 8 m, a Gaussian every half metre, opaque."""
    steps = np.arange(-4, 4.1, 0.5)
    means = np.stack(np.meshgrid(steps, steps, steps + 4), axis=-1).reshape(-1, 3).astype(np.float32)
    count = len(means)
    return Splats(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), np.log(0.3), np.float32),
        logit_opacities=np.full(count, 6, np.float32),
        sh0=np.full((count, 1, 3), (0.4 - 0.5) / SH_C0, np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )


def frustum(y: float) -> Layer:
    """The pyramid of a camera that stands at y and looks north."""
    pose = ViewPose(position=np.array([0.0, y, 4]), focal_point=np.array([0.0, y + 1, 4]), up=np.array([0.0, 0, 1]), angle_deg=60.0)
    camera: Cameras = pose.camera((40, 30))
    segments = pyramid_segments(camera, 3.0)
    colors = np.tile(np.array(VERMILLION, np.uint8), (len(segments), 1))
    return Layer(name="camera", segments=segments, segment_colors=colors, line_width_px=2)


def drawn_px(layers: list[Layer]) -> int:
    image = draw_splat_view(layers, house(), VIEW.camera(SIZE_WH)).image
    return int((np.abs(image.astype(int) - VERMILLION).max(axis=2) < 40).sum())


def test_a_frustum_behind_a_house_is_hidden_and_one_before_it_is_not() -> None:
    assert drawn_px([]) == 0
    assert drawn_px([frustum(-12.0)]) > 150
    assert drawn_px([frustum(9.0)]) == 0


def test_a_layer_that_a_wall_cuts_is_seen_as_far_as_it_stands_before_the_wall() -> None:
    ends = np.array([[[-2.0, -10, 4], [-2.0, 10, 4]]])
    rod = Layer(name="rod", segments=ends, segment_colors=np.array([VERMILLION], np.uint8), line_width_px=3)
    image = draw_splat_view([rod], house(), VIEW.camera(SIZE_WH)).image
    columns = np.flatnonzero((np.abs(image.astype(int) - VERMILLION).max(axis=2) < 40).any(axis=0))
    focal = SIZE_WH[1] / (2 * np.tan(np.radians(20)))
    begins, wall = (160 + focal * -2 / depth for depth in (20.0, 26.0))
    # A pixel of the line's cap, and the half metre by which Gaussians stand out of the wall.
    assert abs(columns.min() - begins) < 3
    assert abs(columns.max() - wall) < 3
