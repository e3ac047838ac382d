"""`radiant join RUN --photographs`: the hamlet of nine photographs gets three more."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from rich.console import Console
from scipy.stats import rankdata
from typer.testing import CliRunner

import radiant
from radiant_app.cli.app import app
from radiant_app.commands.model.evaluate import EvaluateRequest, evaluate
from radiant_app.commands.plan import before_after
from radiant_app.commands.plan.added_photographs import AddedRequest, extend_by_photographs
from radiant_app.commands.plan.before_after import BANDS, known_before_after
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.commands.survey.parts import load_survey
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.export.geotiff import NO_DATA
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_scene
from radiant_core.train.needs import Overrides
from radiant_viewer.runs.run_view import load_run_view

NUM_OLD, NUM_STEPS = 9, 150
OVERRIDES = Overrides(long_side_px=160, num_steps=NUM_STEPS)


def quiet() -> ProgressDisplay:
    return ProgressDisplay(Console(quiet=True))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("added")
    for number, path in enumerate(sorted((sample_scenes_folder() / "hamlet" / "images").iterdir())):
        place = folder / ("old" if number < NUM_OLD else "second") / path.name
        place.parent.mkdir(exist_ok=True)
        shutil.copyfile(path, place)
    train(TrainRequest(source=folder / "old", out=folder / "run", overrides=OVERRIDES))
    return folder / "run"


@pytest.fixture(scope="module")
def extended(run: Path) -> tuple[Path, dict[str, Any]]:
    out = run.parent / "extended"
    return out, extend_by_photographs(AddedRequest(run=run, photographs=run.parent / "second", out=out), quiet())


def test_only_what_new_photographs_show_moves(run: Path, extended: tuple[Path, dict[str, Any]]) -> None:
    out, figures = extended
    before, after = load_ply(run / "scene.ply"), load_ply(out / "scene.ply")
    same = np.ones(len(before), bool)
    for name, array in before.arrays().items():
        rows = after.arrays()[name][: len(before)]
        same &= (rows.reshape(len(before), -1) == array.reshape(len(before), -1)).all(axis=1)
    assert len(after) == len(before) + figures["added"]
    assert figures["unchanged"] > 0
    # What no new photograph shows keeps its bits; what they show has moved, all but a few.
    assert figures["unchanged"] <= same.sum() < figures["unchanged"] + 0.02 * figures["moved"]
    cameras, stood = (load_scene(folder / "sfm" / "scene.safetensors").cameras for folder in (out, run))
    assert cameras.cam_from_world[:NUM_OLD].tobytes() == stood.cam_from_world.tobytes()
    assert figures["steps"] == NUM_STEPS // 3


def test_held_out_photographs_are_scored_before_and_after(extended: tuple[Path, dict[str, Any]]) -> None:
    out, _ = extended
    metrics = json.loads((out / "metrics.json").read_text())
    rows = {row["name"]: row for row in metrics["images"]}
    assert {name: row["is_new"] for name, row in rows.items()} == {
        "drone_0000.jpg": False,
        "drone_0008.jpg": False,
        "second/drone_0009.jpg": True,
    }
    gains = [row["psnr_db"] - row["before_psnr_db"] for row in rows.values()]
    assert np.mean(gains) > 0.2
    assert load_run_view(out).held_out == rows.keys()
    # By the rule alone drone_0005 would be held out, which was trained on.
    scene = radiant.load_scene(out)
    assert {scene.cameras.names[row] for row in scene.indices("held_out")} == rows.keys()
    scored = evaluate(EvaluateRequest(model=out, long_side_px=160), quiet())
    assert {row["name"] for row in scored["images"]} == rows.keys()
    page = (out / "report.html").read_text()
    assert all(name in page for name in rows)


def test_each_cell_has_what_was_known_and_what_is(extended: tuple[Path, dict[str, Any]]) -> None:
    out, figures = extended
    with tifffile.TiffFile(out / "known_change.tif") as file:
        bands = file.asarray()
    assert bands.shape[2] == len(BANDS)
    is_known = bands[..., 0] != NO_DATA
    more = bands[..., 1][is_known] - bands[..., 0][is_known]
    # Two of the three new ones are trained on.
    assert set(np.unique(more)) <= {0, 1, 2}
    assert more.max() == 2
    was, is_now = (float(part.split()[0]) for part in figures["hole_ground"].split(" → "))
    assert is_now <= was


def test_errors_are_read_at_the_same_places_of_smaller_pictures(
    run: Path, extended: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    earlier, survey = load_survey(run), load_survey(extended[0], as_trained=True)
    whole = known_before_after(survey, earlier, quiet()).after.error_db
    monkeypatch.setattr(before_after, "LONG_SIDE_PX", 160)
    smaller = known_before_after(survey, earlier, quiet()).after.error_db
    np.testing.assert_array_equal(np.isfinite(smaller), np.isfinite(whole))
    scored = np.isfinite(whole)
    assert scored.sum() > 100 and np.corrcoef(rankdata(whole[scored]), rankdata(smaller[scored]))[0, 1] > 0.9


def test_the_result_is_extended_again_and_unusable_requests_leave_nothing(
    run: Path, extended: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    out, _ = extended
    new = run.parent / "second"
    nothing = tmp_path / "nothing"
    with pytest.raises(BadInput, match="already"):
        extend_by_photographs(AddedRequest(run=out, photographs=new, out=nothing), quiet())
    with pytest.raises(BadInput, match="is no folder"):
        extend_by_photographs(AddedRequest(run=run, photographs=tmp_path / "none", out=nothing), quiet())
    bare = tmp_path / "bare"
    shutil.copytree(run, bare)
    shutil.rmtree(bare / "sfm" / "undistorted")
    with pytest.raises(BadInput, match=r"9 of the 9 photographs of .* are not at hand"):
        extend_by_photographs(AddedRequest(run=bare, photographs=new, out=nothing), quiet())
    assert not nothing.exists()
    typed = CliRunner().invoke(app, ["join", str(run), str(out), "--photographs", str(new), "--out", str(nothing)])
    assert typed.exit_code != 0
    assert isinstance(typed.exception, BadInput)
    assert "--photographs adds photographs to one run, and NEW joins models" in str(typed.exception)
