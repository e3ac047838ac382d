"""Which helpers a training does without, asked of its own photographs. At most once per training.

    statistic ─ may it lose here? ─ no ─→ it is on
                                  └ yes ─ short trainings without an eighth of the photographs,
                                          with all helpers and without each in turn ─→ on or off

A statistic is one that told the kinds of scenes apart on which a helper gains and loses (`Regime`);
trainings are asked where all of them together are predicted to take at most `MOST_SHARE` of the
one whose model is kept. Counts of steps and pixels predict that, never a clock: every executor
decides the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.errors import RadiantError
from radiant_core.numerics import FloatArray
from radiant_core.regimes import FILL_IN, Regime, require
from radiant_core.train.config import TrainConfig, with_settings
from radiant_core.train.few import EVERY, FEWEST, Choice, Score, Trial
from radiant_core.train.fill_in import AddedPoints, contradicted_share
from radiant_core.train.needs import most_steps
from radiant_core.train.views import TrainingViews

MOST_SHARE = 0.05
"""Of the steps' time of the training, for all trials."""
LONG_SIDE_PX = 128
"""Trials see photographs at most this large."""
FILLED_LEAD_DB = 0.3
"""By so much trials must be better with points filled in: the shorter a training the more it likes
a fuller start (docs/experiments/regimes.md)."""
MOST_STEPS, FEWEST_STEPS = 400, 150
"""Of a trial; fewer tell nothing (docs/experiments/regimes.md)."""
STEP_PX, PREPARED_STEPS = 5_000, 100
"""A step takes as long as so many pixels beside those of its photograph, and what comes before the
first of a trial as long as so many steps: 1.5 ms and 0.4 s where a step of 384 x 288 takes 34."""


@dataclass(frozen=True, kw_only=True)
class Gate:
    """A helper that is "auto" and may lose with these photographs."""

    topic: str
    setting: str
    """Its path in `TrainConfig`."""
    on: Any
    """The value of the setting with the helper; without it `off`."""
    off: Any
    case: Regime
    """Why it may lose; its values say whether it is `tried`, and `on` where it is not."""
    figure: float
    unit: str
    words: tuple[str, str] = ("they are", "they are not")
    """With and without the helper."""
    lead_db: float = 0.0
    """By so much trials must be better with it."""

    def set(self, config: TrainConfig, *, on: bool) -> TrainConfig:
        """The configuration with the helper or without it."""
        return with_settings(config, {self.setting: self.on if on else self.off})


@dataclass(frozen=True, kw_only=True)
class TrialSize:
    """How long each of the trials is."""

    num_steps: int
    long_side_px: int


def open_gates(config: TrainConfig, added: AddedPoints, views: TrainingViews) -> tuple[TrainConfig, tuple[Gate, ...]]:
    """The helpers that may lose with these photographs, of which `added` are the points to fill in;
    others that are "auto" are switched on."""
    if config.fill_in != "auto":
        return config, ()
    config = replace(config, fill_in=True)
    contradicted, seen_through = contradicted_share(added, views), added.seen_through_share
    case = require(FILL_IN, {"contradicted": contradicted, "seen_through": seen_through})
    if case.values["on"] and not case.values["tried"]:
        return config, ()
    share, unit = (seen_through, "that other photographs see through")
    if "contradicted" in case.limits:
        share, unit = (contradicted, "whose colour other photographs do not show there")
    gate = Gate(
        topic="whether points are filled in",
        setting="fill_in",
        on=True,
        off=False,
        case=case,
        figure=100 * share,
        unit=f"% of them {unit}",
        lead_db=FILLED_LEAD_DB,
    )
    return config, (gate,)


def choose_helpers(config: TrainConfig, gates: Sequence[Gate], views: TrainingViews, score: Score) -> Choice:
    """The configuration with each of the gates' helpers on or off.

    Args:
        config: the settings of the training, whose steps and size are known.
        gates: helpers that may lose.
        views: the photographs (V), at the size of the training.
        score: trains a candidate without some of them and scores it on these.

    Returns:
        The configuration, a decision for each gate, and how many trainings that took.
    """
    unasked, settled = config, tuple(_untried(gate) for gate in gates if not gate.case.values["tried"])
    for gate in gates:
        unasked = gate.set(unasked, on=bool(gate.case.values["on"]))
    if not (gates := [gate for gate in gates if gate.case.values["tried"]]):
        return Choice(config=unasked, decisions=settled)
    size = trial_size(config, views, 1 + len(gates))
    why_not = _why_not(config, len(views)) or ("" if size is not None else f"trials would take more than {MOST_SHARE:.0%} of its time")
    if size is None or why_not:
        return Choice(config=unasked, decisions=(*settled, *(_untried(gate, why_not) for gate in gates)))
    held_out = np.zeros(len(views), bool)
    held_out[np.argsort(views.cameras.names)[::EVERY]] = True
    trials = _Trials(score=score, held_out=held_out, size=size, most=1 + len(gates))
    best, decisions = unasked, [*settled]
    for gate in gates:
        best = gate.set(best, on=True)
    try:
        figures = trials.ask(best)
        for gate in gates:
            candidate_figures = trials.ask(candidate := gate.set(best, on=False))
            gain_db = float(np.mean(figures - candidate_figures))
            decisions.append(_tried(gate, gain_db, trials))
            if gain_db < gate.lead_db:
                best, figures = candidate, candidate_figures
    except (RadiantError, MemoryError, torch.OutOfMemoryError) as error:
        reason = f"a trial failed ({str(error).split(';')[0].rstrip('.') or 'out of memory'})"
        decisions = [*settled, *(_untried(gate, reason) for gate in gates)]
        return Choice(config=unasked, decisions=tuple(decisions), num_trials=trials.num_asked)
    return Choice(config=best, decisions=tuple(decisions), num_trials=trials.num_asked)


def trial_size(config: TrainConfig, views: TrainingViews, num_trials: int) -> TrialSize | None:
    """The size of so many trials that take together at most `MOST_SHARE` of a training; None where
    they would be too short to tell."""
    longest = int(views.cameras.sizes_wh.max())
    side = min(LONG_SIDE_PX, longest)
    pixels = float(views.cameras.sizes_wh.prod(axis=1).mean())
    whole, small = (STEP_PX + pixels * share**2 for share in (1.0, side / longest))
    budget = MOST_SHARE * most_steps(config, len(views)) * whole / small
    num_steps = min(MOST_STEPS, int(budget / num_trials) - PREPARED_STEPS)
    return None if num_steps < FEWEST_STEPS else TrialSize(num_steps=num_steps, long_side_px=side)


@dataclass(kw_only=True)
class _Trials:
    """Trainings of candidates on the same photographs, counted."""

    score: Score
    held_out: NDArray[np.bool_]
    size: TrialSize
    most: int
    num_asked: int = 0

    def ask(self, candidate: TrainConfig) -> FloatArray:
        config = replace(candidate, num_steps=self.size.num_steps, max_epochs=None, cross_validate="none")
        self.num_asked += 1
        number, work = self.num_asked - 1, MOST_SHARE / self.most
        side = self.size.long_side_px
        return self.score(Trial(config=config, held_out=self.held_out, number=number, most=self.most, long_side_px=side, work=work))


def _why_not(config: TrainConfig, num_views: int) -> str:
    if config.budget_s is not None:
        return "the training has a budget of time, which leaves none for trials"
    if num_views < FEWEST:
        return f"without some of fewer than {FEWEST} photographs the rest would be another set"
    return ""


def _tried(gate: Gate, gain_db: float, trials: _Trials) -> Decision:
    size, on = trials.size, gain_db >= gate.lead_db
    reason = f"{trials.most} trainings of {size.num_steps} steps at {size.long_side_px} px without {trials.held_out.sum()} of "
    reason += f"{len(trials.held_out)} photographs: with the helper {gain_db:+.2f} dB there"
    reason += f", which must be {gate.lead_db:+.1f} or more" if gate.lead_db else ""
    return replace(_decision(gate, reason, on=on), otherwise_db=-gain_db if on else gain_db)


def _untried(gate: Gate, why_not: str = "") -> Decision:
    """By its case alone; `why_not`: why a trial was not made that it asks for."""
    return _decision(gate, f"{gate.case.reason}; not tried: {why_not}" if why_not else gate.case.reason, on=bool(gate.case.values["on"]))


def _decision(gate: Gate, reason: str, *, on: bool) -> Decision:
    opposite = gate.off if on else gate.on
    return Decision(
        stage="train",
        topic=gate.topic,
        choice=gate.words[not on],
        figure=gate.figure,
        unit=gate.unit,
        reason=reason,
        row=gate.case.row,
        otherwise=f"--set train.{gate.setting}={str(opposite).lower()}",
    )
