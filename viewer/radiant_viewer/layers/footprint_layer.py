"""Layers of footprints: their outlines, and the number of images that see each place of the ground.

overlap(x) = number of footprints that contain x, on square cells; a footprint is convex: x is
inside if left of all sides. Once per picture, O(P · cells under a footprint).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.footprints import Footprints
from radiant_core.plan.plans import CloudPlan
from radiant_viewer.layers.camera_roles import CameraRoles
from radiant_viewer.layers.layer import HeatScale, Layer, LegendEntry, at_height
from radiant_viewer.layers.palette import BLUE, WHITE, category_colors, heat_colors

MAX_OUTLINES = 2000
CELLS_A_SIDE = 72
"""Cells along the longer side of the regions."""


def footprint_layer(footprints: Footprints, roles: CameraRoles, cloud_plan: CloudPlan, height: float = 0.0) -> Layer:
    """Return the outlines of the footprints of C images in their regions' colours, clipped to the
    regions' box, thinned above 2,000; BadInput for other numbers."""
    if len(footprints) != len(roles.edge_of_camera):
        raise BadInput(f"there are {len(footprints)} footprints of {len(roles.edge_of_camera)} cameras: give one each.")
    seeing = np.flatnonzero(footprints.areas_m2 > 0)
    every = max(1, -(-len(seeing) // MAX_OUTLINES))
    rows = seeing[::every]
    corners = footprints.polygons[rows]
    sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    colors = np.concatenate([category_colors(len(roles.edge_ids)), np.array([WHITE], np.uint8)])[roles.edge_of_camera[rows]]
    box = np.concatenate([*cloud_plan.borders, np.zeros((0, 2))])
    is_visible = np.zeros(len(sides), bool)
    if len(box):
        sides, is_visible = _clip_segments(sides, box.min(axis=0), box.max(axis=0))
    text = f"Footprint of an image ({len(seeing)})" if every == 1 else f"Footprint, one of {every} of {len(seeing)}"
    blind = len(footprints) - len(seeing)
    more = (LegendEntry(text=f"Without sight of the ground: {blind}", color=WHITE, marker="line"),) if blind else ()
    return Layer(
        name="Footprints",
        segments=np.concatenate([sides, np.full((*sides.shape[:2], 1), height)], axis=2)[is_visible],
        segment_colors=np.repeat(colors, corners.shape[1], axis=0)[is_visible],
        line_width_px=1.2,
        legend=(LegendEntry(text=text, color=BLUE, marker="line"), *more),
    )


def overlap_layer(footprints: Footprints, cloud_plan: CloudPlan, unit: str, height: float = 0.0, cells_a_side: int = CELLS_A_SIDE) -> Layer:
    """Return the number of images that see each cell of the regions; unseen cells stay empty.
    Raises BadInput without regions."""
    corners = np.concatenate([*cloud_plan.borders, np.zeros((0, 2))])
    if len(corners) < 3 or not 2 <= cells_a_side <= 1000:
        raise BadInput(
            f"the overlap of {len(corners)} corners on {cells_a_side} cells a side cannot be drawn: give regions, 2 to 1000 cells."
        )
    low, spans = corners.min(axis=0), np.ptp(corners, axis=0)
    size = float(spans.max()) / cells_a_side
    counts = overlap_counts(footprints, low, size, np.maximum(1, np.ceil(spans / size - 1e-9)).astype(np.int64))
    rows, columns = np.nonzero(counts)
    most = int(counts.max(initial=0))
    places = low + size * np.stack([columns, rows], axis=1)
    square = size * np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    return Layer(
        name="Overlap",
        polygons=tuple(at_height(place + square, height) for place in places),
        polygon_colors=heat_colors(counts[rows, columns], 0, max(most, 1)),
        heat=HeatScale(label=f"Images that see the spot, cells of {size:.3g} {unit}", low=0, high=max(most, 1)),
    )


def overlap_counts(footprints: Footprints, low: FloatArray, size: float, shape_xy: NDArray[np.int64]) -> NDArray[np.int64]:
    """Count footprints over the cell centres (rows, columns) of a grid from `low` (2,) on."""
    counts = np.zeros((int(shape_xy[1]), int(shape_xy[0])), np.int64)
    for polygon in footprints.polygons[footprints.areas_m2 > 0]:
        # Relative to the grid: products of UTM coordinates would lose metres.
        local = (polygon - low) / size
        first = np.clip(np.floor(local.min(axis=0) - 0.5).astype(np.int64), 0, shape_xy)
        last = np.clip(np.ceil(local.max(axis=0) + 0.5).astype(np.int64), first, shape_xy)
        x, y = np.arange(first[0], last[0]) + 0.5, (np.arange(first[1], last[1]) + 0.5)[:, None]
        inside = np.ones((len(y), len(x)), bool)
        for here, there in zip(local, np.roll(local, -1, axis=0), strict=True):
            inside &= (there[0] - here[0]) * (y - here[1]) - (there[1] - here[1]) * (x - here[0]) >= 0
        counts[first[1] : last[1], first[0] : last[0]] += inside
    return counts


def _clip_segments(segments: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Clip segments (S,2,2) to a box; return which (S,) have a part in it (Liang, Barsky 1984)."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(low - start) / along, (high - start) / along])
    # A segment that is constant along an axis is inside for its whole length or not at all.
    level = along == 0
    inside = (start >= low) & (start <= high)
    first = np.where(level, np.where(inside, -np.inf, np.inf), ends.min(axis=0)).max(axis=1).clip(0, None)
    last = np.where(level, np.where(inside, np.inf, -np.inf), ends.max(axis=0)).min(axis=1).clip(None, 1)
    is_visible = first < last
    shares = np.where(is_visible[:, None], np.stack([first, last], axis=1), 0.0)
    return start[:, None] + shares[..., None] * along[:, None], is_visible
