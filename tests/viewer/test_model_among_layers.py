"""Layers lie before and behind the model by depth, in the same way wherever both are drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.splats import SH_C0, Splats, concatenate_splats
from radiant_viewer.layers.camera_layer import pyramid_segments
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.palette import VERMILLION
from radiant_viewer.pictures.splat_picture import draw_splat_view
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.splats.rgbd import ModelRenderer

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


def test_a_model_is_drawn_however_far_away_and_wherever_it_is() -> None:
    """VTK once left out the picture from 1,414 units on, where the near plane passes its quad."""
    for distance, middle in ((30.0, (0.0, 0, 4)), (3e3, (0.0, 0, 4)), (3e6, (0.0, 0, 4)), (3e3, (5e5, 5e6, 4))):
        far = replace(
            house(), means=(house().means * distance / 30).astype(np.float32), log_scales=house().log_scales + np.log(distance / 30)
        )
        far = replace(
            far, means=(far.means + np.array(middle, np.float32)).astype(np.float32), log_scales=far.log_scales.astype(np.float32)
        )
        place = np.array(middle)
        view = ViewPose(position=place - distance * np.array([0, 1.0, 0]), focal_point=place, up=np.array([0.0, 0, 1]), angle_deg=40.0)
        image = draw_splat_view([], far, view.camera(SIZE_WH)).image
        assert 0.1 < (image < 200).any(axis=2).mean() < 0.9, f"{distance} away from {middle}"


def test_a_sky_does_not_hide_the_model_from_afar_in_pictures_nor_in_the_window() -> None:
    index = np.arange(400) + 0.5
    z, angle = index / 400, np.pi * (1 + np.sqrt(5)) * index
    shell = 150 * np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)
    few = house().select(np.arange(400))
    sky = replace(few, means=shell.astype(np.float32), log_scales=np.full((400, 3), np.log(12.0), np.float32))
    whole = concatenate_splats([house(), sky])
    view = ViewPose(position=np.array([0.0, -250, 190]), focal_point=np.array([0.0, 0, 4]), up=np.array([0.0, 0, 1]), angle_deg=4.0)
    camera = view.camera(SIZE_WH)
    alone = draw_splat_view([], house(), camera).image
    assert (alone == 255).all(axis=2).mean() > 0.2
    np.testing.assert_array_equal(draw_splat_view([], whole, camera).image, alone)
    in_window, own = (np.zeros((SIZE_WH[1], SIZE_WH[0], 4), np.float32) for _ in range(2))
    ModelRenderer(whole).draw(camera, (255, 255, 255), in_window)
    ModelRenderer(house()).draw(camera, (255, 255, 255), own)
    np.testing.assert_array_equal(in_window, own)
    assert (own[..., 3] > 250).mean() > 0.1
