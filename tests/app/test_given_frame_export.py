"""A model trained from a COLMAP project on a map is exported in the frame of the project."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial import KDTree

from radiant_app.commands.export.export import export
from radiant_app.commands.export.request import ExportRequest
from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.georef.given_frame import load_given_frame
from radiant_core.io.colmap.model import read_model
from radiant_core.io.ply import load_ply
from radiant_core.train.needs import Overrides
from tests.colmap_projects import UTM, center_of, hamlet_model, moved, write_project


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The hamlet at UTM coordinates, trained for a few steps."""
    folder = tmp_path_factory.mktemp("utm")
    write_project(folder / "project", moved(hamlet_model(), UTM))
    train(TrainRequest(source=folder / "project", out=folder / "out", overrides=Overrides(num_steps=4, long_side_px=64)))
    return folder / "out"


def written(trained: Path, out: Path) -> tuple[dict[str, object], np.ndarray]:
    """The figures of an export in the given frame, and the offset that stands beside the file."""
    figures = export(ExportRequest(model=trained, out=out, crs="given"), ProgressDisplay(Console(file=io.StringIO())))
    beside = json.loads(out.with_name(f"{out.stem}.georef.json").read_text())
    assert beside["crs"] == "given" and beside["file"] == out.name
    return figures, np.array(beside["offset"])


def test_the_cameras_of_an_export_are_those_of_the_given_model(trained: Path, tmp_path: Path) -> None:
    figures, offset = written(trained, tmp_path / "colmap")
    assert figures["crs"] == "that of the COLMAP model" and figures["offset"] == "465300, 5246300, 400 (add it to the file's coordinates)"
    exported, given = read_model(tmp_path / "colmap" / "sparse" / "0"), moved(hamlet_model(), UTM)
    for image, known in zip(exported.images, given.images, strict=True):
        # 1e-8 m: float64 at 5e6.
        assert np.allclose(center_of(image) + offset, center_of(known), rtol=0, atol=1e-8)
    assert np.allclose(np.sort(exported.points.xyz + offset, axis=0), np.sort(given.points.xyz, axis=0), rtol=0, atol=1e-8)


@pytest.mark.parametrize("ending", ["ply", "sog"])
def test_the_gaussians_of_an_export_lie_where_the_given_points_are(ending: str, trained: Path, tmp_path: Path) -> None:
    from radiant_viewer.runs.model_file import load_model

    out = tmp_path / f"model.{ending}"
    _, offset = written(trained, out)
    splats, scene = load_model(out).splats, load_ply(trained / "scene.ply")
    assert len(splats) == len(scene)
    known = moved(hamlet_model(), UTM).points.xyz
    distances_m = KDTree(splats.means.astype(np.float64)).query(known - offset)[0]
    # Training starts with a Gaussian at every point and moves it by millimetres in four steps; points
    # that held-out photographs alone see have none, and SOG keeps 16 bits of a position.
    assert np.median(distances_m) < 0.1 and np.mean(distances_m < 0.3) > 0.9
    if ending == "ply":
        given = load_given_frame(trained)
        assert given is not None
        assert np.allclose(splats.means + offset, given.given_from_scene.apply(scene.means), rtol=0, atol=1e-4)


def test_a_training_from_a_finished_scene_keeps_the_way_back(trained: Path, tmp_path: Path) -> None:
    train(TrainRequest(source=trained, out=tmp_path / "again", overrides=Overrides(num_steps=2, long_side_px=64)))
    first, again = load_given_frame(trained), load_given_frame(tmp_path / "again")
    assert first is not None and again is not None and (again.given_from_scene.translation == first.given_from_scene.translation).all()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"out": "ortho.tif", "format": "ortho"}, "--crs given is of ply, spz, sog, usd, mesh, colmap, nerfstudio files"),
        ({"out": "cameras.geojson"}, "--crs given is of ply, spz, sog, usd, mesh, colmap, nerfstudio files"),
        ({"out": "tiles", "format": "tiles"}, "--crs given is of"),
        ({"model": "scene.ply", "out": "b.ply"}, "was made from no given model: --crs given needs the folder of a run or scene"),
    ],
)
def test_where_there_is_no_given_frame_one_sentence_says_so(changed: dict[str, str], told: str, trained: Path, tmp_path: Path) -> None:
    request = ExportRequest(model=trained, out=tmp_path / "a.ply", crs="given")
    values = {**changed, "out": tmp_path / changed["out"], "model": trained / changed.get("model", "")}
    with pytest.raises(BadInput, match=told):
        export(replace(request, **values), ProgressDisplay(Console(file=io.StringIO())))
