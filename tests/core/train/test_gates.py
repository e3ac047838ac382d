"""Helpers that may lose: asked of the photographs where a statistic says so and there is time, and taken at their word."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import StageFailed
from radiant_core.hierarchy.device import prepare_training
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.numerics import FloatArray
from radiant_core.regimes import Regime
from radiant_core.train.config import TrainConfig, train_preset, with_settings
from radiant_core.train.few import Choice, Trial
from radiant_core.train.fill_in import fill_in_points
from radiant_core.train.gates import FEWEST_STEPS, LONG_SIDE_PX, MOST_SHARE, MOST_STEPS, Gate, choose_helpers, open_gates, trial_size
from tests.core.train.test_fill_in import ball_before_a_wall, flat_scene
from tests.core.train.test_needs import scene_of

LONG = replace(train_preset("default"), num_steps=30_000, max_epochs=None)
"""So long that trials cost next to nothing beside it."""
ON = Regime(row="on", reason="", evidence="", values={"on": 1, "tried": 1})
FILLED = "whether points are filled in"


class Trainings:
    """Scores of models by a function of their settings; None fails."""

    def __init__(self, figures: dict[tuple[bool, bool], float | None]) -> None:
        self.figures, self.asked = figures, list[Trial]()

    def __call__(self, trial: Trial) -> FloatArray:
        """The figure of (fill_in, sky), a little different for each photograph apart."""
        self.asked.append(trial)
        figure = self.figures[bool(trial.config.fill_in), trial.config.sky]
        if figure is None:
            raise StageFailed("training: 20 steps in a row could not be taken; lower the learning rates.")
        return figure + np.linspace(-3, 3, trial.held_out.sum())


def chosen(trainings: Trainings, config: TrainConfig = LONG) -> Choice:
    scene, views = ball_before_a_wall()
    return choose_helpers(*open_gates(config, fill_in_points(scene, views), views), views, trainings)


@pytest.mark.parametrize(("with_db", "without_db", "expected"), [(24.0, 23.5, True), (23.5, 24.0, False), (23.9, 23.8, False)])
def test_photographs_that_see_through_points_choose(with_db: float, without_db: float, expected: bool) -> None:
    trainings = Trainings({(True, True): with_db, (False, True): without_db})
    choice = chosen(trainings)
    assert choice.config == replace(LONG, fill_in=expected) and choice.num_trials == 2
    (decision,) = choice.decisions
    assert decision.topic == FILLED and decision.figure is not None and decision.figure > 5 and decision.row == "filled-around"
    assert f"with the helper {with_db - without_db:+.2f} dB" in decision.reason
    assert decision.otherwise == f"--set train.fill_in={'false' if expected else 'true'}"
    assert decision.otherwise_db == pytest.approx(without_db - with_db if expected else with_db - without_db)
    for trial in trainings.asked:
        assert (trial.config.num_steps, trial.long_side_px, trial.held_out.sum()) == (MOST_STEPS, 80, 1)


def test_a_trial_that_fails_leaves_what_its_case_says() -> None:
    choice = chosen(Trainings({(True, True): None}))
    (decision,) = choice.decisions
    assert choice.config.fill_in is True and choice.num_trials == 1
    assert "a trial failed" in decision.reason and decision.otherwise_db is None


@pytest.mark.parametrize(
    ("change", "said"),
    [({"num_steps": 1_000}, "more than 5% of its time"), ({"budget_s": 60.0}, "budget of time")],
    ids=["steps", "budget"],
)
def test_where_there_is_no_time_for_trials_none_is_made_and_it_is_said(change: dict, said: str) -> None:
    trainings = Trainings({})
    choice = chosen(trainings, replace(LONG, **change))
    (decision,) = choice.decisions
    assert choice.config.fill_in is True and not trainings.asked and "not tried: " in decision.reason and said in decision.reason
    assert decision.otherwise == "--set train.fill_in=false"


def test_several_helpers_share_the_training_with_all_of_them() -> None:
    """Each is left out of the best so far, so that two that lose together are both off."""
    gates = tuple(
        Gate(
            topic=name,
            setting=name,
            on=True,
            off=False,
            case=Regime(row=name, reason="", evidence="", values={"on": 1, "tried": 1}),
            figure=1.0,
            unit="",
        )
        for name in ("fill_in", "sky")
    )
    for figures, expected, taken in (
        ({(True, True): 20.0, (False, True): 21.0, (False, False): 20.5}, (False, True), 3),
        ({(True, True): 20.0, (False, True): 19.0, (True, False): 20.5}, (True, False), 3),
        ({(True, True): 20.0, (False, True): 21.0, (False, False): 21.5}, (False, False), 3),
    ):
        trainings = Trainings({**figures})
        choice = choose_helpers(replace(LONG, fill_in=True), gates, ball_before_a_wall()[1], trainings)
        assert (choice.config.fill_in, choice.config.sky) == expected and choice.num_trials == taken == len(trainings.asked)


def test_over_ground_nobody_is_asked() -> None:
    scene, views = flat_scene(half_side_m=0.7)
    config, gates = open_gates(LONG, fill_in_points(scene, views), views)
    assert config.fill_in is True and not gates and choose_helpers(config, gates, views, Trainings({})).decisions == ()


def test_points_that_most_photographs_contradict_are_left_out_untried() -> None:
    """The same ball, each photograph of another colour: what fills the ground of one is no other's."""
    scene, views = ball_before_a_wall()
    colors = np.random.default_rng(0).integers(0, 255, (len(views), 3))
    views = replace(views, images=tuple(np.broadcast_to(color, (60, 80, 3)).astype(np.uint8) for color in colors))
    trainings = Trainings({})
    choice = choose_helpers(*open_gates(LONG, fill_in_points(scene, views), views), views, trainings)
    (decision,) = choice.decisions
    assert choice.config.fill_in is False and not trainings.asked and decision.row == "filled-where-nothing-is"
    assert decision.figure is not None and decision.figure > 60 and decision.otherwise == "--set train.fill_in=true"


@pytest.mark.parametrize("forced", [True, False])
def test_what_is_set_is_not_asked(forced: bool) -> None:
    config = with_settings(LONG, {"fill_in": str(forced).lower()})
    scene, views = ball_before_a_wall()
    assert config.fill_in is forced and open_gates(config, fill_in_points(scene, views), views) == (config, ())


def test_trials_together_take_at_most_their_share() -> None:
    views = scene_of(8, size_wh=(576, 432))[1]
    for num_steps in (500, 1_500, 7_000, 30_000):
        for num_trials in (2, 3, 5):
            size = trial_size(replace(LONG, num_steps=num_steps), views, num_trials)
            if size is None:
                continue
            assert FEWEST_STEPS <= size.num_steps <= MOST_STEPS and size.long_side_px == LONG_SIDE_PX
            of_trials = num_trials * size.num_steps * LONG_SIDE_PX**2
            assert of_trials <= MOST_SHARE * num_steps * 576**2
    assert trial_size(replace(LONG, num_steps=500), views, 5) is None
    assert trial_size(replace(LONG, num_steps=1_500), views, 2) is not None


@pytest.mark.parametrize("setting", ["auto", "true", "false"])
def test_a_training_is_prepared_with_points_or_without(setting: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With real trials for auto: whatever they choose is said, and the first Gaussians follow it."""
    monkeypatch.setattr("radiant_core.train.gates.FEWEST_STEPS", 1)
    monkeypatch.setattr("radiant_core.train.gates.PREPARED_STEPS", 0)
    scene, views = ball_before_a_wall()
    config = with_settings(replace(LONG, num_steps=200, sky=False, light="none"), {"fill_in": setting})
    recorder = Recorder()
    prepared = prepare_training(DeviceTask(scene=scene, train=config, backend="native"), views, recorder)
    assert isinstance(prepared.config.fill_in, bool)
    topics = {decision.topic: decision for decision in recorder.decisions}
    assert (FILLED in topics) == (setting == "auto")
    if setting == "auto":
        assert (
            topics[FILLED].choice == ("they are" if prepared.config.fill_in else "they are not") and topics[FILLED].otherwise_db is not None
        )
    assert (len(prepared.initial) > len(scene.points)) == prepared.config.fill_in
