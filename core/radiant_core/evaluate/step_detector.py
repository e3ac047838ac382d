"""Finds seams without a reference: does a model step at a border more than at lines beside it?

One render and 0.3 s per straight border. Of the strip seen from straight above and the Gaussians
that show in it, four quantities are taken at the border and at parallels:
    colour   mean of the 0.4 m to the left − to the right of every half metre of the border, of
             grey and two differences of channels
    height   left − right of neighbouring Gaussians' centres that lie on either side
    density  log of the ratio of Gaussians, weighted by opacity, in the bands to either side
    gap      opacity beside the line − opacity on it
the first two pooled along the border by a location that lets no piece decide: weights 1 / (s² + (x
− v)²), the maximum of Cauchy's likelihood with the scale s of each piece's own surroundings, so
that lawn counts more than hedges. With v(t) for the pooled figure at t,
    score = |v(0) − median of v(t)| / root mean square of v(t) − median,  2 m ≤ |t| ≤ 7 m.
Heights are those of centres: rendered depth mixes surfaces, and 5 cm vanish in its scatter of
20 cm. A seam is found where any score exceeds its threshold, which holds for metric models of
towns from the air (`radiant_app/bench/step_detector.py` measured them).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from radiant_core.evaluate.border_strip import BorderStrip, low_gaussians, render_border_strip
from radiant_core.numerics import FloatArray, check_array
from radiant_core.splats import Splats

if TYPE_CHECKING:
    from radiant_core.render.contract import Backend

Quantity = Literal["colour", "height", "density", "gap"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)

THRESHOLDS: dict[Quantity, float] = {"colour": 4.40, "height": 3.05, "density": 3.21, "gap": 3.34}
"""Together 5 % false alarms on 216 virtual borders of 144 m in six centralised models (town,
caliterra, lewis; 2 seeds, 640 px, 150 s): `python -m radiant_app.bench.step_detector --borders 36
MODEL…`. Cross-validated 6.9 %. Power by that command: height 5 cm 1.00 in the town, 0.44 in
caliterra, 0 in lewis; grey 20/255 0.61, 0.44, 0; grey 2/255 0 everywhere: texture steps more."""

PX_M = 0.1
HALF_WIDTH_M = 10.0
PIECE_M = 0.5
"""Length of the border in which colours are averaged."""
PARALLELS_M: FloatArray = np.concatenate([np.arange(-7.0, -1.9, 0.5), np.arange(2.0, 7.1, 0.5)])
COLOR_WIDTH_M = 0.4
"""Narrow, though a step is blurred over as much: texture grows faster with the distance. A step of
20/255 was found at 0.71 of 90 virtual borders, with 1 m at 0.54, with lines over 1.5 m at 0.38."""
DENSITY_WIDTH_M = 2.0
GAP_WIDTH_M, BESIDE_GAP_M = 0.3, 1.0
"""Half the width of the line, and to where opacity beside it is taken."""
MIN_OPACITY, MIN_ALPHA = 0.3, 0.2
NUM_NEIGHBOURS = 12
NEIGHBOUR_REACH = 2.5
"""Neighbours are at most so many times the usual distance to the nearest one away."""
MIN_PAIRS, MIN_PIECES = 30, 10
MIN_HEIGHT_SCALE_M, MIN_COLOR_SCALE = 0.01, 0.5 / 255


@dataclass(frozen=True, kw_only=True, eq=False)
class BorderSteps:
    """What was found at one border; NaN where there is too little to say.

    steps: left − right in each quantity's unit: grey of 0..1, m, log ratio, opacity; responses
    (1 + 22,): deviation from the median of the parallels over their scatter, at the border and at
    `PARALLELS_M`, of the strongest channel for colour; scatters: the root mean square of the
    parallels' steps, in the unit of `steps`.
    """

    steps: dict[Quantity, float]
    scatters: dict[Quantity, float]
    responses: dict[Quantity, FloatArray]
    strip: BorderStrip

    @property
    def scores(self) -> dict[Quantity, float]:
        """How far each quantity stands out at the border."""
        return {quantity: abs(float(values[0])) for quantity, values in self.responses.items()}

    @property
    def limits(self) -> dict[Quantity, float]:
        """The least step that would have been found, in its unit (of colour that of grey); or NaN.

        A step blurs beyond its bands: a planted one has to be larger, of grey twice as large.
        """
        return {quantity: THRESHOLDS[quantity] * self.scatters[quantity] for quantity in QUANTITIES}

    @property
    def found(self) -> tuple[Quantity, ...]:
        """In which quantities there is a seam; none found does not exclude one, see `limits`."""
        return tuple(quantity for quantity in QUANTITIES if self.scores[quantity] > THRESHOLDS[quantity])


def border_steps(splats: Splats, ends: ArrayLike, *, backend: Backend = "auto") -> BorderSteps:
    """Look for a seam along the border between `ends` (2,2) m; "left" is seen from first to second.

    Raises BadInput for ends that are not finite or nearer than a pixel, or a strip over 20 million
    pixels (100 km).
    """
    ends = check_array("ends", ends, (2, 2))
    strip = render_border_strip(splats, ends, half_width_m=HALF_WIDTH_M, px_m=PX_M, backend=backend)
    measured = {
        "colour": _strongest([_score(values) for values in _colors(strip)]),
        "height": _score(_heights(splats, ends)),
        "density": _score(_densities(strip)),
        "gap": _score(_gaps(strip)),
    }
    return BorderSteps(
        steps={quantity: measured[quantity].step for quantity in QUANTITIES},
        scatters={quantity: measured[quantity].scatter for quantity in QUANTITIES},
        responses={quantity: measured[quantity].responses for quantity in QUANTITIES},
        strip=strip,
    )


def _offsets_m() -> FloatArray:
    """The border, then the parallels (1 + 22,)."""
    return np.concatenate([[0.0], PARALLELS_M])


class _Score(NamedTuple):
    """Step at the border, scatter of the parallels, responses (1 + 22,) in units of that."""

    step: float
    scatter: float
    responses: FloatArray


def _score(values: FloatArray) -> _Score:
    """The border and its parallels (1 + 22,) in units of the parallels' own scatter."""
    known = np.isfinite(values)
    if not known[0] or known[1:].sum() < len(PARALLELS_M) // 2:
        return _Score(np.nan, np.nan, np.full(len(values), np.nan))
    others = values[1:][known[1:]]
    deviations = values - np.median(others)
    # A made-up model may be the same at all parallels, to rounding of float32.
    scatter = max(float(np.sqrt(np.mean((others - np.median(others)) ** 2))), 1e-6)
    return _Score(float(deviations[0]), scatter, deviations / scatter)


def _strongest(rows: list[_Score]) -> _Score:
    """Step and scatter of grey; the responses of whichever channel stands out most."""
    return rows[0]._replace(responses=max((row.responses for row in rows), key=lambda responses: abs(responses[0])))


def _location(values: FloatArray, scales: FloatArray) -> FloatArray:
    """Location (O,) of (O,K): fixed point of v = Σ q x / Σ q, q = 1 / (s² + (x − v)²)."""
    location = np.median(values, axis=1)
    for _ in range(20):
        weights = 1 / (scales**2 + (values - location[:, None]) ** 2)
        location = (weights * values).sum(axis=1) / weights.sum(axis=1)
    return location


def _colors(strip: BorderStrip) -> list[FloatArray]:
    """Pooled steps (1 + 22,) of grey, red − blue, green − magenta."""
    per_piece = round(PIECE_M / PX_M)
    num_pieces = strip.alpha.shape[1] // per_piece
    if num_pieces < MIN_PIECES:
        return [np.full(1 + len(PARALLELS_M), np.nan)]
    shown = strip.image / np.maximum(strip.alpha, MIN_ALPHA)[..., None]
    pieces = shown[:, : num_pieces * per_piece].reshape(len(shown), num_pieces, per_piece, 3).mean(axis=2, dtype=np.float64)
    red, green, blue = np.moveaxis(pieces, 2, 0)
    return [_pooled_steps(channel) for channel in ((red + green + blue) / 3, red - blue, green - (red + blue) / 2)]


def _pooled_steps(channel: FloatArray) -> FloatArray:
    """Steps (1 + 22,) of one channel (T,K), T rows from left to right."""
    width = round(COLOR_WIDTH_M / PX_M)
    starts = len(channel) // 2 - np.rint(_offsets_m() / PX_M).astype(np.int64)
    steps = np.stack([channel[start - width : start].mean(axis=0) - channel[start : start + width].mean(axis=0) for start in starts])
    scales = np.maximum(np.median(np.abs(steps[1:]), axis=0), MIN_COLOR_SCALE)
    return _location(steps, scales)


def _heights(splats: Splats, ends: FloatArray) -> FloatArray:
    """Pooled differences (1 + 22,) m of neighbouring centres across border and parallels."""
    empty = np.full(1 + len(PARALLELS_M), np.nan)
    length_m = float(np.hypot(*(ends[1] - ends[0])))
    along = (ends[1] - ends[0]) / length_m
    local = splats.means.astype(np.float64) - [*ends.mean(axis=0), 0.0]
    s, t = local[:, :2] @ along, local[:, :2] @ [-along[1], along[0]]
    inside = (np.abs(s) <= length_m / 2) & (np.abs(t) <= PARALLELS_M.max() + 1.0)
    shows = splats.logit_opacities > np.log(MIN_OPACITY / (1 - MIN_OPACITY))
    chosen = np.flatnonzero(low_gaussians(splats, inside) & inside & shows)
    if len(chosen) <= NUM_NEIGHBOURS:
        return empty
    centers, t = local[chosen], t[chosen]
    distances, indices = KDTree(centers).query(centers, NUM_NEIGHBOURS + 1)
    neighbours: NDArray[np.int64] = np.asarray(indices, np.int64)
    first, second = np.repeat(np.arange(len(chosen)), NUM_NEIGHBOURS), neighbours[:, 1:].ravel()
    near = (distances[:, 1:].ravel() <= NEIGHBOUR_REACH * np.median(distances[:, 1])) & (first < second)
    first, second = first[near], second[near]
    differences = centers[first, 2] - centers[second, 2]
    values = empty.copy()
    for index, offset_m in enumerate(_offsets_m()):
        across = (t[first] > offset_m) != (t[second] > offset_m)
        if across.sum() >= MIN_PAIRS:
            signs = np.where(t[first[across]] > offset_m, 1.0, -1.0)
            # Of pairs on one side alone: a step would look rough where it adds to what is there.
            rough_m = _roughness_m(first[~across], second[~across], differences[~across], len(chosen))
            scales = np.maximum((rough_m[first[across]] + rough_m[second[across]]) / 2, MIN_HEIGHT_SCALE_M)
            values[index] = _location((signs * differences[across])[None], scales)[0]
    return values


def _roughness_m(first: NDArray[np.int64], second: NDArray[np.int64], differences: FloatArray, count: int) -> FloatArray:
    """Roughness around each centre (N,): square of the mean root of |difference| of pairs (M,)."""
    ends, roots = np.concatenate([first, second]), np.tile(np.sqrt(np.abs(differences)), 2)
    return (np.bincount(ends, roots, count) / np.maximum(np.bincount(ends, minlength=count), 1)) ** 2


def _densities(strip: BorderStrip) -> FloatArray:
    """Log ratio (1 + 22,) of Gaussians left and right of the border and its parallels."""
    counts = strip.density.sum(axis=1) * strip.px_m**2
    if counts.sum() < MIN_PAIRS:
        return np.full(1 + len(PARALLELS_M), np.nan)
    width = round(DENSITY_WIDTH_M / PX_M)
    starts = len(counts) // 2 - np.rint(_offsets_m() / PX_M).astype(np.int64)
    return np.array([np.log((counts[start - width : start].sum() + 1) / (counts[start : start + width].sum() + 1)) for start in starts])


def _gaps(strip: BorderStrip) -> FloatArray:
    """Opacity beside − on the border and its parallels (1 + 22,), mean along it."""
    rows = strip.alpha.mean(axis=1, dtype=np.float64)
    line, beside = round(GAP_WIDTH_M / PX_M), round(BESIDE_GAP_M / PX_M)
    starts = len(rows) // 2 - np.rint(_offsets_m() / PX_M).astype(np.int64)
    outer = [np.concatenate([rows[start - beside : start - line], rows[start + line : start + beside]]).mean() for start in starts]
    return np.array(outer) - [rows[start - line : start + line].mean() for start in starts]
