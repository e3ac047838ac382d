"""Photographs that stay on their devices: who opens them, what reaches the tiers above, and what happens when a device cannot deliver."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.demo import sample_scenes_folder
from radiant_app.commands.extend import ExtendRequest, extend
from radiant_app.commands.replan import ReplanRequest, replan_files
from radiant_app.config.run_config import EvaluateOptions, RunConfig, SfmOptions, TrainOptions
from radiant_app.events import Decided, Event, Failed, StageDone, StageProgress, StageSkipped, Warned, encode
from radiant_app.executors.fork_server import SWITCH
from radiant_app.files.event_file import read_progress
from radiant_app.report.html import access_by_tier
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.captured import Captured, _locate_by_poses, _middle, _warn_of_unplaced
from radiant_app.run.pipeline import RunResult, run
from radiant_app.run.progress import Progress
from radiant_app.workers.field_nodes import _place, _place_once, run_field, run_positions
from radiant_app.workers.nodes import run_node
from radiant_app.workers.redaction import HIDDEN, NOTES_NAME, Redactor, make_redactor
from radiant_app.workers.reporting import EventReporter
from radiant_app.workers.tasks import FieldTask, PlacingTask, PositionsTask, SfmSettings
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput, StageFailed
from radiant_core.evaluate.split import held_out_mask
from radiant_core.hierarchy.joining import are_one_group
from radiant_core.io.messages import load_task, save_task
from radiant_core.io.photos.listing import photograph_positions
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_cameras, load_plan, load_scene
from radiant_core.io.run_store import read_json
from radiant_core.plan.revision.replan import FleetChange
from radiant_core.sfm.given_poses import read_given_poses
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.train.config import train_preset
from radiant_viewer.runs.run_view import load_run_view
from tests.app.alex_weights import write_alex_weights
from tests.app.canary import PHOTOGRAPH_KINDS, POSE_KINDS, SEGMENTS, Parts, add_broken, canaries_of, files_with, watermark

TINY = TrainOptions(long_side_px=96, num_steps=60, max_num_splats=1500)
ONE_EDGE = '[[edge]]\nid = "north"\n[[edge.device]]\nid = "north-1"\n[[edge.device]]\nid = "south-1"\n'
TWO_EDGES = "".join(f'[[edge]]\nid = "{edge}"\n[[edge.device]]\nid = "{edge}-1"\n' for edge in ("north", "south"))


@pytest.fixture(scope="module")
def hamlet() -> Path:
    return sample_scenes_folder() / "hamlet"


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("system") / "system.toml"
    path.write_text(TWO_EDGES)
    return path


@pytest.fixture(scope="module")
def finished(hamlet: Path, system: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[RunConfig, RunResult]:
    folder = tmp_path_factory.mktemp("field")
    shutil.copytree(hamlet / "images", folder / "photos")
    photos, known = folder / "photos", SfmOptions(poses=hamlet / "known")
    config = RunConfig(source=photos, frames="known", sfm=known, system=system, out=folder / "run", train=TINY)
    return config, run(config)


def reporter(stage: str, listen: Callable[[Event], None] = lambda event: None) -> EventReporter:
    return EventReporter(stage=stage, emit=listen)


def test_every_device_scores_its_own_and_only_numbers_go_up(finished: tuple[RunConfig, RunResult]) -> None:
    config, result = finished
    devices = {row["name"].split("/")[0] for row in result.metrics["images"]}
    assert devices <= {"north-1", "south-1"} and result.metrics["missing"] == {}
    assert len(result.metrics["images"]) == 2  # every 8th of 12
    assert result.metrics["psnr_db"] == pytest.approx(np.mean([row["psnr_db"] for row in result.metrics["images"]]))
    assert all(row["psnr_db"] > row["initial_psnr_db"] for row in result.metrics["images"])
    assert not list((config.out / "pictures").glob("**/*drone*")) and not (config.out / "pictures" / "photographs").exists()
    assert list(config.out.glob("devices/*/score/photographs/**/*.png"))


def test_the_report_states_the_leakage_with_its_figure(finished: tuple[RunConfig, RunResult]) -> None:
    _, result = finished
    page = result.report.read_text()
    for leak in result.metrics["leakage"].values():
        assert 10 < leak["psnr_db"] < 50 and 0 < leak["ssim"] < 1
        assert f"{leak['psnr_db']:.2f}" in page
    assert "What is not protected" in page and "drone_" not in page


def test_poses_go_up_under_numbers_and_the_cloud_learns_no_device(finished: tuple[RunConfig, RunResult]) -> None:
    config, _ = finished
    for path in config.out.glob("edges/*/inbox/*/cameras.safetensors"):
        assert all(name.startswith(f"{path.parent.name}/") for name in load_cameras(path).names)
    inboxes = list((config.out / "cloud" / "inbox").rglob("*"))
    content = b"".join(path.read_bytes() for path in inboxes if path.is_file()) + (config.out / "cloud" / "task.json").read_bytes()
    for secret in (b"north-1", b"south-1", b"drone_"):
        assert secret not in content


def test_the_inspector_reads_such_a_run(finished: tuple[RunConfig, RunResult]) -> None:
    config, _ = finished
    view = load_run_view(config.out)
    assert len(view.scene.cameras) == 10 and view.held_out == frozenset() and view.splats is not None
    assert sorted(np.bincount(view.roles.device_of_camera)) == sorted(view.cloud_plan.counts)


def test_a_device_that_begins_again_makes_the_same_scene(finished: tuple[RunConfig, RunResult], tmp_path: Path) -> None:
    config, _ = finished
    shutil.copytree(config.out / "devices" / "north-1", tmp_path / "north-1")
    task = load_task(FieldTask, tmp_path / "north-1").placing
    first, second = (_place_once(tmp_path / "north-1", task, "photographs", reporter("devices/north-1")).scene for _ in range(2))
    assert len(first.points) > 100 and first.points.tobytes() == second.points.tobytes()
    assert first.observations.tobytes() == second.observations.tobytes()
    (tmp_path / "north-1" / "placed" / "scene.safetensors").write_bytes(b"")
    assert len(_place_once(tmp_path / "north-1", task, "photographs", reporter("devices/north-1")).scene.points) > 100


def test_resuming_skips_everything(finished: tuple[RunConfig, RunResult]) -> None:
    config, _ = finished
    before = (config.out / "scene.ply").read_bytes()
    events: list[Event] = []
    run(config, events.append, resume=True)
    assert not any(isinstance(event, StageDone) for event in events) and any(isinstance(event, StageSkipped) for event in events)
    assert (config.out / "scene.ply").read_bytes() == before


def test_photographs_that_were_only_touched_are_not_trained_on_again(finished: tuple[RunConfig, RunResult], tmp_path: Path) -> None:
    config, _ = finished
    shutil.copytree(config.out, tmp_path / "run")
    times_ns = {path: path.stat().st_mtime_ns for path in config.source.iterdir()}
    for path in times_ns:
        path.touch()
    (config.source / "notes.txt").write_text("windy")
    events: list[Event] = []
    try:
        run(replace(config, out=tmp_path / "run"), events.append, resume=True)
    finally:
        for path, time_ns in times_ns.items():
            os.utime(path, ns=(time_ns, time_ns))
    assert {event.stage for event in events if isinstance(event, StageDone)} == {"devices/north-1", "devices/south-1"}
    assert not [event for event in events if isinstance(event, StageProgress)], "each looked and found what it knew"
    manifests = [json.loads((out / "manifest.json").read_text()) for out in (config.out, tmp_path / "run")]
    kept = [sorted((row["stage"], row["topic"]) for row in manifest["decisions"]) for manifest in manifests]
    assert kept[0] == kept[1] and (config.out / "scene.ply").read_bytes() == (tmp_path / "run" / "scene.ply").read_bytes()


def test_a_device_says_that_its_photographs_changed_before_it_begins_again(finished: tuple[RunConfig, RunResult], tmp_path: Path) -> None:
    config, _ = finished
    device = tmp_path / "north-1"
    shutil.copytree(config.out / "devices" / "north-1", device)
    shutil.copytree(config.source, tmp_path / "photos")
    task = load_task(FieldTask, device)
    name = task.placing.names[0]
    (tmp_path / "photos" / name).write_bytes(b"no photograph")
    events: list[Event] = []
    moved = replace(task, placing=replace(task.placing, source=str(tmp_path / "photos")))
    run_field(device, moved, reporter("devices/north-1", events.append))
    assert isinstance(events[0], Warned) and "its photographs changed" in events[0].message and name not in events[0].message


def test_weights_for_lpips_make_every_device_score_again_and_nothing_else(finished: tuple[RunConfig, RunResult], tmp_path: Path) -> None:
    config, first = finished
    copy = tmp_path / "copy"
    shutil.copytree(config.out, copy)
    weights = write_alex_weights(tmp_path / "alex.safetensors")
    events: list[Event] = []
    result = run(
        replace(config, out=copy, evaluate=EvaluateOptions(lpips_weights=weights, lpips_network="alex")), events.append, resume=True
    )
    assert {event.stage for event in events if isinstance(event, StageDone)} == {"devices/north-1/score", "devices/south-1/score"}
    assert result.metrics["lpips"] == pytest.approx(np.mean([row["lpips"] for row in result.metrics["images"]]))
    assert result.metrics["lpips"] > 0 and result.metrics["lpips_network"] == "alex"
    assert result.metrics["psnr_db"] == first.metrics["psnr_db"]


@pytest.fixture(scope="module")
def preload(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("needs Linux and a C compiler to trace opened files")
    library = tmp_path_factory.mktemp("preload") / "opened_files.so"
    source = Path(__file__).with_name("opened_files.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(source), "-ldl"], check=True)
    return library


@pytest.mark.parametrize(
    ("kept", "expected"),
    [([True, True, True], False), ([True, True, False], True), ([False, False, True], True), ([False, False, False], True)],
)
def test_models_that_do_not_hang_together_are_no_group(kept: list[bool], expected: bool) -> None:
    assert are_one_group([(1,), (0,), ()], kept) is expected


@pytest.mark.parametrize("frames", ["known", "gps"])
def test_no_other_process_opens_a_devices_photographs(frames: str, hamlet: Path, system: Path, preload: Path, tmp_path: Path) -> None:
    """Alone traces, from outside, every file and socket that each process of a whole run opens.

    By `known` with two edges, which pool; by `gps` with one edge of both devices, which are
    reconstructed where they are. Its processes start anew: the tracing is loaded at their start.
    """
    source = split_by_device(hamlet / "images", tmp_path / "captured")
    for photograph in source.rglob("*.jpg"):
        watermark(photograph)
    broken = {name: add_broken(source / name) for name in ("north-1", "south-1")}
    if frames == "gps":
        system = tmp_path / "one_edge.toml"
        system.write_text(ONE_EDGE)
    log = tmp_path / "opened.txt"
    command = [sys.executable, "-m", "radiant_app", "run", source, "--out", tmp_path / "run", "--frames", frames]
    poses = ["--poses", hamlet / "known"] if frames == "known" else []
    options = [*poses, "--system", system, "--steps", 20, "--long-side-px", 64, "--max-splats", 800]
    environment = {**os.environ, "LD_PRELOAD": str(preload), "OPENED_FILES": str(log), SWITCH: "0"}
    done = subprocess.run(
        [str(part) for part in (*command, *options)], env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    opened: dict[str, set[str]] = {}
    for line in log.read_text(errors="replace").splitlines():
        process, _, path = line.rpartition("\t")
        assert not ("positions/" in process and "/torch/" in path), "a device that tells its positions need not wait for torch"
        if path.endswith((".jpg", ".png")):
            opened.setdefault(path, set()).add(process)
    for device in ("north-1", "south-1"):
        # Given poses say which photographs there are; without them every file is looked at.
        photographs = [str(path) for path in (source / device).glob("*.jpg") if frames == "gps" or path not in broken[device]]
        readers = {process for path in photographs for process in opened.get(path, set())}
        assert all(path in opened for path in photographs), "the tracing saw nothing"
        own = (f"devices/{device}", f"positions/{device}")
        assert readers
        assert all("radiant_app.workers.worker" in process and any(place in process for place in own) for process in readers), readers
        # What was made of them stays with the device too.
        others = [process for path, who in opened.items() if f"devices/{device}/" in path for process in who]
        assert all(f"devices/{device}" in process for process in others), others
    assert_no_image_bytes(tmp_path / "run", source)
    assert "\tnetwork" not in log.read_text(errors="replace"), "the local executor needs no socket"
    (tmp_path / "run" / "said.txt").write_text(done.stdout + done.stderr)
    assert_no_canary_elsewhere(tmp_path / "run", source, broken)
    if frames == "gps":
        for device, paths in broken.items():
            notes = (tmp_path / "run" / "devices" / device / NOTES_NAME).read_text()
            told = (tmp_path / "run" / "manifest.json").read_text()
            assert all(path.name in notes for path in paths if not {"copied", "blurred"} & set(path.stem.split()))
            assert "files skipped, each of which is truncated" in told and "photographs have no pose and are left out." in told
    assert_models_and_little_else_were_sent(tmp_path / "run")


def assert_no_canary_elsewhere(run_folder: Path, source: Path, broken: dict[str, list[Path]]) -> None:
    """Nothing of a device's photographs is in a file of any other node or of the owner, nothing of its poses but at its edge."""
    of_owner = [path for path in run_folder.iterdir() if path.is_file() or path.name in ("evaluation", "delivered", "pictures")]
    assert {"report.html", "manifest.json", "events.jsonl", "said.txt"} <= {path.name for path in of_owner}
    nodes = [path for kind in ("devices", "positions", "edges") for path in (run_folder / kind).glob("*")]
    nodes += [path for path in (run_folder / "cloud", run_folder / "planning") if path.is_dir()]
    parts_of = Parts()
    for name in ("north-1", "south-1"):
        device = run_folder / "devices" / name
        skipped = [path.name for path in broken[name]]
        canaries = canaries_of(source / name, load_cameras(device / "cameras.safetensors"), 64, skipped)
        assert all(len(patterns) >= 6 for patterns in canaries.patterns.values())
        (own_edge,) = (path.parent.parent for path in run_folder.glob(f"edges/*/inbox/{name}"))
        elsewhere = [node for node in nodes if node.name != name and node != own_edge]
        assert len(elsewhere) >= 2 and run_folder / "cloud" in elsewhere
        # A reconstruction of the other device's own photographs is most of all bytes:
        # tests/stress/test_canaries.py searches that too.
        assert files_with(canaries, [path for node in elsewhere for path in node.iterdir() if path.name != "sfm"], parts_of) == []
        assert files_with(canaries.of(PHOTOGRAPH_KINDS), [own_edge, *of_owner], parts_of) == []
        # The search finds what is there.
        assert files_with(canaries.of(POSE_KINDS), [own_edge], parts_of)
        found = {hit.split(" in /")[0] for hit in files_with(canaries, [source / name])}
        assert found >= {"name", "EXIF", "pixels", "JPEG", *SEGMENTS}


def assert_models_and_little_else_were_sent(run_folder: Path) -> None:
    """Bytes that went up: the model, the poses or virtual cameras, and a record under 1 kB; the ledger counts just that."""
    ledger = {row["node"]: row["other_bytes"] for row in json.loads((run_folder / "manifest.json").read_text())["ledger"]}
    edges = [(f"edges/{path.name}", "devices") for path in (run_folder / "edges").iterdir()]
    for node, tier in (*edges, ("cloud", "edges")):
        inbox, records = run_folder / node / "inbox", run_folder / node / "deliveries"
        assert ledger[node] == sum(path.stat().st_size for place in (inbox, records) for path in place.rglob("*") if path.is_file())
        for sender in inbox.iterdir():
            sent = {path.name: path.stat().st_size for path in sender.iterdir()}
            assert sent.pop("model.safetensors") == (run_folder / tier / sender.name / "upload.safetensors").stat().st_size
            assert sent.pop("cameras.safetensors" if tier == "devices" else "virtual_cameras.safetensors") > 0
            sent |= {path.name: path.stat().st_size for path in (records / sender.name).iterdir()}
            assert {"delivery.json", "delivery.sig"} <= set(sent) and sum(sent.values()) <= 1000, sent


def split_by_device(images: Path, target: Path) -> Path:
    for index, path in enumerate(sorted(images.iterdir())):
        folder = target / ("north-1" if index % 2 else "south-1")
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, folder / path.name)
    return target


def assert_no_image_bytes(folder: Path, source: Path) -> None:
    """Nothing an edge, the cloud or the owner wrote is an image of a scene or holds a stretch of a photograph's bytes."""
    stretches = [photo.read_bytes()[start : start + 32] for photo in source.rglob("drone*.jpg") for start in (2000, 5000)]
    places = [folder / "edges", folder / "cloud", folder / "evaluation", folder / "delivered"]
    written = [path for place in places for path in place.rglob("*") if path.is_file()]
    written += [path for path in folder.iterdir() if path.is_file()]
    assert len(written) > 10
    for path in written:
        data = path.read_bytes()
        assert path.suffix not in (".jpg", ".png") and not data.startswith((b"\xff\xd8\xff", b"\x89PNG")), path
        assert not any(stretch in data for stretch in stretches), path


@pytest.mark.draws
def test_a_device_that_cannot_deliver_is_named_and_the_rest_goes_on(hamlet: Path, system: Path, tmp_path: Path) -> None:
    """Alone goes on, after a device failed at its work, to a scene, a report and a new plan."""
    source = split_by_device(hamlet / "images", tmp_path / "captured")
    import cv2

    for index, path in enumerate((source / "south-1").iterdir()):
        # The sky at different times: equal files would be copies of one photograph.
        cv2.imwrite(str(path), np.full((240, 320, 3), (235, 180, 120 + index), np.uint8))
    events: list[Event] = []
    # The poses lie beside the devices' folders.
    shutil.copytree(hamlet / "known", source / "sparse" / "0")
    config = RunConfig(source=source, frames="known", system=system, out=tmp_path / "run", train=TINY)
    result = run(config, events.append)
    names = [f"{path.parent.name}/{path.name}" for path in sorted(source.glob("*/*.jpg"))]
    lost = sum(name.startswith("south-1/") for name, held in zip(names, held_out_mask(names), strict=True) if held)
    assert lost == result.metrics["num_unscored"] > 0
    assert f"Scored on {len(result.metrics['images'])} of {len(result.metrics['images']) + lost} held-out" in result.report.read_text()
    assert list(result.metrics["missing"]) == ["south-1"] and "triangulated" in result.metrics["missing"]["south-1"]
    assert any(isinstance(event, Warned) and event.stage == "devices/south-1" for event in events)
    assert "south-1" in result.report.read_text() and len(load_ply(config.out / "scene.ply")) > 100
    assert (result.metrics["refined"], result.metrics["not_refined"]) == (False, {}), "one device alone is left, which knows all"
    decisions = read_json(config.out / "manifest.json")["decisions"]
    assert [one["choice"] for one in decisions if one["stage"] == "cloud/refine"] == ["the scene stays as it was joined"]
    progress = read_progress(config.out)
    ended = {stage.stage for stage in progress.stages if stage.state == "done"}
    assert set(progress.expected) <= ended and "cloud/refine" not in progress.expected, "the count of stages ends"
    new = replan_files(ReplanRequest(source=config.out, out=tmp_path / "new.json"), ProgressDisplay(Console(file=io.StringIO())))
    dealt = next(plan for plan in load_plan(config.out / "plan.json")[1] if "south-1" in plan.device_ids)
    assert f"photographs that never arrived, of south-1 ({len(dealt.cameras_of('south-1'))}): have them taken again" in new["warnings"]


def placing_in(source: Path) -> PlacingTask:
    """By GPS, of photographs in a device's own folder."""
    sfm = SfmSettings(matching="auto", seed=0, two_view_points=True)
    origin = (50.0, 8.0, 100.0)
    return PlacingTask(frames="gps", source=str(source), names=(), held_out=(), fetch=False, origin=origin, sfm=sfm, poses=None)


def test_a_device_that_fails_names_no_photograph(hamlet: Path, tmp_path: Path) -> None:
    source, folder = tmp_path / "captured", tmp_path / "devices" / "north-1"
    source.mkdir()
    folder.mkdir(parents=True)
    name = "secret [of] mine.jpg"
    (source / name).write_bytes((hamlet / "images" / "drone_0000.jpg").read_bytes()[:5000])
    placing = replace(placing_in(source), names=(name,))
    save_task(folder, FieldTask(train=train_preset("draft"), backend="native", placing=placing, changed=()))
    events: list[Event] = []
    run_node("field", folder, "devices/north-1", events.append)
    assert any("truncated" in event.message for event in events if isinstance(event, Warned))
    assert name in (folder / NOTES_NAME).read_text()
    told = [*map(encode, events), (folder / "frame.json").read_text(), (folder / "notes.json").read_text()]
    assert "truncated" in told[-2] and not any("secret" in text for text in told)


def test_whatever_a_device_says_is_without_its_names(tmp_path: Path) -> None:
    for name in ("a.jpg", "a.jpg.png", "night\n.jpg", "zoo.jpg"):
        (tmp_path / name).touch()
    names = Redactor(notes=tmp_path / NOTES_NAME, source=tmp_path, given=("gone.jpg",))
    decision = Decision(stage="devices/a.jpg", topic="a.jpg", choice="left out: a.jpg, zoo.jpg", figure=1.0, unit="px", reason="(gone.jpg)")
    hidden = names.redact_event(Decided(decision=decision))
    assert isinstance(hidden, Decided) and hidden.decision.stage == "devices/a.jpg"
    assert {hidden.decision.topic, hidden.decision.choice.removeprefix("left out: "), hidden.decision.reason[1:-1]} == {HIDDEN}
    failed = names.redact_event(
        Failed(stage="s", message=f"cannot read {tmp_path / 'a.jpg.png'} or {'night' + chr(10) + '.jpg'!r}", exit_code=2)
    )
    assert failed == Failed(stage="s", message=f"cannot read {tmp_path}/{HIDDEN} or '{HIDDEN}'", exit_code=2)
    kept = StageProgress(stage="s", done=1, total=2, note="data.jpg of 3, a.jpgx")
    assert names.redact_event(kept) == kept, "other words stay"
    assert "left out: a.jpg, zoo.jpg" in (tmp_path / NOTES_NAME).read_text()


def test_a_folder_of_all_devices_has_no_secret_names(tmp_path: Path) -> None:
    for fetch, said in ((True, "a.jpg"), (False, HIDDEN)):
        placing = replace(placing_in(tmp_path), names=("a.jpg",), fetch=fetch)
        save_task(tmp_path, FieldTask(train=train_preset("draft"), backend="native", placing=placing, changed=()))
        assert make_redactor("field", tmp_path).redact("a.jpg is truncated") == f"{said} is truncated"
    save_task(tmp_path, PositionsTask(source=str(tmp_path), cell_m=None, held_out=("a.jpg",), owned=True))
    assert make_redactor("positions", tmp_path).redact("a.jpg is truncated") == f"{HIDDEN} is truncated"
    assert make_redactor("device", tmp_path).redact("a.jpg is truncated") == "a.jpg is truncated"


def test_unplaced_photographs_of_a_devices_own_folder_are_counted() -> None:
    nowhere = np.full((3, 3), np.nan)
    nowhere[1] = 0.0
    for owners, expected in [
        (("north-1", "north-1", "south-1"), ["1 of 2 photographs of device north-1 have", "1 of 1 photographs of device south-1 have"]),
        ((None, None, None), ["2 of 3 photographs have no usable position: a.jpg, c.jpg."]),
    ]:
        heard: list[Event] = []
        captured = Captured(names=("a.jpg", "b.jpg", "c.jpg"), owners=owners, positions=nowhere, origin=None)
        _warn_of_unplaced(captured, cast(Progress, SimpleNamespace(listen=heard.append)))
        told = [event.message for event in heard if isinstance(event, Warned)]
        assert len(told) == len(expected) and all(message.startswith(start) for message, start in zip(told, expected, strict=True))
        assert owners[0] is None or ".jpg" not in " ".join(told)


def test_a_device_with_an_empty_folder_is_named_and_the_rest_goes_on(hamlet: Path, tmp_path: Path) -> None:
    """Alone runs `--frames gps` in full: planned anew, extended and resumed from devices that mapped their own photographs."""
    system = tmp_path / "system.toml"
    system.write_text(TWO_EDGES + '[[edge.device]]\nid = "south-2"\n')
    source = tmp_path / "captured"
    for index, path in enumerate(sorted((hamlet / "images").iterdir())):
        folder = source / ("north-1" if index < 6 else "south-1")
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, folder / path.name)
    (source / "south-2").mkdir()
    (source / "south-1" / "lost.jpg").symlink_to("nowhere")
    config = RunConfig(source=source, frames="gps", system=system, out=tmp_path / "run", train=TINY)
    result = run(config)
    assert "no photograph" in result.metrics["missing"]["south-2"] and "north-1" not in result.metrics["missing"]
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert any("south-2 takes no part" in warning for warning in manifest["warnings"])
    told = next(row for row in manifest["ledger"] if row["node"] == "plan")
    assert told["num_photographs"] == 0 and 0 < told["other_bytes"] < 10_000, "names and positions alone"
    # What was delivered can be planned anew and extended; nobody knows more than the plan of what
    # arrived.
    display = ProgressDisplay(Console(file=io.StringIO()))
    delivered = len(load_scene(config.out / "delivered" / "scene.safetensors").cameras)
    assert 0 < delivered <= sum(len(plan.camera_indices) for plan in load_plan(config.out / "plan.json")[1]), "some may have no pose"
    new = replan_files(
        ReplanRequest(source=config.out, out=tmp_path / "new.json", change=FleetChange(dead=frozenset(["south-1"]))), display
    )
    assert new["captured"] == delivered and new["lost"] == new["moved"] == 0, "what a dead device has delivered stays"
    extended = extend(ExtendRequest(old=config.out, new=config.out, out=tmp_path / "more.ply", num_epochs=1), display)
    assert extended["frames"] == "both runs have one origin" and extended["views"] > 0 and extended["gaussians"] > 100
    # Without a place it is not planned, so that nobody else has anything new to do.
    import cv2

    cv2.imwrite(str(source / "south-2" / "found.png"), np.full((240, 320, 3), 200, np.uint8))
    events: list[Event] = []
    again = run(config, events.append, resume=True)
    assert [event.stage for event in events if isinstance(event, StageDone)] == ["positions/south-2"]
    assert again.metrics["psnr_db"] == result.metrics["psnr_db"] and "whose place is known" in again.metrics["missing"]["south-2"]
    warnings = json.loads((tmp_path / "run" / "manifest.json").read_text())["warnings"]
    assert any("1 of 1 photographs of device south-2 have no usable position" in warning for warning in warnings)
    assert not any("takes no part" in warning or "found.png" in warning for warning in warnings), "names stay with the device"


def test_the_middle_of_a_site_on_the_180th_meridian_lies_there() -> None:
    site = np.array([[-17.0, 179.999, 5.0], [-17.0, -179.999, 5.0], [-17.001, 179.998, 9.0], [-17.001, -179.998, 1.0]])
    lat, lon, alt = _middle(site)
    assert abs(abs(lon) - 180) < 1e-3 and lat == pytest.approx(-17.0005) and alt == 5.0


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"source": "unknown"}, BadInput, "no device of the system"),
        ({"source": "twice"}, BadInput, "both have a photograph 'drone_0000.jpg'"),
        ({"poses": None}, BadInput, "no poses beside its photographs"),
        ({"frames": "gps", "poses": None, "source": "stripped"}, BadInput, "no photograph has a GPS position"),
        ({"source": "strange"}, BadInput, "and the folder 'other'"),
        ({"source": "lost"}, BadInput, r"photograph 'drone_0000.jpg' of the poses is not in"),
        ({"source": "sky"}, StageFailed, "no device delivered a model"),
    ],
)
def test_what_cannot_be_placed_is_refused(hamlet: Path, system: Path, tmp_path: Path, change: dict, error: type, said: str) -> None:
    import cv2

    make = {
        "stripped": lambda folder: [
            cv2.imwrite(str(folder / p.name), np.asarray(cv2.imread(str(p)))) for p in (hamlet / "images").iterdir()
        ],
        "unknown": lambda folder: shutil.copytree(hamlet / "images", folder / "East-9"),
        "twice": lambda folder: [shutil.copytree(hamlet / "images", folder / name) for name in ("north-1", "south-1")],
        "strange": lambda folder: [(folder / name).mkdir() for name in ("north-1", "other")],
        "lost": lambda folder: [shutil.copyfile(p, folder / p.name) for p in sorted((hamlet / "images").iterdir())[1:]],
        "sky": lambda folder: [
            cv2.imwrite(str(folder / p.name), np.full((240, 320, 3), 200 + index, np.uint8))
            for index, p in enumerate((hamlet / "images").iterdir())
        ],
    }
    settings = {"source": hamlet / "images", "poses": hamlet / "known", "frames": "known", **change}
    if isinstance(settings["source"], str):
        folder = tmp_path / settings["source"]
        folder.mkdir()
        make[settings["source"]](folder)
        settings["source"] = folder
    sfm = SfmOptions(poses=settings.pop("poses"))
    with pytest.raises(error, match=said):
        run(RunConfig(system=system, sfm=sfm, out=tmp_path / "run", train=TINY, **settings))
    assert (tmp_path / "run").exists() == (error is StageFailed)


def test_options_that_contradict_are_refused(hamlet: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="--frames known"):
        RunConfig(source=hamlet, out=tmp_path, sfm=SfmOptions(poses=hamlet))
    with pytest.raises(BadInput, match="one owner"):
        RunConfig(source=hamlet, out=tmp_path, single_owner=True)


def test_the_manifest_says_what_each_tier_received(finished: tuple[RunConfig, RunResult]) -> None:
    config, _ = finished
    ledger = json.loads((config.out / "manifest.json").read_text())["ledger"]
    fetched = {row["node"]: row["num_photographs"] for row in ledger}
    assert {node for node, count in fetched.items() if count} == {"devices/north-1", "devices/south-1"}, "each fetched its own"
    assert sum(fetched.values()) == 12
    assert {row["node"] for row in ledger} >= {"devices/north-1", "edges/north", "cloud", "devices/north-1/score", "planning"}
    tiers = {row["tier"]: row for row in access_by_tier(ledger, shared=False)}
    assert [row["num_nodes"] for row in tiers.values()] == [2, 2, 2] and list(tiers) == ["device", "edge", "cloud"]
    assert tiers["device"]["num_photographs"] == 12 and tiers["edge"]["photograph_bytes"] == tiers["cloud"]["photograph_bytes"] == 0
    assert sum(row["other_bytes"] for row in tiers.values()) == sum(row["other_bytes"] for row in ledger)
    page = (config.out / "report.html").read_text()
    assert "with nodes run by local" in page and "planned from a count raster" in page and "no device&#39;s id" in page


@pytest.mark.parametrize("owned", [False, True])
def test_copies_are_counted_once_and_neither_planned_nor_named(owned: bool, hamlet: Path, tmp_path: Path) -> None:
    photographs = sorted((hamlet / "images").iterdir())[:3]
    (tmp_path / "photos").mkdir()
    for path in photographs:
        for name in (path.name, f"z_{path.name}"):
            shutil.copy(path, tmp_path / "photos" / name)
    task = PositionsTask(source=str(tmp_path / "photos"), cell_m=None, held_out=(), owned=owned)
    told: list[Event] = []
    run_positions(tmp_path, task, reporter("positions", told.append))
    assert list(json.loads((tmp_path / "positions.json").read_text())["photographs"]) == [path.name for path in photographs]
    warnings = [event.message for event in told if isinstance(event, Warned)]
    # A device's own are told by its structure from motion, which knows the broken ones, too.
    assert len(warnings) == (not owned)
    assert all(warning.startswith("3 of 6 photographs are copies") and "drone" not in warning for warning in warnings)


def test_a_frame_counts_the_positions_that_it_is_from(hamlet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    photos = tmp_path / "photos"
    shutil.copytree(hamlet / "images", photos)
    first = min(photos.iterdir())
    shutil.copy(first, photos / f"z_{first.name}")
    (photos / "broken.jpg").write_bytes(first.read_bytes()[:-1000])
    assert len([place for place in photograph_positions(photos).values() if place is not None]) == 14
    # Mapping takes half a minute; a known model of the same photographs is a scene as good.
    monkeypatch.setattr(
        "radiant_core.sfm.reconstruct.reconstruct",
        lambda photo_folder, work, config, report: scene_from_colmap(hamlet / "known", photo_folder, work, report),
    )
    origin = next(place for place in photograph_positions(photos).values() if place is not None)
    told: list[Event] = []
    placing = replace(placing_in(photos), origin=origin)
    save_task(tmp_path, FieldTask(train=train_preset("draft"), backend="native", placing=placing, changed=()))
    _place(tmp_path, placing, reporter("devices/a", told.append))
    (frame,) = [event.decision for event in told if isinstance(event, Decided) and event.decision.topic == "frame"]
    assert frame.reason.startswith("from 12 positions;")


def test_copies_among_given_poses_are_told(hamlet: Path, tmp_path: Path) -> None:
    shutil.copytree(hamlet / "images", tmp_path / "images")
    first, second = sorted(path.name for path in (tmp_path / "images").iterdir())[:2]
    shutil.copy(tmp_path / "images" / first, tmp_path / "images" / second)
    poses = read_given_poses(tmp_path, hamlet / "known")
    told: list[Event] = []
    captured = _locate_by_poses(poses, None, tmp_path, cast(Progress, SimpleNamespace(listen=told.append)))
    assert second not in captured.names and len(captured.names) == 11
    (warning,) = [event.message for event in told if isinstance(event, Warned)]
    assert warning.startswith("1 of 12 photographs are copies") and f"{second} (of {first})" in warning
