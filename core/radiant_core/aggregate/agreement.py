"""Which of several models contradict the others; they are left out of the join. Once per join.

Every model is rendered at some cameras of every other, as a guest:

    agree(i, j):  PSNR of i's and j's pictures at j's cameras, both opaque  ≥  MIN_AGREEMENT_DB

The model with the largest share of contradicting neighbours is left out if that is most of them,
then the rest is counted again. Models that contradict each other where no third covers the place
both stay and are named: nothing shows which is wrong. Attackers need about half of a model's
neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats

MIN_AGREEMENT_DB = 10.0
"""Half grey against a photograph is about 14 dB; models: 16 to 22 (docs/threat_model.md)."""
MIN_MODELS = 3
"""Of two models that contradict each other it is undecidable which is wrong: none is left out."""
NUM_ASKED = 4
"""Cameras of each model at which the others are rendered."""
LONG_SIDE_PX = 96
OPAQUE = 0.8
MIN_SHARE = 0.05
"""Of the pixels: two models are neighbours where both are opaque in at least so many."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Agreement:
    """agreement_db (M,M) of guest i and host j, NaN where they share too little; reasons; and pairs
    that contradict each other and both stay, with their agreement in dB."""

    agreement_db: FloatArray
    refused: dict[int, str]
    ties: dict[tuple[int, int], float]


def find_contradictions(models: Sequence[Splats], cameras: Sequence[Cameras], backend: Backend = "auto") -> Agreement:
    """Which of M models are not to be joined, one sentence each, none where M is under three; and
    which contradict each other and stay."""
    if len(models) != len(cameras):
        raise BadInput(f"{len(cameras)} sets of cameras for {len(models)} models: give one each.")
    agreement_db = np.full((len(models), len(models)), np.nan)
    for host, host_cameras in enumerate(cameras):
        sample = _sample_cameras(host_cameras)
        if not len(sample):
            continue
        home = list(render_views(models[host], sample, backend))
        for guest in range(len(models)):
            if guest != host:
                agreement_db[guest, host] = _agreement_db(home, list(render_views(models[guest], sample, backend)))
    # Of a pair the worse direction counts, NaN where they share no place.
    pairs = np.fmin(agreement_db, agreement_db.T)
    refused = _find_outvoted(pairs)
    stay = [model for model in range(len(models)) if model not in refused]
    ties = {
        (first, second): float(pairs[first, second]) for first, second in combinations(stay, 2) if pairs[first, second] < MIN_AGREEMENT_DB
    }
    return Agreement(agreement_db=agreement_db, refused=refused, ties=ties)


def _sample_cameras(cameras: Cameras) -> Cameras:
    rows = np.unique(np.linspace(0, len(cameras) - 1, min(NUM_ASKED, len(cameras))).astype(np.int64))
    return cameras.select(rows).scaled(LONG_SIDE_PX) if len(cameras) else cameras


def _agreement_db(home: Sequence, guest: Sequence) -> float:
    """PSNR over all pixels that both show; NaN where they are too few."""
    both = [(home_view.alpha > OPAQUE) & (guest_view.alpha > OPAQUE) for home_view, guest_view in zip(home, guest, strict=True)]
    num_shared, num_pixels = sum(int(mask.sum()) for mask in both), sum(mask.size for mask in both)
    if num_shared < MIN_SHARE * num_pixels:
        return float("nan")
    triples = zip(home, guest, both, strict=True)
    squares = sum(float(np.square(home_view.image[m] - guest_view.image[m]).sum()) for home_view, guest_view, m in triples)
    return float(-10 * np.log10(max(squares / (3 * num_shared), 1e-10)))


def _find_outvoted(pairs: FloatArray) -> dict[int, str]:
    """Models to leave out, from the agreement (M,M) of pairs in dB.

    In rounds the model with the largest share of contradicting neighbours, or all that are equal in
    that; only those that most of their neighbours outside of these contradict.
    """
    neighbours, against = ~np.isnan(pairs), pairs < MIN_AGREEMENT_DB
    remaining, refused = np.ones(len(pairs), bool), dict[int, str]()
    while remaining.sum() >= MIN_MODELS:
        num_neighbours = (neighbours & remaining).sum(axis=1)
        shares = np.where(remaining, (against & remaining).sum(axis=1) / np.maximum(num_neighbours, 1), 0.0)
        worst = shares == shares.max()
        outvoted = np.flatnonzero(worst & remaining & (2 * (against & remaining & ~worst).sum(axis=1) > num_neighbours))
        if not len(outvoted):
            break
        for model in outvoted.tolist():
            refused[model] = (
                f"it contradicts {int((against & remaining)[model].sum())} of the {num_neighbours[model]} models that show the same places "
                f"(below {MIN_AGREEMENT_DB:g} dB)."
            )
        remaining[outvoted] = False
    return refused
