"""What suits few photographs, found by models of some of them that are scored on the others. Once
per training, where `TrainConfig.cross_validate` asks for it.

    photographs ─ two parts apart in turn ─ a model of the rest for each candidate
                ─ PSNR of those apart, colours corrected ─→ the candidate that is kept

Gaussians left out at random, and more of them, gain 2 dB on one set of 20 photographs and lose 1 on
another (docs/experiments/training.md). Short trainings do not tell, so each has the full length:
six or eight trainings of seven eighths of the photographs before the one whose model is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from radiant_core.decisions import Decision
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
that differ in their seed alone differ by as much."""

Score = Callable[[TrainConfig, NDArray[np.bool_], int], FloatArray]
"""(candidate, which photographs are apart (V,), number of the trial) → PSNR in dB of those (K,)."""


def is_asked(config: TrainConfig, num_views: int) -> bool:
    """Whether photographs are asked: something is open, and they are few or `always` is set. Never
    beside a budget of time, which the trials would not keep."""
    wanted = config.cross_validate == "always" or (config.cross_validate == "auto" and num_views < FEW and config.budget_s is None)
    return wanted and num_views >= FEWEST and max_trials(config) > 0


def max_trials(config: TrainConfig) -> int:
    """The most trainings that the choice takes; 0 where nothing is open."""
    challenges = 2 * _grows_by_pixels(config) + (config.drop_gaussians == "auto")
    return len(PARTS) * (1 + challenges) if challenges else 0


def choose_for_few(config: TrainConfig, views: TrainingViews, score: Score) -> tuple[TrainConfig, tuple[Decision, ...]]:
    """The configuration with what these photographs gain by, in place of what their number says.

    Open are `drop_gaussians` and the pixels per Gaussian, where they are "auto". First is what the
    number of photographs says; then, each time against the best so far: twice the Gaussians, else
    half of them, and Gaussians left out the other way.

    Args:
        config: the settings of the training.
        views: its photographs (V).
        score: trains a candidate without some of them and scores it on these.

    Returns:
        The configuration and what was decided; unchanged and nothing where `is_asked` is false.
    """
    if not is_asked(config, len(views)):
        return config, ()
    parts = _parts(views.cameras.names)
    start = best = _by_number(config, len(views))
    first = figures = _ask(start, parts, score, 0)
    tried: list[str] = []
    for words, challenge in _CHALLENGES.items():
        candidate = challenge(config, start, best, views)
        if candidate is None:
            continue
        own = _ask(candidate, parts, score, len(PARTS) * (1 + len(tried)))
        gain = float((own - figures).mean())
        tried.append(f"{words} {gain:+.2f} dB")
        # NaN is no gain.
        if gain >= MIN_GAIN_DB:
            best, figures = candidate, own
    decision = Decision(
        stage="train",
        topic="what few photographs gain by",
        choice=_words(best) if best != start else f"{_words(best)}, as their number says",
        figure=float((figures - first).mean()),
        unit=f"dB over what the number of photographs says, on {len(first)} of {len(views)} in turn",
        reason=f"{len(PARTS) * (1 + len(tried))} trainings without them: {', '.join(tried)}; from {MIN_GAIN_DB:g} dB on one is taken",
        changes_nothing=best == start,
    )
    return replace(best, cross_validate="none"), (decision,)


def score_apart(splats: Splats, views: TrainingViews, backend: Backend) -> FloatArray:
    """PSNR in dB of a model at each of K views (K,), its colours corrected to the photograph's; of
    those of which masks leave something."""
    used = [None] * len(views) if views.weights is None else [used_pixels(weights) for weights in views.weights]
    triples = zip(render_views(splats, views.cameras, backend), views.images, used, strict=True)
    return np.array(
        [
            psnr_db(correct_colors(view.image, image / 255, own), image / 255, own)
            for view, image, own in triples
            if own is None or own.any()
        ]
    )


def _parts(names: Sequence[str]) -> list[NDArray[np.bool_]]:
    ordered = sorted(range(len(names)), key=names.__getitem__)
    masks = [np.zeros(len(names), bool) for _ in PARTS]
    for mask, first in zip(masks, PARTS, strict=True):
        mask[ordered[first::EVERY]] = True
    return masks


def _grows_by_pixels(config: TrainConfig) -> bool:
    density = config.density
    return isinstance(density, Adc | Mcmc) and density.kind != "adc" and density.pixels_per_splat == "auto"


def _by_number(config: TrainConfig, num_views: int) -> TrainConfig:
    config = fit_dropping(config, num_views)[0]
    return _with_pixels(config, pixels_per_splat(config)) if _grows_by_pixels(config) else config


def _with_pixels(config: TrainConfig, pixels: int | None) -> TrainConfig:
    assert isinstance(config.density, Adc | Mcmc)
    return replace(config, density=replace(config.density, pixels_per_splat=pixels))


def _with_twice(config: TrainConfig, start: TrainConfig, best: TrainConfig, views: TrainingViews) -> TrainConfig | None:
    pixels = pixels_per_splat(best)
    return _if_it_differs(best, max(1, pixels // 2), views) if _grows_by_pixels(config) and pixels is not None else None


def _with_half(config: TrainConfig, start: TrainConfig, best: TrainConfig, views: TrainingViews) -> TrainConfig | None:
    pixels = pixels_per_splat(best)
    return _if_it_differs(best, 2 * pixels, views) if _grows_by_pixels(config) and pixels is not None and best == start else None


def _dropping_the_other_way(config: TrainConfig, start: TrainConfig, best: TrainConfig, views: TrainingViews) -> TrainConfig | None:
    other: Literal["none", "always"] = "none" if best.drop_gaussians == "always" else "always"
    return replace(best, drop_gaussians=other) if config.drop_gaussians == "auto" else None


def _if_it_differs(best: TrainConfig, pixels: int, views: TrainingViews) -> TrainConfig | None:
    candidate = _with_pixels(best, pixels)
    return None if most_splats(candidate, views) == most_splats(best, views) else candidate


_CHALLENGES = {
    "twice the Gaussians": _with_twice,
    "half of the Gaussians": _with_half,
    "leaving Gaussians out the other way": _dropping_the_other_way,
}
"""(what was asked for, by number, the best so far, views) → what is tried against the best."""


def _ask(candidate: TrainConfig, parts: Sequence[NDArray[np.bool_]], score: Score, trial: int) -> FloatArray:
    candidate = replace(candidate, cross_validate="none")
    return np.concatenate([score(candidate, held, trial + number) for number, held in enumerate(parts)])


def _words(config: TrainConfig) -> str:
    drops = config.drop_gaussians == "always"
    dropped = f"up to {config.drop_share:.0%} of the Gaussians left out at each step" if drops else "none left out"
    pixels = pixels_per_splat(config)
    return dropped if pixels is None else f"{dropped}, at most one per {pixels} pixels"
