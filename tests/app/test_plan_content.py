"""`radiant plan` on footprints: forecasts, buffers in plan, lists and regions, flight plans that say where the camera looks."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.plan.content import ContentRequest, buffer_rule, content_request
from radiant_app.commands.plan.plan import PlanRequest, plan
from radiant_app.commands.plan.tables import plan_tables
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.frames import geodetic_from_enu
from radiant_core.io.records import load_plan_waypoints
from radiant_core.waypoints.reader import read_waypoints


def flight(folder: Path, alt_m: float = 60.0, more: str = "", cells: str = "") -> Path:
    east, north = np.meshgrid(np.linspace(-100, 100, 12), np.linspace(-80, 80, 9))
    positions = np.column_stack([east.ravel(), north.ravel(), np.zeros(108)])
    lines = [f"wp{i},{lat},{lon},{alt_m}{cells}" for i, (lat, lon, _) in enumerate(geodetic_from_enu(positions, (47.37, 8.54, 0.0)))]
    path = folder / "flight.csv"
    path.write_text("\n".join([f"name,latitude,longitude,altitude{more}", *lines]))
    return path


def made(source: Path, content: ContentRequest, compare: bool = False) -> dict[str, Any]:
    request = PlanRequest(
        source=source, out=source.parent / "plan.json", system=None, method="exact", seed=0, compare=compare, content=content
    )
    return plan(request, ProgressDisplay(Console(file=io.StringIO())))


def test_forecast_buffers_and_comparison_stand_in_plan_lists_regions_and_pictures(tmp_path: Path) -> None:
    result = made(flight(tmp_path), content_request(None, 73.7, "20%", None), compare=True)
    methods, borders, flights = plan_tables(result)
    assert "paper-literal" in methods and "edge-1 | edge-2" in borders
    assert all(f"edge-{edge}-device-{device}" in flights or f"edge-{edge}-{device}" in flights for edge in (1, 2) for device in (1, 2))
    assert "content" not in [row["method"] for row in result["methods"]], "it would be halves of equal counts"
    assert "nobody knows before capture" in result["methods_left_out"]
    record = json.loads((tmp_path / "plan.json").read_text())
    assert record["forecast"]["borders"][0]["risk"] in ("low", "medium", "high")
    buffered = sum(len(buffer["camera_indices"]) for buffer in record["buffers"])
    assert buffered > 0
    rows = [line.split(",")[-1] for path in (tmp_path / "plan_waypoints").glob("*.csv") for line in path.read_text().split()[1:]]
    assert rows.count("buffer") == buffered and rows.count("own") == 108
    kinds = [feature["properties"]["kind"] for feature in json.loads((tmp_path / "plan_regions.geojson").read_text())["features"]]
    assert kinds.count("buffer") == buffered and kinds.count("waypoint") == 108
    assert (tmp_path / "plan_methods.png").is_file() and (tmp_path / "plan.png").is_file()


def test_headings_and_pitches_are_kept_from_file_to_plan_and_lists(tmp_path: Path) -> None:
    source = flight(tmp_path, more=",heading(deg),gimbalmode,gimbalpitchangle", cells=",90,2,-45")
    result = made(source, ContentRequest())
    assert "as the flight plan says" in result["forecast"]
    kept = load_plan_waypoints(tmp_path / "plan.json")
    assert kept is not None and kept.heading_pitch_deg is not None
    np.testing.assert_array_equal(kept.heading_pitch_deg, np.tile([90.0, -45.0], (108, 1)))
    again = read_waypoints(sorted((tmp_path / "plan_waypoints").iterdir())[0]).waypoints
    assert again.heading_pitch_deg is not None
    np.testing.assert_array_equal(again.heading_pitch_deg[0], [90.0, -45.0])
    unaimed = flight(tmp_path, more=",gimbalmode,gimbalpitchangle", cells=",0,0")
    assert read_waypoints(unaimed).waypoints.heading_pitch_deg is None
    with pytest.raises(BadInput, match="looking nowhere"):
        read_waypoints(flight(tmp_path, more=",heading,pitch", cells=",0,91"))


def test_altitudes_that_cannot_be_heights_are_said_and_nothing_is_forecast(tmp_path: Path) -> None:
    assert "give the ground's altitude" in made(flight(tmp_path, 1200.0), ContentRequest())["forecast"]
    (tmp_path / "b").mkdir()
    result = made(flight(tmp_path / "b", 1200.0), ContentRequest(ground_m=1140.0))
    assert result["borders"]
    (tmp_path / "c").mkdir()
    assert "below the ground" in made(flight(tmp_path / "c", 10.0), ContentRequest(ground_m=20.0))["forecast"]
    (tmp_path / "d").mkdir()
    with pytest.raises(BadInput, match="cannot be planned"):
        made(flight(tmp_path / "d", 0.0), content_request(None, 73.7, "20%", None))
    assert [path.name for path in (tmp_path / "d").iterdir()] == ["flight.csv"]


def test_bad_options_are_refused() -> None:
    for text in ("20", "m", "-3m", "200%", "0%", "nan%"):
        with pytest.raises(BadInput, match="buffer"):
            buffer_rule(text, None)
    with pytest.raises(BadInput, match="--deadline"):
        buffer_rule(None, 3.0)
    with pytest.raises(BadInput, match="field of view"):
        content_request(None, float("nan"), None, None)
    with pytest.raises(BadInput, match="--ground"):
        content_request(float("inf"), 70.0, None, None)
