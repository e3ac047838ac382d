"""Which pairs deserve all their features: those whose largest features match. Once per scene.

A preview matches the 512 largest features of each two candidates, 1 % of the products of 4,096 and
well under a millisecond. Of pairs that COLMAP verified with 120 matches or more, 95 % had 14 mutual
ones or more in the preview; pairs that show nothing in common had 4 (docs/experiments/sfm.md).
Each photograph keeps its best partners, some of them spread over the weaker ones, since views far
apart fix depth; and two trees over all photographs keep them in one piece.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree

NUM_PREVIEWED = 512
LEAST_SCORE = 6
"""Fewer matches in the preview are chance."""
NUM_TREES = 2
FAR_SHARE = 0.3
"""Share of the partners taken evenly from the weaker ones."""
SURE_SCORE = 12
"""A far partner has at least as many: it is hardly ever lost in verification."""

Pairs = NDArray[np.int64]


def choose_partners(candidates: Pairs, scores: NDArray[np.int64], num_photographs: int, num_partners: int) -> NDArray[np.bool_]:
    """Which candidates (E,2) of photographs 0..N−1 to match in full, given the matches of their
    previews (E,): a mask (E,)."""
    chosen = np.zeros(len(candidates), bool)
    for _ in range(NUM_TREES):
        chosen |= _strongest_tree(candidates, np.where(chosen, 0, scores), num_photographs)
    usable = np.flatnonzero(scores >= LEAST_SCORE)
    ends = candidates[usable]
    num_far = int(FAR_SHARE * num_partners)
    for photograph in range(num_photographs):
        rows = usable[(ends == photograph).any(axis=1)]
        rows = rows[np.argsort(-scores[rows], kind="stable")]
        near, farther = rows[: num_partners - num_far], rows[num_partners - num_far :]
        sure = farther[scores[farther] >= SURE_SCORE]
        # The weakest first, the others at equal steps of rank.
        far = sure[np.linspace(len(sure) - 1, 0, num_far, dtype=int)] if len(sure) > num_far else farther[:num_far]
        chosen[near] = chosen[far] = True
    return chosen


def _strongest_tree(candidates: Pairs, scores: NDArray[np.int64], num_photographs: int) -> NDArray[np.bool_]:
    """The candidates (E,) of a spanning forest of greatest total score; those of 0 are no edges."""
    edges = np.flatnonzero(scores > 0)
    costs = csr_array((1.0 / scores[edges], candidates[edges].T), shape=(num_photographs, num_photographs))
    rows, columns = minimum_spanning_tree(costs).nonzero()
    number = candidates.min(axis=1) * num_photographs + candidates.max(axis=1)
    return np.isin(number, np.minimum(rows, columns) * num_photographs + np.maximum(rows, columns)) & (scores > 0)
