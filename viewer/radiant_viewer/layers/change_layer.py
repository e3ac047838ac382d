"""Layers of an edit: rings around cameras that moved to another edge, marks on pinned ones, rims of
locked or dragged regions. Once per edit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_viewer.layers.layer import Layer, LegendEntry, at_height, outline_segments
from radiant_viewer.layers.palette import INK, VERMILLION, YELLOW

RING_PX = 9.0
"""Extra width of a ring over the dot of a camera."""
SELECTED_PX = 5.0
"""Extra width of a selected camera's ring: wider ones side by side would hide the map."""


def changed_layer(positions: FloatArray, changed: NDArray[np.bool_]) -> Layer:
    """Return larger dots for cameras (C,3) that moved to another edge; draw it below cameras."""
    points = positions[changed]
    legend = (LegendEntry(text=f"Changed hands since the opening ({len(points)})", color=YELLOW, marker="ring"),) if len(points) else ()
    return Layer(
        name="Changed hands",
        points=points,
        point_colors=np.tile(np.array(YELLOW, np.uint8), (len(points), 1)),
        point_size_px=_ring_px(len(positions)),
        point_rim=True,
        behind=True,
        legend=legend,
    )


def constraint_layer(positions: FloatArray, cloud_plan: CloudPlan, constraints: PlanConstraints, height: float = 0.0) -> Layer:
    """Return squares on pinned cameras (C,3), and rims just inside locked regions (dark) and
    dragged ones (vermillion)."""
    pinned = positions[sorted(constraints.pinned)] if constraints.pinned else np.zeros((0, 3))
    segments, colors, legend = [np.zeros((0, 2, 3))], [np.zeros((0, 3), np.uint8)], []
    for ids, color, text in (
        (constraints.locked, INK, "Locked region"),
        (tuple(constraints.fixed_weights_m2), VERMILLION, "Region with a dragged border"),
    ):
        rims = [cloud_plan.borders[cloud_plan.edge_ids.index(name)] for name in ids if name in cloud_plan.edge_ids]
        sides = outline_segments([at_height(_shrink(rim), height) for rim in rims if len(rim) >= 3])
        segments.append(sides)
        colors.append(np.tile(np.array(color, np.uint8), (len(sides), 1)))
        legend += [LegendEntry(text=f"{text}: {', '.join(ids)}", color=color, marker="line")] if ids else []
    if len(pinned):
        legend.append(LegendEntry(text=f"Pinned camera ({len(pinned)})", color=INK, marker="square"))
    return Layer(
        name="Constraints",
        points=pinned,
        point_colors=np.tile(np.array(INK, np.uint8), (len(pinned), 1)),
        point_size_px=4,
        square_points=True,
        segments=np.concatenate(segments),
        segment_colors=np.concatenate(colors),
        line_width_px=4.0,
        legend=tuple(legend),
    )


def selection_layer(positions: FloatArray) -> Layer:
    """Return vermillion rings about selected cameras (K,3)."""
    return Layer(
        name="Selection",
        points=positions,
        point_colors=np.tile(np.array(VERMILLION, np.uint8), (len(positions), 1)),
        point_size_px=_ring_px(len(positions)) - RING_PX + SELECTED_PX,
        point_rim=True,
        ring_points=True,
        in_front=True,
        legend=(LegendEntry(text=f"Selected ({len(positions)})", color=VERMILLION, marker="ring"),) if len(positions) else (),
    )


def _shrink(border: FloatArray) -> FloatArray:
    """Shrink a convex border (V,2) about its middle, so that neighbours' rims do not overlap."""
    middle = border.mean(axis=0)
    return middle + 0.98 * (border - middle)


def _ring_px(count: int) -> float:
    """Return the width of rings around `count` dots of `camera_layer`."""
    return float(np.clip(100 / np.sqrt(max(count, 1)), 3.0, 7.0)) + RING_PX
