"""Photographs that stay on their devices: who opens them, and what reaches the tiers above."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import RunResult, run
from radiant_app.config.run_config import EvaluateOptions, RunConfig, SfmOptions
from radiant_app.events import Decided, Event, StageProgress, StageSkipped, Warned
from radiant_app.report.html import REPORT, access_by_tier
from radiant_app.run.captured import _locate_by_poses
from radiant_app.run.progress import Progress
from radiant_app.workers.field_nodes import _place, _place_once, run_field, run_positions
from radiant_app.workers.redaction import NOTES_NAME
from radiant_app.workers.tasks import FieldTask, PositionsTask
from radiant_core.hierarchy.codec import load_task, save_task
from radiant_core.hierarchy.joining import are_one_group
from radiant_core.io.photos.listing import photograph_positions
from radiant_core.io.records import load_cameras
from radiant_core.light.captures import CAPTURES_NAME
from radiant_core.sfm.given_poses import read_given_poses
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.train.config import train_preset
from radiant_viewer.runs.run_view import load_run_view
from tests.app.alex_weights import write_alex_weights
from tests.app.canary import PHOTOGRAPH_KINDS, POSE_KINDS, SEGMENTS, Parts, add_broken, canaries_of, files_with, watermark
from tests.app.field_kit import ONE_EDGE, TINY, TWO_EDGES, placing_in, reporter, split_by_device
from tests.told import stages_done


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


def test_nothing_of_a_photograph_lies_above_its_device_and_little_else_than_models_was_sent(finished: tuple[RunConfig, RunResult]) -> None:
    """By given poses, with two edges, which pool."""
    config, _ = finished
    assert_no_image_bytes(config.out, config.source)
    assert_models_and_little_else_were_sent(config.out)


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
    assert not stages_done(events) and any(isinstance(event, StageSkipped) for event in events)
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
    assert {*stages_done(events)} == {"devices/north-1", "devices/south-1"}
    assert {event.stage for event in events if isinstance(event, StageProgress)} == {REPORT}, "each looked and found what it knew"
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
    assert isinstance(events[0], Warned) and "its photographs have changed" in events[0].message and name not in events[0].message


def test_weights_for_lpips_make_every_device_score_again_and_nothing_else(finished: tuple[RunConfig, RunResult], tmp_path: Path) -> None:
    config, first = finished
    copy = tmp_path / "copy"
    shutil.copytree(config.out, copy)
    weights = write_alex_weights(tmp_path / "alex.safetensors")
    events: list[Event] = []
    result = run(
        replace(config, out=copy, evaluate=EvaluateOptions(lpips_weights=weights, lpips_network="alex")), events.append, resume=True
    )
    assert {*stages_done(events)} == {"devices/north-1/score", "devices/south-1/score"}
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


@pytest.mark.parametrize("frames", [pytest.param("known", marks=pytest.mark.stress), "gps"])
def test_no_other_process_opens_a_devices_photographs(frames: str, hamlet: Path, system: Path, preload: Path, tmp_path: Path) -> None:
    """Alone traces, from outside, every file and socket that each process of a whole run opens.

    By `known` with two edges, which pool; by `gps` with one edge of both devices, which are
    reconstructed where they are. Nodes are forks, named by what they run, of a server that loads the tracing.
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
    # Two rounds of refining: a further one opens what the second does.
    options = [*poses, "--system", system, "--steps", 20, "--long-side-px", 64, "--max-splats", 800, "--set", "refine.rounds=2"]
    environment = {**os.environ, "LD_PRELOAD": str(preload), "OPENED_FILES": str(log)}
    done = subprocess.run(
        [str(part) for part in (*command, *options)], env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    opened: dict[str, set[str]] = {}
    loading_torch: set[str] = set()
    for line in log.read_text(errors="replace").splitlines():
        process, _, path = line.rpartition("\t")
        if "/torch/__pycache__/__init__." in path:
            loading_torch.add(process)
        if path.endswith((".jpg", ".png")):
            opened.setdefault(path, set()).add(process)
    assert loading_torch and not any(" radiant_app run " in process for process in loading_torch), "the process of a run loads no torch"
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


def test_a_device_that_tells_its_positions_need_not_wait_for_torch(hamlet: Path, tmp_path: Path) -> None:
    save_task(tmp_path, PositionsTask(source=str(hamlet / "images"), cell_m=None, held_out=(), owned=True))
    code = "import sys; from pathlib import Path; from radiant_app.workers.nodes import run_node\n"
    code += "run_node('positions', Path(sys.argv[1]), 'positions/a', lambda event: None)\nassert 'torch' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and (tmp_path / "positions.json").is_file(), done.stderr


def assert_no_canary_elsewhere(run_folder: Path, source: Path, broken: dict[str, list[Path]]) -> None:
    """Nothing of a device's photographs is in a file of any other node or of the owner, nothing of its poses but at its edge."""
    of_owner = [path for path in run_folder.iterdir() if path.is_file() or path.name in ("evaluation", "delivered", "pictures")]
    assert {"report.html", "manifest.json", "events.jsonl", "said.txt"} <= {path.name for path in of_owner}
    nodes = [path for kind in ("devices", "positions", "edges") for path in (run_folder / kind).glob("*")]
    nodes += [path for path in (run_folder / "cloud", run_folder / "planning") if path.is_dir()]
    parts_of = Parts()
    assert {path.parent for path in run_folder.rglob(CAPTURES_NAME)} == {run_folder / "devices" / name for name in ("north-1", "south-1")}
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
    assert frame.reason.startswith("12 of 12 positions count;")


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
