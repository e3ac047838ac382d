"""How well a scene fits its survey: lines for a terminal, rows for the report. Once per run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from radiant_app.workers.sources import SURVEY
from radiant_core.errors import StoreDamaged
from radiant_core.io.run_store import read_json


def survey_of_run(run: Path) -> dict[str, Any] | None:
    """The record of a run's or scene's fit to ground control; None without one."""
    for folder in (run / "sfm", run):
        if (folder / "result.json").is_file():
            try:
                return read_json(folder / "result.json").get(SURVEY)
            except StoreDamaged:
                return None
    return None


def survey_lines(record: Mapping[str, Any]) -> list[str]:
    """A line for ground control, one for check points, one for camera positions, as there are."""
    lines = []
    for kind, name in (("control", "ground control"), ("check", "check points")):
        if (summary := record[kind]) is not None:
            east, north, up = (f"{1000 * value:.0f}" for value in summary["rms_m"])
            expected = f", expected {1000 * summary['expected_axis_m']:.0f} mm" if kind == "check" else ""
            lines.append(
                f"{name}: {summary['num_points']} points, RMS {1000 * summary['rms_axis_m']:.0f} mm per axis (east {east}, north {north}, "
                f"up {up}){expected}"
            )
    if record["num_positions"]:
        shift = ", ".join(f"{value:.3f}" for value in record["positions_shift_m"])
        apart = f"; they lie {shift} m east, north, up of the ground control's datum" if record["control"] is not None else ""
        lines.append(f"camera positions: {record['num_positions']}, RMS {1000 * record['positions_rms_m']:.0f} mm per axis{apart}")
    return lines


def survey_rows(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row per point for the report, lengths in millimetres."""
    return [
        {
            "name": point["name"],
            "kind": "check" if point["is_check"] else "control",
            "images": point["num_images"],
            "east": f"{1000 * point['residual_m'][0]:+.0f}",
            "north": f"{1000 * point['residual_m'][1]:+.0f}",
            "up": f"{1000 * point['residual_m'][2]:+.0f}",
            "sigma": " ".join(f"{1000 * value:.0f}" for value in point["expected_m"]),
            "px": f"{point['residual_px']:.2f}",
        }
        for point in record["points"]
    ]
