"""`Support`: which training views constrain each Gaussian, as a table and as a file. N Gaussians.

A Gaussian of one view, or of several from one direction, may lie at any depth along their rays
without a photograph contradicting it. `evaluate.support` measures it by rendering.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.io.array_file import load_arrays, name_file_in_errors, save_arrays
from radiant_core.numerics import FloatArray, check_array
from radiant_core.splats import Splats

SUPPORT_NAME = "support.safetensors"
"""Beside the scores of the machine that measured it."""
MIN_VIEWS, MIN_PARALLAX_DEG = 2, 2.0
"""What fewer views or a smaller angle constrain may lie at any depth
(docs/experiments/off_path.md)."""
BACKGROUND = 2.0
"""What is farther from the middle of the sparse points than this many times their reach is sky or
horizon, which no parallax constrains and nobody walks around."""
REACH_QUANTILE = 0.99
_DTYPES = {"num_views": "I64", "parallax_deg": "F64", "shown_px": "F64"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Support:
    """Of N Gaussians: num_views (N,), parallax_deg (N,), shown_px (N,).

    Raises BadInput where a table is of another length or not finite, or a number is negative."""

    num_views: NDArray[np.int64]
    parallax_deg: FloatArray
    shown_px: FloatArray

    def __post_init__(self) -> None:
        count = len(self.num_views)
        for name, dtype in (("num_views", np.int64), ("parallax_deg", np.float64), ("shown_px", np.float64)):
            object.__setattr__(self, name, check_array(name, getattr(self, name), (count,), dtype))

    def __len__(self) -> int:
        return len(self.num_views)

    def select(self, chosen: NDArray[np.bool_]) -> Support:
        """Of the Gaussians that a mask (N,) chooses."""
        return Support(num_views=self.num_views[chosen], parallax_deg=self.parallax_deg[chosen], shown_px=self.shown_px[chosen])

    def constrained(self, num_views: int = MIN_VIEWS, parallax_deg: float = MIN_PARALLAX_DEG) -> NDArray[np.bool_]:
        """Which Gaussians (N,) so many views show, with so large an angle between two of them."""
        return (self.num_views >= num_views) & (self.parallax_deg >= parallax_deg)


def unconstrained(
    splats: Splats, support: Support, points: FloatArray, num_views: int = MIN_VIEWS, parallax_deg: float = MIN_PARALLAX_DEG
) -> NDArray[np.bool_]:
    """Which Gaussians (N,) too few views constrain, the background around sparse points (P,3)
    apart; without points nothing is background."""
    loose = ~support.constrained(num_views, parallax_deg)
    if not len(points):
        return loose
    middle = np.median(points, axis=0)
    reach = float(np.quantile(np.linalg.norm(points - middle, axis=1), REACH_QUANTILE))
    away = np.linalg.norm(splats.means.astype(np.float64) - middle, axis=1)
    return loose & (away <= BACKGROUND * reach)


def save_support(path: Path, support: Support) -> None:
    """Write the support of a model to `path`, atomically; raises as `write_atomic`."""
    save_arrays(path, "radiant.support", {name: getattr(support, name) for name in _DTYPES}, {})


def load_support(path: Path) -> Support:
    """The support that `save_support` wrote; StoreDamaged when broken, BadInput for something
    else."""
    arrays, _ = load_arrays(path, "radiant.support", _DTYPES)
    with name_file_in_errors(path):
        return Support(**arrays)
