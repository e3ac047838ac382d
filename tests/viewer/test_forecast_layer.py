"""Forecasts, buffers, partitions and lines as pictures: what is there, where, in which colour."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.charts.line_chart import Line, Panel, line_picture
from radiant_core.errors import BadInput
from radiant_core.plan.borders.forecast import BorderForecast, Risk
from radiant_viewer.charts.partition_chart import Partition, partitions_picture
from radiant_viewer.layers.forecast_layer import RISK_COLORS, forecast_layers
from radiant_viewer.layers.palette import category_colors
from radiant_viewer.pictures.offscreen import draw_map


def forecast(x_m: float, risk: Risk) -> BorderForecast:
    return BorderForecast(
        edge_ids=("a", "b"),
        ends=np.array([[x_m, 0.0], [x_m, 10.0]]),
        half_band_m=1.0,
        num_images=(3, 4),
        support=(2.0, 3.0),
        interior_support=(4.0, 4.0),
        forward_overlap=None,
        side_overlap=0.5,
        risk=risk,
    )


def test_borders_are_drawn_where_they_run_in_the_colour_of_their_risk() -> None:
    layers = forecast_layers([forecast(0.0, "high"), forecast(20.0, "medium")])
    image = draw_map(layers, (300, 200)).image
    for color, left, right in ((RISK_COLORS["high"], 0, 150), (RISK_COLORS["medium"], 150, 300)):
        columns = np.flatnonzero((np.abs(image.astype(int) - color).max(axis=2) <= 4).any(axis=0))
        assert len(columns) and columns.min() >= left and columns.max() < right
    assert [entry.text for entry in layers[1].legend] == ["Medium risk of a seam (1 border)", "High risk of a seam (1 border)"]
    assert forecast_layers([]) == ()


def test_partitions_show_each_camera_in_its_regions_colour_and_say_who_has_none() -> None:
    positions = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 8.0], [10.0, 8.0]])
    owners = np.array([0, 1, 0, 1])
    times = np.array([10.0, 20.0])
    picture = partitions_picture(positions, [Partition(name="x", edge_of_camera=owners, edge_time_s=times)], ("a", "b"), "Title")
    for color in category_colors(2):
        assert (np.abs(picture.astype(int) - color).max(axis=2) <= 2).sum() > 50
    lost = [Partition(name="x", edge_of_camera=np.array([-1, 1, 0, 1]), edge_time_s=times)]
    assert (partitions_picture(positions, lost, ("a", "b"), "Title") != picture).any()
    with pytest.raises(BadInput, match="other cameras or edges"):
        partitions_picture(positions[:2], lost, ("a", "b"), "Title")
    with pytest.raises(BadInput, match="no partition"):
        partitions_picture(positions, [], ("a", "b"), "Title")


def test_lines_are_drawn_and_poison_is_refused() -> None:
    line = Line(name="a", x=np.arange(5.0), y=np.arange(5.0))
    picture = line_picture([Panel(lines=(line,), x_label="x", y_label="y")], "Title")
    assert (picture != 255).any(axis=2).mean() > 0.01
    with pytest.raises(BadInput, match="not finite"):
        Line(name="a", x=np.arange(2.0), y=np.array([1.0, np.nan]))
    with pytest.raises(BadInput, match="no line"):
        line_picture([], "Title")
