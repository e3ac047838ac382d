"""What a training needs: limits of a backend, of the photographs' pixels and of their number; what
is asked for is left alone."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.regimes import FEW_PHOTOGRAPHS
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig, train_preset, with_settings
from radiant_core.train.densify.policies import Adc, Mcmc, NoDensification
from radiant_core.train.needs import MIN_PLANNED, MIN_STEPS, Overrides, fit_to_backend, fit_to_views, pixels_per_splat
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above

FRAME = Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3))


def scene_of(num_views: int, gains: np.ndarray | None = None, size_wh: tuple[int, int] = (64, 48)) -> tuple[SfmScene, TrainingViews]:
    """Views of one flat ground, of the same points; photograph v is `gains[v]` times as bright."""
    cameras = cameras_above([(0.1 * v, 0.0) for v in range(num_views)], size_wh=size_wh)
    gains = np.ones(num_views) if gains is None else gains
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (40, 2)), np.zeros(40)])
    observations = np.array([(point, view) for point in range(40) for view in range(num_views)])
    images = tuple(np.full((*size_wh[::-1], 3), round(100 * gain), np.uint8) for gain in gains)
    scene = SfmScene(cameras=cameras, points=points, colors=np.full((40, 3), 100, np.uint8), observations=observations, frame=FRAME)
    return scene, TrainingViews(cameras=cameras, images=images)


class TestLength:
    def test_a_long_run_of_few_photographs_is_cut_and_says_so(self) -> None:
        _, views = scene_of(20)
        config, decisions = fit_to_views(TrainConfig(num_steps=10**9, max_epochs=100), views)
        assert config.num_steps == 2_000
        (decision,) = decisions
        assert decision.topic == "length" and "2,000" in decision.choice and decision.figure == 20 and not decision.forced

    def test_never_below_the_floor_and_never_longer_than_asked(self) -> None:
        _, views = scene_of(3)
        assert fit_to_views(TrainConfig(num_steps=7_000, max_epochs=10), views)[0].num_steps == MIN_STEPS
        assert fit_to_views(TrainConfig(num_steps=800, max_epochs=10), views)[0].num_steps == 800
        assert fit_to_views(TrainConfig(num_steps=7_000, max_epochs=None), views)[0].num_steps == 7_000

    def test_steps_that_were_asked_for_are_all_taken(self) -> None:
        assert fit_to_backend(train_preset("default"), "native", Overrides())[0].max_epochs == 120
        assert fit_to_backend(train_preset("default"), "native", Overrides(num_steps=20_000))[0].max_epochs is None
        both = Overrides(num_steps=20_000, settings={"max_epochs": 5})
        assert fit_to_backend(train_preset("default"), "native", both)[0].max_epochs == 5
        assert train_preset("standard").max_epochs is train_preset("paper").max_epochs is None

    @pytest.mark.parametrize("epochs", [0, -1])
    def test_a_limit_below_one_is_refused(self, epochs: int) -> None:
        with pytest.raises(BadInput, match="max_epochs is"):
            TrainConfig(max_epochs=epochs)
        with pytest.raises(BadInput, match="settle_epochs is"):
            TrainConfig(settle_epochs=epochs)


class TestSize:
    @pytest.mark.parametrize("density", [Adc(kind="planned", pixels_per_splat=80), Mcmc(pixels_per_splat=80)])
    def test_growth_is_limited_by_the_pixels_of_the_photographs(self, density) -> None:
        _, views = scene_of(50, size_wh=(160, 120))
        config, decisions = fit_to_views(TrainConfig(density=density, max_epochs=None), views)
        assert config.max_num_splats == 50 * 160 * 120 // 80 and [d.topic for d in decisions] == ["number of Gaussians"]

    @pytest.mark.parametrize("density", [Adc(kind="planned"), Mcmc()])
    def test_of_few_photographs_and_where_gaussians_are_left_out_at_random_there_may_be_more(self, density) -> None:
        pixels, few = 160 * 120, FEW_PHOTOGRAPHS
        wishes = [("always", 40, 50), ("none", 56, 50), ("none", 80, 2 * few), ("none", 40, few - 1), ("auto", 40, few), ("auto", 57, 51)]
        for wish, per_splat, count in wishes:
            views = scene_of(count, size_wh=(160, 120))[1]
            config, decisions = fit_to_views(TrainConfig(density=density, max_epochs=None, drop_gaussians=wish), views)
            assert config.max_num_splats == count * pixels // per_splat, wish
            assert f"one Gaussian per {per_splat} pixels" in decisions[0].reason
            asked = replace(density, pixels_per_splat=60)
            asked_for = TrainConfig(density=asked, max_epochs=None, drop_gaussians=wish)
            assert fit_to_views(asked_for, views)[0].max_num_splats == count * pixels // 60

    def test_more_photographs_never_mean_fewer_gaussians(self) -> None:
        config = TrainConfig(density=Adc(kind="planned"), drop_gaussians="none")
        most = [count * 19_200 / (pixels_per_splat(config, count) or 1) for count in range(2, 200)]
        # Whole pixels per Gaussian round by a hundredth.
        assert all(after >= 0.98 * before for before, after in itertools.pairwise(most))
        assert pixels_per_splat(config, FEW_PHOTOGRAPHS) == 40 and pixels_per_splat(config, 2 * FEW_PHOTOGRAPHS) == 80

    def test_the_number_of_pixels_can_be_set(self) -> None:
        for text, value in (("auto", "auto"), ("60", 60), ("none", None)):
            density = with_settings(train_preset("default"), {"density.pixels_per_splat": text}).density
            assert density.pixels_per_splat == value  # type: ignore[union-attr]
        for text in ("0", "few"):
            with pytest.raises(BadInput, match="pixels_per_splat"):
                with_settings(train_preset("default"), {"density.pixels_per_splat": text})

    def test_a_floor_a_switch_and_policies_without_a_limit_to_reach(self) -> None:
        _, views = scene_of(2)
        assert fit_to_views(TrainConfig(density=Adc(kind="planned")), views)[0].max_num_splats == MIN_PLANNED
        for config in (TrainConfig(density=density) for density in (Adc(kind="planned", pixels_per_splat=None), Adc(), NoDensification())):
            assert fit_to_views(config, views) == (config, ())
