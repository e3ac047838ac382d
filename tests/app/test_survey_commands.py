"""`radiant measure` and `radiant change` on made-up runs: what is kept, exported and refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_core.errors import BadInput
from radiant_core.survey.map_grid import map_frame_of
from tests.viewer.made_up_run import made_up_town, save_run


def radiant(*arguments: object) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None:
        raise result.exception
    return result.stdout


def test_measures_are_kept_listed_exported_and_taken_out(tmp_path: Path) -> None:
    town, run = made_up_town(), tmp_path / "run"
    save_run(run, replace(town, splats=replace(town.splats, log_scales=town.splats.log_scales + 0.9)))
    ends = map_frame_of(town.scene.frame).from_world([[-30.0, 0, 1], [30, 0, 1]])
    at = " ".join(f"{east:.3f},{north:.3f}" for east, north, _ in ends)
    said = json.loads(radiant("measure", run, "--kind", "distance", "--at", at, "--resolution", 2, "--name", "=street", "--json"))
    # UTM at the equator and its zone's rim is 0.1 % longer than the ground.
    assert said["figures"]["distance on the map"]["value"] == pytest.approx(60, rel=2e-3)
    assert list(json.loads(radiant("measure", run, "--json"))["measures"]) == ["=street"]
    with pytest.raises(BadInput, match="another name"):
        radiant("measure", run, "--kind", "distance", "--at", at, "--resolution", 2, "--name", "=street")
    radiant("measure", run, "--export", tmp_path / "a.csv")
    radiant("measure", run, "--export", tmp_path / "a.geojson")
    assert "'=street" in (tmp_path / "a.csv").read_text(), "no formula for a spreadsheet"
    (line,) = json.loads((tmp_path / "a.geojson").read_text())["features"]
    assert line["geometry"]["type"] == "LineString" and abs(line["geometry"]["coordinates"][0][1]) < 1e-5
    with pytest.raises(BadInput, match="no measure named"):
        radiant("measure", run, "--remove", "other")
    radiant("measure", run, "--remove", "=street")
    assert json.loads(radiant("measure", run, "--json")) == {"measures": {}}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("measure", "RUN", "--kind", "area"), "both --kind and --at"),
        (("measure", "RUN", "--export", "a.txt"), "geojson or .csv"),
        (("change", "RUN", "RUN", "--out", "OUT"), "given twice"),
        (("change", "RUN", "NONE", "--out", "OUT"), "no folder of a run"),
        (("change", "RUN", "OTHER", "--out", "OUT", "--min-area", "-1"), "above zero"),
    ],
)
def test_what_cannot_be_is_said_in_one_sentence(tmp_path: Path, arguments: tuple[str, ...], sentence: str) -> None:
    save_run(tmp_path / "RUN", made_up_town())
    given = [str(tmp_path / word) if word in ("RUN", "NONE", "OTHER", "OUT") else word for word in arguments]
    with pytest.raises(BadInput, match=sentence):
        radiant(*given)
    assert not (tmp_path / "OUT").exists()
