"""A plan's footprints as plain values for plan.json: borders and buffer captures. Once per plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from radiant_core.plan.borders.buffers import EdgeBuffer
from radiant_core.plan.borders.forecast import BorderForecast

GROUND_KEY = "ground_m"
"""Altitude of the ground in the waypoints' own heights, where it was given."""


def content_record(forecasts: Sequence[BorderForecast], buffers: Sequence[EdgeBuffer], assumed: str) -> dict[str, Any]:
    """`forecast` (what was `assumed`, and the borders) and, where any were planned, `buffers`."""
    record: dict[str, Any] = {"forecast": {"assumed": assumed, "borders": [border_record(forecast) for forecast in forecasts]}}
    if buffers:
        record["buffers"] = [
            {
                "edge_id": buffer.edge_id,
                "device_ids": list(buffer.device_ids),
                "camera_indices": buffer.camera_indices.tolist(),
                "device_of_camera": buffer.device_of_camera.tolist(),
                "device_time_s": buffer.device_time_s.tolist(),
                "edge_time_s": buffer.edge_time_s,
                "planned_edge_time_s": buffer.planned_edge_time_s,
                "num_refused": buffer.num_refused,
            }
            for buffer in buffers
        ]
    return record


def border_record(forecast: BorderForecast) -> dict[str, Any]:
    """One border's forecast, names with their units."""
    return {
        "edges": list(forecast.edge_ids),
        "ends_m": forecast.ends.tolist(),
        "half_band_m": forecast.half_band_m,
        "num_images": list(forecast.num_images),
        "support": list(forecast.support),
        "interior_support": list(forecast.interior_support),
        "coverage": forecast.coverage,
        "forward_overlap": forecast.forward_overlap,
        "side_overlap": forecast.side_overlap,
        "risk": forecast.risk,
    }
