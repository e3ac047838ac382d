"""Training: it learns, it is repeatable, it keeps what it must keep, and says what is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from radiant_core.aggregate.synthetic_views import synthetic_views
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.frames import Frame
from radiant_core.render.rasterize import rasterize
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.splats import SH_C0, Splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.initialize import first_splats, initial_splats, sky_share
from radiant_core.train.needs import Overrides, fit_to_backend
from radiant_core.train.results import TrainProgress
from radiant_core.train.trainer import FitOptions, Steps, fit_splats
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

CAMERAS = cameras_above([(x, y) for x in (-2.0, 0.0, 2.0) for y in (-1.5, 1.5)])
CONFIG = replace(train_preset("draft"), num_steps=60, sh_degree=0)


def photographs() -> TrainingViews:
    views = synthetic_views(ground_splats(), CAMERAS)
    return TrainingViews(cameras=views.cameras, images=views.images)


def grey_start() -> Splats:
    truth = ground_splats()
    return Splats(**{**truth.arrays(), "sh0": np.zeros_like(truth.sh0), "logit_opacities": truth.logit_opacities * 0 - 2})


def mean_psnr_db(splats: Splats, views: TrainingViews) -> float:
    pairs = zip(render_views(splats, views.cameras), views.images, strict=True)
    return float(np.mean([psnr_db(view.image, image / 255) for view, image in pairs]))


def test_grey_ground_learns_its_colours() -> None:
    views = photographs()
    result = fit_splats(grey_start(), views, CONFIG)
    before, after = mean_psnr_db(grey_start(), views), mean_psnr_db(result.splats, views)
    assert after > before + 8, f"{before:.1f} dB → {after:.1f} dB"
    assert result.last_loss < result.first_loss


def test_same_seed_gives_the_same_bits_and_another_seed_does_not() -> None:
    views, config = photographs(), replace(CONFIG, num_steps=8)
    first, second = fit_splats(grey_start(), views, config), fit_splats(grey_start(), views, config)
    other = fit_splats(grey_start(), views, replace(config, seed=1))
    for name, array in first.splats.arrays().items():
        np.testing.assert_array_equal(array, second.splats.arrays()[name])
    assert (first.splats.sh0 != other.splats.sh0).any()


def test_cameras_reach_the_renderer_as_they_are_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    # Rounded to float32, a camera 10 km from the origin stands a millimetre off, and training would
    # see another picture than evaluation.
    dtypes: list[torch.dtype] = []

    def spy(splats, viewmats, Ks, *sizes, **options):
        dtypes.extend((viewmats.dtype, Ks.dtype))
        return rasterize(splats, viewmats, Ks, *sizes, **options)

    monkeypatch.setattr("radiant_core.train.view_loss.rasterize", spy)
    fit_splats(grey_start(), photographs(), replace(CONFIG, num_steps=1))
    assert dtypes == [torch.float64, torch.float64]


@pytest.mark.parametrize("share", [1 / 3, 1e-3])
def test_no_gaussian_outgrows_its_distance_to_the_nearest_camera(share: float) -> None:
    start = grey_start()
    # One at a camera's own centre, one as large as the scene just below another, and an ordinary
    # one.
    means, log_scales = start.means.copy(), start.log_scales.copy()
    means[:2] = CAMERAS.centers[:2] - [[0, 0, 0], [0, 0, 0.5]]
    log_scales[:2] = 3.0
    start = replace(start, means=means.astype(np.float32), log_scales=log_scales)
    config = replace(CONFIG, num_steps=3, max_scale_per_distance=share)
    splats = fit_splats(start, photographs(), config).splats
    distances = np.linalg.norm(splats.means[:, None].astype(np.float64) - CAMERAS.centers, axis=2).min(axis=1)
    assert (np.exp(splats.log_scales.astype(np.float64)).max(axis=1) <= share * distances * (1 + 1e-5) + 1e-37).all()
    free = fit_splats(start, photographs(), replace(config, max_scale_per_distance=None)).splats
    assert free.log_scales[:2].max() > 2.5


@pytest.mark.parametrize("share", [0.0, -1.0, np.nan, np.inf])
def test_a_limit_of_sizes_must_be_positive(share: float) -> None:
    with pytest.raises(BadInput, match="max_scale_per_distance"):
        TrainConfig(max_scale_per_distance=share)


def test_frozen_tensors_keep_their_bits() -> None:
    start = grey_start()
    options = FitOptions(steps=Steps(means=0, quats=0, log_scales=0))
    result = fit_splats(start, photographs(), replace(CONFIG, num_steps=5), options)
    for name in ("means", "quats", "log_scales"):
        np.testing.assert_array_equal(start.arrays()[name], result.splats.arrays()[name])
    assert (result.splats.sh0 != start.sh0).any()


def test_progress_ends_with_the_last_step() -> None:
    seen: list[TrainProgress] = []
    ticks = iter(range(1000))
    options = FitOptions(report=seen.append, report_every_s=3, clock=lambda: float(next(ticks)))
    fit_splats(grey_start(), photographs(), replace(CONFIG, num_steps=7), options)
    assert [progress.step for progress in seen] == [3, 6, 7]


@pytest.mark.parametrize("value", [0, 255])
def test_flat_photographs_end_in_a_finite_model(value: int) -> None:
    images = tuple(np.full((36, 48, 3), value, np.uint8) for _ in CAMERAS.names)
    result = fit_splats(
        grey_start(), TrainingViews(cameras=CAMERAS, images=images), replace(CONFIG, num_steps=20, means_lr=3e-3, scales_lr=0.2)
    )
    assert np.isfinite(result.last_loss)


def test_views_of_the_wrong_size_are_named() -> None:
    with pytest.raises(BadInput, match="expected \\(36, 48, 3\\) uint8"):
        TrainingViews(cameras=CAMERAS, images=tuple(np.zeros((36, 47, 3), np.uint8) for _ in CAMERAS.names))


class TestInitialSplats:
    points = np.random.default_rng(0).uniform(-3, 3, (500, 3)) * [1, 1, 0.1]
    colors = np.random.default_rng(1).integers(0, 256, (500, 3)).astype(np.uint8)

    def start(self, **options) -> Splats:
        return initial_splats(self.points, self.colors, CAMERAS, **{"max_num_splats": 1000, "sh_degree": 1, **options})

    def test_one_gaussian_per_point_in_its_colour(self) -> None:
        splats = self.start()
        order = np.lexsort(self.points.T[::-1])
        np.testing.assert_allclose(splats.means, self.points[order].astype(np.float32))
        np.testing.assert_allclose(0.5 + 0.28209479 * splats.sh0[:, 0], self.colors[order] / 255, atol=1e-6)

    def test_the_limit_holds(self) -> None:
        assert len(self.start(max_num_splats=100)) == 100

    def test_scaling_the_world_scales_the_gaussians(self) -> None:
        small = self.start()
        big = initial_splats(self.points * 1000, self.colors, CAMERAS, max_num_splats=1000, sh_degree=1)
        np.testing.assert_allclose(np.exp(big.log_scales), 1000 * np.exp(small.log_scales), rtol=1e-5)

    def test_a_lone_point_far_away_stays_small(self) -> None:
        points = np.vstack([self.points, [[1e5, 0, 0]]])
        splats = initial_splats(points, np.vstack([self.colors, [[0, 0, 0]]]), CAMERAS, max_num_splats=1000, sh_degree=0)
        assert np.exp(splats.log_scales).max() < 5

    def test_duplicates_are_merged(self) -> None:
        twice = np.vstack([self.points, self.points])
        splats = initial_splats(twice, np.vstack([self.colors, self.colors]), CAMERAS, max_num_splats=2000, sh_degree=0)
        assert len(splats) == 500

    def test_points_at_a_cameras_centre_are_left_out(self) -> None:
        at_cameras = CAMERAS.centers + 1e-5
        points = np.vstack([self.points, at_cameras])
        splats = initial_splats(
            points, np.vstack([self.colors, np.zeros((len(at_cameras), 3), np.uint8)]), CAMERAS, max_num_splats=2000, sh_degree=0
        )
        assert len(splats) == 500

    def test_too_few_points_are_refused(self) -> None:
        with pytest.raises(BadInput, match="only 1 different sparse points"):
            initial_splats(np.zeros((9, 3)), np.zeros((9, 3), np.uint8), CAMERAS, max_num_splats=10, sh_degree=0)

    def test_a_camera_that_looks_up_gets_a_sky(self) -> None:
        up = CAMERAS.select([0])
        pose = up.cam_from_world.copy()
        pose[0, :3, :3] = np.eye(3)  # z of the camera is up
        looking_up = type(up)(names=up.names, Ks=up.Ks, cam_from_world=pose, sizes_wh=up.sizes_wh)
        assert sky_share(looking_up) == 1.0 and sky_share(CAMERAS) == 0.0
        splats = initial_splats(self.points, self.colors, looking_up, max_num_splats=1000, sh_degree=0)
        assert len(splats) > 500 and splats.means[500:, 2].min() > -10
        limited = initial_splats(self.points, self.colors, looking_up, max_num_splats=100, sh_degree=0)
        assert len(limited) <= 100 and 10 < (limited.means[:, 2] > 1).sum() <= 25

    def test_a_sky_begins_opaque_in_the_colour_of_the_photographs_upper_part(self) -> None:
        pose = CAMERAS.select([0]).cam_from_world.copy()
        pose[0, :3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # looks level, to the north
        level = replace(CAMERAS.select([0]), cam_from_world=pose)
        width, height = level.sizes_wh[0]
        photograph = np.zeros((height, width, 3), np.uint8)
        photograph[: height // 2] = (40, 120, 240)
        count = len(self.points)
        scene = SfmScene(
            cameras=level, points=self.points, colors=self.colors, observations=np.column_stack([np.arange(count), np.zeros(count, int)]),
            frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)),
        )  # fmt: skip
        splats, _ = first_splats(scene, TrainingViews(cameras=level, images=(photograph,)), train_preset("draft"))
        far = splats.means[:, 2] > 10
        assert far.sum() > 100
        np.testing.assert_allclose(0.5 + SH_C0 * splats.sh0[far, 0], np.tile(np.array([40, 120, 240]) / 255, (far.sum(), 1)), atol=1e-5)
        assert (splats.logit_opacities[far] > 2).all()


def test_reference_backend_reduces_and_says_so_and_obeys_force() -> None:
    config, decisions = fit_to_backend(TrainConfig(), "reference", Overrides(num_steps=9000))
    assert config.num_steps == 9000 and config.long_side_px < 1152
    assert {d.topic: d.forced for d in decisions} == {"long_side_px": False, "num_steps": True, "max_num_splats": False}
    unchanged, none = fit_to_backend(TrainConfig(), "gsplat", Overrides())
    assert unchanged == TrainConfig() and none == ()


def test_unknown_preset_lists_the_known() -> None:
    with pytest.raises(BadInput, match="draft, default, standard, paper"):
        train_preset("fast")
