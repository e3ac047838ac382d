"""What suits few photographs, found by models of some of them that are scored on the others. Once
per training, where `TrainConfig.cross_validate` asks for it.

    photographs ─ two parts apart in turn ─ a model of the rest for each candidate
                ─ PSNR of those apart, colours corrected ─→ the candidate that is kept

Gaussians left out at random, and how many there may be, gain a decibel on one set of 20 photographs
and lose half of one on another (docs/experiments/training.md). Short trainings do not tell, so each
is as long as the one whose model is kept; its last state is scored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.errors import RadiantError
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.io.photos.masks import used_pixels
from radiant_core.numerics import FloatArray
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import Adc, Mcmc
from radiant_core.train.needs import fit_dropping, most_splats, pixels_per_splat
from radiant_core.train.views import TrainingViews

FEW = 25
"""`cross_validate` "auto" asks below so many photographs."""
FEWEST = 6
"""With fewer than these nothing is asked: what is left of them is another set."""
EVERY, PARTS = 8, (0, 4)
"""Photographs apart: every eighth by name, from the first and from the fifth."""
MIN_GAIN_DB = 0.1
"""A candidate that gains less, in the mean over the photographs apart, is not taken: two trainings
that differ in their seed alone differ by 0.1 to 0.2 dB (docs/experiments/training.md)."""
TOPIC = "what few photographs gain by"


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """A candidate to be trained without some photographs and scored on these."""

    config: TrainConfig
    held: NDArray[np.bool_]
    """Which photographs are apart (V,)."""
    number: int
    """From 0, in the order of the trials."""
    most: int
    """How many trials there may be."""


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
    asked, plain = config.cross_validate, replace(config, cross_validate="none")
    if asked == "none":
        return Choice(config=config)
    rest = views.select(np.flatnonzero(~_parts(views)[0])) if len(views) >= FEWEST else views
    start = _by_number(plain, len(views))
    most = len(PARTS) * (1 + sum(challenge(plain, start, start, rest) is not None for challenge in _CHALLENGES))
    if why_not := _why_not(config, views, most):
        return Choice(config=plain, decisions=(_not_asked(asked, len(views), why_not),))
    parts = _parts(views)
    best, first, tried = start, _ask(start, parts, score, 0, most), []
    if isinstance(first, str):
        decision = _not_asked(asked, len(views), f"a training without some of them failed: {first}")
        return Choice(config=plain, decisions=(decision,), num_trials=len(PARTS))
    figures = first
    for challenge in _CHALLENGES:
        candidate = challenge(plain, start, best, rest)
        if candidate is None:
            continue
        own = _ask(candidate, parts, score, len(PARTS) * (1 + len(tried)), most)
        gain = float("nan") if isinstance(own, str) else float((own - figures).mean())
        tried.append(f"{_words(candidate, views)} {f'failed ({own})' if isinstance(own, str) else f'{gain:+.2f} dB'}")
        # NaN is no gain.
        if not isinstance(own, str) and gain >= MIN_GAIN_DB:
            best, figures = candidate, own
    num_trials = len(PARTS) * (1 + len(tried))
    decision = Decision(
        stage="train",
        topic=TOPIC,
        choice=_words(best, views) if best != start else f"{_words(best, views)}, as their number says",
        figure=float((figures - first).mean()),
        unit=f"dB over what the number of photographs says, on {len(first)} of {len(views)} in turn",
        reason=f"{num_trials} trainings without them, each candidate against the best before: {', '.join(tried)}; "
        f"from {MIN_GAIN_DB:g} dB on one is taken",
    )
    return Choice(config=best, decisions=(decision,), num_trials=num_trials)


def score_apart(splats: Splats, views: TrainingViews, backend: Backend) -> FloatArray:
    """PSNR in dB of a model at each of K views (K,), its colours corrected to the photograph's, of
    the pixels that count."""
    used = _used(views)
    triples = zip(render_views(splats, views.cameras, backend), views.images, used, strict=True)
    return np.array([psnr_db(correct_colors(view.image, image / 255, own), image / 255, own) for view, image, own in triples])


def _used(views: TrainingViews) -> list[NDArray[np.bool_] | None]:
    return [None] * len(views) if views.weights is None else [used_pixels(weights) for weights in views.weights]


def _parts(views: TrainingViews) -> list[NDArray[np.bool_]]:
    """The parts (V,) that are apart in turn, of photographs of which masks leave something."""
    shown = [index for index, used in enumerate(_used(views)) if used is None or used.any()]
    ordered = sorted(shown, key=views.cameras.names.__getitem__)
    masks = [np.zeros(len(views), bool) for _ in PARTS]
    for mask, first in zip(masks, PARTS, strict=True):
        mask[ordered[first::EVERY]] = True
    return masks


def _why_not(config: TrainConfig, views: TrainingViews, most: int) -> str:
    """Why photographs are not asked; empty where they are."""
    if config.cross_validate == "auto" and len(views) >= FEW:
        return f"from {FEW} photographs on their number decides"
    if config.budget_s is not None:
        return "the training has a budget of time, which leaves none for others"
    if len(views) < FEWEST or not all(part.any() for part in _parts(views)):
        return f"without some of fewer than {FEWEST} photographs that show something the rest would be another set"
    if most == len(PARTS):
        return "nothing is open: whether Gaussians are left out and how many there may be are set, or no limit of growth would be reached"
    return ""


def _not_asked(asked: str, num_views: int, reason: str) -> Decision:
    return Decision(
        stage="train",
        topic=TOPIC,
        choice="photographs are not asked",
        figure=float(num_views),
        unit="training photographs",
        reason=reason,
        changes_nothing=asked == "auto" and num_views >= FEW,
    )


def _grows_by_pixels(config: TrainConfig) -> bool:
    density = config.density
    return isinstance(density, Adc | Mcmc) and density.kind != "adc" and density.pixels_per_splat == "auto"


def _by_number(config: TrainConfig, num_views: int) -> TrainConfig:
    config = fit_dropping(config, num_views)[0]
    return _with_pixels(config, pixels_per_splat(config)) if _grows_by_pixels(config) else config


def _with_pixels(config: TrainConfig, pixels: int | None) -> TrainConfig:
    assert isinstance(config.density, Adc | Mcmc)
    return replace(config, density=replace(config.density, pixels_per_splat=pixels))


def _with_twice(config: TrainConfig, start: TrainConfig, best: TrainConfig, rest: TrainingViews) -> TrainConfig | None:
    pixels = pixels_per_splat(best)
    return _if_it_differs(best, max(1, pixels // 2), rest) if _grows_by_pixels(config) and pixels is not None else None


def _with_half(config: TrainConfig, start: TrainConfig, best: TrainConfig, rest: TrainingViews) -> TrainConfig | None:
    pixels = pixels_per_splat(best)
    return _if_it_differs(best, 2 * pixels, rest) if _grows_by_pixels(config) and pixels is not None and best == start else None


def _dropping_the_other_way(config: TrainConfig, start: TrainConfig, best: TrainConfig, rest: TrainingViews) -> TrainConfig | None:
    other: Literal["none", "always"] = "none" if best.drop_gaussians == "always" else "always"
    return replace(best, drop_gaussians=other) if config.drop_gaussians == "auto" else None


def _if_it_differs(best: TrainConfig, pixels: int, rest: TrainingViews) -> TrainConfig | None:
    candidate = _with_pixels(best, pixels)
    return None if most_splats(candidate, rest) == most_splats(best, rest) else candidate


_CHALLENGES = (_with_twice, _with_half, _dropping_the_other_way)
"""(what was asked for, by number, the best so far, the photographs of a trial) → what is tried
against the best; None: nothing."""


def _ask(candidate: TrainConfig, parts: Sequence[NDArray[np.bool_]], score: Score, first: int, most: int) -> FloatArray | str:
    """The figures of a candidate on all parts, or why a training of it failed."""
    try:
        trials = (Trial(config=candidate, held=held, number=first + part, most=most) for part, held in enumerate(parts))
        return np.concatenate([score(trial) for trial in trials])
    except RadiantError as error:
        return str(error).rstrip(".")


def _words(config: TrainConfig, views: TrainingViews) -> str:
    drops = config.drop_gaussians == "always"
    dropped = f"up to {config.drop_share:.0%} of the Gaussians left out at each step" if drops else "none left out"
    return dropped if pixels_per_splat(config) is None else f"{dropped} and growth to {most_splats(config, views):,}"
