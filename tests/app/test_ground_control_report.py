"""What terminal and report say of ground control: figures in millimetres, and what is not there left out."""

from __future__ import annotations

from pathlib import Path

from radiant_app.report.ground_control import positions_lines, survey_lines, survey_of_run, survey_rows
from radiant_core.io.run_store import write_json

POINT = {
    "name": "gcp-1",
    "is_check": False,
    "num_images": 7,
    "residual_m": [0.0104, -0.002, 0.03],
    "expected_m": [0.01, 0.01, 0.02],
    "residual_px": 0.314,
}
SUMMARY = {
    "num_points": 5,
    "rms_m": [0.022, 0.027, 0.032],
    "expected_m": [0.028, 0.028, 0.033],
    "rms_axis_m": 0.0275,
    "expected_axis_m": 0.0295,
}
RECORD = {
    "system": "EPSG:32632",
    "tie_sigma_px": 0.2,
    "mark_sigma_px": 0.3,
    "num_positions": 12,
    "positions_rms_m": 0.031,
    "positions_shift_m": [0.1, -0.2, 47.2],
    "control": SUMMARY,
    "check": {**SUMMARY, "num_points": 10},
    "points": [POINT, {**POINT, "name": "check-1", "is_check": True}],
}


def test_lines_say_what_was_measured_and_expected() -> None:
    control, check, positions = survey_lines(RECORD)
    assert control == "ground control: 5 points, RMS 28 mm per axis (east 22, north 27, up 32)"
    assert check == "check points: 10 points, RMS 28 mm per axis (east 22, north 27, up 32), expected 30 mm"
    assert "12, RMS 31 mm" in positions and "0.100, -0.200, 47.200 m" in positions
    alone = survey_lines({**RECORD, "control": None, "check": None})
    assert len(alone) == 1 and "datum" not in alone[0]


def test_rows_are_in_millimetres() -> None:
    first, second = survey_rows(RECORD)
    assert first == {
        "name": "gcp-1", "kind": "control", "images": "7", "east": "+10", "north": "-2", "up": "+30", "sigma": "10 10 20", "px": "0.31",
    }  # fmt: skip
    assert second["kind"] == "check"


def test_a_scene_without_a_survey_has_none(tmp_path: Path) -> None:
    assert survey_of_run(tmp_path) is None
    write_json(tmp_path / "result.json", {"images": "x", "unregistered": []})
    assert survey_of_run(tmp_path) is None
    write_json(tmp_path / "result.json", {"images": "x", "unregistered": [], "ground_control": RECORD})
    assert survey_of_run(tmp_path) == RECORD


def test_what_does_not_count_is_said_by_name() -> None:
    lost = {**POINT, "name": "gcp-2", "num_counting": 0, "counts": False, "residual_m": [0.0, 0.0, 0.0]}
    counted = {**RECORD, "control": {**SUMMARY, "num_counting": 4}, "num_positions_counting": 10, "points": [POINT, lost]}
    control, _, positions, left = survey_lines(counted)
    assert control.startswith("ground control: 4 of 5 points count, RMS 28 mm")
    assert positions.startswith("camera positions: 10 of 12 count") and left == "do not count: gcp-2 (0 of 7 marks fit, 0 mm off)"
    assert survey_rows(counted)[1]["images"] == "0 of 7, does not count"
    record = {"num_photographs": 60, "num_positions": 40, "num_counting": 39, "left_out": [{"name": "a.jpg", "away_m": 301.0}]}
    assert positions_lines(record) == ["GPS positions: 39 of 40 count (60 photographs); not: a.jpg 301 m"]
    assert positions_lines(None) == [] == positions_lines({**record, "num_positions": 0})
