"""Measures of a run as lines and outlines with their first figure. Once per change."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from radiant_core.io.measures_file import places_of
from radiant_core.numerics import FloatArray
from radiant_core.survey.map_grid import MapFrame
from radiant_viewer.layers.layer import Label, Layer, outline_segments
from radiant_viewer.layers.palette import ORANGE, VERMILLION

SAVED, CLICKED = "Measures", "Measure at work"
CLOSED = ("area", "volume")


def kept_layer(measures: Mapping[str, Any], map_frame: MapFrame) -> Layer:
    """All measures of a run where they were taken, each with its name and first figure."""
    worlds = [map_frame.to_world(places_of(row)) for row in measures.values()]
    segments = [_segments(places, row["kind"] in CLOSED) for places, row in zip(worlds, measures.values(), strict=True)]
    labels = [
        Label(text=f"{name}: {_first(row)}", position=places[-1]) for (name, row), places in zip(measures.items(), worlds, strict=True)
    ]
    return _layer(
        SAVED, np.concatenate([np.zeros((0, 3)), *worlds]), np.concatenate([np.zeros((0, 2, 3)), *segments]), tuple(labels), VERMILLION
    )


def clicked_layer(points: FloatArray, *, closed: bool, name: str = CLICKED, labels: tuple[Label, ...] = ()) -> Layer:
    """The places (P,3) clicked so far; an outline, if `closed`, from three places on."""
    return _layer(name, points, _segments(points, closed and len(points) > 2), labels, ORANGE)


def _layer(name: str, points: FloatArray, segments: FloatArray, labels: tuple[Label, ...], color: tuple[int, int, int]) -> Layer:
    return Layer(
        name=name,
        points=points,
        point_colors=np.tile(np.array(color, np.uint8), (len(points), 1)),
        point_size_px=8,
        point_rim=True,
        segments=segments,
        segment_colors=np.tile(np.array(color, np.uint8), (len(segments), 1)),
        line_width_px=2.5,
        in_front=True,
        labels=labels,
    )


def _segments(points: FloatArray, closed: bool) -> FloatArray:
    sides = outline_segments([points])
    return sides if closed else sides[: max(0, len(points) - 1)]


def _first(row: Mapping[str, Any]) -> str:
    about = next(iter(row["figures"].values()), None)
    return "" if about is None else f"{about['value']:.2f} ± {about['sigma']:.2f} {about['unit']}"
