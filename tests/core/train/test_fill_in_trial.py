"""Points filled in: asked of the photographs only where these see through some, and taken at their word."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import StageFailed
from radiant_core.hierarchy.device import prepare_training
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.numerics import FloatArray
from radiant_core.train.config import train_preset, with_settings
from radiant_core.train.few import Trial
from radiant_core.train.fill_in_trial import TOPIC, TRIAL_LONG_SIDE_PX, TRIAL_STEPS, choose_fill_in
from tests.core.train.test_fill_in import ball_before_a_wall, flat_scene

CONFIG = train_preset("default")


class Trainings:
    """Scores of models with points filled in and without; None fails."""

    def __init__(self, with_db: float | None, without_db: float | None) -> None:
        self.figures, self.asked = {True: with_db, False: without_db}, list[Trial]()

    def __call__(self, trial: Trial) -> FloatArray:
        """The figure, a little different for each photograph apart."""
        self.asked.append(trial)
        figure = self.figures[bool(trial.config.fill_in)]
        if figure is None:
            raise StageFailed("training: 20 steps in a row could not be taken; lower the learning rates.")
        return figure + np.linspace(-3, 3, trial.held.sum())


@pytest.mark.parametrize(("with_db", "without_db", "expected"), [(24.0, 23.5, True), (23.5, 24.0, False), (None, 24.0, True)])
def test_photographs_that_see_through_points_choose(with_db: float | None, without_db: float, expected: bool) -> None:
    trainings = Trainings(with_db, without_db)
    choice = choose_fill_in(CONFIG, *ball_before_a_wall(), trainings)
    assert choice.config == replace(CONFIG, fill_in=expected)
    (decision,) = choice.decisions
    assert decision.topic == TOPIC and decision.figure is not None and decision.figure > 5
    assert ("failed" if with_db is None else f"gain {with_db - without_db:+.2f} dB") in decision.reason
    for trial in trainings.asked:
        assert (trial.config.num_steps, trial.long_side_px, trial.held.sum()) == (TRIAL_STEPS, TRIAL_LONG_SIDE_PX, 1)


def test_over_ground_nobody_is_asked() -> None:
    trainings = Trainings(None, None)
    choice = choose_fill_in(CONFIG, *flat_scene(half_side_m=0.7), trainings)
    assert choice.config.fill_in is True and not choice.decisions and not trainings.asked


@pytest.mark.parametrize("forced", [True, False])
def test_what_is_set_is_not_asked(forced: bool) -> None:
    trainings = Trainings(None, None)
    config = with_settings(CONFIG, {"fill_in": str(forced).lower()})
    assert config.fill_in is forced
    assert choose_fill_in(config, *ball_before_a_wall(), trainings).config is config and not trainings.asked


@pytest.mark.parametrize("setting", ["auto", "true", "false"])
def test_a_training_is_prepared_with_points_or_without(setting: str) -> None:
    """With real trials for auto: whatever they choose is said, and the first Gaussians follow it."""
    scene, views = ball_before_a_wall()
    config = with_settings(replace(CONFIG, num_steps=5, sky=False, light="none"), {"fill_in": setting})
    recorder = Recorder()
    prepared = prepare_training(DeviceTask(scene=scene, train=config, backend="native"), views, recorder)
    assert isinstance(prepared.config.fill_in, bool)
    topics = {decision.topic: decision for decision in recorder.decisions}
    assert (TOPIC in topics) == (setting == "auto")
    if setting == "auto":
        assert topics[TOPIC].choice == ("they are" if prepared.config.fill_in else "they are not")
    assert (len(prepared.initial) > len(scene.points)) == prepared.config.fill_in
