"""`radiant plan` with positions in, and regions for, a system whose grids are missing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from radiant_app.cli.app import app
from radiant_core.errors import BadInput

LAT_LON = [(40.700 + 0.0003 * (row // 4), -73.900 + 0.0004 * (row % 4)) for row in range(12)]


def planned(source: Path, out: Path, *arguments: str) -> Result:
    return CliRunner().invoke(app, ["plan", str(source), "--out", str(out), *arguments])


def in_degrees(folder: Path) -> Path:
    lines = [f"{lat},{lon},80,w{row}" for row, (lat, lon) in enumerate(LAT_LON)]
    (folder / "a.csv").write_text("\n".join(["latitude,longitude,altitude(m),name", *lines]))
    return folder / "a.csv"


def in_feet(folder: Path) -> Path:
    """The same places in EPSG:2263, 80 m high, by PROJ and the definition of the foot."""
    from pyproj import Transformer

    to_plane = Transformer.from_crs("EPSG:4326", "EPSG:2263", always_xy=True)
    places = [[*to_plane.transform(lon, lat), 80 * 3937 / 1200] for lat, lon in LAT_LON]
    line = {"type": "LineString", "coordinates": places, "crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::2263"}}}
    (folder / "a.geojson").write_text(json.dumps(line))
    return folder / "a.geojson"


def regions_of(folder: Path) -> dict:
    return json.loads(next(folder.glob("*.geojson")).read_text())


def test_regions_in_feet_come_with_a_warning_or_not_at_all(tmp_path: Path) -> None:
    source, out = in_degrees(tmp_path), tmp_path / "out"
    out.mkdir()
    refused = planned(source, out / "plan.json", "--crs", "EPSG:2263", "--require-grids")
    assert isinstance(refused.exception, BadInput) and "us_noaa_njhpgn.tif" in str(refused.exception)
    assert not list(out.iterdir())
    result = planned(source, out / "plan.json", "--crs", "EPSG:2263")
    assert result.exception is None
    assert "computed here to about 4 m instead of 2 m" in " ".join(result.output.split())
    regions = regions_of(out)
    assert regions["crs"]["properties"]["name"] == "urn:ogc:def:crs:EPSG::2263"
    # Heights above take-off are no third numbers, which would count from the system's datum in feet.
    points = [f for f in regions["features"] if f["properties"]["kind"] == "waypoint"]
    assert {(len(f["geometry"]["coordinates"]), *heights_of(f)) for f in points} == {(2, 80.0, "takeoff")}


def test_positions_in_feet_are_flown_in_metres(tmp_path: Path) -> None:
    source, out = in_feet(tmp_path), tmp_path / "out"
    out.mkdir()
    with_switch = planned(source, out / "plan.json", "--require-grids")
    assert isinstance(with_switch.exception, BadInput) and "a.geojson" in str(with_switch.exception)
    result = planned(source, out / "plan.json")
    assert result.exception is None and "us_noaa_njhpgn.tif" in " ".join(result.output.split())
    points = [f for f in regions_of(out)["features"] if f["properties"]["kind"] == "waypoint"]
    heights, counts_from = zip(*(heights_of(f) for f in points), strict=True)
    assert list(heights) == pytest.approx([80.0] * len(LAT_LON), abs=2e-3) and set(counts_from) == {"absolute"}


def heights_of(feature: dict) -> tuple[float, str]:
    return feature["properties"]["height_m"], feature["properties"]["height_from"]
