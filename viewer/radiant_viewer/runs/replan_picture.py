"""The map of a re-plan, with marks on moved and lost positions. Once per re-plan."""

from __future__ import annotations

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.plan.revision.replan import Replan
from radiant_viewer.layers.layer import Layer, LegendEntry
from radiant_viewer.layers.palette import INK, VERMILLION
from radiant_viewer.layers.region_layer import border_layer, duration_text, edge_site_layer, region_layer, strip_layer
from radiant_viewer.layers.waypoint_layer import waypoint_layer
from radiant_viewer.pictures.images import Image
from radiant_viewer.pictures.offscreen import render_map
from radiant_viewer.pictures.page import PageText
from radiant_viewer.runs.run_pictures import SIZE_WH

MAX_MARKS = 20_000


def replan_picture(positions: FloatArray, new: Replan) -> Image:
    """Return the map (H,W,3) of positions (P,3); moved ones have a ring, lost ones a square."""
    cloud, edges = new.cloud, new.edges
    layers = [
        region_layer(cloud),
        strip_layer(cloud, edges),
        border_layer(cloud),
        waypoint_layer(positions, cloud),
        _marks("Moved", positions[new.moved], VERMILLION, "Goes to another device"),
        _marks("Lost", positions[new.lost], INK, "Captured by a dead device", square=True),
        edge_site_layer(cloud),
    ]
    before = "cannot end as it is" if np.isinf(new.makespan_before_s) else f"{duration_text(new.makespan_before_s)} if nothing moves"
    subtitle = (
        f"{len(positions)} positions, {int(new.moved.sum())} move   ·   {before}, {duration_text(cloud.makespan_s)} after, "
        f"at best {duration_text(cloud.lower_bound_s)}"
    )
    return render_map([layer for layer in layers if layer is not None], SIZE_WH, PageText(title="Plan anew", subtitle=subtitle))


def _marks(name: str, points: FloatArray, color: tuple[int, int, int], text: str, *, square: bool = False) -> Layer | None:
    if not len(points):
        return None
    every = -(-len(points) // MAX_MARKS)
    thinned = points[::every]
    return Layer(
        name=name,
        points=thinned,
        point_colors=np.tile(np.array(color, np.uint8), (len(thinned), 1)),
        point_size_px=float(np.clip(120 / np.sqrt(len(thinned)), 2.0, 5.0)),
        point_rim=not square,
        square_points=square,
        legend=(LegendEntry(text=f"{text} ({len(points)})", color=color, marker="square" if square else "ring"),),
    )
