"""Whether points are filled in where photographs see through some of them. At most once per
training.

Over ground that cameras fly over, hardly any filled-in point lies before what another photograph
shows (0 to 2 % of four sets), and they gain up to 0.9 dB. Around an object or along a street 12 to
18 % do: there they gain half a decibel or lose as much, and two short, small trainings without an
eighth of the photographs tell which (docs/experiments/training.md).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.errors import RadiantError
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig
from radiant_core.train.few import EVERY, FEWEST, Choice, Score, Trial
from radiant_core.train.fill_in import fill_in_points
from radiant_core.train.views import TrainingViews

ASKED_FROM = 0.05
"""Share of the filled-in points that photographs see through from which on trials choose."""
TRIAL_LONG_SIDE_PX, TRIAL_STEPS = 192, 400
TOPIC = "whether points are filled in"


def choose_fill_in(config: TrainConfig, scene: SfmScene, views: TrainingViews, score: Score) -> Choice:
    """The configuration with `fill_in` on or off in place of "auto".

    Args:
        config: the settings of the training.
        scene: cameras (V) and sparse points.
        views: its photographs (V), in one light.
        score: trains a candidate without some of them and scores it on these.

    Returns:
        The configuration; a decision where photographs see through enough points to ask them.
    """
    if config.fill_in != "auto":
        return Choice(config=config)
    filled, without = replace(config, fill_in=True), replace(config, fill_in=False)
    share = fill_in_points(scene, views).seen_through_share
    if share < ASKED_FROM:
        return Choice(config=filled)
    held = np.zeros(len(views), bool)
    held[np.argsort(views.cameras.names)[::EVERY]] = True
    if why_not := _why_not(config, len(views)):
        return Choice(config=filled, decisions=(_decision(share, "they are, untried", why_not),))
    try:
        with_db, without_db = (_score(score, held, number, candidate) for number, candidate in enumerate((filled, without)))
    except (RadiantError, MemoryError, torch.OutOfMemoryError) as error:
        reason = f"a trial failed ({str(error).split(';')[0].rstrip('.') or 'out of memory'})"
        return Choice(config=filled, decisions=(_decision(share, "they are, untried", reason),), num_trials=2)
    gain_db = float(np.mean(with_db - without_db))
    reason = f"two trainings of {TRIAL_STEPS} steps at {TRIAL_LONG_SIDE_PX} px without {held.sum()} of {len(views)} photographs: "
    reason += f"points filled in gain {gain_db:+.2f} dB there"
    chosen, words = (filled, "they are") if gain_db >= 0 else (without, "they are not")
    return Choice(config=chosen, decisions=(_decision(share, words, reason),), num_trials=2)


def _score(score: Score, held: NDArray[np.bool_], number: int, candidate: TrainConfig) -> FloatArray:
    config = replace(candidate, num_steps=TRIAL_STEPS, max_epochs=None, cross_validate="none")
    return score(Trial(config=config, held=held, number=number, most=2, long_side_px=TRIAL_LONG_SIDE_PX))


def _why_not(config: TrainConfig, num_views: int) -> str:
    if config.budget_s is not None:
        return "the training has a budget of time, which leaves none for trials"
    if num_views < FEWEST:
        return f"without some of fewer than {FEWEST} photographs the rest would be another set"
    return ""


def _decision(share: float, choice: str, reason: str) -> Decision:
    return Decision(
        stage="train", topic=TOPIC, choice=choice, figure=100 * share, unit="% of them that other photographs see through", reason=reason
    )
