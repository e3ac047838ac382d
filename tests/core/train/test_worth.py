"""Photographs that add nothing: blurred and repeated ones are found, what is told is the measured
figure, and nothing else is dropped."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.regimes import SHARPNESS
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.views import TrainingViews
from radiant_core.train.worth import (
    Worth,
    _medians_of_others,
    find_repeats,
    images_worth,
    relative_sharpness,
    worth_training,
)
from tests.core.scenes import cameras_above

CAMERAS = cameras_above([(x, y) for x in (-0.8, 0.0, 0.8) for y in (-0.5, 0.5)], size_wh=(96, 72))
TEXTURE = np.random.default_rng(0).integers(0, 256, (400, 400, 3), np.uint8)
TEXTURE_PX_PER_M = 25.0
AUTO = replace(TrainConfig(), skip_images="auto")


def photograph(cameras: Cameras, index: int) -> np.ndarray:
    """Flat ground of random texels on z = 0 as the camera sees it."""
    x, y, z = cameras.centers[index]
    step = z / cameras.Ks[index, 0, 0] * TEXTURE_PX_PER_M
    left, top = 200 + x * TEXTURE_PX_PER_M - step * 48, 200 - y * TEXTURE_PX_PER_M - step * 36
    to_texture = np.array([[step, 0, left], [0, step, top]])
    return cv2.warpAffine(TEXTURE, to_texture, (96, 72), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def flat_scene(cameras: Cameras = CAMERAS, num_points: int = 400) -> tuple[SfmScene, TrainingViews]:
    points = np.column_stack([np.random.default_rng(1).uniform(-2.5, 2.5, (num_points, 2)), np.zeros(num_points)])
    everything = np.array([(point, camera) for point in range(num_points) for camera in range(len(cameras))]).reshape(-1, 2)
    frame = Frame(kind="metric", origin_lat_lon_alt=np.zeros(3))
    scene = SfmScene(cameras=cameras, points=points, colors=np.zeros((num_points, 3), np.uint8), observations=everything, frame=frame)
    scene = replace(scene, observations=everything[scene.observed_pixels(cameras)[0]])
    images = tuple(np.asarray(photograph(cameras, index), np.uint8) for index in range(len(cameras)))
    return scene, TrainingViews(cameras=cameras, images=images)


def with_image(views: TrainingViews, index: int, image: np.ndarray) -> TrainingViews:
    images = list(views.images)
    images[index] = np.asarray(image, np.uint8)
    return replace(views, images=tuple(images))


def with_points_of_two(scene: SfmScene, share: float) -> SfmScene:
    """The scene, of whose points such a share is found in two photographs alone, here and there."""
    few = np.random.default_rng(2).random(len(scene.points)) < share
    order = np.random.default_rng(3).permutation(len(scene.observations))
    rows = scene.observations[order]
    place = np.array([(rows[:row, 0] == rows[row, 0]).sum() for row in range(len(rows))])
    return replace(scene, observations=rows[~few[rows[:, 0]] | (place < 2)])


def streaked(image: np.ndarray, length_px: int) -> np.ndarray:
    return cv2.blur(image, (length_px, 1))


def test_of_sharp_and_different_photographs_none_is_left_out() -> None:
    scene, views = flat_scene()
    sharpness = relative_sharpness(scene, views)
    assert ((sharpness > 0.9) & (sharpness < 1.1)).all(), sharpness
    worth = images_worth(scene, views)
    assert worth.keep_mask.all() and [decision.topic for decision in worth.decisions] == ["repeated photographs", "blurred photographs"]
    assert worth.decisions[1].figure == pytest.approx(100 * sharpness.min())
    assert worth_training(scene, views, AUTO)[:2] == (scene, views)


def test_a_streaked_photograph_is_found_and_left_out_with_its_figure() -> None:
    scene, views = flat_scene()
    blurred = with_image(views, 2, streaked(views.images[2], 9))
    sharpness = relative_sharpness(scene, blurred)
    assert sharpness.argmin() == 2 and sharpness[2] < SHARPNESS and np.delete(sharpness, 2).min() > 0.9
    restricted, left, decisions = worth_training(scene, blurred, AUTO)
    assert left.cameras.names == restricted.cameras.names == tuple(np.delete(CAMERAS.names, 2))
    assert decisions[1].choice == "1 of 6 photographs are left out" and decisions[1].figure == pytest.approx(100 * sharpness[2])
    assert len(left.images) == 5 and restricted.observations[:, 1].max() == 4


def test_a_darker_photograph_or_one_of_a_lawn_is_not_taken_for_blurred() -> None:
    scene, views = flat_scene()
    darker = with_image(views, 2, views.images[2] * 0.8)
    assert images_worth(scene, darker).keep_mask.all()
    # The east of the ground is a lawn: photographs of it are smooth, and so is what the others show
    # there.
    smooth = TEXTURE.copy()
    smooth[:, 210:] = cv2.GaussianBlur(TEXTURE, (0, 0), 4)[:, 210:]
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(globals(), "TEXTURE", smooth)
        scene, views = flat_scene()
    assert views.images[5][:, 60:].std() < 0.5 * views.images[0][:, :36].std()
    assert images_worth(scene, views).keep_mask.all()


def test_points_found_in_two_photographs_alone_do_not_keep_a_blurred_one() -> None:
    scene, views = flat_scene(num_points=1_000)
    assert ((counts := np.bincount(scene.observations[:, 0])) >= 3).mean() > 0.9
    mixed = with_points_of_two(scene, 0.45)
    counts = np.bincount(mixed.observations[:, 0])
    assert 0.3 < (counts == 2).mean() < 0.6
    # In the middle, where all see the ground; a corner is seen by few.
    blurred = with_image(views, 2, streaked(views.images[2], 9))
    assert images_worth(mixed, blurred).keep_mask.tolist() == [True, True, False, True, True, True]


def test_a_blurred_photograph_that_alone_shows_a_place_stays() -> None:
    far = cameras_above([(-0.8, 0.0), (0.0, 0.0), (0.8, 0.0), (0.0, 3.0)], size_wh=(96, 72))
    scene, views = flat_scene(far, 2_000)
    lonely = replace(scene, points=scene.points * [1, 2.4, 1])
    everything = np.array([(point, camera) for point in range(2_000) for camera in range(4)])
    lonely = replace(lonely, observations=everything)
    lonely = replace(lonely, observations=everything[lonely.observed_pixels(far)[0]])
    blurred = with_image(views, 3, streaked(views.images[3], 9))
    assert relative_sharpness(lonely, blurred)[3] < SHARPNESS
    assert images_worth(lonely, blurred).keep_mask.all()


def test_where_all_are_blurred_alike_none_is() -> None:
    scene, views = flat_scene()
    assert images_worth(scene, replace(views, images=tuple(streaked(image, 9) for image in views.images))).keep_mask.all()


def doubled(noise: float) -> tuple[SfmScene, TrainingViews]:
    names = (*CAMERAS.names, "copy.png")
    order = [0, 1, 2, 3, 4, 5, 1]
    cameras = Cameras(names=names, Ks=CAMERAS.Ks[order], cam_from_world=CAMERAS.cam_from_world[order], sizes_wh=CAMERAS.sizes_wh[order])
    scene, views = flat_scene(cameras)
    shaken = views.images[6] + np.random.default_rng(3).normal(0, noise, views.images[6].shape)
    return scene, with_image(views, 6, shaken.clip(0, 255))


def test_the_second_of_two_equal_photographs_is_left_out() -> None:
    for noise in (0.0, 2.0):
        scene, views = doubled(noise)
        np.testing.assert_array_equal(find_repeats(scene, views), [False] * 6 + [True])
        assert images_worth(scene, views).decisions[0].figure == 1


def test_another_picture_from_the_same_place_is_no_repeat() -> None:
    scene, views = doubled(0.0)
    assert not find_repeats(scene, with_image(views, 6, 255 - views.images[6])).any()
    turned = views.cameras.cam_from_world.copy()
    turned[6, :3, :3] = np.diag([-1, -1, 1]) @ turned[6, :3, :3]
    turned[6, :3, 3] = -turned[6, :3, :3] @ views.cameras.centers[6]
    cameras = replace(views.cameras, cam_from_world=turned)
    assert not find_repeats(replace(scene, cameras=cameras), replace(views, cameras=cameras)).any()


def test_medians_of_the_others_are_those_of_each_group_without_its_value() -> None:
    rng = np.random.default_rng(5)
    group, values = rng.integers(0, 12, 60), rng.normal(size=60).round(1)
    group[group == 7] = 40
    group[:1] = 90
    medians, sizes = _medians_of_others(group, values)
    for index in range(60):
        others = np.delete(values, index)[np.delete(group, index) == group[index]]
        assert sizes[index] == len(others) + 1
        assert medians[index] == pytest.approx(np.median(others) if len(others) else values[index])


def degenerate(kind: str) -> tuple[SfmScene, TrainingViews]:
    scene, views = flat_scene()
    if kind == "one image":
        return scene.restricted_to(np.array([0])), views.select([0])
    if kind == "all black":
        return scene, replace(views, images=tuple(np.zeros_like(image) for image in views.images))
    if kind == "no observations":
        return replace(scene, observations=np.zeros((0, 2), np.int64)), views
    if kind == "no points":
        nothing = {"points": np.zeros((0, 3)), "colors": np.zeros((0, 3), np.uint8), "observations": np.zeros((0, 2), np.int64)}
        return replace(scene, **nothing), views
    if kind == "one pixel":
        cameras = cameras_above([(-1.0, 0.0), (0.0, 0.0), (1.0, 0.0)], size_wh=(1, 1))
        everything = np.array([(point, camera) for point in range(len(scene.points)) for camera in range(3)])
        images = tuple(np.full((1, 1, 3), value, np.uint8) for value in (0, 100, 255))
        return replace(scene, cameras=cameras, observations=everything), TrainingViews(cameras=cameras, images=images)
    if kind == "behind and beside":
        return replace(scene, points=scene.points * 1e6 + [0, 0, 1e6]), views
    poses = np.repeat(CAMERAS.cam_from_world[:1], len(CAMERAS), axis=0)
    cameras = replace(CAMERAS, cam_from_world=poses)
    return replace(scene, cameras=cameras), replace(views, cameras=cameras)


@pytest.mark.parametrize("kind", ["one image", "all black", "no observations", "no points", "one pixel", "behind and beside", "one place"])
def test_degenerate_input_gives_finite_figures_and_drops_nothing(kind: str) -> None:
    worth: Worth = images_worth(*degenerate(kind))
    assert worth.keep_mask.all()
    for decision in worth.decisions:
        assert decision.figure is not None and np.isfinite(decision.figure)


def test_what_is_masked_says_nothing_of_sharpness() -> None:
    scene, views = flat_scene()
    half = np.full((72, 96), 255, np.uint8)
    half[:, 40:] = 0
    smeared = views.images[2].copy()
    smeared[:, 32:] = 128
    hidden = replace(with_image(views, 2, smeared), weights=(half,) * len(views))
    assert images_worth(scene, hidden).keep_mask.all()
    assert not images_worth(scene, replace(hidden, weights=None)).keep_mask.all()


def test_none_leaves_everything_and_the_plain_presets_skip_nothing() -> None:
    scene, views = doubled(0.0)
    assert worth_training(scene, views, replace(AUTO, skip_images="none")) == (scene, views, ())
    assert {name: train_preset(name).skip_images for name in ("default", "draft", "standard", "paper")} == {
        "default": "auto",
        "draft": "auto",
        "standard": "none",
        "paper": "none",
    }
    with pytest.raises(BadInput, match="skip_images is 'some'"):
        replace(AUTO, skip_images="some")
