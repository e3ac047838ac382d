"""A folder of one kind given for another is named, with what to do: by every command that wants
photographs, and by those that want a run."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from radiant_app.commands.model.evaluate import EvaluateRequest, evaluate
from radiant_app.commands.run.steps import require_run
from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.files.system_file import even_system
from radiant_app.run.captured import device_folders
from radiant_app.workers.folder_kinds import kind_of, named_folder
from radiant_app.workers.sources import detect_source
from radiant_core.errors import BadInput
from radiant_core.io.colmap.text import write_model
from tests.colmap_projects import hamlet_model, write_photographs, write_project


def touched(folder: Path, *names: str, manifest: dict[str, str] | None = None) -> Path:
    """A folder with empty files of these names, or folders where they end with /."""
    folder.mkdir()
    for name in names:
        (folder / name).mkdir() if name.endswith("/") else (folder / name).touch()
    if manifest is not None:
        (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


KINDS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "run": (
        lambda folder: touched(folder, "plan.json", "devices/", "scene.ply", "metrics.json", manifest={"status": "done"}),
        "is a finished run: `radiant inspect {0}` shows it, `radiant export {0}` writes its model; here a folder of photographs",
    ),
    "unfinished run": (
        lambda folder: touched(folder, "plan.json", "devices/", manifest={"status": "failed"}),
        "is an unfinished run: give the photographs it was made from, and --out {0} --resume to go on with it; here",
    ),
    "interrupted run": (
        lambda folder: touched(folder, "sfm/", "events.jsonl", "plan.json", manifest={"status": "interrupted"}),
        "is an unfinished run: ",
    ),
    "run with a broken manifest": (lambda folder: touched(folder, "plan.json", "manifest.json"), "is an unfinished run: "),
    "training": (lambda folder: touched(folder, "scene.ply", "metrics.json", manifest={}), "is a finished training: "),
    "scene": (
        lambda folder: touched(folder, "scene.safetensors", "result.json", "undistorted/"),
        "is the result of `radiant sfm`: `radiant train {0}` makes a model of it; here",
    ),
    "model of COLMAP, binary": (
        lambda folder: touched(folder, "cameras.bin", "images.bin", "points3D.bin", "rigs.bin"),
        "is a COLMAP model, which holds no photographs: give the folder that has it in sparse/ and the photographs in images/; here",
    ),
    "model of COLMAP, text": (lambda folder: touched(folder, "cameras.txt", "images.txt", "points3D.txt"), "is a COLMAP model, "),
    "streamed SOG": (lambda folder: touched(folder, "lod-meta.json", "0/"), "is an export of a model with levels of detail: "),
    "3D Tiles": (lambda folder: touched(folder, "tileset.json"), "is an export of a model with levels of detail: "),
    "a model": (lambda folder: touched(folder, "scene.ply"), "is a folder with a model: "),
}
COMMANDS: dict[str, Callable[[Path, Path], object]] = {
    "sfm, run, batch": lambda source, out: detect_source(source),
    "run --frames gps": lambda source, out: device_folders(source, even_system(2, 2)),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_photographs_is_named_where_photographs_are_expected(kind: str, command: str, tmp_path: Path) -> None:
    make, told = KINDS[kind]
    source = make(tmp_path / "given")
    with pytest.raises(BadInput) as refused:
        COMMANDS[command](source, tmp_path / "out")
    assert f"{source} {told.format(source)}" in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", ["model of COLMAP, text", "streamed SOG", "a model"])
def test_a_training_of_no_photographs_is_refused_alike_and_leaves_nothing(kind: str, tmp_path: Path) -> None:
    make, told = KINDS[kind]
    source = make(tmp_path / "given")
    with pytest.raises(BadInput) as refused:
        train(TrainRequest(source=source, out=tmp_path / "out"))
    assert told.format(source) in str(refused.value) and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("none", "is no folder: give a folder of photographs"),
        ("scene.ply", "is no folder but a model: give"),
        ("scene.SPZ", "is no folder but a model: give"),
        ("photo.jpg", "is no folder: give a folder of photographs, a COLMAP project or a Mill 19 folder."),
    ],
)
def test_what_is_no_folder_is_named(name: str, told: str, tmp_path: Path) -> None:
    if name != "none":
        (tmp_path / name).touch()
    with pytest.raises(BadInput) as refused:
        detect_source(tmp_path / name)
    assert str(refused.value).startswith(f"{tmp_path / name} {told}")


def test_photographs_are_read_whatever_else_lies_beside_them(tmp_path: Path) -> None:
    for place in (tmp_path / "loose", tmp_path / "project" / "images"):
        write_photographs(place, ["drone_0000.jpg"])
    for folder in (tmp_path / "loose", tmp_path / "project"):
        for name in ("manifest.json", "plan.json", "scene.ply", "cameras.txt", "images.txt"):
            (folder / name).write_text("{}")
        assert detect_source(folder)[0] == "photographs"


def test_a_command_that_wants_a_run_names_what_came(tmp_path: Path) -> None:
    photographs = write_photographs(tmp_path / "photographs", ["drone_0000.jpg", "drone_0001.jpg"])
    project = write_project(tmp_path / "project", hamlet_model())
    for folder, told in ((photographs, "2 photographs"), (project, "12 photographs")):
        with pytest.raises(BadInput, match=f"{folder}, which has {told}, holds no plan.json: give the folder of a run"):
            require_run(folder)
        with pytest.raises(BadInput, match=f"{folder}, which has {told}, holds no scene.ply: give the folder of a run that went that far"):
            evaluate(EvaluateRequest(model=folder), None)  # pyright: ignore[reportArgumentType]
    write_model(tmp_path / "model", hamlet_model())
    assert named_folder(tmp_path / "model").endswith("model, a COLMAP model, which holds no photographs,")
    assert kind_of(tmp_path) is None and named_folder(tmp_path / "none") == str(tmp_path / "none")
