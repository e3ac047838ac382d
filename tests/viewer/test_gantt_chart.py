"""Gantt charts: bars of both kinds where they belong, many rows, and what cannot be drawn."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_viewer.charts.charts import STAGE_COLORS, TimelineSpan
from radiant_viewer.charts.gantt_chart import FOOT_PX, MAX_ROWS, PALE, ROW_PX, TOP_PX, GanttRow, gantt_picture


def span(stage: str, start_s: float, stop_s: float) -> TimelineSpan:
    return TimelineSpan(stage=stage, start_s=start_s, stop_s=stop_s)


def columns_of(picture: np.ndarray, row_px: int, color: tuple[float, ...]) -> np.ndarray:
    """Which columns of a line of pixels have the colour within two levels."""
    return np.flatnonzero((np.abs(picture[row_px].astype(int) - np.array(color)) <= 2).all(axis=1))


def test_measured_bars_lie_below_predicted_ones_and_are_as_much_longer() -> None:
    rows = [GanttRow(name="d", predicted=(span("train", 0, 10),), measured=(span("train", 0, 20),))]
    picture = gantt_picture(rows, "Both")
    assert picture.shape == (TOP_PX + ROW_PX + FOOT_PX, 1280, 3)
    full = STAGE_COLORS["train"]
    pale = tuple(PALE * channel + (1 - PALE) * 255 for channel in full)
    upper, lower = TOP_PX + round(0.31 * ROW_PX), TOP_PX + round(0.72 * ROW_PX)
    predicted, measured = columns_of(picture, upper, pale), columns_of(picture, lower, full)
    assert len(measured) / len(predicted) == pytest.approx(2.0, rel=0.03)
    assert abs(int(predicted[0]) - int(measured[0])) <= 3, "both begin at 0"
    assert not len(columns_of(picture, upper, full)[columns_of(picture, upper, full) > predicted[-1] + 3])


def test_a_plan_alone_and_idle_machines_are_drawn_and_a_fleet_is_cut_to_the_slowest() -> None:
    rows = [GanttRow(name=f"n{index}", predicted=(span("train", 0, 1 + index),)) for index in range(MAX_ROWS + 50)]
    picture = gantt_picture(rows, "Many")
    assert len(picture) == TOP_PX + ROW_PX * MAX_ROWS + FOOT_PX
    idle = gantt_picture([GanttRow(name="idle"), rows[0]], "One idle")
    assert len(idle) == TOP_PX + 2 * ROW_PX + FOOT_PX and (idle != 255).any()
    np.testing.assert_array_equal(idle, gantt_picture([GanttRow(name="idle"), rows[0]], "One idle"))


def test_nothing_to_draw_is_refused() -> None:
    with pytest.raises(BadInput, match="no Gantt chart to draw"):
        gantt_picture([], "None")
    with pytest.raises(BadInput, match="no Gantt chart to draw"):
        gantt_picture([GanttRow(name="idle")], "None")
    with pytest.raises(BadInput, match="at least 640 px"):
        gantt_picture([GanttRow(name="d", predicted=(span("train", 0, 1),))], "Narrow", width_px=100)
    with pytest.raises(BadInput, match="expected 0 ≤ start ≤ stop"):
        span("train", float("nan"), 1.0)
