"""A cleaning is made once and holds wherever the model is shown or exported."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import Cleaning, SupportStep
from radiant_core.geometry.cleaning_file import save_cleaning
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.splats import concatenate_splats
from radiant_viewer.pictures.images import load_image
from radiant_viewer.runs.model_file import load_model
from radiant_viewer.runs.run_view import file_stamps, load_run_view, run_support
from tests.viewer.made_up_run import made_up_town, save_run

QUARTER = "-130,-80 0,-80 0,0 -130,0"


def radiant(*arguments: object) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The made-up town under a floater as wide as it is, which no photograph shows."""
    town = made_up_town()
    wide = replace(town.splats.select(np.array([0])), means=np.array([[0.0, 0, 100]]), log_scales=np.full((1, 3), np.log(200)))
    save_run(tmp_path / "run", replace(town, splats=concatenate_splats([town.splats, wide])))
    return tmp_path / "run"


def cleaned(run: Path, *options: object) -> dict[str, Any]:
    return json.loads(radiant("clean", run, *options, "--json"))


def test_what_a_cleaning_leaves_out_is_in_no_file_and_no_picture(run: Path, tmp_path: Path) -> None:
    whole = load_ply(run / "scene.ply")
    (tmp_path / "keys.json").write_text('{"keyframes": [{"time_s": 0, "position": [-150, -150, 90], "target": [0, 0, 0]}]}')
    picture = ("--keyframes", tmp_path / "keys.json", "--size", "96x64")
    radiant("render", run, *picture, "--out", tmp_path / "before")
    said = cleaned(run, "--max-size", 50)
    assert said["left_out"] == 1 and said["kept"] == len(whole) - 1
    radiant("render", run, *picture, "--out", tmp_path / "after")
    radiant("render", run, *picture, "--uncleaned", "--out", tmp_path / "uncleaned")
    before, after, uncleaned = (load_image(tmp_path / name / "frame_00000.png") for name in ("before", "after", "uncleaned"))
    np.testing.assert_array_equal(before, uncleaned)
    assert (before != after).any(axis=2).mean() > 0.5, "the floater is in the whole picture"
    orbits = ("--trajectory", "orbit", "--frames", 1, "--size", "96x64")
    for name, option in (("clear", ()), ("hazy", ("--uncleaned",))):
        radiant("render", run, *orbits, *option, "--out", tmp_path / name)
    clear, hazy = (load_image(tmp_path / name / "frame_00000.png").astype(int) for name in ("clear", "hazy"))
    # The floater veils the whole orbit; around the scene alone nothing is drawn.
    assert (clear.max(axis=2) < 5).mean() > 0.2 > (hazy.max(axis=2) < 5).mean()
    for name in ("a.ply", "a.spz", "a.sog"):
        figures = json.loads(radiant("export", run, tmp_path / name, "--json"))
        assert figures["gaussians"] == len(whole) - 1 and figures["left_out_by_cleaning"] == 1
    assert json.loads(radiant("export", run, tmp_path / "b.ply", "--uncleaned", "--json"))["gaussians"] == len(whole)
    np.testing.assert_array_equal(load_ply(tmp_path / "a.ply").means, whole.means[:-1])
    np.testing.assert_array_equal(load_ply(run / "scene.ply").means, whole.means)


def test_steps_add_up_and_are_taken_back_one_by_one(run: Path) -> None:
    stamps = file_stamps(run)
    counts = [cleaned(run, *options)["left_out"] for options in (("--max-size", 50), ("--keep", QUARTER), ("--regions-margin", 5))]
    assert counts[0] == 1 < counts[1] <= counts[2]
    assert file_stamps(run) != stamps, "an open window reads it"
    inside = load_run_view(run).splats
    assert inside is not None and (inside.means[:, :2] <= 0).all()
    assert cleaned(run, "--undo")["left_out"] == counts[1] and cleaned(run, "--redo")["left_out"] == counts[2]
    assert cleaned(run, "--reset")["left_out"] == 0 and cleaned(run, "--redo")["left_out"] == 1
    remaining = cleaned(run, "--remove", QUARTER, "--heights", ",2")
    assert remaining["steps"][-1]["step"] == {
        "kind": "polygon",
        "keep": "outside",
        "high": 2.0,
        "corners": [[-130.0, -80.0], [0.0, -80.0], [0.0, 0.0], [-130.0, 0.0]],
    }
    assert "left out; kept:" in radiant("clean", run)


def test_support_is_measured_once_and_follows_what_is_kept(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_cleaning(run / "cleaning.json", Cleaning(steps=(SupportStep(),)))
    with pytest.raises(BadInput, match=r"radiant clean .* --measure"):
        load_run_view(run)
    monkeypatch.setattr("radiant_app.commands.model.clean.MEASURED_LONG_SIDE_PX", 96)
    said = cleaned(run, "--measure")
    assert 1 <= said["left_out"] < 9000
    view = load_run_view(run)
    assert view.splats is not None and len(view.splats) == said["kept"]
    support = run_support(view)
    assert support is not None and len(support) == len(view.splats) and support.constrained().mean() > 0.9


def test_a_polygon_in_degrees_is_the_same_ground(run: Path, tmp_path: Path) -> None:
    ring = [[-0.0005, -0.0003], [0.0005, -0.0003], [0.0005, 0.0003], [-0.0005, 0.0003], [-0.0005, -0.0003]]
    (tmp_path / "ground.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    cleaned(run, "--keep", tmp_path / "ground.geojson")
    kept = load_model(run).splats
    # 0.0005° of longitude on the equator are 55.66 m, 0.0003° of latitude 33.17 m.
    np.testing.assert_allclose(np.abs(kept.means[:, :2]).max(axis=0), [55.66, 33.17], atol=1.0)


def test_a_model_alone_has_its_cleaning_beside_it(run: Path, tmp_path: Path) -> None:
    save_ply(tmp_path / "alone.ply", load_ply(run / "scene.ply"))
    said = cleaned(tmp_path / "alone.ply", "--max-size", 50)
    assert said["cleaning"] == str(tmp_path / "alone.cleaning.json") and load_model(tmp_path / "alone.ply").cleaned.num_left_out == 1
    for options in (("--regions-margin", 3), ("--min-views", 2), ("--keep", "a.geojson")):
        with pytest.raises(BadInput, match=r"plan|cameras|place on earth"):
            radiant("clean", tmp_path / "alone.ply", *options)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--max-size", 1e-9), "leaves nothing"),
        (("--keep", "1,2 3,4"), "2 corners"),
        (("--keep", "1 2 3"), "no polygon"),
        (("--keep", "nowhere.geojson"), "there is no file"),
        (("--heights", "0,3"), "add --keep or --remove"),
        (("--keep", QUARTER, "--heights", "low"), "no heights"),
        (("--min-opacity", 2), "less than 1"),
        (("--max-size", "nan"), "more than 0"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(options: tuple[object, ...], sentence: str, run: Path) -> None:
    cleaned(run, "--max-size", 50)
    before = (run / "cleaning.json").read_bytes()
    with pytest.raises(BadInput, match=sentence):
        radiant("clean", run, *options)
    assert (run / "cleaning.json").read_bytes() == before
