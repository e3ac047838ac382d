"""What suits few photographs, found by models of some of them that are scored on the others. Once
per training, where `TrainConfig.cross_validate` asks for it.

    photographs ─ two parts apart in turn ─ a model of the rest for each candidate
                ─ PSNR of those apart, colours corrected ─→ the candidate that is kept

Gaussians left out at random, and how many there may be, gain half a decibel on one set of 20
photographs and lose as much on another (docs/experiments/training.md). Short trainings do not tell,
so each takes as many steps as the one whose model is kept; its last state is scored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.errors import RadiantError
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.io.photos.masks import used_pixels
from radiant_core.numerics import FloatArray
from radiant_core.regimes import FEW_PHOTOGRAPHS, PHOTOGRAPHS, require
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import Adc, Mcmc
from radiant_core.train.needs import fit_dropping, most_splats, most_steps, pixels_per_splat
from radiant_core.train.views import TrainingViews

FEWEST = 6
"""With fewer than these nothing is asked: what is left of them is another set."""
EVERY, PARTS = 8, (0, 4)
"""Photographs apart: every eighth by name, from the first and from the fifth."""
MIN_SHOWN = 0.1
"""Share of a photograph's pixels that masks must leave for it to be apart: of a few pixels the
correction of colours explains all."""
MIN_GAIN_DB = 0.1
"""A candidate that gains less, in the mean over the photographs apart, is not taken: two trainings
that differ in their seed alone differ by 0.1 to 0.2 dB (docs/experiments/training.md)."""
TOPIC = "what few photographs gain by"


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """A candidate to be trained without some photographs and scored on these."""

    config: TrainConfig
    held_out: NDArray[np.bool_]
    """Which photographs are apart (V,)."""
    number: int
    """From 0, in the order of the trials."""
    most: int
    """How many trials there may be."""
    long_side_px: int | None = None
    """Photographs are reduced to it; None: they are not."""
    work: float = 1.0
    """How long it takes, the training whose model is kept being 1."""


Score = Callable[[Trial], FloatArray]
"""PSNR in dB of the photographs apart (K,); raises what a training raises."""


class KeptScores(Protocol):
    """Scores of trials by their key, so that an interrupted choice does not begin anew; this base
    keeps none."""

    def find(self, key: str) -> FloatArray | None:
        """The score of the trial with that key; None where there is none."""
        return None

    def keep(self, key: str, figures: FloatArray) -> None:
        """Keep the score of a trial."""


class NoKeptScores(KeptScores):
    """An interrupted choice begins anew."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Choice:
    """The settings as photographs chose them, what was decided, how many trainings that took."""

    config: TrainConfig
    decisions: tuple[Decision, ...] = ()
    num_trials: int = 0


def choose_for_few(config: TrainConfig, views: TrainingViews, score: Score) -> Choice:
    """The configuration with what these photographs gain by, in place of what their number says.

    Open are `drop_gaussians` and the pixels per Gaussian, where they are "auto". First is what the
    number of photographs says; then, each time against the best so far: twice the Gaussians, else
    half of them, and Gaussians left out the other way.

    Args:
        config: the settings of the training.
        views: its photographs (V).
        score: trains a candidate without some of them and scores it on these.

    Returns:
        The configuration, whose `cross_validate` is "none", and a decision; no decision where the
        configuration does not ask.
    """
    mode, plain = config.cross_validate, replace(config, cross_validate="none")
    if mode == "none":
        return Choice(config=config)
    if why_not := _why_not(config, len(views)):
        return Choice(config=plain, decisions=(_not_asked(mode, len(views), why_not),))
    parts = _parts(views)
    start = _by_number(plain, len(views))
    twice, half = (_resized(start, factor, views, parts) if _grows_by_pixels(plain, len(views)) else None for factor in (2.0, 0.5))
    num_candidates = 1 + sum(option is not None for option in (twice, half)) + (plain.drop_gaussians == "auto")
    if why_not := _why_not_these(parts, num_candidates):
        return Choice(config=plain, decisions=(_not_asked(mode, len(views), why_not),))
    trials = _Trials(score=score, parts=parts, num_steps=most_steps(plain, len(views)), most=len(parts) * num_candidates)
    best, first = start, trials.ask(start)
    if first is None:
        decision = _not_asked(mode, len(views), f"a training without some of them {trials.failure}")
        return Choice(config=plain, decisions=(decision,), num_trials=trials.num_asked)
    figures, tried = first, []
    challenges: tuple[Callable[[TrainConfig], TrainConfig | None], ...] = (
        lambda best: twice,
        lambda best: half if best == start else None,
        lambda best: _dropping_the_other_way(best) if plain.drop_gaussians == "auto" else None,
    )
    for challenge in challenges:
        if (candidate := challenge(best)) is None:
            continue
        candidate_figures = trials.ask(candidate)
        gain = float("nan") if candidate_figures is None else float((candidate_figures - figures).mean())
        tried.append(f"{_words(candidate, views)} {trials.failure if candidate_figures is None else f'{gain:+.2f} dB'}")
        # NaN is no gain.
        if candidate_figures is not None and gain >= MIN_GAIN_DB:
            best, figures = candidate, candidate_figures
    decision = Decision(
        stage="train",
        topic=TOPIC,
        choice=_words(best, views) if best != start else f"{_words(best, views)}, as their number says",
        figure=float((figures - first).mean()),
        unit=f"dB over what the number of photographs says, on {len(first)} of {len(views)} in turn",
        reason=f"{trials.num_asked} trainings without them, each candidate against the best before: {', '.join(tried)}; "
        f"from {MIN_GAIN_DB:g} dB on one is taken",
        row=require(PHOTOGRAPHS, {"photographs": len(views)}).row,
    )
    return Choice(config=best if best != start else plain, decisions=(decision,), num_trials=trials.num_asked)


@dataclass(kw_only=True)
class _Trials:
    """Trainings of candidates, counted."""

    score: Score
    parts: Sequence[NDArray[np.bool_]]
    num_steps: int
    most: int
    num_asked: int = 0
    failure: str = ""
    """Why the last one failed, if it did."""

    def ask(self, candidate: TrainConfig) -> FloatArray | None:
        """The figures of a candidate on all parts; None where a training of it failed."""
        config, figures = replace(candidate, num_steps=self.num_steps, max_epochs=None), []
        for held_out in self.parts:
            self.num_asked += 1
            try:
                figures.append(self.score(Trial(config=config, held_out=held_out, number=self.num_asked - 1, most=self.most)))
            except (RadiantError, MemoryError, torch.OutOfMemoryError) as error:
                self.failure = f"failed ({str(error).split(';')[0].rstrip('.') or 'out of memory'})"
                return None
        return np.concatenate(figures)


def score_apart(splats: Splats, views: TrainingViews, backend: Backend) -> FloatArray:
    """PSNR in dB of a model at each of K views (K,), its colours corrected to the photograph's, of
    the pixels that count."""
    used = _used(views)
    triples = zip(render_views(splats, views.cameras, backend), views.images, used, strict=True)
    return np.array([psnr_db(correct_colors(view.image, image / 255, mask), image / 255, mask) for view, image, mask in triples])


def _used(views: TrainingViews) -> list[NDArray[np.bool_] | None]:
    return [None] * len(views) if views.weights is None else [used_pixels(weights) for weights in views.weights]


def _parts(views: TrainingViews) -> list[NDArray[np.bool_]]:
    """The parts (V,) that are apart in turn, of photographs of which masks leave enough."""
    usable = [index for index, used in enumerate(_used(views)) if used is None or used.mean() >= MIN_SHOWN]
    ordered = sorted(usable, key=views.cameras.names.__getitem__)
    masks = [np.zeros(len(views), bool) for _ in PARTS]
    for mask, first in zip(masks, PARTS, strict=True):
        if len(usable) >= FEWEST:
            mask[ordered[first::EVERY]] = True
    return masks


def _why_not(config: TrainConfig, num_views: int) -> str:
    """Why so many photographs are not asked; empty where they are."""
    if config.cross_validate == "auto" and num_views >= FEW_PHOTOGRAPHS:
        return f"from {FEW_PHOTOGRAPHS} photographs on their number decides"
    if config.budget_s is not None:
        return "the training has a budget of time, which leaves none for others"
    return ""


def _why_not_these(parts: Sequence[NDArray[np.bool_]], num_candidates: int) -> str:
    if not any(part.any() for part in parts):
        return f"without some of fewer than {FEWEST} photographs that show something the rest would be another set"
    if num_candidates == 1:
        return "nothing is open: whether Gaussians are left out and how many there may be are set, or no limit of growth would be reached"
    return ""


def _not_asked(mode: str, num_views: int, reason: str) -> Decision:
    return Decision(
        stage="train",
        topic=TOPIC,
        choice="photographs are not asked",
        figure=float(num_views),
        unit="training photographs",
        reason=reason,
        row=require(PHOTOGRAPHS, {"photographs": num_views}).row,
        changes_nothing=mode == "auto" and num_views >= FEW_PHOTOGRAPHS,
    )


def _grows_by_pixels(config: TrainConfig, num_views: int) -> bool:
    # Where dense points begin a model it does not grow.
    open_ = getattr(config.density, "pixels_per_splat", None) == "auto" and config.dense_points == "none"
    return open_ and pixels_per_splat(config, num_views) is not None


def _by_number(config: TrainConfig, num_views: int) -> TrainConfig:
    config = fit_dropping(config, num_views)[0]
    return _with_pixels(config, pixels_per_splat(config, num_views)) if _grows_by_pixels(config, num_views) else config


def _with_pixels(config: TrainConfig, pixels: int | None) -> TrainConfig:
    assert isinstance(config.density, Adc | Mcmc)
    return replace(config, density=replace(config.density, pixels_per_splat=pixels))


def _resized(start: TrainConfig, factor: float, views: TrainingViews, parts: Sequence[NDArray[np.bool_]]) -> TrainConfig | None:
    """With so many times the Gaussians; None where that is the same training, of all or in a
    trial."""
    candidate = _with_pixels(start, round((pixels_per_splat(start, len(views)) or 1) / factor))
    trained_on = (views, *(views.select(np.flatnonzero(~held_out)) for held_out in parts))
    return candidate if all(most_splats(candidate, subset) != most_splats(start, subset) for subset in trained_on) else None


def _dropping_the_other_way(best: TrainConfig) -> TrainConfig:
    return replace(best, drop_gaussians="none" if best.drop_gaussians == "always" else "always")


def _words(config: TrainConfig, views: TrainingViews) -> str:
    drops = config.drop_gaussians == "always"
    dropped = f"up to {config.drop_share:.0%} of the Gaussians left out at each step" if drops else "none left out"
    return dropped if pixels_per_splat(config, len(views)) is None else f"{dropped} and growth to {most_splats(config, views):,}"
