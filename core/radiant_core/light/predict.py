"""Predicts the light of photographs that nothing was solved from, without their pixels. Once per
score.

    mean        log g = the mean of the known ones
    exposure    log g = s · log₂(t ISO / N²) + c         s for all channels, c per channel, by EXIF
    time        linear between the photographs taken before and after
    place       the mean of the known ones by how many of their points the camera sees
    exposure, then time or place of what it leaves

Which one is decided per set: each predicts every known photograph from the others, `FOLDS` apart,
and the least root mean square error of log g wins, the first of equals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.light.captures import Shots
from radiant_core.light.lights import NUM_TERMS, Lights, camera_keys
from radiant_core.numerics import FloatArray

FOLDS = 8
"""As in the split of a scene, so that errors are those of photographs held out."""
MIN_KNOWN = 4
"""With fewer known photographs the mean is all that can be said."""
MIN_EXPOSURE_RANGE = 0.1
"""Stops: photographs exposed more alike than this have no slope."""

Base = Literal["mean", "exposure"]
Interpolation = Literal["none", "time", "place"]
CANDIDATES: tuple[tuple[Base, Interpolation], ...] = (
    ("mean", "none"),
    ("mean", "place"),
    ("mean", "time"),
    ("exposure", "none"),
    ("exposure", "place"),
    ("exposure", "time"),
)
_WORDS = {"exposure": "their exposure by EXIF", "time": "those taken before and after", "place": "those that show the same"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Prediction:
    """The lights of K photographs, how they were predicted, and that error of log g in cross
    validation beside the one of the mean."""

    lights: Lights
    base: Base
    interpolation: Interpolation
    error: float
    mean_error: float

    def decision(self, stage: str, num_known: int) -> Decision:
        """What was chosen, as the report lists it."""
        by = [_WORDS[name] for name in (self.base, self.interpolation) if name in _WORDS]
        return Decision(
            stage=stage,
            topic="light of photographs held out",
            choice=f"predicted by {' and '.join(by)}" if by else "the mean of the training photographs",
            figure=100 * self.error,
            unit="% error of brightness between training photographs",
            reason=f"the least of {len(CANDIDATES)} predictors over {num_known} of them; their mean: {100 * self.mean_error:.1f} %",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _KnownLights:
    """log_gains (V,3), ranks (V,) and log₂ exposures (V,) of the photographs predicted from."""

    log_gains: FloatArray
    ranks: FloatArray
    exposures: FloatArray

    def select(self, rows: NDArray[np.int64]) -> _KnownLights:
        return _KnownLights(log_gains=self.log_gains[rows], ranks=self.ranks[rows], exposures=self.exposures[rows])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Queries:
    """ranks (K,), log₂ exposures (K,) of the photographs asked for, and shared (K,V), how much of
    each known one their cameras see."""

    ranks: FloatArray
    exposures: FloatArray
    shared: FloatArray


def predict_lights(lights: Lights, shots: Shots, points: Sequence[FloatArray], targets: Shots) -> Prediction:
    """Predict the light of K photographs from that of V others.

    Args:
        lights: of V photographs.
        shots: what else is known of these.
        points: places (n,3) that each of them shows, in the frame of the cameras.
        targets: what is known of the K photographs.

    Returns:
        Their lights, every one known, and the choice with its error.
    """
    rows = np.flatnonzero(lights.is_known)
    training = _KnownLights(log_gains=lights.log_gains[rows], ranks=shots.ranks[rows], exposures=shots.log2_exposures[rows])
    places = [points[int(row)] for row in rows]
    among = _Queries(ranks=training.ranks, exposures=training.exposures, shared=_shared_places(places, shots, rows))
    base, interpolation, error, mean_error = _choose(training, among)
    queries = _Queries(
        ranks=targets.ranks, exposures=targets.log2_exposures, shared=_shared_places(places, targets, np.arange(len(targets)))
    )
    log_gains = _predict(training, queries, base, interpolation) if len(rows) else np.zeros((len(targets), 3))
    camera_of, vignettings = _vignettings_of(lights, shots, targets)
    predicted = Lights(log_gains=log_gains, camera_of=camera_of, vignettings=vignettings, is_known=np.ones(len(targets), bool))
    return Prediction(lights=predicted, base=base, interpolation=interpolation, error=error, mean_error=mean_error)


def _choose(training: _KnownLights, among: _Queries) -> tuple[Base, Interpolation, float, float]:
    """The best predictor, its error, and the error of the mean."""
    count = len(training.ranks)
    if count < MIN_KNOWN:
        spread = float(np.sqrt(np.mean(training.log_gains.var(axis=0)))) if count else 0.0
        return "mean", "none", spread, spread
    order = np.argsort(training.ranks, kind="stable")
    folds = min(FOLDS, count)
    errors = []
    for base, interpolation in CANDIDATES:
        residuals = np.zeros((count, 3))
        for first in range(folds):
            fold = order[first::folds]
            others = np.setdiff1d(np.arange(count), fold)
            part = _Queries(ranks=among.ranks[fold], exposures=among.exposures[fold], shared=among.shared[np.ix_(fold, others)])
            residuals[fold] = training.log_gains[fold] - _predict(training.select(others), part, base, interpolation)
        errors.append(float(np.sqrt(np.mean(residuals**2))))
    best = int(np.argmin(errors))
    return *CANDIDATES[best], errors[best], errors[0]


def _predict(training: _KnownLights, queries: _Queries, base: Base, interpolation: Interpolation) -> FloatArray:
    """Log gains (K,3) of those asked for."""
    here, there = _base(training, training.exposures, base), _base(training, queries.exposures, base)
    residuals = training.log_gains - here
    if interpolation == "time":
        order = np.argsort(training.ranks, kind="stable")
        between = [np.interp(queries.ranks, training.ranks[order], residuals[order, channel]) for channel in range(3)]
        return there + np.stack(between, axis=1)
    if interpolation == "place":
        total = queries.shared.sum(axis=1, keepdims=True)
        return there + np.where(total > 0, queries.shared @ residuals / np.maximum(total, 1e-12), residuals.mean(axis=0))
    return there


def _base(training: _KnownLights, exposures: FloatArray, base: Base) -> FloatArray:
    """The mean (K,3) of the known ones, or the line through them by exposure where that is
    known."""
    mean = np.broadcast_to(training.log_gains.mean(axis=0), (len(exposures), 3))
    exposed = np.isfinite(training.exposures)
    x = training.exposures[exposed]
    if base == "mean" or len(x) < MIN_KNOWN or np.ptp(x) < MIN_EXPOSURE_RANGE:
        return mean
    gains = training.log_gains[exposed]
    slope = float(((x - x.mean()) @ (gains - gains.mean(axis=0)).mean(axis=1)) / ((x - x.mean()) ** 2).sum())
    with_exposure = np.isfinite(exposures)
    line = gains.mean(axis=0) + slope * (np.where(with_exposure, exposures, x.mean()) - x.mean())[:, None]
    return np.where(with_exposure[:, None], line, mean)


def _shared_places(points: Sequence[FloatArray], shots: Shots, rows: NDArray[np.int64]) -> FloatArray:
    """Share (K,V) of the points of V photographs that project into each of the cameras `rows`."""
    counts = np.array([max(1, len(cloud)) for cloud in points], np.float64)
    places = np.concatenate([*points, np.zeros((0, 3))])
    owner = np.repeat(np.arange(len(points)), [len(cloud) for cloud in points])
    shared = np.zeros((len(rows), len(points)))
    for number, row in enumerate(rows):
        camera = shots.cameras.select([int(row)])
        in_camera = places @ camera.cam_from_world[0, :3, :3].T + camera.cam_from_world[0, :3, 3]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            pixels = (in_camera @ camera.Ks[0].T)[:, :2] / in_camera[:, 2:]
            inside = (in_camera[:, 2] > 0) & (pixels >= 0).all(axis=1) & (pixels < camera.sizes_wh[0]).all(axis=1)
        shared[number] = np.bincount(owner[inside], minlength=len(points)) / counts
    return shared


def _vignettings_of(lights: Lights, shots: Shots, targets: Shots) -> tuple[NDArray[np.int64], FloatArray]:
    """The camera of each target and the vignettings; none for one that took no known
    photograph."""
    camera_of = dict(zip(map(tuple, camera_keys(shots.cameras).tolist()), lights.camera_of.tolist(), strict=True))
    strange = len(lights.vignettings)
    rows = np.array([camera_of.get(tuple(key), strange) for key in camera_keys(targets.cameras).tolist()], np.int64)
    return rows, np.concatenate([lights.vignettings, np.zeros((1, NUM_TERMS, 3))])
