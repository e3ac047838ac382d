"""Waypoints: a dot at each planned photograph, in its region's colour. Once per picture."""

from __future__ import annotations

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan
from radiant_viewer.layers.layer import Layer, LegendEntry
from radiant_viewer.layers.palette import BLUE, category_colors

MAX_DOTS = 50_000
"""More dots would cover each other on a map of a million pixels."""


def waypoint_layer(positions: FloatArray, cloud_plan: CloudPlan) -> Layer:
    """Return waypoints (P,3) m of a plan as dots, thinned above 50,000, as the legend says;
    BadInput where their number is not the plan's."""
    if len(positions) != len(cloud_plan.edge_of_camera):
        raise BadInput(f"the plan is of {len(cloud_plan.edge_of_camera)} cameras, there are {len(positions)} waypoints: plan again.")
    every = -(-len(positions) // MAX_DOTS)
    thinned = slice(None, None, every)
    colors = category_colors(len(cloud_plan.edge_ids))[cloud_plan.edge_of_camera[thinned]]
    meaning = "Waypoint, in its region's colour" if every == 1 else f"One of {every} waypoints"
    return Layer(
        name="Waypoints",
        points=positions[thinned],
        point_colors=colors,
        # Dots shrink with their number, as those of cameras.
        point_size_px=float(np.clip(200 / np.sqrt(len(colors)), 2.0, 7.0)),
        point_rim=len(colors) <= 5000,
        legend=(LegendEntry(text=meaning, color=BLUE, marker="ring"),),
    )
