"""Photographs that stay on four devices which train one model: who is scored, what travels, who fails."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import radiant_app.report.html
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import RunResult, run
from radiant_app.config.run_config import PlanOptions, RunConfig, SfmOptions
from radiant_app.events import Event, StageDone, Warned
from radiant_app.workers.field_nodes import MADE_FROM
from radiant_core.io.records import load_splats
from radiant_viewer.runs.run_view import load_run_view
from tests.app.field_kit import TINY

DEVICES = ("edge-1-1", "edge-1-2", "edge-2-1", "edge-2-2")
SYSTEM = "".join(
    f'[[edge]]\nid = "edge-{edge}"\n' + "".join(f'[[edge.device]]\nid = "edge-{edge}-{number}"\n' for number in (1, 2)) for edge in (1, 2)
)


def config_in(folder: Path, owners: Path) -> RunConfig:
    (folder / "system.toml").write_text(SYSTEM)
    return RunConfig(
        source=owners,
        frames="known",
        sfm=SfmOptions(poses=sample_scenes_folder() / "hamlet" / "known"),
        system=folder / "system.toml",
        out=folder / "run",
        train=TINY,
        plan=PlanOptions(within_edge="together", between_edges="together"),
    )


@pytest.fixture(scope="module")
def owners(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("owners")
    for index, path in enumerate(sorted((sample_scenes_folder() / "hamlet" / "images").iterdir())):
        own = folder / DEVICES[index % 4]
        own.mkdir(exist_ok=True)
        shutil.copyfile(path, own / path.name)
    return folder


@pytest.fixture(scope="module")
def finished(owners: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[RunConfig, RunResult]:
    config = config_in(tmp_path_factory.mktemp("together"), owners)
    return config, run(config)


def test_devices_score_their_own_photographs_of_the_model_of_all(finished: tuple[RunConfig, RunResult]) -> None:
    config, result = finished
    assert result.metrics["missing"] == {} and len(result.metrics["images"]) == 2
    assert all(row["psnr_db"] > 12 and row["initial_psnr_db"] > 8 for row in result.metrics["images"])
    models = [load_splats(config.out / "devices" / name / "model.safetensors") for name in DEVICES]
    firsts = [(config.out / "devices" / name / "initial.safetensors").read_bytes() for name in DEVICES]
    assert all(np.array_equal(model.means, models[0].means) for model in models) and len(set(firsts)) == 1
    assert not list((config.out / "edges").glob("*/inbox/*")) and not list((config.out / "cloud").glob("inbox/*"))
    assert not list(config.out.glob("devices/*/photos")), "photographs are read where they are"


def test_the_inspector_shows_the_poses_that_the_root_received(finished: tuple[RunConfig, RunResult]) -> None:
    config, _ = finished
    view = load_run_view(config.out)
    assert len(view.scene.cameras) == 10 and view.splats is not None
    assert sorted(np.bincount(view.roles.device_of_camera)) == [2, 2, 3, 3]
    assert not any("drone" in name for name in view.scene.cameras.names)


def test_a_device_that_begins_anew_makes_its_group_begin_anew_with_the_same_bytes(
    finished: tuple[RunConfig, RunResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, _ = finished
    monkeypatch.setattr(radiant_app.report.html, "write_report", lambda *arguments: None)
    shutil.copytree(config.out, tmp_path / "run")
    (tmp_path / "run" / "devices" / "edge-2-1" / "done.json").unlink()
    assert (tmp_path / "run" / "devices" / "edge-1-1" / MADE_FROM).is_file(), "the others are done with their photographs"
    events: list[Event] = []
    run(replace(config, out=tmp_path / "run"), events.append, resume=True)
    done = {event.stage for event in events if isinstance(event, StageDone)}
    assert done >= {*(f"devices/{name}" for name in DEVICES), "edges/edge-1", "edges/edge-2", "cloud"}
    for name in ("scene.ply", *(f"devices/{name}/initial.safetensors" for name in DEVICES)):
        assert (config.out / name).read_bytes() == (tmp_path / "run" / name).read_bytes(), name


def test_a_device_without_a_model_is_named_and_the_others_do_not_wait_for_it(
    owners: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(radiant_app.report.html, "write_report", lambda *arguments: None)
    shutil.copytree(owners, tmp_path / "owners")
    config = config_in(tmp_path, tmp_path / "owners")
    # Only one of its photographs can be read, and two are needed.
    for path in sorted((tmp_path / "owners" / "edge-1-2").iterdir())[1:]:
        path.write_bytes(path.read_bytes()[:2000])
    warned: list[str] = []

    def listen(event: Event) -> None:
        if isinstance(event, Warned):
            warned.append(f"{event.stage}: {event.message}")

    result = run(config, listen)
    assert list(result.metrics["missing"]) == ["edge-1-2"], (result.metrics["missing"], warned)
    assert any("edges/edge-1: steps go on without edge-1-2" in message for message in warned), warned
    refused = json.loads((config.out / "edges" / "edge-1" / "refused.json").read_text())
    assert list(refused) == ["edge-1-2"]
    assert not any("Traceback" in message for message in warned)
