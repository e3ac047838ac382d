"""Layers of a plan's forecast: borders by their risk, and buffer captures. Once per picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.buffers import EdgeBuffer
from radiant_core.plan.borders.forecast import BorderForecast
from radiant_core.plan.plans import CloudPlan
from radiant_viewer.layers.layer import Label, Layer, LegendEntry, at_height
from radiant_viewer.layers.palette import BLACK, VERMILLION, WHITE, YELLOW, category_colors, rgb, tint

RISK_COLORS = {"low": WHITE, "medium": YELLOW, "high": VERMILLION}
"""Colours of borders, over a dark line that sets off light ones."""
MAX_LABELS = 12
"""With more borders there are no labels."""
MAX_DOTS = 20_000


def forecast_layers(forecasts: Sequence[BorderForecast], height: float = 0.0) -> tuple[Layer, ...]:
    """Return every border as a dark line under one in the colour of its risk; empty without any."""
    if not forecasts:
        return ()
    ends = np.stack([at_height(forecast.ends, height) for forecast in forecasts])
    colors = np.array([RISK_COLORS[forecast.risk] for forecast in forecasts], np.uint8)
    dark = Layer(
        name="Forecast rims",
        segments=ends,
        segment_colors=np.tile(tint(BLACK, WHITE, 0.15), (len(ends), 1)),
        line_width_px=8,
        in_front=True,
    )
    labels = [Label(text=_label(forecast), position=side.mean(axis=0)) for forecast, side in zip(forecasts, ends, strict=True)]
    colored = Layer(
        name="Forecast",
        segments=ends,
        segment_colors=colors,
        line_width_px=5,
        in_front=True,
        labels=tuple(labels) if len(labels) <= MAX_LABELS else (),
        legend=_legend(forecasts),
    )
    return dark, colored


def buffer_layer(positions: FloatArray, cloud_plan: CloudPlan, buffers: Sequence[EdgeBuffer]) -> Layer:
    """Return the positions (P,3) that edges capture for their neighbours, larger, in the colour of
    the capturing region; thinned above 20,000. Draw it below the waypoints."""
    edges = np.concatenate([np.full(len(b.camera_indices), cloud_plan.edge_ids.index(b.edge_id)) for b in buffers]).astype(np.int64)
    cameras = np.concatenate([np.zeros(0, np.int64), *(buffer.camera_indices for buffer in buffers)])
    thinned = slice(None, None, max(1, -(-len(cameras) // MAX_DOTS)))
    colors = category_colors(len(cloud_plan.edge_ids))
    text = f"Buffer: {len(cameras)}, ring of who takes it"
    return Layer(
        name="Buffer captures",
        points=positions[cameras[thinned]],
        point_colors=colors[edges[thinned]],
        point_size_px=float(np.clip(420 / np.sqrt(max(1, len(positions))), 5.0, 14.0)),
        point_rim=True,
        legend=(LegendEntry(text=text, color=rgb(colors[edges[0]]), marker="ring"),) if len(cameras) else (),
    )


def _label(forecast: BorderForecast) -> str:
    return f"{min(forecast.support):.1f} images a spot"


def _legend(forecasts: Sequence[BorderForecast]) -> tuple[LegendEntry, ...]:
    counts = {risk: sum(forecast.risk == risk for forecast in forecasts) for risk in RISK_COLORS}
    return tuple(
        LegendEntry(
            text=f"{risk.capitalize()} risk of a seam ({count} border{'s' if count > 1 else ''})", color=RISK_COLORS[risk], marker="line"
        )
        for risk, count in counts.items()
        if count
    )
