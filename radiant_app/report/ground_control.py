"""How well a scene fits its survey: lines for a terminal, rows for the report. Once per run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.workers.sources import DOUBTS, POSITIONS, SURVEY
from radiant_core.errors import StoreDamaged
from radiant_core.io.records import load_scene
from radiant_core.io.run_store import read_json

MAX_NAMED = 5


def survey_of_run(run: Path) -> dict[str, Any] | None:
    """The record of a run's or scene's fit to ground control; None without one."""
    for folder in (run / "sfm", run):
        if (folder / "result.json").is_file():
            try:
                return read_json(folder / "result.json").get(SURVEY)
            except StoreDamaged:
                return None
    return None


def placing_of_run(run: Path) -> dict[str, Any]:
    """How a run's or scene's photographs were placed, for metrics.json: the count of GPS positions,
    doubts about the frame, and photographs without a pose; empty where they lie on devices."""
    for folder in (run / "sfm", run):
        if (folder / "result.json").is_file():
            try:
                record = read_json(folder / "result.json")
            except StoreDamaged:
                return {}
            placing = {key: record[key] for key in (POSITIONS, DOUBTS) if key in record}
            placing |= _overlap_of(folder / "scene.safetensors")
            return {**placing, "num_unplaced": len(record["unregistered"])} if "unregistered" in record else placing
    return {}


def _overlap_of(path: Path) -> dict[str, float]:
    """How many photographs see a point, in the mean."""
    if not path.is_file():
        return {}
    scene = load_scene(path)
    return {"views_per_point": len(scene.observations) / len(scene.points)} if len(scene.points) else {}


def survey_lines(record: Mapping[str, Any]) -> list[str]:
    """A line for ground control, one for check points, one for camera positions, as there are."""
    lines = []
    for kind, name in (("control", "ground control"), ("check", "check points")):
        if (summary := record[kind]) is not None:
            total, counting = summary["num_points"], summary.get("num_counting", summary["num_points"])
            east, north, up = (f"{1000 * value:.0f}" for value in summary["rms_m"])
            expected = f", expected {1000 * summary['expected_axis_m']:.0f} mm" if kind == "check" else ""
            points = _counted(counting, total, "points")
            lines.append(
                f"{name}: {points}, RMS {1000 * summary['rms_axis_m']:.0f} mm per axis (east {east}, north {north}, up {up}){expected}"
            )
    if record["num_positions"]:
        shift = ", ".join(f"{value:.3f}" for value in record["positions_shift_m"])
        apart = f"; they lie {shift} m east, north, up of the ground control's datum" if record["control"] is not None else ""
        total, counting = record["num_positions"], record.get("num_positions_counting", record["num_positions"])
        counts = str(total) if counting == total else f"{counting} of {total} count"
        lines.append(f"camera positions: {counts}, RMS {1000 * record['positions_rms_m']:.0f} mm per axis{apart}")
    return [*lines, *_left_out(record)]


def positions_lines(record: Mapping[str, Any] | None) -> list[str]:
    """A line on the GPS positions that place a scene; none where no photograph has one."""
    if record is None or not record["num_positions"]:
        return []
    total, counting, photographs = record["num_positions"], record["num_counting"], record["num_photographs"]
    of = f" ({photographs} photographs)" if photographs != total else ""
    left_out = [f"{row['name']} {row['away_m']:.3g} m" for row in record["left_out"][:MAX_NAMED]] if counting else []
    more = " …" if counting and len(record["left_out"]) > MAX_NAMED else ""
    others = f"; not: {', '.join(left_out)}{more}" if left_out else ""
    return [f"GPS positions: {counting} of {total} count{of}{others}"]


def _counted(counting: int, total: int, noun: str) -> str:
    return f"{total} {noun}" if counting == total else f"{counting} of {total} {noun} count"


def _left_out(record: Mapping[str, Any]) -> list[str]:
    """A line on the points that do not count, by name."""
    rows = [point for point in record["points"] if not point.get("counts", True)]
    if not rows:
        return []
    named = []
    for row in rows[:MAX_NAMED]:
        away_mm = 1000 * float(np.linalg.norm(row["residual_m"]))
        named.append(f"{row['name']} ({row['num_counting']} of {row['num_images']} marks fit, {away_mm:,.0f} mm off)")
    return [f"do not count: {', '.join(named)}{' …' if len(rows) > MAX_NAMED else ''}"]


def _marks(point: Mapping[str, Any]) -> str:
    """How many photographs show a point, and how many of its marks count where not all do."""
    total, counting = point["num_images"], point.get("num_counting", point["num_images"])
    counts = str(total) if counting == total else f"{counting} of {total}"
    return counts if point.get("counts", True) else f"{counts}, does not count"


def survey_rows(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row per point for the report, lengths in millimetres."""
    return [
        {
            "name": point["name"],
            "kind": "check" if point["is_check"] else "control",
            "images": _marks(point),
            "east": f"{1000 * point['residual_m'][0]:+.0f}",
            "north": f"{1000 * point['residual_m'][1]:+.0f}",
            "up": f"{1000 * point['residual_m'][2]:+.0f}",
            "sigma": " ".join(f"{1000 * value:.0f}" for value in point["expected_m"]),
            "px": f"{point['residual_px']:.2f}",
        }
        for point in record["points"]
    ]
