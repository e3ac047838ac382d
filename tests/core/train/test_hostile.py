"""Hostile inputs of training: each ends in one sentence or in a finite model that renders finite
pictures, under every densification."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate.synthetic_views import synthetic_views
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput, StageFailed
from radiant_core.frames import Frame
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.splats import SH_C0
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.densify.policies import Adc, Mcmc, NoDensification
from radiant_core.train.initialize import first_splats
from radiant_core.train.results import TrainResult
from radiant_core.train.trainer import FitOptions, fit_splats
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

Input = tuple[SfmScene, TrainingViews]
CAMERAS = cameras_above([(x, y) for x in (-1.5, 0.0, 1.5) for y in (-1.0, 1.0)], size_wh=(32, 24))
EDITS = Adc(from_step=4, until_step=36, every=6, min_gradient=1e-7, reset_opacity_every=15)
CONFIG = replace(
    train_preset("default"),
    num_steps=40,
    schedule_steps=40,
    density=EDITS,
    max_num_splats=2_000,
)
POLICIES = {
    "none": replace(CONFIG, density=NoDensification()),
    "adc": replace(CONFIG, adam="dense"),
    "planned": replace(CONFIG, density=replace(EDITS, kind="planned"), start_scale=0.5),
    "mcmc": replace(CONFIG, density=Mcmc(from_step=4, until_step=36, every=6)),
}


def scene_of(points: np.ndarray, cameras: Cameras) -> SfmScene:
    """A scene whose every point every camera sees."""
    count = len(points)
    return SfmScene(
        cameras=cameras,
        points=points,
        colors=np.full((count, 3), 128, np.uint8),
        observations=np.array([(point, camera) for point in range(count) for camera in range(len(cameras))]).reshape(-1, 2),
        frame=Frame(kind="metric", origin_lat_lon_alt=np.zeros(3)),
    )


def ordinary() -> Input:
    truth = ground_splats(200)
    views = synthetic_views(truth, CAMERAS)
    return scene_of(truth.means.astype(np.float64), CAMERAS), TrainingViews(cameras=CAMERAS, images=views.images)


def with_images(change: Callable[[int, np.ndarray], np.ndarray]) -> Input:
    scene, views = ordinary()
    return scene, replace(views, images=tuple(change(index, image).astype(np.uint8) for index, image in enumerate(views.images)))


def with_cameras(cameras: Cameras, points: np.ndarray | None = None) -> Input:
    scene, views = ordinary()
    return scene_of(scene.points if points is None else points, cameras), replace(views, cameras=cameras)


def single_image() -> Input:
    scene, views = ordinary()
    return scene_of(scene.points, CAMERAS.select([0])), views.select([0])


def wrong_focal() -> Input:
    return with_cameras(replace(CAMERAS, Ks=CAMERAS.Ks * [[1.2, 1, 1], [1, 1.2, 1], [1, 1, 1]]))


def on_a_line() -> Input:
    return with_cameras(CAMERAS, np.linspace(-3, 3, 50)[:, None] * [1.0, 0.5, 0.0])


def moved_and_scaled(scale: float, offset_m: float) -> Input:
    scene, _ = ordinary()
    poses = CAMERAS.cam_from_world.copy()
    poses[:, :3, 3] = -np.einsum("cij,cj->ci", poses[:, :3, :3], scale * CAMERAS.centers + offset_m)
    return with_cameras(replace(CAMERAS, cam_from_world=poses), scale * scene.points + offset_m)


def one_pixel() -> Input:
    cameras = cameras_above([(-1.0, 0.0), (0.0, 0.0), (1.0, 0.0)], size_wh=(1, 1))
    images = tuple(np.full((1, 1, 3), value, np.uint8) for value in (0, 100, 255))
    return scene_of(ordinary()[0].points, cameras), TrainingViews(cameras=cameras, images=images)


def far_outlier() -> Input:
    scene, views = ordinary()
    points = np.concatenate([scene.points, [[1e6, -1e6, 1e5]]])
    return scene_of(points, CAMERAS), views


def cameras_in_one_place() -> Input:
    return with_cameras(replace(CAMERAS, cam_from_world=np.repeat(CAMERAS.cam_from_world[:1], len(CAMERAS), axis=0)))


def fitted(given: Input, config: TrainConfig) -> TrainResult:
    scene, views = given
    initial, _ = first_splats(scene, views, config)
    return fit_splats(initial, views, config, FitOptions(validation=views))


INPUTS = {
    "single image": single_image,
    "all black": lambda: with_images(lambda index, image: 0 * image),
    "all white": lambda: with_images(lambda index, image: 0 * image + 255),
    "flat": lambda: with_images(lambda index, image: 0 * image + 77),
    "two exposures": lambda: with_images(lambda index, image: image * (0.3 if index % 2 else 1.0)),
    "focal length wrong by 20 %": wrong_focal,
    "points on a line": on_a_line,
    "10⁶ m wide": lambda: moved_and_scaled(1e6 / 8, 0.0),
    "10⁶ m away": lambda: moved_and_scaled(1.0, 1e6),
    "a millimetre wide": lambda: moved_and_scaled(1e-4, 0.0),
    "one-pixel images": one_pixel,
    "a point far off": far_outlier,
    "cameras in one place": cameras_in_one_place,
}


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("name", INPUTS)
def test_a_hostile_input_ends_in_a_finite_model(name: str, policy: str) -> None:
    given = INPUTS[name]()
    result = fitted(given, POLICIES[policy])
    assert len(result.splats) > 0 and result.num_steps == CONFIG.num_steps
    for tensor, array in result.splats.arrays().items():
        assert np.isfinite(array).all(), tensor
    assert np.isfinite([result.first_loss, result.last_loss]).all()
    assert np.isfinite([figure for _, figure in result.validation]).all()
    for view in render_views(result.splats, given[1].cameras):
        assert np.isfinite(view.image).all() and np.isfinite(view.depth).all()


@pytest.mark.parametrize("name", ["all black", "flat", "all white"])
def test_one_colour_is_learnt(name: str) -> None:
    scene, views = INPUTS[name]()
    result = fitted((scene, views), replace(CONFIG, num_steps=150, density=NoDensification(), start_scale=1.0))
    assert result.last_loss < 0.5 * result.first_loss
    middle = next(iter(render_views(result.splats, views.cameras))).image[8:16, 10:22]
    np.testing.assert_allclose(middle, views.images[0][0, 0, 0] / 255, atol=0.12)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_without_points_there_is_one_sentence(count: int) -> None:
    scene, views = ordinary()
    few = scene_of(scene.points[:count], CAMERAS)
    with pytest.raises(BadInput, match=f"only {count} different sparse points, expected at least 4"):
        first_splats(few, views, CONFIG)


def test_points_all_in_one_place_are_one_point() -> None:
    scene, views = ordinary()
    with pytest.raises(BadInput, match="only 1 different sparse points"):
        first_splats(scene_of(np.repeat(scene.points[:1], 50, axis=0), CAMERAS), views, replace(CONFIG, fill_in=False))


def test_gradients_that_are_not_finite_end_in_one_sentence() -> None:
    scene, views = ordinary()
    initial, _ = first_splats(scene, views, CONFIG)
    huge = replace(initial, sh0=np.full_like(initial.sh0, 1e38 / SH_C0 * 0.1))
    with pytest.raises((BadInput, StageFailed), match=r"lower the learning rates|not finite|expected"):
        fit_splats(huge, views, CONFIG)
