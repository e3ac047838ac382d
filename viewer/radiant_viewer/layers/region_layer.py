"""Layers of a plan: regions, borders, devices' strips, and edges with counts and predicted times.
Pure functions of `CloudPlan` and `EdgePlan`, once per plan or edit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_viewer.layers.layer import Label, Layer, LegendEntry, at_height, outline_segments
from radiant_viewer.layers.palette import INK, WHITE, category_colors, rgb, shade_colors, tint

FILL_TINT = 0.62
"""Share of white in a region's fill."""
MAX_FULL_LABELS = 8
"""With more edges labels are names only; the legend has the figures."""


def duration_text(seconds: float) -> str:
    """Return seconds in a readable unit: "42 s", "3.2 min", "1.5 h"."""
    if seconds < 100:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.3g} min" if seconds < 6000 else f"{seconds / 3600:.3g} h"


def region_layer(cloud_plan: CloudPlan, height: float = 0.0) -> Layer:
    """Return each edge's region in a tint of its colour, with its border."""
    edges = [index for index, border in enumerate(cloud_plan.borders) if len(border) >= 3]
    polygons = tuple(at_height(cloud_plan.borders[index], height) for index in edges)
    colors = category_colors(len(cloud_plan.edge_ids))
    sides = outline_segments(polygons)
    return Layer(
        name="Regions",
        pale_fills=True,
        polygons=polygons,
        polygon_colors=tint(colors, WHITE, FILL_TINT)[edges],
        segments=sides,
        segment_colors=np.tile(np.array(INK, np.uint8), (len(sides), 1)),
        line_width_px=2.2,
        legend=tuple(LegendEntry(text=_edge_text(cloud_plan, index), color=rgb(colors[index]), marker="area") for index in edges),
    )


def strip_layer(cloud_plan: CloudPlan, edge_plans: Sequence[EdgePlan], height: float = 0.0) -> Layer:
    """Return each device's strip in a shade of its edge's colour; devices without cameras are in
    the legend only."""
    edge_colors = category_colors(len(cloud_plan.edge_ids))
    polygons, fills, labels, legend = [], [], [], []
    for plan in (plan for plan in edge_plans if plan.device_ids):
        shades = shade_colors(edge_colors[cloud_plan.edge_ids.index(plan.edge_id)], len(plan.device_ids))
        for index, (device_id, strip) in enumerate(zip(plan.device_ids, plan.strips, strict=True)):
            legend.append(LegendEntry(text=_device_text(plan, index), color=rgb(shades[index]), marker="area"))
            if len(strip) >= 3:
                polygons.append(at_height(strip, height))
                fills.append(tint(shades[index], WHITE, FILL_TINT))
                labels.append(Label(text=device_id, position=polygons[-1].mean(axis=0)))
    sides = outline_segments(polygons)
    return Layer(
        name="Device strips",
        pale_fills=True,
        polygons=tuple(polygons),
        polygon_colors=np.array(fills, np.uint8).reshape(-1, 3),
        segments=sides,
        segment_colors=np.tile(tint(INK, WHITE, 0.35), (len(sides), 1)),
        line_width_px=1.0,
        labels=tuple(labels),
        legend=tuple(legend),
    )


def border_layer(cloud_plan: CloudPlan, height: float = 0.0) -> Layer:
    """Return the lines of the regions' borders alone, to draw over strips or points."""
    sides = outline_segments([at_height(border, height) for border in cloud_plan.borders])
    text = "Border of a region" if sum(len(border) > 0 for border in cloud_plan.borders) > 1 else "Border of the region"
    return Layer(
        name="Borders",
        segments=sides,
        segment_colors=np.tile(np.array(INK, np.uint8), (len(sides), 1)),
        line_width_px=2.6,
        in_front=True,
        legend=(LegendEntry(text=text, color=INK, marker="line"),),
    )


def edge_site_layer(cloud_plan: CloudPlan, height: float = 0.0) -> Layer:
    """Return the site of each edge with id, number of cameras and predicted time; sites far outside
    the map are only counted."""
    near = is_near_map(cloud_plan)
    sites = at_height(cloud_plan.sites, height)
    labels = [Label(text=_edge_label(cloud_plan, index), position=sites[index], strong=True) for index in np.flatnonzero(near).tolist()]
    text = "Edge" if near.all() else f"Edge ({int((~near).sum())} outside the map)"
    return Layer(
        name="Edges",
        points=sites[near],
        point_colors=np.tile(np.array(WHITE, np.uint8), (int(near.sum()), 1)),
        point_size_px=11,
        point_rim=True,
        square_points=True,
        in_front=True,
        labels=tuple(labels),
        legend=(LegendEntry(text=text, color=WHITE, marker="square"),),
    )


def is_near_map(cloud_plan: CloudPlan) -> np.ndarray:
    """Return whether each site (E,) lies within half a diagonal of the regions: one 10 km off would
    shrink the map to a dot."""
    corners: FloatArray = np.concatenate([*cloud_plan.borders, np.zeros((0, 2))])
    if not len(corners):
        return np.ones(len(cloud_plan.edge_ids), bool)
    low, high = corners.min(axis=0), corners.max(axis=0)
    reach = 0.5 * float(np.linalg.norm(high - low))
    return ((cloud_plan.sites > low - reach) & (cloud_plan.sites < high + reach)).all(axis=1)


def _edge_label(cloud_plan: CloudPlan, index: int) -> str:
    if len(cloud_plan.edge_ids) > MAX_FULL_LABELS:
        return cloud_plan.edge_ids[index]
    return f"{cloud_plan.edge_ids[index]}\n{_load_text(int(cloud_plan.counts[index]), cloud_plan.edge_time_s[index])}"


def _edge_text(cloud_plan: CloudPlan, index: int) -> str:
    return f"{cloud_plan.edge_ids[index]}: {_load_text(int(cloud_plan.counts[index]), cloud_plan.edge_time_s[index])}"


def _device_text(plan: EdgePlan, index: int) -> str:
    count = int((plan.device_of_camera == index).sum())
    return f"{plan.device_ids[index]}: {_load_text(count, plan.device_time_s[index])}"


def _load_text(count: int, seconds: float) -> str:
    return f"{count} camera{'' if count == 1 else 's'}, {duration_text(seconds)}"
