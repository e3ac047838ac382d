"""Whether one method beats another: a mean difference with bounds. Once per comparison, 10 ms.

Both methods are run with the same seeds S on the same images I of each scene, so that differences d
(S,I) are pairwise. Seeds and images of every scene are drawn anew, each on their own; per draw
    mean + mean over scenes of [ √(S/(S−1)) (mean of the drawn seeds' rows − mean)
                               + √(I/(I−1)) (mean of the drawn images' columns − mean) ]
which is the part of Owen's (2007) bootstrap for crossed seeds and images that is linear in either;
the roots make each variance unbiased. Bounds are percentiles of the draws, widened by t over normal
quantile at the degrees of freedom after Satterthwaite (1946): three seeds say little of a fourth.
Noise of every seed and image alone is counted twice, so bounds rather hold too often. Scenes are
not drawn: the claim is about these scenes and, with one seed, about that seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri, stdtrit

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array, require_finite

MAX_COUNTS = 2_000_000
"""Numbers held at a time, 16 MB."""


@dataclass(frozen=True, kw_only=True)
class PairedDifference:
    """Mean difference a − b in the figure's unit, scenes weighted equally, and its bounds."""

    mean: float
    low: float
    """Two-sided bounds, (1 − confidence) / 2 beyond either of them."""
    high: float
    at_least: float
    """One-sided: the difference is at least this, with the same confidence."""
    at_most: float
    """One-sided: the difference is at most this, with the same confidence."""
    confidence: float
    degrees_of_freedom: float
    """After Satterthwaite, infinite where nothing varies; few mean too few seeds or images."""
    num_scenes: int
    num_images: int
    """Over all scenes."""
    num_seeds: int
    """The fewest of any scene; with 1 the bounds leave other seeds out."""


def paired_bootstrap(
    a: ArrayLike | Sequence[ArrayLike],
    b: ArrayLike | Sequence[ArrayLike],
    *,
    confidence: float = 0.95,
    num_draws: int = 10_000,
    seed: int = 0,
) -> PairedDifference:
    """Bounds of the mean of a − b, arrays (S,I) over seeds and images, or one such array per scene.

    The same input gives the same bounds. BadInput when shapes differ, a scene has no seed or under
    2 images, a value is not finite, `confidence` not in 0.5 to 1 or `num_draws` in 100 to 1e7.
    """
    if not 0.5 < confidence < 1:
        raise BadInput(f"confidence is {confidence}, expected more than 0.5 and less than 1.")
    if not 100 <= num_draws <= 10_000_000:
        raise BadInput(f"num_draws is {num_draws}, expected 100 to 10,000,000.")
    scenes = _differences(a, b)
    # From the first value on: differences that are all alike then have bounds of no width at all.
    first = float(scenes[0].flat[0])
    scenes = [scene - first for scene in scenes]
    mean = first + float(np.mean([scene.mean() for scene in scenes]))
    generator = np.random.default_rng(seed)
    deviations, variances = np.zeros(num_draws), []
    for scene in scenes:
        for margin in (scene.mean(axis=1), scene.mean(axis=0)):
            if len(margin) > 1:
                offsets = (margin - scene.mean()) / len(scenes)
                deviations += np.sqrt(len(margin) / (len(margin) - 1)) * _drawn_means(offsets, num_draws, generator)
                variances.append((float(np.var(offsets, ddof=1)) / len(margin), len(margin) - 1))
    freedom = _degrees_of_freedom(variances)
    tail = 1 - confidence
    low, high = (mean + _bound(deviations, share, freedom) for share in (tail / 2, 1 - tail / 2))
    at_least, at_most = (mean + _bound(deviations, share, freedom) for share in (tail, 1 - tail))
    return PairedDifference(
        mean=mean,
        low=low,
        high=high,
        at_least=at_least,
        at_most=at_most,
        confidence=confidence,
        degrees_of_freedom=freedom,
        num_scenes=len(scenes),
        num_images=sum(scene.shape[1] for scene in scenes),
        num_seeds=min(scene.shape[0] for scene in scenes),
    )


def _differences(a: ArrayLike | Sequence[ArrayLike], b: ArrayLike | Sequence[ArrayLike]) -> list[FloatArray]:
    """One (S,I) per scene."""
    firsts, seconds = _scenes("a", a), _scenes("b", b)
    if [scene.shape for scene in firsts] != [scene.shape for scene in seconds]:
        shapes = [[scene.shape for scene in scenes] for scenes in (firsts, seconds)]
        raise BadInput(f"a has the shapes {shapes[0]} and b {shapes[1]}: measure both with the same seeds on the same images.")
    differences = []
    for first, second in zip(firsts, seconds, strict=True):
        if first.shape[0] < 1 or first.shape[1] < 2:
            raise BadInput(
                f"a scene has {first.shape[0]} seeds and {first.shape[1]} images, expected 1 and 2 or more: nothing bounds it else."
            )
        with np.errstate(over="ignore"):
            difference = first - second
            require_finite("a − b", difference)
            # Squares of what is larger overflow; no figure of an image is.
            if np.abs(difference).max() > 1e100:
                raise BadInput(f"a difference is {np.abs(difference).max():.3g}, expected figures of images: check what was passed.")
        differences.append(difference)
    return differences


def _scenes(name: str, values: ArrayLike | Sequence[ArrayLike]) -> list[FloatArray]:
    if isinstance(values, np.ndarray):
        return [check_array(name, values, (None, None))]
    if not isinstance(values, list | tuple) or not len(values):
        raise BadInput(f"{name} is a {type(values).__name__}, expected an array (seeds, images) or a list with one per scene.")
    return [check_array(f"{name}[{index}]", scene, (None, None)) for index, scene in enumerate(values)]


def _drawn_means(offsets: FloatArray, num_draws: int, generator: np.random.Generator) -> FloatArray:
    """Means (num_draws,) of as many offsets (N,) as there are, drawn with replacement."""
    means = np.empty(num_draws)
    block = max(1, MAX_COUNTS // len(offsets))
    for start in range(0, num_draws, block):
        part = means[start : start + block]
        part[:] = offsets[generator.integers(len(offsets), size=(len(part), len(offsets)))].mean(axis=1)
    return means


def _degrees_of_freedom(variances: Sequence[tuple[float, int]]) -> float:
    """Of a sum of variances, each with its own degrees of freedom (Satterthwaite 1946)."""
    total = sum(variance for variance, _ in variances)
    if total == 0:
        return float("inf")
    return 1 / sum((variance / total) ** 2 / freedom for variance, freedom in variances)


def _bound(deviations: FloatArray, share: float, freedom: float) -> float:
    widening = 1.0 if np.isinf(freedom) else float(stdtrit(freedom, share) / ndtri(share))
    return widening * float(np.quantile(deviations, share))
