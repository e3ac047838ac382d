"""Layer of the Gaussians by the photographs that constrain them. Built once per picture."""

from __future__ import annotations

import numpy as np

from radiant_core.geometry.support import MIN_PARALLAX_DEG, Support, unconstrained
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_viewer.layers.detail import even_subset
from radiant_viewer.layers.layer import Layer, LegendEntry
from radiant_viewer.layers.splat_layer import MAX_POINTS, point_size_px

NAME = "Support"
LOOSE, TWO, MORE = (213, 94, 0), (230, 190, 40), (0, 114, 178)
"""Colours that differ in lightness as well as in hue."""


def support_layer(splats: Splats, support: Support, sparse_points: FloatArray, max_points: int = MAX_POINTS) -> Layer:
    """Return the N Gaussians by their support, those of the background (beyond the sparse points
    (P,3)) apart; the loosest are drawn last, so that they lie on top."""
    loose = unconstrained(splats, support, sparse_points)
    background = ~support.constrained() & ~loose
    two = support.constrained() & (support.num_views == 2)
    order = np.argsort(np.where(loose, 2, np.where(two, 1, 0)), kind="stable")
    order = order[~background[order]]
    if len(order) > max_points:
        order = order[np.sort(even_subset(splats.means[order], max_points))]
    colors = np.where(loose[:, None], LOOSE, np.where(two[:, None], TWO, MORE))[order].astype(np.uint8)
    counts = int(loose.sum()), int(two.sum()), int(len(splats) - loose.sum() - two.sum() - background.sum())
    texts = (f"fewer than 2 photographs or {MIN_PARALLAX_DEG:g}° between them: at any depth", "2 photographs", "3 photographs or more")
    entries = zip(texts, counts, (LOOSE, TWO, MORE), strict=True)
    return Layer(
        name=NAME,
        points=splats.means[order].astype(np.float64),
        point_colors=colors,
        point_size_px=point_size_px(len(order)),
        legend=tuple(LegendEntry(text=f"{count:,} Gaussians, {text}", color=color, marker="dot") for text, count, color in entries),
    )
