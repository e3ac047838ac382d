"""The charts of a report as a phone shows them: a name, a time and a bar below it per line, so that
nothing is scrolled sideways. Once per report.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from radiant_viewer.charts.charts import TimelineRow, stage_colors
from radiant_viewer.layers.region_layer import duration_text
from radiant_viewer.layers.themes import hex_color

LEAST_PERCENT = 0.6
"""A bar is at least as wide, to be seen."""


def timeline_lines(rows: Sequence[TimelineRow]) -> dict[str, Any]:
    """The lines of a timeline and the key of its colours, for the page; none without a time."""
    spans = [span for row in rows for span in row.spans]
    end_s = max((span.stop_s for span in spans), default=0.0)
    if end_s <= 0:
        return {"lines": [], "key": []}
    colors = {stage: _css(color) for stage, color in stage_colors(dict.fromkeys(span.stage for span in spans)).items()}
    lines = [
        {
            "name": row.name,
            "strong": row.strong,
            "took": duration_text(sum(span.stop_s - span.start_s for span in row.spans)),
            "bars": [
                {
                    "left": round(100 * span.start_s / end_s, 2),
                    "width": round(max(LEAST_PERCENT, 100 * (span.stop_s - span.start_s) / end_s), 2),
                    "color": colors[span.stage],
                    "stage": span.stage,
                }
                for span in row.spans
            ],
        }
        for row in rows
        if row.spans
    ]
    return {"lines": lines, "key": [{"stage": stage, "color": color} for stage, color in colors.items()], "end": duration_text(end_s)}


def _css(color: tuple[float, float, float]) -> str:
    red, green, blue = (round(255 * value) for value in color)
    return hex_color((red, green, blue))
