"""Of the candidates, the pairs that a preview finds worth all their features. Once per scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.sfm.colmap.pairs import Pairs
from radiant_core.sfm.colmap.quick_database import preview_pairs
from radiant_core.sfm.config import Report, SfmConfig, SfmProgress
from radiant_core.sfm.quick.partners import LEAST_SCORE, NUM_PREVIEWED, choose_partners


def keep_promising(database: Path, candidates: Pairs, config: SfmConfig, report: Report) -> tuple[Pairs, tuple[Decision, ...]]:
    """The candidates to match in full, and why. All where a user asked for spatial or exhaustive
    matching, with `effort` thorough, and where no photograph has more than `num_partners`."""
    if config.effort == "thorough":
        return candidates, ()
    names = sorted({name for pair in candidates for name in pair})
    report(SfmProgress(phase="pairs", done=0, total=len(candidates)))
    few = 2 * len(candidates) <= config.num_partners * len(names)
    if config.matching != "auto" or not config.num_partners or few:
        report(SfmProgress(phase="pairs", done=len(candidates), total=len(candidates)))
        return candidates, ()
    scores = _previewed(database, candidates, config, report)
    number_of = {name: number for number, name in enumerate(names)}
    numbered = np.array([[number_of[name] for name in pair] for pair in candidates], np.int64)
    promising = np.flatnonzero(choose_partners(numbered, scores, len(names), config.num_partners))
    decision = Decision(
        stage="sfm",
        topic="matching in full",
        choice=f"{len(promising):,} of {len(candidates):,} pairs",
        figure=float(np.median(scores[promising])) if len(promising) else 0.0,
        unit="matches in the preview, median of the pairs kept",
        reason=f"each photograph is matched with the {config.num_partners} that share most of its {NUM_PREVIEWED} largest features",
        changes_nothing=len(promising) == len(candidates),
    )
    return [candidates[index] for index in promising.tolist()], (decision,)


def keep_related(database: Path, candidates: Pairs, config: SfmConfig, report: Report) -> Pairs:
    """The candidates that have anything in common; all with `effort` thorough."""
    if config.effort == "thorough" or not candidates:
        return candidates
    scores = _previewed(database, candidates, config, report)
    return [candidates[index] for index in np.flatnonzero(scores >= LEAST_SCORE).tolist()]


def _previewed(database: Path, candidates: Pairs, config: SfmConfig, report: Report) -> NDArray[np.int64]:
    def tell(num_done: int) -> None:
        report(SfmProgress(phase="pairs", done=num_done, total=len(candidates)))

    return preview_pairs(database, candidates, config, tell)
