"""Layers of points: the sparse points of structure from motion, and Gaussians as coloured points.

Colour of a Gaussian = 0.5 + C0 · sh0, clipped (its view-independent part). Built once per picture.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core.scene import SfmScene
from radiant_core.splats import SH_C0, Splats
from radiant_viewer.layers.detail import even_subset
from radiant_viewer.layers.layer import Layer, LegendEntry
from radiant_viewer.layers.palette import GREY

_BLOCK = 1 << 16
MAX_POINTS = 10_000_000
"""Most points kept, 60 bytes each; the legend says if some were left out. `detail.py` chooses the
drawn ones."""


def sparse_point_layer(scene: SfmScene, max_points: int = MAX_POINTS) -> Layer:
    """Return the P points of the scene in their colours. Points without observations are the
    Gaussians of a delivered model, and the layer is named so."""
    kind = "sparse points" if len(scene.observations) else "Gaussians"
    rows = None if len(scene.points) <= max_points else even_subset(scene.points, max_points)
    # Indexing with all of them would copy them.
    points, colors = (scene.points, scene.colors) if rows is None else (scene.points[rows], scene.colors[rows])
    return Layer(
        name="Sparse points" if len(scene.observations) else "Gaussians",
        points=points,
        point_colors=colors,
        point_size_px=point_size_px(len(points)),
        legend=(LegendEntry(text=_count_text(kind, len(points), len(scene.points)), color=GREY, marker="dot"),),
    )


def splat_layer(splats: Splats, min_opacity: float = 0.3, max_points: int = MAX_POINTS) -> Layer:
    """Return the centres of Gaussians of opacity ≥ `min_opacity` (0 to 1), in their colours."""
    logit = float(np.log(min_opacity / (1 - min_opacity))) if 0 < min_opacity < 1 else -np.inf
    is_opaque = splats.logit_opacities >= logit
    # Indexing with all of them would copy them.
    means, sh0 = (splats.means, splats.sh0) if is_opaque.all() else (splats.means[is_opaque], splats.sh0[is_opaque])
    if len(means) > max_points:
        rows = even_subset(means, max_points)
        means, sh0 = means[rows], sh0[rows]
    points = means.astype(np.float64)
    points.flags.writeable = False
    return Layer(
        name="Gaussians",
        points=points,
        point_colors=base_colors(sh0),
        point_size_px=point_size_px(len(points)),
        legend=(
            LegendEntry(text=_count_text("Gaussians", len(points), len(splats)), color=GREY, marker="dot"),
            LegendEntry(text=f"as points: those of opacity ≥ {min_opacity:g}", color=GREY, marker="dot"),
        ),
    )


def base_colors(sh0: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return view-independent colours (N,3) uint8 of coefficients (N,1,3), in blocks that stay in
    the cache."""
    colors = np.empty((len(sh0), 3), np.uint8)
    for start in range(0, len(sh0), _BLOCK):
        part = slice(start, start + _BLOCK)
        np.rint(255 * np.clip(0.5 + SH_C0 * sh0[part, 0], 0, 1), out=colors[part], casting="unsafe")
    colors.flags.writeable = False
    return colors


def inside_box(means: NDArray[np.float32], box: list[list[float]]) -> NDArray[np.bool_]:
    """Return whether each position (N,3) lies in the box of lower and upper corner (2,3)."""
    low, high = np.asarray(box, np.float64)
    return ((means >= low) & (means <= high)).all(axis=1)


def _count_text(noun: str, count: int, total: int) -> str:
    return f"{total:,} {noun}" if count == total else f"{count:,} of {total:,} {noun}"


def point_size_px(count: int) -> float:
    """Return the size of each of so many points, px."""
    return float(np.clip(700 / np.sqrt(max(count, 1)), 2.0, 4.5))
