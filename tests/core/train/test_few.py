"""What few photographs gain by: which trainings are asked, and what is taken of their answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from radiant_core.errors import BadInput, StageFailed
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.numerics import FloatArray
from radiant_core.regimes import FEW_PHOTOGRAPHS
from radiant_core.render.rendered_view import render_views
from radiant_core.train.config import TrainConfig, train_preset, with_settings
from radiant_core.train.densify.policies import Adc, Mcmc, NoDensification
from radiant_core.train.few import EVERY, FEWEST, MIN_GAIN_DB, PARTS, TOPIC, Trial, choose_for_few, score_apart
from radiant_core.train.needs import PIXELS_OF_FEW, fit_to_views
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

ASKED = replace(train_preset("default"), cross_validate="auto", density=Adc(kind="planned"))
SIZE_WH = (160, 120)


def photographs(num_views: int, size_wh: tuple[int, int] = SIZE_WH) -> TrainingViews:
    """Grey photographs of that size."""
    cameras = cameras_above([(0.1 * view, 0.0) for view in range(num_views)], size_wh=size_wh)
    return TrainingViews(cameras=cameras, images=tuple(np.full((*size_wh[::-1], 3), 99, np.uint8) for _ in range(num_views)))


class Trainings:
    """Scores candidates by a table of (left out at random, pixels per Gaussian) → dB; None fails."""

    def __init__(self, table: Mapping[tuple[str, int | None], float | None]) -> None:
        self.table = table
        self.asked: list[tuple[str, int | None]] = []
        self.apart: list[NDArray[np.bool_]] = []
        self.most = 0
        self.lengths: set[int] = set()

    def __call__(self, trial: Trial) -> FloatArray:
        """The figure of the table, a little different for each photograph apart."""
        assert trial.config.cross_validate == "none" and len(self.asked) <= trial.number < trial.most
        key = trial.config.drop_gaussians, getattr(trial.config.density, "pixels_per_splat", None)
        self.asked.append(key)
        self.apart.append(trial.held_out)
        self.most = trial.most
        self.lengths.add(fit_to_views(trial.config, photographs(int((~trial.held_out).sum())))[0].num_steps)
        figure = self.table[key]
        if figure is None:
            raise StageFailed("training: 20 steps in a row could not be taken; lower the learning rates.")
        return figure + np.linspace(-3, 3, trial.held_out.sum())

    @property
    def candidates(self) -> list[tuple[str, int | None]]:
        """What was asked, once each, in order."""
        return list(dict.fromkeys(self.asked))


def chosen(
    table: Mapping[tuple[str, int | None], float], config: TrainConfig = ASKED, num_views: int = 20
) -> tuple[tuple[Any, Any], Trainings]:
    """What is open, as it was chosen, and the trainings that were asked."""
    trainings = Trainings(table)
    choice = choose_for_few(config, photographs(num_views), trainings)
    assert choice.config.cross_validate == "none" and choice.num_trials == len(trainings.asked)
    return (choice.config.drop_gaussians, getattr(choice.config.density, "pixels_per_splat", None)), trainings


def refuse(trial: Trial) -> FloatArray:
    """A training that must not be taken."""
    raise AssertionError("nothing is to be trained")


class TestChoice:
    def test_more_gaussians_are_taken_where_they_gain_and_fewer_are_not_asked_for_then(self) -> None:
        choice, trainings = chosen({("always", 40): 20.0, ("always", 20): 20.5, ("none", 20): 20.55})
        assert choice == ("always", 20)
        assert trainings.candidates == [("always", 40), ("always", 20), ("none", 20)]

    def test_fewer_where_more_lose_and_none_left_out_where_that_gains(self) -> None:
        choice, trainings = chosen({("always", 40): 20.0, ("always", 20): 19.0, ("always", 80): 20.2, ("none", 80): 20.4})
        assert choice == ("none", 80)
        assert trainings.candidates == [("always", 40), ("always", 20), ("always", 80), ("none", 80)]

    def test_what_gains_less_than_the_least_or_is_no_number_changes_nothing(self) -> None:
        less = 20.0 + MIN_GAIN_DB - 0.01
        table = {("always", 40): 20.0, ("always", 20): less, ("always", 80): float("nan"), ("none", 40): less}
        choice = choose_for_few(ASKED, photographs(20), Trainings(table))
        (decision,) = choice.decisions
        assert choice.config == replace(ASKED, cross_validate="none") and choice.num_trials == 8
        assert decision.figure == 0.0 and "as their number says" in decision.choice
        assert not decision.changes_nothing, "who asked for eight trainings reads what they said"
        assert "8 trainings" in decision.reason and "nan" in decision.reason

    def test_a_candidate_that_cannot_be_trained_is_not_taken_and_says_why(self) -> None:
        table = {("always", 40): 20.0, ("always", 20): None, ("always", 80): 19.0, ("none", 40): 20.5}
        choice = choose_for_few(ASKED, photographs(20), lenient := Trainings(table))
        (decision,) = choice.decisions
        assert choice.num_trials == len(lenient.asked) == 7 and "7 trainings" in decision.reason
        assert choice.config.drop_gaussians == "none" and decision.figure == pytest.approx(0.5)
        assert "failed (training: 20 steps in a row could not be taken)" in decision.reason
        assert lenient.candidates == [("always", 40), ("always", 20), ("always", 80), ("none", 40)]

    def test_where_the_first_cannot_be_trained_without_some_their_number_decides(self) -> None:
        trainings = Trainings({("always", 40): None})
        choice = choose_for_few(ASKED, photographs(20), trainings)
        (decision,) = choice.decisions
        assert choice.config == replace(ASKED, cross_validate="none") and choice.num_trials == len(trainings.asked) == 1
        assert decision.choice == "photographs are not asked" and "20 steps in a row" in decision.reason and not decision.changes_nothing

    def test_the_decision_tells_what_every_candidate_gained_over_what_it_would_have_replaced(self) -> None:
        table = {("always", 40): 20.0, ("always", 20): 20.5, ("none", 20): 20.7}
        (decision,) = choose_for_few(ASKED, photographs(20), Trainings(table)).decisions
        assert decision.figure == pytest.approx(0.7) and not decision.changes_nothing and not decision.forced
        twice = "up to 20% of the Gaussians left out at each step and growth to 19,200"
        assert f"{twice} +0.50 dB, none left out and growth to 19,200 +0.20 dB" in decision.reason
        assert decision.choice == "none left out and growth to 19,200" and "5 of 20" in decision.unit

    def test_trials_are_as_long_as_the_training_that_they_stand_for(self) -> None:
        table = {("always", 40): 20.0, ("always", 20): 19.0, ("always", 80): 19.0, ("none", 40): 19.0}
        for num_views in (FEWEST, 20, FEW_PHOTOGRAPHS - 1):
            whole = fit_to_views(replace(ASKED, cross_validate="none"), photographs(num_views))[0].num_steps
            assert chosen(table, num_views=num_views)[1].lengths == {whole}

    def test_where_dense_points_begin_a_model_that_does_not_grow_its_size_is_not_asked(self) -> None:
        trainings = Trainings({("always", "auto"): 20.0, ("none", "auto"): 19.0})  # type: ignore[dict-item]
        assert choose_for_few(replace(ASKED, dense_points="always"), photographs(20), trainings).num_trials == trainings.most == 4

    def test_what_the_user_set_is_not_asked(self) -> None:
        fixed = with_settings(ASKED, {"drop_gaussians": "none"})
        choice, trainings = chosen({("none", 40): 20.0, ("none", 20): 21.0}, fixed)
        assert choice == ("none", 20) and trainings.candidates == [("none", 40), ("none", 20)]
        fixed = with_settings(ASKED, {"density.pixels_per_splat": 60})
        choice, trainings = chosen({("always", 60): 20.0, ("none", 60): 21.0}, fixed)
        assert choice == ("none", 60) and len(trainings.asked) == 4 == trainings.most

    @pytest.mark.parametrize("density", [NoDensification(), Adc(kind="adc")])
    def test_without_a_limit_of_growth_only_leaving_out_is_open(self, density) -> None:
        config = replace(ASKED, density=density)
        pixels = getattr(density, "pixels_per_splat", None)
        choice, trainings = chosen({("always", pixels): 20.0, ("none", pixels): 21.0}, config)
        assert choice == ("none", pixels) and len(trainings.asked) == trainings.most == 4

    def test_mcmc_has_the_same_limit(self) -> None:
        choice, _ = chosen({("always", 40): 20.0, ("always", 20): 21.0, ("none", 20): 19.0}, replace(ASKED, density=Mcmc()))
        assert choice == ("always", 20)

    def test_a_limit_that_growth_cannot_reach_is_not_tried_twice(self) -> None:
        # Three of the twenty are apart.
        bound = 17 * SIZE_WH[0] * SIZE_WH[1] // PIXELS_OF_FEW
        _, trainings = chosen({("always", 40): 20.0, ("always", 80): 19.0, ("none", 40): 19.0}, replace(ASKED, max_num_splats=bound))
        assert ("always", 20) not in trainings.candidates
        small = Trainings({("always", 40): 20.0, ("none", 40): 19.0})
        choose_for_few(ASKED, photographs(20, (32, 24)), small)
        assert small.candidates == [("always", 40), ("none", 40)] and small.most == 4

    def test_what_is_chosen_is_what_a_training_keeps(self) -> None:
        views = photographs(20)
        choice = choose_for_few(ASKED, views, Trainings({("always", 40): 20.0, ("always", 20): 21.0, ("none", 20): 19.0}))
        settled, decisions = fit_to_views(choice.config, views)
        assert settled.max_num_splats == 20 * SIZE_WH[0] * SIZE_WH[1] // 20
        (size,) = (decision for decision in decisions if decision.topic == "number of Gaussians")
        assert size.reason == "more than one Gaussian per 20 pixels were not set, nor chosen by trials"


class TestAsked:
    def test_few_photographs_alone_and_any_number_where_it_is_set(self) -> None:
        always = replace(ASKED, cross_validate="always")
        table = {("always", 40): 20.0, ("always", 20): 19.0, ("always", 80): 19.0, ("none", 40): 19.0}
        # Of six photographs growth may reach 4,000 Gaussians with 40 pixels each as with 80.
        most = FEW_PHOTOGRAPHS - 1
        for config, num_views, num_trials in ((ASKED, most, 8), (ASKED, FEWEST, 6), (always, 25, 8), (always, most, 8)):
            assert len(chosen(table, config, num_views)[1].asked) == num_trials, num_views
        assert choose_for_few(replace(ASKED, cross_validate="none"), photographs(20), refuse).decisions == ()

    @pytest.mark.parametrize(
        ("change", "num_views", "said"),
        [
            ({}, FEW_PHOTOGRAPHS, "from 36 photographs on their number decides"),
            ({"budget_s": 9.0}, 20, "a budget of time"),
            ({"cross_validate": "always"}, FEWEST - 1, "fewer than 6 photographs"),
            ({"cross_validate": "always", "drop_gaussians": "none", "density": NoDensification()}, 20, "nothing is open"),
            ({"cross_validate": "always", "drop_gaussians": "none", "max_num_splats": 100}, 20, "no limit of growth would be reached"),
        ],
    )
    def test_where_nothing_is_asked_nothing_is_trained_and_a_decision_says_why(self, change, num_views: int, said: str) -> None:
        config = replace(ASKED, **change)
        choice = choose_for_few(config, photographs(num_views), refuse)
        (decision,) = choice.decisions
        assert choice.config == replace(config, cross_validate="none") and choice.num_trials == 0
        assert decision.topic == TOPIC and decision.choice == "photographs are not asked" and said in decision.reason
        assert decision.changes_nothing == (not change), "what `auto` leaves to their number is no news"

    def test_it_is_no_part_of_a_budget_of_time_and_off_by_default(self) -> None:
        with pytest.raises(BadInput, match="leave one of them out"):
            replace(ASKED, cross_validate="always", budget_s=9.0)
        assert {train_preset(name).cross_validate for name in ("draft", "default", "standard", "paper")} == {"none"}

    def test_photographs_that_a_mask_covers_are_never_apart_nor_counted(self) -> None:
        views, covered = photographs(10), np.array([0, 4])
        weights = [np.full(SIZE_WH[::-1], 255, np.uint8) for _ in range(10)]
        for index in covered:
            weights[index] = np.zeros(SIZE_WH[::-1], np.uint8)
            weights[index][:4, :4] = 255
        trainings = Trainings({("always", 40): 20.0, ("always", 20): 19.0, ("always", 80): 19.0, ("none", 40): 19.0})
        choose_for_few(ASKED, TrainingViews(cameras=views.cameras, images=views.images, weights=tuple(weights)), trainings)
        assert len(trainings.apart) == 8 and not any(part[covered].any() for part in trainings.apart)
        for num_covered in (10, 10 - FEWEST + 1):
            hidden = tuple(own * (index >= num_covered) for index, own in enumerate(np.full((10, *SIZE_WH[::-1]), 255, np.uint8)))
            few = TrainingViews(cameras=views.cameras, images=views.images, weights=tuple(own.astype(np.uint8) for own in hidden))
            (decision,) = choose_for_few(ASKED, few, refuse).decisions
            assert "that show something" in decision.reason

    @pytest.mark.parametrize("num_views", [FEWEST, 7, 8, 13, 20, FEW_PHOTOGRAPHS - 1])
    def test_each_part_leaves_something_to_train_on_and_no_photograph_is_in_two(self, num_views: int) -> None:
        _, trainings = chosen({("always", 40): 20.0, ("always", 20): 19.0, ("always", 80): 19.0, ("none", 40): 19.0}, num_views=num_views)
        first, second = trainings.apart[:2]
        assert first.any() and second.any() and not (first & second).any() and (~first & ~second).sum() >= num_views / 2
        assert first.sum() == -(-num_views // EVERY) and len(PARTS) == 2


class TestScore:
    @pytest.fixture
    def shown(self) -> Callable[[float], TrainingViews]:
        cameras = cameras_above([(-1, -1), (1, 1)])
        renders = [view.image for view in render_views(ground_splats(), cameras)]

        def brighter(gain: float) -> TrainingViews:
            return TrainingViews(cameras=cameras, images=tuple(np.clip(255 * gain * image, 0, 255).astype(np.uint8) for image in renders))

        return brighter

    def test_light_does_not_count_and_another_picture_does(self, shown: Callable[[float], TrainingViews]) -> None:
        model = ground_splats()
        same, darker = score_apart(model, shown(1.0), "native"), score_apart(model, shown(0.7), "native")
        assert same.shape == (2,) and (np.abs(same - darker) < 3).all() and (same > 40).all()
        other = replace(model, sh0=-model.sh0)
        assert (score_apart(other, shown(1.0), "native") < same - 10).all()
        (expected,) = (
            psnr_db(correct_colors(view.image, image / 255), image / 255)
            for view, image in zip(render_views(model, shown(0.7).cameras.select(np.array([0]))), shown(0.7).images[:1], strict=True)
        )
        assert darker[0] == pytest.approx(expected)

    def test_what_a_mask_leaves_counts(self, shown: Callable[[float], TrainingViews]) -> None:
        views = shown(1.0)
        spoilt = views.images[0].copy()
        spoilt[:, : spoilt.shape[1] // 2] = 255
        weights = [np.full(spoilt.shape[:2], 255, np.uint8) for _ in range(2)]
        weights[0][:, : spoilt.shape[1] // 2] = 0
        masked = TrainingViews(cameras=views.cameras, images=(spoilt, views.images[1]), weights=tuple(weights))
        assert (score_apart(ground_splats(), masked, "native") > 40).all()
