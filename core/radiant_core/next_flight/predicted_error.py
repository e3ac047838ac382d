"""Which error a model has at each facet, predicted from what is known of it. Once per map.

    y = −10 log10(mean squared error of a render about the facet's pixel)     dB, more is better,
        once one colour map per photograph is taken out (evaluate/color_correction.py)
    y ≈ a + f(mean of y in the training photographs) + g(log det J)           f, g rising

The first term knows how hard a place is to show, the second how well it was photographed. The mean
is of decibels: that of squared errors is the worst photograph's, where something is in front. For a
view it is weighted by how alike the photographs look, from which side and how near; for the map it
is that of all. f and g are fitted to held-out photographs by turns, each the closest rising
function to what the other leaves (isotonic regression; Bacchetti, J. Am. Stat. Assoc. 84, 1989). It
predicts for views like the photographs, not for any view. How far it can be trusted is measured on
photographs that took no part in its fit, by cell, a mean over those that show it: `margin_db` is
what nine of ten cells there exceed, `rank` the correlation of ranks. M samples: a facet in a
held-out photograph.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_error import MIN_SQUARED_ERROR
from radiant_core.evaluate.image_pair import Used
from radiant_core.io.photos.masks import used_pixels
from radiant_core.next_flight.facets import Rows
from radiant_core.next_flight.sightings import Sighting
from radiant_core.numerics import FloatArray
from radiant_core.render.rendered_view import RenderedView, use_views
from radiant_core.splats import Splats

NUM_FOLDS, NUM_ROUNDS = 5, 8
MARGIN = 0.1
"""Share of the cells that may be worse than they are called."""
MIN_SAMPLES = 100
ALIKE_DEG, ALIKE_RATIO, LEAST_WEIGHT = 20.0, 0.5, 0.01
"""Two looks at a facet weigh exp(−(angle / 20°)² − (ln(ratio of GSDs) / 0.5)²) and 0.01 more."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorSamples:
    """rows (M,) of facets, photograph (M,) that saw it, held_db (M,): y there, train_db (M,): mean
    y of the training photographs at that facet for such a view, score (M,): log det J."""

    rows: Rows
    photograph: NDArray[np.int64]
    held_db: FloatArray
    train_db: FloatArray
    score: FloatArray

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, chosen: NDArray[np.bool_]) -> ErrorSamples:
        """The samples that a mask (M,) chooses."""
        return ErrorSamples(
            rows=self.rows[chosen],
            photograph=self.photograph[chosen],
            held_db=self.held_db[chosen],
            train_db=self.train_db[chosen],
            score=self.score[chosen],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Rising:
    """A rising function by its values at rising places, both (P,); constant beyond the ends."""

    at: FloatArray
    values: FloatArray

    def __call__(self, places: FloatArray) -> FloatArray:
        """Its values (K,)."""
        return np.interp(places, self.at, self.values)


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorModel:
    """The fitted prediction, and how it did on photographs that took no part in it: None where
    there are fewer than two."""

    middle_db: float
    by_training: Rising
    by_score: Rising
    num_cells: int
    num_photographs: int
    margin_db: float | None = None
    """Nine of ten cells are at most so many dB worse than predicted."""
    rank: float | None = None
    """Spearman's correlation of predicted and true error over cells; None where all are equal."""
    good: float | None = None
    """Share of the cells of photographs apart that were at least as good as predicted less the
    margin of the others."""

    def predict(self, train_db: FloatArray, score: FloatArray) -> FloatArray:
        """y (K,) of facets; NaN where no training photograph shows one."""
        return np.where(np.isfinite(train_db), self.middle_db + self.by_training(np.nan_to_num(train_db)) + self.by_score(score), np.nan)


def errors_in_views(
    splats: Splats,
    cameras: Cameras,
    image_of: Callable[[int], NDArray[np.uint8]],
    sightings: Sequence[Sighting],
    cell: float,
    weights: Sequence[NDArray[np.uint8]] | None = None,
) -> Iterator[FloatArray]:
    """Per camera the mean squared error (R,) of the model about the pixels of the facets that it
    sees, over a square as wide as a cell there usually is; image_of: the photograph (H,W,3) of a
    camera's index and size, asked for by threads. weights: used shares (H,W) of their pixels; NaN
    at facets behind what a mask leaves out. ValueError where sightings are of pictures of another
    size."""
    for index, sighting in zip(range(len(cameras)), sightings, strict=True):
        if (sighting.pixels >= cameras.sizes_wh[index] + 1).any():
            raise ValueError(f"a sighting is of pixels beyond a picture of {cameras.sizes_wh[index].tolist()} px")

    def errors(index: int, view: RenderedView) -> FloatArray:
        used = None if weights is None else used_pixels(weights[index])
        if used is not None and not used.any():
            return np.full(len(sightings[index].rows), np.nan)
        photograph = image_of(index).astype(np.float32) / 255
        difference = correct_colors(view.image, photograph, used) - photograph
        return _errors_at(sightings[index], np.einsum("hwc,hwc->hw", difference, difference) / 3, cell, used)

    return use_views(splats, cameras, errors)


def _errors_at(sighting: Sighting, squared: FloatArray, cell: float, used: Used) -> FloatArray:
    """Means (R,) of squared errors (H,W) about the pixels of a sighting."""
    if not len(sighting.rows):
        return np.zeros(0)
    smooth = _mean_about(squared, max(1, round(cell / float(np.median(sighting.gsd)))), used)
    columns, lines = sighting.pixels.astype(np.int64).T
    return smooth[np.minimum(lines, smooth.shape[0] - 1), np.minimum(columns, smooth.shape[1] - 1)].astype(np.float64)


def _mean_about(squared: FloatArray, side: int, used: Used) -> FloatArray:
    """Means (H,W) over the used pixels of squares of such a side; NaN where a pixel is not used."""
    if used is None:
        return cv2.blur(squared, (side, side), borderType=cv2.BORDER_REFLECT).astype(np.float64)
    sums, shares = (cv2.blur(part, (side, side), borderType=cv2.BORDER_REFLECT) for part in (squared * used, used.astype(np.float64)))
    return np.where(used, sums / np.maximum(shares, 1e-12), np.nan)


def mean_errors_db(count: int, sightings: Sequence[Sighting], errors: Sequence[FloatArray]) -> FloatArray:
    """y (K,) of the mean over views at each of `count` facets; NaN where none sees one."""
    total, number = np.zeros(count), np.zeros(count)
    for sighting, error in zip(sightings, errors, strict=True):
        counts = np.isfinite(error)
        total[sighting.rows[counts]] += error[counts]
        number[sighting.rows[counts]] += 1
    return np.where(number > 0, decibels(total / np.maximum(number, 1)), np.nan)


class TrainingErrors:
    """y of training photographs at `count` facets, from the squared errors (R,) of their
    sightings."""

    def __init__(self, count: int, sightings: Sequence[Sighting], errors: Sequence[FloatArray]) -> None:
        counted = [np.isfinite(error) for error in errors]
        rows = np.concatenate([sighting.rows[counts] for sighting, counts in zip(sightings, counted, strict=True)])
        order = np.argsort(rows, kind="stable")

        def sorted_by_facet(parts: Iterable[NDArray[np.floating]]) -> FloatArray:
            return np.concatenate([part[counts] for part, counts in zip(parts, counted, strict=True)]).astype(np.float64)[order]

        self._db = decibels(sorted_by_facet(errors))
        self._toward = sorted_by_facet(sighting.toward for sighting in sightings)
        self._log_gsd = np.log(sorted_by_facet(sighting.gsd for sighting in sightings))
        self._num = np.bincount(rows, minlength=count)
        self._first = np.cumsum(self._num) - self._num

    def typical_db(self) -> FloatArray:
        """Mean y (K,) of all; NaN where none sees a facet."""
        total = np.bincount(np.repeat(np.arange(len(self._num)), self._num), weights=self._db, minlength=len(self._num))
        return np.where(self._num > 0, total / np.maximum(self._num, 1), np.nan)

    def seen_alike_db(self, sighting: Sighting) -> FloatArray:
        """Mean y (R,) at the facets of another view, of photographs that see each as it does."""
        num = self._num[sighting.rows]
        look = np.repeat(np.arange(len(num)), num)
        of = np.arange(len(look)) - np.repeat(np.cumsum(num) - num, num) + self._first[sighting.rows][look]
        angles_deg = np.degrees(np.arccos(np.clip((self._toward[of] * sighting.toward[look]).sum(axis=1), -1, 1)))
        ratios = self._log_gsd[of] - np.log(sighting.gsd.astype(np.float64))[look]
        weights = np.exp(-np.square(angles_deg / ALIKE_DEG) - np.square(ratios / ALIKE_RATIO)) + LEAST_WEIGHT
        weight, total = (np.bincount(look, weights=part, minlength=len(num)) for part in (weights, weights * self._db[of]))
        return np.where(num > 0, total / np.maximum(weight, LEAST_WEIGHT), np.nan)


def decibels(squared: FloatArray) -> FloatArray:
    """y (K,) of mean squared errors."""
    return -10 * np.log10(np.maximum(squared, MIN_SQUARED_ERROR))


def rank_correlation(a: FloatArray, b: FloatArray) -> float:
    """Spearman's correlation of two lists (M,); NaN where either has one value alone."""
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return np.nan
    return float(np.corrcoef(_ranks(a), _ranks(b))[0, 1])


def _ranks(values: FloatArray) -> FloatArray:
    """Ranks (M,), the mean of theirs for equal values. `scipy.stats.rankdata`, whose module takes a
    second to load."""
    _, owner, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - (counts - 1) / 2)[owner]


def error_samples(train: TrainingErrors, score: FloatArray, sightings: Sequence[Sighting], errors: Sequence[FloatArray]) -> ErrorSamples:
    """Samples of held-out photographs at facets that training photographs show too."""
    rows = np.concatenate([sighting.rows for sighting in sightings]) if sightings else np.zeros(0, np.int64)
    photograph = np.repeat(np.arange(len(sightings)), [len(sighting.rows) for sighting in sightings])
    held_db = decibels(np.concatenate(errors)) if errors else np.zeros(0)
    train_db = np.concatenate([train.seen_alike_db(sighting) for sighting in sightings]) if sightings else np.zeros(0)
    samples = ErrorSamples(rows=rows, photograph=photograph, held_db=held_db, train_db=train_db, score=score[rows])
    return samples.select(np.isfinite(samples.train_db) & np.isfinite(samples.held_db))


def fit_errors(samples: ErrorSamples) -> ErrorModel:
    """The prediction from samples of held-out photographs; BadInput for fewer than 100 of them."""
    if len(samples) < MIN_SAMPLES:
        raise BadInput(
            f"held-out photographs show {len(samples)} cells that training photographs show too, at least {MIN_SAMPLES} are needed to "
            "predict errors: hold more photographs out, or choose smaller cells."
        )
    model = _fit(samples)
    names = np.unique(samples.photograph)
    if len(names) < 2:
        return model
    folds = np.searchsorted(names, samples.photograph) % min(NUM_FOLDS, len(names))
    predicted = np.full(len(samples), np.nan)
    for fold in range(int(folds.max()) + 1):
        others = _fit(samples.select(folds != fold))
        fold_samples = samples.select(folds == fold)
        predicted[folds == fold] = others.predict(fold_samples.train_db, fold_samples.score)
    predicted_db, true_db = _by_cell(samples, predicted)
    rank = rank_correlation(predicted_db, true_db)
    return ErrorModel(
        middle_db=model.middle_db,
        by_training=model.by_training,
        by_score=model.by_score,
        num_cells=model.num_cells,
        num_photographs=model.num_photographs,
        margin_db=float(max(0.0, -np.quantile(true_db - predicted_db, MARGIN))),
        rank=rank if np.isfinite(rank) else None,
        good=_good_share(samples, predicted, folds),
    )


def _by_cell(samples: ErrorSamples, predicted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Predicted and true y of each cell that the samples (M,) show, over their photographs."""
    cells, cell_of = np.unique(samples.rows, return_inverse=True)
    counts = np.bincount(cell_of, minlength=len(cells))
    error = np.bincount(cell_of, weights=10 ** (-samples.held_db / 10)) / counts
    return np.bincount(cell_of, weights=predicted) / counts, decibels(error)


def _good_share(samples: ErrorSamples, predicted: FloatArray, folds: NDArray[np.int64]) -> float:
    """Share of the cells at least as good as called, a fold's by the margin of the others'."""
    excess = []
    for fold in range(int(folds.max()) + 1):
        predicted_db, true_db = _by_cell(samples.select(folds == fold), predicted[folds == fold])
        excess.append(true_db - predicted_db)
    is_good = [
        excess[fold] >= np.quantile(np.concatenate([part for other, part in enumerate(excess) if other != fold]), MARGIN)
        for fold in range(len(excess))
    ]
    return float(np.concatenate(is_good).mean())


def _fit(samples: ErrorSamples) -> ErrorModel:
    middle_db = float(samples.held_db.mean())
    residuals = samples.held_db - middle_db
    by_training, by_score = Rising(at=np.zeros(1), values=np.zeros(1)), Rising(at=np.zeros(1), values=np.zeros(1))
    of_training, of_score = _Places.of(samples.train_db), _Places.of(samples.score)
    for _ in range(NUM_ROUNDS):
        by_training = of_training.closest_rising(residuals - of_score.each(by_score))
        by_score = of_score.closest_rising(residuals - of_training.each(by_training))
    return ErrorModel(
        middle_db=middle_db,
        by_training=by_training,
        by_score=by_score,
        num_cells=len(np.unique(samples.rows)),
        num_photographs=len(np.unique(samples.photograph)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Places:
    """Where M samples are: places (P,) that differ, rising, the owner (M,) and the counts (P,)."""

    at: FloatArray
    owner: NDArray[np.int64]
    counts: NDArray[np.int64]

    @classmethod
    def of(cls, places: FloatArray) -> _Places:
        at, owner = np.unique(places, return_inverse=True)
        return cls(at=at, owner=owner, counts=np.bincount(owner))

    def each(self, rising: Rising) -> FloatArray:
        """Its values at the samples (M,)."""
        return rising(self.at)[self.owner]

    def closest_rising(self, values: FloatArray) -> Rising:
        """The rising function closest to values (M,), of mean 0."""
        fitted = np.asarray(isotonic_regression(np.bincount(self.owner, weights=values) / self.counts, weights=self.counts).x)
        return Rising(at=self.at, values=fitted - np.average(fitted, weights=self.counts))
