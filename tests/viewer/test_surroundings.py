"""What surrounds a scene is seen from within, and is not in the way from beyond it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.splats import SH_C0, Splats, concatenate_splats
from radiant_viewer.pictures.splat_picture import Surroundings, render_over_white
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.splats.rgbd import ModelRenderer
from radiant_viewer.splats.splat_worker import Parts
from tests.viewer.test_model_among_layers import house

RADIUS_M = 150.0
EAST = np.array([1.0, 0, 0])


def sky() -> Splats:
    """An opaque blue half sphere around the house."""
    index = np.arange(400) + 0.5
    z, angle = index / 400, np.pi * (1 + np.sqrt(5)) * index
    flat = np.sqrt(1 - z * z)
    means = RADIUS_M * np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
    count = len(means)
    return Splats(
        means=means.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.full((count, 3), np.log(10.0), np.float32),
        logit_opacities=np.full(count, 6, np.float32),
        sh0=np.tile((np.array([0.2, 0.4, 0.9], np.float32) - 0.5) / SH_C0, (count, 1, 1)),
        shN=np.zeros((count, 0, 3), np.float32),
    )


def looking_from(distance_m: float) -> ViewPose:
    toward = np.array([0.0, -np.cos(0.6), np.sin(0.6)])
    angle_deg = 2 * np.degrees(np.arctan(12 / distance_m))
    return ViewPose(position=distance_m * toward, focal_point=np.zeros(3), up=np.array([0.0, 0, 1]), angle_deg=angle_deg)


def is_blue(image: np.ndarray) -> np.ndarray:
    return image[..., 2].astype(int) > image[..., 0].astype(int) + 60


def test_the_sky_is_behind_a_scene_and_never_before_it() -> None:
    whole = concatenate_splats([house(), sky()])
    level = replace(looking_from(40.0), position=np.array([0.0, -30, 4]), focal_point=np.array([0.0, 0, 6]), angle_deg=60.0)
    assert is_blue(render_over_white(whole, level.camera((96, 72)))).mean() > 0.3
    for distance_m in (130.0, 200.0, 1000.0):
        camera = looking_from(distance_m).camera((96, 72))
        image = render_over_white(whole, camera)
        assert not is_blue(image).any()
        np.testing.assert_array_equal(image, render_over_white(house(), camera))
        assert (image < 200).any(axis=2).mean() > 0.1  # the house is there


def test_the_window_leaves_out_the_same_and_keeps_what_it_has_cut_out() -> None:
    whole = concatenate_splats([house(), sky()])
    parts = Parts(whole, ModelRenderer)
    camera = looking_from(300.0).camera((96, 72))
    drawn = np.zeros((72, 96, 4), np.float32)
    renderer = parts.renderer(None, None, None, camera.centers[0])
    assert renderer is not None
    renderer.draw(camera, (255, 255, 255), drawn)
    assert np.abs(255 * drawn[..., :3] - render_over_white(house(), camera)).max() < 1.01
    assert parts.renderer(None, None, None, camera.centers[0] * 1.001) is renderer
    inside = parts.renderer(None, None, None, np.zeros(3))
    assert inside is not None and inside is not renderer
    assert Parts(whole.select(np.zeros(0, np.int64)), ModelRenderer).renderer(None, None, None, np.zeros(3)) is None


def test_an_eye_at_the_scene_sees_everything_and_another_what_is_farther_than_itself() -> None:
    around = Surroundings.of(concatenate_splats([house(), sky()]))
    for eye in (around.middle, around.middle + 0.99 * around.near * EAST, np.full(3, np.nan), np.full(3, np.inf)):
        assert around.in_the_way(eye) is None and around.seen(None).all()
    for distance in np.geomspace(1.01, 100, 40) * around.near:
        up_to = around.in_the_way(around.middle + distance * EAST)
        assert up_to is not None and 1.25 * 0.999 <= up_to / distance <= 1.25**2 * 1.001
        kept = around.seen(up_to)
        assert kept[: len(house())].all() and kept[len(house()) :].all() == (up_to < RADIUS_M - 10)


@pytest.mark.parametrize("count", [1, 2])
def test_a_model_of_one_place_has_no_surroundings(count: int) -> None:
    alone = house().select(np.zeros(count, np.int64))
    around = Surroundings.of(alone)
    assert around.near == 0 and around.in_the_way(np.array([1e9, 0, 0])) is None
