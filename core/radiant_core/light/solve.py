"""Solves the light of photographs from brightness that is known twice. Once per training and score.

    minimise  Σ over observations  ρ(y_o − log g_v(o) − Σ_k a_k(v) r_o^2k − b_p(o))     per channel

y are log brightnesses of places p that several photographs show (`lights_from_tracks`), whose
albedos b are eliminated, or log ratios of photographs to renders of a model (`lights_from_model`),
without b. ρ is Cauchy's with the scale of the median, by `NUM_ROUNDS` rounds of weighted least
squares on a sparse matrix of V + 3 K unknowns. Each set of photographs that share places has mean
log g = 0. A photograph with fewer than `MIN_SHARED` shared places is not known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import spsolve

from radiant_core.cameras import Cameras
from radiant_core.light.evenness import evenness, parts_of
from radiant_core.light.lights import NUM_TERMS, Lights, cameras_alike, squared_radii
from radiant_core.numerics import FloatArray
from radiant_core.regimes import LIGHT_EVENNESS, LIGHT_SPREAD
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.views import TrainingViews

DARKEST, BRIGHTEST = 8.0, 247.0
"""Of 255: beyond these noise and clipping decide."""
MIN_SHARED = 20
"""A photograph with fewer observations is not known."""
NUM_ROUNDS = 10
SOME, SOME_ROUNDS, MARGIN = 100, 4, 0.75
"""Observations of each photograph, and rounds, by which it is asked whether light differs at all:
their gains have errors of 0.5 %. It does not where figures are below this share of the limits."""
WIDTH = 2.0
"""Of Cauchy's weights, in standard deviations by the median."""
FIRST_SCALE, LEAST_SCALE = 0.05, 1e-6
BLUR_PX = 3
NUM_PLACES = 64
COMPARED_PX, SAMPLES, OPAQUE = 192, 2_000, 0.95
"""Size of the renders compared, pixels of each that are, and the opacity that these have."""
NUM_SIZED = 8
"""Views in which renders of that size are compared with larger ones."""
GAIN_SPREAD, TERM_SPREAD = 1.0, 0.3
"""Standard deviations that log gains and terms of a vignetting have beforehand: what photographs
that overlap little leave open stays near 0."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Observations:
    """T observations: photograph `view` (T,), r² (T,), log brightness or ratio `logs` (T,3), NaN
    where it says nothing; `place` (T,), or None for ratios; `part` (T,) of the picture, by
    `parts_of`, or None where it is not known."""

    view: NDArray[np.int64]
    squared_radii: FloatArray
    logs: FloatArray
    place: NDArray[np.int64] | None = None
    part: NDArray[np.int64] | None = None


def lights_from_tracks(scene: SfmScene, views: TrainingViews) -> Lights:
    """The light of V photographs by what they show at the scene's points; `views.cameras` are the
    scene's in the same order."""
    return solve_lights(observe_tracks(scene, views), views.cameras)


def lights_if_they_differ(scene: SfmScene, views: TrainingViews) -> Lights:
    """The same, of some of the points alone where these already say that light does not differ, or
    not by gains that explain whole pictures."""
    observed = observe_tracks(scene, views)
    rows = _of_some_places(observed, len(views))
    if 2 * len(rows) < len(observed.view):
        assert observed.place is not None and observed.part is not None
        some = Observations(
            view=observed.view[rows],
            squared_radii=observed.squared_radii[rows],
            logs=observed.logs[rows],
            place=observed.place[rows],
        )
        lights = solve_lights(some, views.cameras, SOME_ROUNDS)
        lights = replace(lights, evenness=_evenness(observed, lights))
        if lights.spread < MARGIN * LIGHT_SPREAD or lights.evenness < MARGIN * LIGHT_EVENNESS:
            return lights
    return solve_lights(observed, views.cameras)


def observe_tracks(scene: SfmScene, views: TrainingViews) -> Observations:
    """What V photographs show at the scene's points, smoothed."""
    rows, pixels = views.observed_pixels(scene)
    place, view = scene.observations[rows].T
    colors = np.empty((len(rows), 3))
    by_view, bounds = np.argsort(view, kind="stable"), np.cumsum(np.bincount(view, minlength=len(views)))
    for index, photo_rows in enumerate(np.split(by_view, bounds[:-1])):
        if not len(photo_rows):
            continue
        smooth = cv2.blur(np.asarray(views.images[index], np.float32), (BLUR_PX, BLUR_PX))
        colors[photo_rows] = smooth[pixels[photo_rows, 1], pixels[photo_rows, 0]]
    cameras = views.cameras
    sizes = cameras.sizes_wh[view].astype(np.float64)
    squared = 4 * ((pixels + 0.5 - cameras.Ks[view, :2, 2]) ** 2).sum(axis=1) / (sizes**2).sum(axis=1)
    part = parts_of(pixels, cameras.sizes_wh[view])
    return Observations(view=view, squared_radii=squared, logs=log_of_colors(colors), place=place, part=part)


def _of_some_places(observed: Observations, count: int) -> NDArray[np.int64]:
    """The observations of places drawn evenly at random, of which each of so many photographs
    shows `SOME`, or all that it has."""
    assert observed.place is not None
    turn = np.random.default_rng(0).permutation(int(observed.place.max(initial=-1)) + 1)
    in_turn = np.lexsort((turn[observed.place], observed.view))
    first = np.cumsum(np.bincount(observed.view, minlength=count)) - np.bincount(observed.view, minlength=count)
    early = np.empty(len(in_turn), bool)
    early[in_turn] = np.arange(len(in_turn)) - first[observed.view[in_turn]] < SOME
    chosen = np.zeros(len(turn), bool)
    chosen[observed.place[early]] = True
    return np.flatnonzero(chosen[observed.place])


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenLights:
    """The lights of V photographs, and places (n,3) that each shows, at most `NUM_PLACES`."""

    lights: Lights
    places: tuple[FloatArray, ...]


def lights_from_model(model: Splats, views: TrainingViews, backend: Backend = "auto", seen_px: int | None = None) -> SeenLights:
    """The light of V photographs relative to a model: gains keep their mean, since the model's own
    light is the canonical one. Cameras are in the frame of the model. seen_px: long side of the
    pictures in which its light is meant, by default that of the views."""
    cameras = views.cameras.scaled(COMPARED_PX)
    times = round((int(views.cameras.sizes_wh.max(initial=1)) if seen_px is None else seen_px) / COMPARED_PX)
    per_view: list[tuple[NDArray[np.int64], FloatArray, FloatArray, NDArray[np.int64]]] = []
    places: list[FloatArray] = []
    for index, render in enumerate(render_views(model, cameras, backend)):
        size = (int(cameras.sizes_wh[index, 0]), int(cameras.sizes_wh[index, 1]))
        image = cv2.resize(np.asarray(views.images[index]), size, interpolation=cv2.INTER_AREA)
        used = render.alpha > OPAQUE
        if views.weights is not None:
            used &= cv2.resize(np.asarray(views.weights[index]), size, interpolation=cv2.INTER_AREA) > 127
        rows = np.flatnonzero(used)
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, min(SAMPLES, len(rows))).astype(np.int64))] if len(rows) else rows
        logs = log_of_colors(image.reshape(-1, 3)[rows].astype(np.float64)) - log_of_colors(
            255 * render.image.reshape(-1, 3)[rows].astype(np.float64)
        )
        part = parts_of(np.column_stack([rows % size[0], rows // size[0]]), cameras.sizes_wh[index])
        per_view.append((np.full(len(rows), index), squared_radii(cameras, index).ravel()[rows], logs, part))
        places.append(_places(cameras, index, render.depth, rows[:: max(1, len(rows) // NUM_PLACES)]))
    view, squared, logs, parts = (np.concatenate(column) for column in zip(*per_view, strict=True))
    lights = solve_lights(Observations(view=view, squared_radii=squared, logs=logs, part=parts), views.cameras)
    if times > 1 and lights.is_known.any():
        offset = _log_of_size(model, cameras, times, backend)
        lights = replace(lights, log_gains=np.where(lights.is_known[:, None], lights.log_gains - offset, lights.log_gains))
    return SeenLights(lights=lights, places=tuple(places))


def _log_of_size(model: Splats, cameras: Cameras, times: int, backend: Backend) -> FloatArray:
    """By how much (3,) of log brightness renders `times` as large are above these, in the mean:
    every Gaussian is widened by a share of a pixel, so that a model of trained sharpness is 3 %
    brighter, or darker, in renders half as large."""
    rows = np.unique(np.linspace(0, len(cameras) - 1, min(NUM_SIZED, len(cameras))).astype(np.int64))
    some = cameras.select(rows)
    large = replace(some, Ks=some.Ks * np.array([times, times, 1.0])[:, None], sizes_wh=times * some.sizes_wh)
    logs = list[FloatArray]()
    for whole, render in zip(render_views(model, large, backend), render_views(model, some, backend), strict=True):
        height, width = render.image.shape[:2]
        used = render.alpha > OPAQUE
        averaged = cv2.resize(whole.image, (width, height), interpolation=cv2.INTER_AREA)[used]
        logs.append(log_of_colors(255 * averaged.astype(np.float64)) - log_of_colors(255 * render.image[used].astype(np.float64)))
    difference = np.concatenate(logs)
    known = np.isfinite(difference)
    return np.where(known, difference, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)


def _places(cameras: Cameras, index: int, depth: NDArray[np.float32], rows: NDArray[np.int64]) -> FloatArray:
    """Where pixels (n,) of a camera see something, (n,3)."""
    y, x = np.divmod(rows, depth.shape[1])
    rays = np.column_stack([x + 0.5, y + 0.5, np.ones(len(rows))]) @ np.linalg.inv(cameras.Ks[index]).T
    pose = cameras.cam_from_world[index]
    return (rays * depth.ravel()[rows, None] - pose[:3, 3]) @ pose[:3, :3]


def solve_lights(observed: Observations, cameras: Cameras, num_rounds: int = NUM_ROUNDS) -> Lights:
    """The lights of V photographs, those of `cameras`, by T observations; photographs that cannot
    be known get gain 1."""
    camera_of, num_cameras = cameras_alike(cameras)
    count = len(cameras)
    log_gains, vignettings = np.zeros((count, 3)), np.zeros((num_cameras, NUM_TERMS, 3))
    is_known = np.ones(count, bool)
    for channel in range(3):
        rows = _usable(observed, channel, count)
        enough = np.bincount(observed.view[rows], minlength=count) >= MIN_SHARED
        is_known &= enough
        if not len(rows):
            continue
        solution = _solve_channel(observed, rows, channel, camera_of, num_cameras, num_rounds)
        log_gains[:, channel] = np.where(enough, solution[:count], 0.0)
        vignettings[:, :, channel] = solution[count:].reshape(num_cameras, NUM_TERMS)
    log_gains[~is_known] = 0.0
    lights = Lights(log_gains=log_gains, camera_of=camera_of, vignettings=vignettings, is_known=is_known)
    return lights if observed.part is None else replace(lights, evenness=_evenness(observed, lights))


def _evenness(observed: Observations, lights: Lights) -> float:
    assert observed.part is not None
    return evenness(lights.spread, _residuals(observed, lights), observed.view, observed.part)


def _residuals(observed: Observations, lights: Lights) -> FloatArray:
    """What lights leave of the mean log over channels (T,), of places less their mean; NaN where
    something is not known."""
    view = observed.view
    powers = np.stack([observed.squared_radii ** (term + 1) for term in range(NUM_TERMS)], axis=1)
    explained = lights.log_gains[view] + np.einsum("ok,okc->oc", powers, lights.vignettings[lights.camera_of[view]])
    residuals = np.where(lights.is_known[view], (observed.logs - explained).mean(axis=1), np.nan)
    residuals[~np.isfinite(residuals)] = np.nan
    if observed.place is None:
        return residuals
    tells = np.isfinite(residuals)
    size = int(observed.place.max(initial=-1)) + 1
    counts, sums = (np.bincount(observed.place[tells], weights, size) for weights in (None, residuals[tells]))
    # A place that one photograph shows says nothing.
    return np.where(counts[observed.place] > 1, residuals - sums[observed.place] / np.maximum(counts[observed.place], 1), np.nan)


def log_of_colors(colors: FloatArray) -> FloatArray:
    """Log of colours of 255, NaN where too dark, too bright, or no number."""
    with np.errstate(invalid="ignore"):
        usable = (colors >= DARKEST) & (colors <= BRIGHTEST)
    return np.log(np.where(usable, colors, np.nan))


def _usable(observed: Observations, channel: int, count: int) -> NDArray[np.int64]:
    """Rows that can be compared: with a value, of places that two photographs with enough of them
    show."""
    usable = np.isfinite(observed.logs[:, channel]) & np.isfinite(observed.squared_radii)
    place = observed.place
    if place is None:
        return np.flatnonzero(usable & (np.bincount(observed.view[usable], minlength=count) >= MIN_SHARED)[observed.view])
    while True:
        views_per_place = np.bincount(place[usable], minlength=int(place.max(initial=-1)) + 1)
        remaining = usable & (views_per_place[place] > 1)
        remaining &= (np.bincount(observed.view[remaining], minlength=count) >= MIN_SHARED)[observed.view]
        if remaining.sum() == usable.sum():
            return np.flatnonzero(remaining)
        usable = remaining


def _solve_channel(
    observed: Observations, rows: NDArray[np.int64], channel: int, camera_of: NDArray[np.int64], num_cameras: int, num_rounds: int
) -> FloatArray:
    """Log gains, then the terms of each camera, (V + 3 K,) of one channel."""
    count, of_places = len(camera_of), observed.place is not None
    view, squared, logs = observed.view[rows], observed.squared_radii[rows], observed.logs[rows, channel]
    if observed.place is None:
        equations: _Ratios | _Brightness = _Ratios.of(view, squared, logs, camera_of, num_cameras)
    else:
        place = np.unique(observed.place[rows], return_inverse=True)[1]
        equations = _Brightness(design=_design(view, squared, camera_of, num_cameras), place=place, logs=logs)
    prior = sparse.diags(np.repeat([GAIN_SPREAD**-2.0, TERM_SPREAD**-2.0], [count, num_cameras * NUM_TERMS]))
    weights, solution, scale = np.ones(len(rows)), np.zeros(count + NUM_TERMS * num_cameras), FIRST_SCALE
    for _ in range(num_rounds):
        normal, right = equations.normal(weights)
        solution = np.asarray(spsolve((normal + scale**2 * prior).tocsc(), right), np.float64)
        residuals = equations.residuals(solution, weights)
        scale = max(LEAST_SCALE, 1.4826 * float(np.median(np.abs(residuals))))
        weights = 1 / (1 + (residuals / (WIDTH * scale)) ** 2)
    return _center(solution, view, equations.of_place, count) if of_places and isinstance(equations, _Brightness) else solution


@dataclass(frozen=True, kw_only=True, eq=False)
class _Ratios:
    """Least squares of T ratios to a model: every photograph meets its own gain and its camera's
    terms alone, so that sums of powers of r² per photograph are all that the equations need."""

    view: NDArray[np.int64]
    of_view: sparse.csr_matrix
    """(V, T), 1 where an observation is of a photograph."""
    powers: FloatArray
    """r^2m (T, 2 NUM_TERMS + 1) for m from 0 on."""
    logs: FloatArray
    camera_of: NDArray[np.int64]
    num_cameras: int

    @classmethod
    def of(cls, view: NDArray[np.int64], squared: FloatArray, logs: FloatArray, camera_of: NDArray[np.int64], num_cameras: int) -> _Ratios:
        powers = np.ones((len(view), 2 * NUM_TERMS + 1))
        np.multiply.accumulate(np.broadcast_to(squared[:, None], (len(view), 2 * NUM_TERMS)), axis=1, out=powers[:, 1:])
        of_view = sparse.csr_matrix((np.ones(len(view)), (view, np.arange(len(view)))), shape=(len(camera_of), len(view)))
        return cls(view=view, of_view=of_view, powers=powers, logs=logs, camera_of=camera_of, num_cameras=num_cameras)

    def normal(self, weights: FloatArray) -> tuple[sparse.csr_matrix, FloatArray]:
        count, size = len(self.camera_of), len(self.camera_of) + NUM_TERMS * self.num_cameras
        sums = (self.of_view @ (self.powers * weights[:, None])).T
        rights = (self.of_view @ (self.powers[:, : NUM_TERMS + 1] * (weights * self.logs)[:, None])).T
        views, terms = np.arange(count), [count + NUM_TERMS * self.camera_of + term for term in range(NUM_TERMS)]
        entries = [(views, views, sums[0])]
        for term, columns in enumerate(terms):
            entries += [(views, columns, sums[term + 1]), (columns, views, sums[term + 1])]
            entries += [(columns, others, sums[term + second + 2]) for second, others in enumerate(terms)]
        at, to, values = (np.concatenate(part) for part in zip(*entries, strict=True))
        right = np.concatenate([rights[0], np.zeros(size - count)])
        for columns, value in zip(terms, rights[1:], strict=True):
            np.add.at(right, columns, value)
        return sparse.csr_matrix((values, (at, to)), shape=(size, size)), right

    def residuals(self, solution: FloatArray, weights: FloatArray) -> FloatArray:
        del weights
        first = len(self.camera_of) + NUM_TERMS * self.camera_of[self.view]
        terms = solution[first[:, None] + np.arange(NUM_TERMS)]
        return self.logs - solution[self.view] - np.einsum("ok,ok->o", terms, self.powers[:, 1 : NUM_TERMS + 1])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Brightness:
    """Least squares of T log brightnesses of places, whose albedos are eliminated."""

    design: sparse.csr_matrix
    place: NDArray[np.int64]
    logs: FloatArray

    @cached_property
    def of_place(self) -> sparse.csr_matrix:
        """(T, P), 1 where an observation is of a place."""
        count = len(self.place)
        return sparse.csr_matrix((np.ones(count), (np.arange(count), self.place)), shape=(count, int(self.place.max()) + 1))

    def normal(self, weights: FloatArray) -> tuple[sparse.csr_matrix, FloatArray]:
        weighted = self.design.T.multiply(weights).tocsr()
        cross, place_weights = weighted @ self.of_place, np.bincount(self.place, weights)
        means = sparse.diags(1 / np.maximum(place_weights, 1e-300)) @ cross.T
        return weighted @ self.design - cross @ means, weighted @ self.logs - cross @ self._means(self.logs, weights)

    def residuals(self, solution: FloatArray, weights: FloatArray) -> FloatArray:
        residuals = self.logs - self.design @ solution
        return residuals - self._means(residuals, weights)[self.place]

    def _means(self, values: FloatArray, weights: FloatArray) -> FloatArray:
        """The weighted means of values (T,) at each place, (P,)."""
        return np.bincount(self.place, weights * values) / np.maximum(np.bincount(self.place, weights), 1e-300)


def _design(view: NDArray[np.int64], squared: FloatArray, camera_of: NDArray[np.int64], num_cameras: int) -> sparse.csr_matrix:
    """The factors (T, V + 3 K) of log gains and terms in each observation."""
    count, num_rows = len(camera_of), len(view)
    first = count + NUM_TERMS * camera_of[view]
    columns = np.concatenate([view, *(first + term for term in range(NUM_TERMS))])
    values = np.concatenate([np.ones(num_rows), *(squared ** (term + 1) for term in range(NUM_TERMS))])
    rows = np.tile(np.arange(num_rows), NUM_TERMS + 1)
    return sparse.csr_matrix((values, (rows, columns)), shape=(num_rows, count + NUM_TERMS * num_cameras))


def _center(solution: FloatArray, view: NDArray[np.int64], of_place: sparse.csr_matrix, count: int) -> FloatArray:
    """The solution with mean log gain 0 of each set of photographs that share places."""
    shows = sparse.csr_matrix((np.ones(len(view)), (view, np.arange(len(view)))), shape=(count, len(view))) @ of_place
    _, part = connected_components(shows @ shows.T, directed=False)
    present = np.bincount(view, minlength=count) > 0
    sums = np.bincount(part[present], weights=solution[:count][present], minlength=part.max() + 1)
    level = sums / np.maximum(1, np.bincount(part[present], minlength=part.max() + 1))
    centred = solution.copy()
    centred[:count] -= np.where(present, level[part], 0.0)
    return centred
