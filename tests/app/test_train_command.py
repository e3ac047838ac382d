"""`radiant train` on the hamlet: its folder, resuming, the limits of the command line, and one sentence for what it cannot use."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.model.evaluate import EvaluateRequest, evaluate
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.steps import sfm
from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.events import Decided, Event, StageProgress, StageSkipped, Warned
from radiant_app.files.score_file import SCORES
from radiant_app.quantities import bytes_of, seconds_of
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.dealing import deal_files
from radiant_app.workers.nodes import run_node
from radiant_core.cameras import concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.hierarchy import device
from radiant_core.hierarchy.codec import save_task
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.text import write_model
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_scene, save_scene
from radiant_core.io.run_store import read_json, write_json
from radiant_core.sfm.config import SfmConfig
from radiant_core.train.checkpoint import CheckpointFolder
from radiant_core.train.config import train_preset
from radiant_core.train.few import TOPIC
from radiant_core.train.needs import Overrides
from radiant_core.train.results import TrainResult, TrainState

QUICK = Overrides(num_steps=40, long_side_px=96)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of `radiant sfm` on the hamlet's known cameras."""
    folder = tmp_path_factory.mktemp("hamlet")
    (folder / "images").symlink_to(sample_scenes_folder() / "hamlet" / "images")
    (folder / "sparse").symlink_to(sample_scenes_folder() / "hamlet" / "known")
    sfm(folder, folder / "scene", SfmConfig(), ProgressDisplay(Console(quiet=True)))
    return folder / "scene"


@pytest.fixture(scope="module")
def finished(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[TrainRequest, dict, list[Event]]:
    request = TrainRequest(source=scene, out=tmp_path_factory.mktemp("out") / "trained", overrides=QUICK)
    events: list[Event] = []
    return request, train(request, events.append), events


def interrupted(work: Callable[[], object], folder: Path) -> None:
    """Do some work and press Ctrl-C after step 20 of its training; the checkpoints of the steps 19 and 20 are in `folder`."""
    offer = CheckpointFolder.offer

    def save_and_stop(self: CheckpointFolder, step: int, state: Callable[[], TrainState]) -> None:
        self._due_s = 0.0
        offer(self, step, state)
        if step == 20:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(CheckpointFolder, "offer", save_and_stop)
        with pytest.raises(KeyboardInterrupt):
            work()
    assert len(list(folder.glob("checkpoints/*.json"))) == 2


def test_the_folder_holds_model_figures_pictures_and_what_was_decided(
    finished: tuple[TrainRequest, dict, list[Event]], scene: Path
) -> None:
    request, metrics, events = finished
    assert read_json(request.out / "metrics.json") == metrics
    assert len(load_ply(request.out / "scene.ply")) == metrics["num_gaussians"]
    names = load_scene(scene / "scene.safetensors").cameras.names
    held_out = sorted(name for name, held in zip(names, held_out_mask(names), strict=True) if held)
    assert sorted(image["name"] for image in metrics["images"]) == held_out
    for image in metrics["images"]:
        assert image["psnr_db"] > image["initial_psnr_db"] and np.isfinite([image["ssim"], image["flip"]]).all()
    for kind in ("photographs", "renders", "differences"):
        assert sorted(path.stem for path in (request.out / "pictures" / kind).iterdir()) == held_out
    manifest = read_json(request.out / "manifest.json")
    assert manifest["status"] == "done" and manifest["config"]["overrides"]["num_steps"] == QUICK.num_steps
    assert {d["topic"] for d in manifest["decisions"]} >= {"num_steps", "long_side_px", "sky", "fill-in points"}
    assert (
        {"train", "evaluation"} <= manifest["stages"].keys() and metrics["peak_bytes"]["train"] > 10**8 and metrics["cpu_s"]["train"] > 0.1
    )
    assert metrics["training"]["num_photographs"] == len(names) - len(held_out)
    assert any(isinstance(event, StageProgress) and event.stage == "train" for event in events)
    assert not (request.out / "checkpoints").exists()


def test_resuming_a_finished_training_trains_nothing_and_keeps_every_byte(finished: tuple[TrainRequest, dict, list[Event]]) -> None:
    request, metrics, _ = finished
    before = (request.out / "scene.ply").read_bytes()
    decisions = read_json(request.out / "manifest.json")["decisions"]
    events: list[Event] = []
    again = train(request, events.append, resume=True)
    assert StageSkipped(stage="train") in events
    assert (request.out / "scene.ply").read_bytes() == before
    assert again["images"] == metrics["images"] and again["training"] == metrics["training"]
    assert sorted(map(str, read_json(request.out / "manifest.json")["decisions"])) == sorted(map(str, decisions))


def test_a_damaged_model_is_trained_again(finished: tuple[TrainRequest, dict, list[Event]], tmp_path: Path) -> None:
    request, _, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(request.out, copy)
    damaged = bytearray((copy / "scene.ply").read_bytes())
    damaged[-3] ^= 1
    (copy / "scene.ply").write_bytes(damaged)
    train(replace(request, out=copy), resume=True)
    assert (copy / "scene.ply").read_bytes() == (request.out / "scene.ply").read_bytes()


def test_other_settings_or_a_used_folder_are_refused(finished: tuple[TrainRequest, dict, list[Event]]) -> None:
    request, _, _ = finished
    with pytest.raises(BadInput, match="not empty"):
        train(request)
    with pytest.raises(BadInput, match="begun with another --seed"):
        train(replace(request, seed=1), resume=True)


def test_after_ctrl_c_the_training_goes_on_to_the_same_bytes(finished: tuple[TrainRequest, dict, list[Event]], tmp_path: Path) -> None:
    request, _, _ = finished
    stopped = replace(request, out=tmp_path / "stopped")
    interrupted(lambda: train(stopped), stopped.out)
    assert read_json(stopped.out / "manifest.json")["status"] == "interrupted"
    train(stopped, resume=True)
    assert (stopped.out / "scene.ply").read_bytes() == (request.out / "scene.ply").read_bytes()


def doubled_project(folder: Path) -> Path:
    """The hamlet's known cameras with every photograph under a second name as well, as after reading a card in twice."""
    hamlet = sample_scenes_folder() / "hamlet"
    model = read_model(hamlet / "known")
    (folder / "images").mkdir(parents=True)
    doubles = []
    for number, image in enumerate(model.images):
        for name in (image.name, f"z_{image.name}"):
            shutil.copy(hamlet / "images" / image.name, folder / "images" / name)
        double = replace(image, image_id=1_000 + number, name=f"z_{image.name}")
        doubles.append(replace(double, points2d=np.zeros((0, 2)), point3d_ids=np.zeros(0, np.int64)))
    write_model(folder / "sparse" / "0", replace(model, images=(*model.images, *doubles)))
    return folder


def test_copies_of_held_out_photographs_are_not_trained_on(finished: tuple[TrainRequest, dict, list[Event]], tmp_path: Path) -> None:
    request, metrics, _ = finished
    events: list[Event] = []
    doubled = train(replace(request, source=doubled_project(tmp_path / "doubled"), out=tmp_path / "out"), events.append)
    assert [image["name"] for image in doubled["images"]] == [image["name"] for image in metrics["images"]]
    assert doubled["training"]["num_photographs"] == metrics["training"]["num_photographs"]
    # The same photographs, points and steps; only the order of sums differs.
    assert doubled["psnr_db"] == pytest.approx(metrics["psnr_db"], abs=0.1)
    assert any(isinstance(event, Warned) and "12 of 24 photographs are copies" in event.message for event in events)


def test_copies_are_not_scored_either(finished: tuple[TrainRequest, dict, list[Event]], tmp_path: Path) -> None:
    request, metrics, _ = finished
    project = doubled_project(tmp_path / "doubled")
    figures = evaluate(
        EvaluateRequest(model=request.out / "scene.ply", scene=project, long_side_px=64), ProgressDisplay(Console(quiet=True))
    )
    assert figures["num_images"] == len(metrics["images"]) == 2
    assert figures["copies"].startswith("12 of 24 photographs are copies")


def test_copies_that_a_scene_holds_are_not_trained_on(finished: tuple[TrainRequest, dict, list[Event]], tmp_path: Path) -> None:
    request, metrics, _ = finished
    project, folder = doubled_project(tmp_path / "doubled"), tmp_path / "scene"
    shutil.copytree(request.source, folder)
    scene = load_scene(folder / "scene.safetensors")
    cameras = concatenate_cameras([scene.cameras, replace(scene.cameras, names=tuple(f"z_{name}" for name in scene.cameras.names))])
    save_scene(folder / "scene.safetensors", replace(scene, cameras=cameras))
    write_json(folder / "result.json", {**read_json(folder / "result.json"), "images": str(project / "images")})
    doubled = train(replace(request, source=folder, out=tmp_path / "out"))
    assert [image["name"] for image in doubled["images"]] == [image["name"] for image in metrics["images"]]
    assert doubled["psnr_db"] == metrics["psnr_db"]


def test_time_ends_the_training_whatever_the_preset_says(scene: Path, tmp_path: Path) -> None:
    request = TrainRequest(source=scene, out=tmp_path / "out", overrides=Overrides(long_side_px=64), time_s=1.0)
    metrics = train(request)
    assert 0.9 < metrics["training"]["train_s"] < 5
    decisions = read_json(tmp_path / "out" / "manifest.json")["decisions"]
    assert [d["figure"] for d in decisions if d["topic"] == "budget"] == [1.0]
    assert "num_steps" not in {d["topic"] for d in decisions}


def test_a_killed_choice_among_settings_goes_on_where_it_was(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asking = replace(QUICK, settings={"cross_validate": "always"})
    request, trained = TrainRequest(source=scene, out=tmp_path / "whole", overrides=asking), []
    fit = device.fit_splats

    def count(*given: Any) -> TrainResult:
        if len(trained) == 2 and "stopped" in kinds:
            kinds.clear()
            raise KeyboardInterrupt
        trained.append(given)
        return fit(*given)

    kinds: set[str] = set()
    monkeypatch.setattr(device, "fit_splats", count)
    train(request)
    num_trainings = len(trained)
    (decision,) = (own for own in read_json(request.out / "manifest.json")["decisions"] if own["topic"] == TOPIC)
    assert f"{num_trainings - 1} trainings without them" in decision["reason"] and num_trainings >= 5
    stopped = replace(request, out=tmp_path / "stopped")
    kinds.add("stopped")
    trained.clear()
    with pytest.raises(KeyboardInterrupt):
        train(stopped)
    assert len(read_json(stopped.out / SCORES)) == 2
    train(stopped, resume=True)
    assert len(trained) == num_trainings, "no trial was taken twice"
    assert (stopped.out / "scene.ply").read_bytes() == (request.out / "scene.ply").read_bytes()
    train(stopped, resume=True)
    assert len(trained) == num_trainings
    with pytest.raises(BadInput, match=r"--time is how long one training takes, and --set train.cross_validate=always"):
        replace(request, time_s=9.0)


def test_validation_photographs_are_neither_trained_on_nor_scored(finished: tuple[TrainRequest, dict, list[Event]], tmp_path: Path) -> None:
    request, metrics, _ = finished
    validated = train(replace(request, out=tmp_path / "out", validate=True))
    assert validated["training"]["num_photographs"] < metrics["training"]["num_photographs"]
    looks = validated["training"]["validation"]
    assert validated["training"]["best_step"] == max(looks, key=lambda look: look["psnr_db"])["step"]
    assert [image["name"] for image in validated["images"]] == [image["name"] for image in metrics["images"]]


def test_memory_becomes_a_limit_of_gaussians_and_too_little_one_sentence(scene: Path, tmp_path: Path) -> None:
    events: list[Event] = []
    request = TrainRequest(source=scene, out=tmp_path / "out", overrides=QUICK, memory_bytes=64 * 10**9)
    train(request, events.append)
    (decision,) = [event.decision for event in events if isinstance(event, Decided) and event.decision.topic == "memory"]
    assert decision.figure == 64_000 and decision.forced
    with pytest.raises(BadInput, match=r"100 MB of memory leave room for 0 Gaussians.*give [\d,]+ MB"):
        train(replace(request, out=tmp_path / "small", memory_bytes=100 * 10**6))
    assert not (tmp_path / "small").exists()


def test_a_single_ply_of_photographs_says_what_it_takes(tmp_path: Path) -> None:
    photos = Path(__file__).parents[2] / "sample_scenes" / "hamlet" / "images"
    with pytest.raises(BadInput, match=r"holds no scene yet.*model\.ply.*give a folder as --out.*'radiant sfm'"):
        train(TrainRequest(source=photos, out=tmp_path / "model.ply"))
    with pytest.raises(BadInput, match="is no folder: give a folder of photographs"):
        train(TrainRequest(source=tmp_path / "nowhere", out=tmp_path / "model.ply"))
    assert not list(tmp_path.iterdir())


def test_a_single_ply_has_the_same_model_and_no_folder(finished: tuple[TrainRequest, dict, list[Event]], tmp_path: Path) -> None:
    request, metrics, _ = finished
    result = train(replace(request, out=tmp_path / "model.ply"))
    assert result["num_splats"] == metrics["num_gaussians"]
    assert (tmp_path / "model.ply").read_bytes() == (request.out / "scene.ply").read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["model.ply"]
    with pytest.raises(BadInput, match="give a folder"):
        train(replace(request, out=tmp_path / "other.ply"), resume=True)


def test_what_cannot_be_trained_on_is_told_in_one_sentence_and_leaves_nothing(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    few = tmp_path / "few"
    shutil.copytree(scene, few)
    whole = load_scene(scene / "scene.safetensors")
    save_scene(few / "scene.safetensors", whole.restricted_to(np.array([0, 1])))
    out = tmp_path / "out"
    for source, more, told in [
        (tmp_path / "none", {}, "is no folder"),
        (tmp_path / "empty", {}, "contains no photographs"),
        (few, {}, "has 2 photographs, expected at least 3"),
        (scene, {"overrides": Overrides(long_side_px=8)}, "expected 11 or more a side"),
    ]:
        with pytest.raises(BadInput, match=re.escape(told)):
            train(TrainRequest(source=source, out=out, **more))
        assert not out.exists()
    with pytest.raises(BadInput, match="--time"):
        TrainRequest(source=scene, out=out, time_s=0.0)


def test_checkpoints_of_other_photographs_are_refused(finished: tuple[TrainRequest, dict, list[Event]], tmp_path: Path) -> None:
    request, _, _ = finished
    source = tmp_path / "scene"
    shutil.copytree(request.source, source)
    photographs = tmp_path / "photographs"
    shutil.copytree(Path(read_json(source / "result.json")["images"]), photographs)
    (source / "result.json").write_text(json.dumps({"images": str(photographs), "unregistered": []}))
    stopped = replace(request, source=source, out=tmp_path / "out")
    interrupted(lambda: train(stopped), stopped.out)
    first, second = sorted(photographs.iterdir())[1:3]
    shutil.copyfile(first, second)
    with pytest.raises(BadInput, match="checkpoints of a training with other settings, photographs or software"):
        train(stopped, resume=True)
    assert list(stopped.out.glob("checkpoints/*.json")), "what was reached stays"


@pytest.mark.parametrize(("text", "seconds"), [("90", 90), ("90s", 90), ("5m", 300), (" 1.5 h ", 5400), (".5h", 1800), ("2min", 120)])
def test_times_as_people_write_them(text: str, seconds: float) -> None:
    assert seconds_of(text) == seconds


@pytest.mark.parametrize(("text", "number"), [("600MB", 6e8), ("2GB", 2e9), ("1GiB", 2**30), ("1.5gb", 1.5e9), ("4096", 4096)])
def test_memory_as_people_write_it(text: str, number: float) -> None:
    assert bytes_of(text) == number


@pytest.mark.parametrize("text", ["", "0", "-1", "5 parsecs", "nan", "inf", "1e400", "1" * 400, "0.0001", "٣", "5m5"])
def test_other_amounts_are_refused_with_examples(text: str) -> None:
    with pytest.raises(BadInput, match="such as 600MB, 2GB"):
        bytes_of(text)
    if text != "0.0001":
        with pytest.raises(BadInput, match="such as 90s, 5m"):
            seconds_of(text)


def test_warnings_of_a_damaged_checkpoint_reach_the_manifest(finished: tuple[TrainRequest, dict, list[Event]], tmp_path: Path) -> None:
    request, _, _ = finished
    stopped = replace(request, out=tmp_path / "out")
    interrupted(lambda: train(stopped), stopped.out)
    for path in stopped.out.glob("checkpoints/*.safetensors"):
        path.write_bytes(b"")
    events: list[Event] = []
    train(stopped, events.append, resume=True)
    assert any(isinstance(event, Warned) and "damaged" in event.message for event in events)
    assert any("damaged" in warning for warning in read_json(stopped.out / "manifest.json")["warnings"])
    assert (stopped.out / "scene.ply").read_bytes() == (request.out / "scene.ply").read_bytes()


def test_a_device_goes_on_inside_its_training_and_drops_checkpoints_of_another_task(scene: Path, tmp_path: Path) -> None:
    names = load_scene(scene / "scene.safetensors").cameras.names

    def device(name: str, seed: int = 0) -> Path:
        folder = tmp_path / name
        deal_files(Path(read_json(scene / "result.json")["images"]), names, folder / "photos")
        train = replace(train_preset("draft"), num_steps=40, long_side_px=96, seed=seed)
        save_task(folder, DeviceTask(train=train, backend="native", scene=load_scene(scene / "scene.safetensors")))
        return folder

    def run(folder: Path) -> list[Event]:
        events: list[Event] = []
        run_node("device", folder, "devices/d", events.append)
        return events

    whole, killed = device("whole"), device("killed")
    run(whole)
    interrupted(lambda: run(killed), killed)
    assert run(killed)
    assert (killed / "model.safetensors").read_bytes() == (whole / "model.safetensors").read_bytes()
    assert not (killed / "checkpoints").exists()
    # Dealt anew for another plan: what the first task left is of no use, and in nobody's way.
    replanned = device("replanned")
    interrupted(lambda: run(replanned), replanned)
    run(device("replanned", seed=1))
    assert (replanned / "model.safetensors").read_bytes() != (whole / "model.safetensors").read_bytes()
    assert not (replanned / "checkpoints").exists()
