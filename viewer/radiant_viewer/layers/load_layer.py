"""Loads: under each edge a bar, filled by its time over the slowest. Once per plan or edit."""

from __future__ import annotations

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan
from radiant_viewer.layers.layer import Layer, LegendEntry, at_height, outline_segments
from radiant_viewer.layers.palette import INK, WHITE, category_colors
from radiant_viewer.layers.region_layer import duration_text, is_near_map

WIDTH, FLATNESS, DROP = 0.13, 0.18, 0.06
"""Width of a bar and its distance below the edge as shares of the regions' longer side; between
them its height as a share of its width."""


def load_layer(cloud_plan: CloudPlan, height: float = 0.0) -> Layer:
    """Return a white bar under every edge near the map, filled by its time over the makespan."""
    corners = np.concatenate([*cloud_plan.borders, np.zeros((0, 2))])
    edges = np.flatnonzero(is_near_map(cloud_plan)) if len(corners) else np.zeros(0, np.int64)
    side = float(np.ptp(corners, axis=0).max()) if len(corners) else 1.0
    makespan_s = cloud_plan.makespan_s
    shares = cloud_plan.edge_time_s / makespan_s if makespan_s > 0 else np.zeros(len(cloud_plan.edge_ids))
    # Smaller where many edges stand close together.
    width = WIDTH * side * min(1.0, (12 / max(len(edges), 1)) ** 0.5)
    whole = [_bar(cloud_plan.sites[index], width, 1.0, side) for index in edges]
    filled = [_bar(cloud_plan.sites[index], width, float(np.clip(shares[index], 0, 1)), side) for index in edges]
    loaded = [place for place, index in enumerate(edges) if shares[index] > 0]
    colors = category_colors(len(cloud_plan.edge_ids))[edges]
    outlines = outline_segments([at_height(bar, height) for bar in whole])
    slowest = cloud_plan.edge_ids[int(cloud_plan.edge_time_s.argmax())]
    return Layer(
        name="Edge loads",
        polygons=tuple(at_height(bar, height) for bar in (*whole, *(filled[place] for place in loaded))),
        polygon_colors=np.concatenate([np.tile(np.array(WHITE, np.uint8), (len(whole), 1)), colors[loaded]]),
        segments=outlines,
        segment_colors=np.tile(np.array(INK, np.uint8), (len(outlines), 1)),
        line_width_px=1.2,
        legend=(LegendEntry(text=f"Load: a full bar is {duration_text(makespan_s)} ({slowest})", color=WHITE, marker="area"),),
    )


def _bar(site: FloatArray, width: float, share: float, side: float) -> FloatArray:
    """Corners (4,2) of the filled share of a bar centred below a site."""
    left, top = site[0] - width / 2, site[1] - DROP * side
    right, bottom = left + share * width, top - FLATNESS * width
    return np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
