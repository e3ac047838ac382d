"""What plan.json says of borders and buffers: every key with its value, as plain JSON."""

from __future__ import annotations

import json

import numpy as np

from radiant_core.io.plan_content import content_record
from radiant_core.plan.borders.buffers import EdgeBuffer
from radiant_core.plan.borders.forecast import BorderForecast

FORECAST = BorderForecast(
    edge_ids=("north", "south"),
    ends=np.array([[1.0, 2.0], [3.0, 4.5]]),
    half_band_m=7.5,
    num_images=(8, 9),
    support=(3.0, 4.0),
    interior_support=(6.0, 5.0),
    forward_overlap=0.75,
    side_overlap=None,
    risk="high",
)
BUFFER = EdgeBuffer(
    edge_id="south",
    device_ids=("s1", "s2"),
    camera_indices=np.array([5, 3]),
    device_of_camera=np.array([1, 0]),
    device_time_s=np.array([10.0, 11.0]),
    edge_time_s=20.0,
    planned_edge_time_s=18.0,
    num_refused=4,
)
BORDER = {
    "edges": ["north", "south"], "ends_m": [[1.0, 2.0], [3.0, 4.5]], "half_band_m": 7.5, "num_images": [8, 9], "support": [3.0, 4.0],
    "interior_support": [6.0, 5.0], "coverage": 0.5, "forward_overlap": 0.75, "side_overlap": None, "risk": "high",
}  # fmt: skip
TAKEN = {
    "edge_id": "south", "device_ids": ["s1", "s2"], "camera_indices": [5, 3], "device_of_camera": [1, 0], "device_time_s": [10.0, 11.0],
    "edge_time_s": 20.0, "planned_edge_time_s": 18.0, "num_refused": 4,
}  # fmt: skip


def test_every_key_stands_with_its_value_and_comes_back_from_json() -> None:
    record = content_record([FORECAST], [BUFFER], "60 m above the ground")
    assert json.loads(json.dumps(record)) == {"forecast": {"assumed": "60 m above the ground", "borders": [BORDER]}, "buffers": [TAKEN]}
    assert content_record([], [], "x") == {"forecast": {"assumed": "x", "borders": []}}


def test_a_device_finds_its_buffer() -> None:
    assert BUFFER.cameras_of("s1").tolist() == [3] and BUFFER.cameras_of("s2").tolist() == [5]
