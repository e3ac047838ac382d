"""`radiant measure`, also between two dates, on made-up runs: what is kept, exported and refused."""

from __future__ import annotations

import json
import multiprocessing
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_app.commands.export import heights as export_heights
from radiant_app.commands.survey import measure
from radiant_app.commands.survey import worker as measure_worker
from radiant_app.commands.survey.parts import load_survey
from radiant_app.commands.survey.worker import Measuring
from radiant_app.report.progress import terminal_display
from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import Cleaning, PolygonStep
from radiant_core.geometry.cleaning_file import save_cleaning
from radiant_core.io.measures_file import load_measures, save_measures
from radiant_core.io.run_store import atomic_path
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
        (("measure", "RUN", "--name", "street"), "--name is of a new measure"),
        (("measure", "RUN", "--base", "3"), "--base is of a new measure"),
        (("measure", "RUN", "--resolution", "3"), "--resolution is of a new measure"),
        (("measure", "RUN", "--kind", "distance", "--at", "1,2,nan 3,4,5"), "no list of places"),
        (("measure", "RUN", "--since", "RUN", "--out", "OUT"), "given twice"),
        (("measure", "NONE", "--since", "RUN", "--out", "OUT"), "no folder of a run"),
        (("measure", "OTHER", "--since", "RUN", "--out", "OUT", "--min-area", "-1"), "above zero"),
    ],
)
def test_what_cannot_be_is_said_in_one_sentence(tmp_path: Path, arguments: tuple[str, ...], sentence: str) -> None:
    save_run(tmp_path / "RUN", made_up_town())
    given = [str(tmp_path / word) if word in ("RUN", "NONE", "OTHER", "OUT") else word for word in arguments]
    with pytest.raises(BadInput, match=sentence):
        radiant(*given)
    assert not (tmp_path / "OUT").exists()


def no_matching(*_: object) -> None:
    raise AssertionError("minutes of matching had begun")


def test_sizes_that_cannot_be_are_refused_before_anything_is_matched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = tmp_path / "run"
    save_run(run, made_up_town())
    for module in (export_heights, measure):
        monkeypatch.setattr(module, "points_of_survey", no_matching)
    for kind, name in (("dsm", "a.tif"), ("dtm", "a.tif"), ("contours", "a.geojson"), ("laz", "a.laz"), ("glb", "a.glb")):
        with pytest.raises(BadInput, match="was asked for, expected a number of at least"):
            radiant("export", run, tmp_path / name, "--format", kind, "--resolution", "0.0001")
    with pytest.raises(BadInput, match="was asked for, expected a number of at least"):
        radiant("measure", run, "--kind", "distance", "--at", "1,2 3,4", "--resolution", "0.0001")
    for kind, at, base, sentence in (
        ("height", "1,2", None, "height takes two"),
        ("area", "1,2 3,4", None, "area takes three"),
        ("volume", "1,2 3,4 5,0", "nan", "a base of nan"),
        ("distance", "1,2 3,4", "5", "a base of 5"),
    ):
        with pytest.raises(BadInput, match=sentence):
            radiant("measure", run, "--kind", kind, "--at", at, *([] if base is None else ["--base", base]))
    asked = {"measure": "height", "points": [[1, 2, None]], "eyes": [[0, 0, 9]]}
    assert "height takes two" in Measuring(run, terminal_display()).answer(asked)["error"]
    with pytest.raises(BadInput, match="larger cells"):
        radiant("export", run, tmp_path / "a.tif", "--format", "dsm", "--resolution", "0.006")


def test_a_cleaning_cuts_heights_and_the_surface_of_measures(tmp_path: Path) -> None:
    town, run = made_up_town(), tmp_path / "run"
    save_run(run, replace(town, splats=replace(town.splats, log_scales=town.splats.log_scales + 0.9)))
    survey = load_survey(run)
    whole = measure.surface_for_measures(survey, 2.0, terminal_display())
    west = PolygonStep(corners=((-150.0, -100.0), (0.0, -100.0), (0.0, 100.0), (-150.0, 100.0)))
    save_cleaning(run / "cleaning.json", Cleaning(steps=(west,)))
    # The surface that is kept is of the model before its cleaning.
    cut = measure.surface_for_measures(load_survey(run), 2.0, terminal_display())
    spots = survey.map_frame.from_world([[-40.0, 0.0, 0.5], [40.0, 0.0, 0.5]])[:, :2]
    assert np.isfinite(whole.at(spots)[0]).tolist() == [True, True]
    assert np.isfinite(cut.at(spots)[0]).tolist() == [True, False]
    assert measure.surface_for_measures(load_survey(run), 2.0, terminal_display()).heights.tobytes() == cut.heights.tobytes()


def keep_meanwhile(run: Path) -> None:
    kept = load_measures(run)
    save_measures(run, {**kept, "distance 2": kept["distance 1"]})


def test_clicks_in_the_window_are_measured_and_kept_as_by_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    town, run = made_up_town(), tmp_path / "run"
    save_run(run, replace(town, splats=replace(town.splats, log_scales=town.splats.log_scales + 0.9)))
    measuring = Measuring(run, terminal_display())
    eyes = [[-30.0, -40, 60], [30.0, -40, 60]]
    # Haze halfway: what is meant is the ground behind it, at 0.5 m.
    haze = [[-30.0, -20, 30.25], [30.0, -20, 30.25]]
    assert measuring.answer({"measure": "distance", "points": haze, "eyes": eyes, "name": "a"}) == {"name": "a"}
    # On the map the height is the surface's.
    flat = [[-30.0, 0, None], [30, 0, None]]
    assert measuring.answer({"measure": "distance", "points": flat, "eyes": eyes}) == {"name": "distance 1"}
    kept = json.loads(radiant("measure", run, "--json"))["measures"]
    for name in ("a", "distance 1"):
        figure = kept[name]["figures"]["distance on the map"]
        assert figure["value"] == pytest.approx(60, rel=3e-3) and 0 < figure["sigma"] < 1
        world = map_frame_of(town.scene.frame).to_world(kept[name]["places"])
        assert abs(world[:, 1]).max() < 1 and abs(world[:, 2] - 0.5).max() < 0.7
    said = measuring.answer({"measure": "area", "points": [*flat, [60.0, 400, None]], "eyes": [*eyes, eyes[0]]})
    assert "not known at place 3" in said["error"]
    assert "no kind" in measuring.answer({"measure": "weight", "points": flat, "eyes": eyes})["error"]
    assert "named 'a'" in measuring.answer({"measure": "distance", "points": flat, "eyes": eyes, "name": "a"})["error"]
    # Another process keeps one while this one measures.
    first_hit = measure.first_hit
    monkeypatch.setattr(measure, "first_hit", lambda *given: (keep_meanwhile(run), first_hit(*given))[1])
    assert measuring.answer({"measure": "distance", "points": haze, "eyes": eyes}) == {"name": "distance 3"}
    assert {"distance 1", "distance 2", "distance 3"} <= set(load_measures(run))
    assert measuring.answer({"export": str(tmp_path / "b.csv")}) == {"name": "b.csv"} and (tmp_path / "b.csv").is_file()
    assert "exists" in measuring.answer({"export": str(tmp_path / "b.csv")})["error"]
    assert measuring.answer({"remove": "a"}) == {"name": "a"} and "no measure" in measuring.answer({"remove": "a"})["error"]


def test_a_measure_worker_that_is_told_to_end_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    processes = multiprocessing.get_context("fork")
    begun = processes.Event()

    def write_slowly(run: Path, *_: object) -> None:
        with atomic_path(run / "heights.safetensors") as temporary:
            temporary.touch()
            begun.set()
            time.sleep(60)

    monkeypatch.setattr("radiant_app.commands.survey.worker.serve", write_slowly)
    monkeypatch.setattr("sys.argv", ["measure_worker", str(tmp_path)])
    worker = processes.Process(target=lambda: sys.exit(measure_worker.main()))
    worker.start()
    assert begun.wait(60) and any(tmp_path.iterdir())
    worker.terminate()
    worker.join(60)
    assert worker.exitcode == 0 and not any(tmp_path.iterdir())
