"""One word for what lies around a scene: kept in files of the model, left out of pages and pictures, each by option."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from radiant_app.cli.app import app
from radiant_core.errors import BadInput
from radiant_core.io.ply import load_ply
from radiant_viewer.runs.run_view import load_run_view
from radiant_viewer.runs.shown_model import shown_of_run
from tests.viewer.hazy_town import haze_share, hazy
from tests.viewer.made_up_run import made_up_town, save_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("around") / "town"
    save_run(folder, hazy(made_up_town()))
    return folder


def exported(*words: str | Path) -> dict[str, int]:
    done = CliRunner().invoke(app, [*map(str, words), "--json"])
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def refused(*words: str | Path) -> str:
    done = CliRunner().invoke(app, [*map(str, words)])
    assert isinstance(done.exception, BadInput)
    return str(done.exception)


def test_files_of_the_model_keep_it_and_leave_it_out_by_option(run: Path, tmp_path: Path) -> None:
    view = load_run_view(run)
    assert view.splats is not None
    scene, whole = len(shown_of_run(view).splats), len(view.splats)
    assert scene < whole
    exported("export", run, tmp_path / "a.ply")
    assert len(load_ply(tmp_path / "a.ply")) == whole, "another program gets all of a model, unless somebody says otherwise"
    exported("export", run, tmp_path / "b.ply", "--surroundings")
    assert (tmp_path / "b.ply").read_bytes() == (tmp_path / "a.ply").read_bytes()
    said = exported("export", run, tmp_path / "c.ply", "--no-surroundings")
    assert len(load_ply(tmp_path / "c.ply")) == scene and said["left_out_around"] == whole - scene
    alone = exported("export", tmp_path / "a.ply", tmp_path / "d.ply", "--no-surroundings")
    assert len(load_ply(tmp_path / "d.ply")) == whole - alone["left_out_around"] < whole, "of a model alone where most of it lies"


def test_pages_leave_it_out_and_show_it_by_option(run: Path, tmp_path: Path) -> None:
    view = load_run_view(run)
    assert view.splats is not None
    scene, whole = len(shown_of_run(view).splats), len(view.splats)
    for number, (words, count) in enumerate([((), scene), (("--no-surroundings",), scene), (("--surroundings",), whole)]):
        said = exported("export", run, tmp_path / f"{number}.html", "--format", "viewer", *words)
        assert said["gaussians"] == count, words


def test_a_picture_leaves_it_out_and_shows_it_by_option(run: Path, tmp_path: Path) -> None:
    hazy_shares = []
    for name, words in (("a.png", ()), ("b.png", ("--surroundings",)), ("c.png", ("--uncleaned",))):
        exported("render", run, "--out", tmp_path / name, "--size", "240x160", *words)
        picture = cv2.imread(str(tmp_path / name))
        assert picture is not None
        hazy_shares.append(haze_share(np.ascontiguousarray(picture[..., ::-1])))
    assert hazy_shares[0] < 0.01 and hazy_shares[1] > 0.05 and hazy_shares[1] == hazy_shares[2]


def test_what_has_no_gaussians_has_none_around_it(run: Path, tmp_path: Path) -> None:
    said = refused("export", run, tmp_path / "plan.geojson", "--no-surroundings")
    assert "--surroundings is of a model's Gaussians, and geojson has none" in said and not (tmp_path / "plan.geojson").exists()
