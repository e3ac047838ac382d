"""Seams: borders between regions in short pieces, the colour steps across them, and their layer.

    step(x)²    = max(0, ‖c₊(x) − c₋(x)‖² − texture(x)²)
    texture(x)² = median over parallels p of ‖c₊(x+p n) − c₋(x+p n)‖²

c± is the mean colour of the Gaussians in the band of one width on either side of the border,
weighted by opacity times covered area, n the normal; bands are pooled over neighbouring pieces of a
border, since a seam has the same sign along it and texture has not. The parallels lie inside the
regions, so the scene's texture is subtracted (in squares, as independent parts add). Pieces are
weighted by their coverage; an unobserved piece has no figure. Once per picture; S pieces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.borders.borders import shared_borders
from radiant_core.plan.plans import CloudPlan
from radiant_core.splats import Splats
from radiant_viewer.layers.layer import HeatScale, Layer, LegendEntry
from radiant_viewer.layers.palette import GREY, heat_colors
from radiant_viewer.layers.splat_layer import base_colors

PARALLELS = (-3.0, -2.0, 2.0, 3.0)
"""Distances from the border at which the scene's texture is measured, in band widths."""
MIN_GAUSSIANS = 3
"""Least number of Gaussians of a band; with fewer, its piece has no value."""
POOLED_WIDTHS = 2.0
"""Length along the border over which bands are pooled, in widths."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeamPieces:
    """S pieces of borders: ends (S,2,2) on the map, edge_pairs (S,2), the regions beside them."""

    ends: FloatArray
    edge_pairs: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class ColorSteps:
    """Per piece (S,) in 8-bit levels, NaN where unknown: the step beyond the texture, the texture,
    and the largest step beyond it of a parallel, where there is no border; smaller steps cannot be
    distinguished from texture."""

    levels: FloatArray
    texture_levels: FloatArray
    limit_levels: FloatArray


def seam_pieces(cloud_plan: CloudPlan, length: float) -> SeamPieces:
    """Return the regions' shared borders in pieces of about `length`, without the outer edge."""
    ends, pairs = [np.zeros((0, 2, 2))], [np.zeros((0, 2), np.int64)]
    for border in shared_borders(cloud_plan):
        count = max(1, int(np.ceil(border.length_m / length)))
        cuts = border.ends[0] + np.linspace(0, 1, count + 1)[:, None] * (border.ends[1] - border.ends[0])
        ends.append(np.stack([cuts[:-1], cuts[1:]], axis=1))
        pairs.append(np.tile([border.first, border.second], (count, 1)))
    return SeamPieces(ends=np.concatenate(ends), edge_pairs=np.concatenate(pairs))


def piece_normals(pieces: SeamPieces) -> FloatArray:
    """Return unit normals (S,2) of the pieces, into the region of the lower index."""
    along = pieces.ends[:, 1] - pieces.ends[:, 0]
    return np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)


def color_steps(
    splats: Splats, pieces: SeamPieces, width: float, shares: ArrayLike | None = None, *, pooled_widths: float = POOLED_WIDTHS
) -> ColorSteps:
    """Return the colour steps across each piece; NaN where too few Gaussians lie beside it or its
    share (S,) of coverage is 0. `width` of a band > 0; `shares`: weights of the pieces, equal by
    default; `pooled_widths` = infinity gives all pieces of a border one figure. Raises BadInput for
    a bad width."""
    if not (np.isfinite(width) and width > 0):
        raise BadInput(f"the width of a seam band is {width}, expected a positive number.")
    counts = np.ones(len(pieces.ends)) if shares is None else check_array("shares", shares, (len(pieces.ends),))
    weights = _visible_weights(splats, width)
    weighted = np.column_stack([weights[:, None] * base_colors(splats.sh0), weights, np.ones(len(splats))])
    tree = KDTree(splats.means[:, :2].astype(np.float64))
    middles, normals = pieces.ends.mean(axis=1), piece_normals(pieces)
    same_border = (pieces.edge_pairs[:, None] == pieces.edge_pairs).all(axis=2)
    pooled = same_border & (np.linalg.norm(middles[:, None] - middles, axis=2) <= pooled_widths * width)

    def band_colors(offset_widths: float) -> FloatArray:
        # The lower region's border runs counter-clockwise: "left" is one side in all its pieces.
        chosen = tree.query_ball_point(middles + offset_widths * width * normals, 0.5 * width)
        weighted_sums = np.array([weighted[rows].sum(axis=0) for rows in chosen]).reshape(-1, 5)
        sums, numbers = (pooled * counts) @ weighted_sums[:, :4], (pooled & (counts > 0)) @ weighted_sums[:, 4:]
        return np.where(numbers >= MIN_GAUSSIANS, sums[:, :3] / np.maximum(sums[:, 3:], 1e-12), np.nan)

    def squares_at(offset_widths: float) -> FloatArray:
        return ((band_colors(offset_widths + 0.5) - band_colors(offset_widths - 0.5)) ** 2).mean(axis=1)

    parallels = np.stack([squares_at(offset) for offset in PARALLELS])
    has_value = np.isfinite(parallels).any(axis=0) & (counts > 0)
    usual = np.nanmedian(np.where(has_value, parallels, 0.0), axis=0)
    largest = np.nanmax(np.where(has_value, parallels, 0.0), axis=0)

    def levels(squares: FloatArray) -> FloatArray:
        return np.where(has_value, np.sqrt(np.maximum(0.0, squares)), np.nan)

    return ColorSteps(levels=levels(squares_at(0.0) - usual), texture_levels=levels(usual), limit_levels=levels(largest - usual))


def seam_layer(pieces: SeamPieces, values: ArrayLike, label: str, height: float = 0.0, least_high: float = 0.0) -> Layer:
    """Return the pieces of the borders coloured by one value (S,) each; `label` names quantity and
    unit, NaN is grey. The scale ends at the highest value or at `least_high`, so that invisible
    steps do not get the brightest colour. Raises BadInput for another number of values."""
    # A value that is not finite becomes one grey piece, counted in the legend.
    raw = np.asarray(values, np.float64)
    has_value = np.isfinite(raw)
    levels = check_array("values of the seam", np.where(has_value, raw, 0.0), (len(pieces.ends),))
    low = min(0.0, float(levels.min(initial=0.0)))
    high = _round_up(max(float(levels.max(initial=0.0)), least_high))
    colors = np.where(has_value[:, None], heat_colors(levels, low, high), np.array(GREY, np.uint8))
    ends = np.concatenate([pieces.ends, np.full((len(pieces.ends), 2, 1), height)], axis=2)
    unknown = int((~has_value).sum())
    missing = (LegendEntry(text=f"Not observed ({unknown} of {len(has_value)} pieces)", color=GREY, marker="line"),)
    return Layer(
        name="Seams",
        segments=ends,
        segment_colors=colors,
        line_width_px=7,
        in_front=True,
        legend=missing if unknown else (),
        heat=HeatScale(label=label, low=low, high=high),
    )


def _visible_weights(splats: Splats, width: float) -> FloatArray:
    """Return opacity times covered area (N,): the product of the two longer axes, at most a quarter
    of the band's square."""
    opacities = splats.opacities
    log_areas = np.sort(splats.log_scales.astype(np.float64), axis=1)[:, 1:].sum(axis=1)
    # Relative to the band: neither a tiny nor a huge scene under- or overflows.
    return opacities * np.exp(np.clip(log_areas - 2 * np.log(width), -50, np.log(0.25)))


def _round_up(value: float) -> float:
    """Round up to one digit, for the end of a colour bar: 36.8 gives 40; 1 for a value ≤ 0."""
    if value <= 0:
        return 1.0
    step = 10.0 ** np.floor(np.log10(value))
    return float(np.ceil(value / step) * step)
