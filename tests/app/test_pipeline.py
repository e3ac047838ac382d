"""The main job on the smallest sample scene: all stages, every photograph to one device, resuming, library use, bad input."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.methods.bench import MethodBench, bench_methods
from benchmarks.methods.cells import ModelCache, run_cell
from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import EvaluateOptions, RunConfig
from radiant_app.events import Decided, Event, StageSkipped, Warned
from radiant_app.files.event_file import read_progress
from radiant_app.report.html import TIERS
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import load_plan, load_scene, load_splats
from radiant_core.io.run_store import read_json
from radiant_core.io.transport.upload import load_upload
from tests.app.alex_weights import write_alex_weights
from tests.app.pipeline_kit import FOUR, TINY, TINY_OPTIONS, Finished, radiant, refused
from tests.forked import has_ended
from tests.told import stages_done


def test_every_output_is_there_and_reads(finished: Finished) -> None:
    config, result, _ = finished
    for name in ("manifest.json", "plan.json", "scene.ply", "metrics.json", "report.html", "pictures/regions.png", "pictures/timeline.png"):
        assert (config.out / name).stat().st_size > 0, name
    assert len(load_ply(config.out / "scene.ply")) == result.metrics["num_gaussians"] == len(result.load_splats())
    assert result.metrics["lpips"] is None and result.metrics["lpips_reason"]
    for row in (*result.metrics["images"], result.metrics, result.metrics["median"]):
        assert row["psnr_cc_db"] >= row["psnr_db"] - 1e-6 and 0 < row["ssim_cc"] <= 1
    page = result.report.read_text()
    assert re.findall(r'(?:src|href)="(?!data:)[^"]*', page) == ['href="scene.html'], "the report needs nothing but itself to be read"
    flight = (config.out / "scene.html").read_text()
    assert "createViewer" in flight and not re.findall(r'(?:src|href)="(?!data:)', flight)
    assert len(flight) < 30_000_000


def test_every_training_photograph_went_to_exactly_one_device(finished: Finished) -> None:
    config, _, _ = finished
    scene = load_scene(config.out / "sfm" / "scene.safetensors")
    held_out = held_out_mask(scene.cameras.names)
    training = sorted(name for name, held in zip(scene.cameras.names, held_out, strict=True) if not held)
    dealt = sorted(path.name for path in config.out.glob("devices/*/photos/*"))
    assert dealt == training
    _, edge_plans = load_plan(config.out / "plan.json")
    indices = np.concatenate([plan.camera_indices for plan in edge_plans])
    assert sorted(indices) == list(range(len(training)))


def test_no_photograph_lies_at_an_edge_or_the_cloud(finished: Finished) -> None:
    config, _, _ = finished
    manifest = json.loads((config.out / "manifest.json").read_text())
    num_photographs = {tier: sum(row["num_photographs"] for row in manifest["ledger"] if row["tier"] == tier) for tier in TIERS}
    assert num_photographs == {"device": 10, "edge": 0, "cloud": 0, "owner": 12}, "every 8th stays with the owner, who had all"
    pictures = [path for tier in ("edges", "cloud") for path in (config.out / tier).rglob("*") if path.suffix.lower() in (".jpg", ".png")]
    assert pictures == []


def test_a_finished_runs_stream_of_events_tells_of_every_stage(finished: Finished) -> None:
    config, _, _ = finished
    manifest = json.loads((config.out / "manifest.json").read_text())
    progress = read_progress(config.out)
    assert (progress.status, progress.is_running) == ("done", False)
    assert {stage.stage for stage in progress.stages} >= set(manifest["stages"])
    assert {stage.state for stage in progress.stages} == {"done"}


def test_training_beats_both_baselines_on_every_held_out_photograph(finished: Finished) -> None:
    _, result, _ = finished
    for row in result.metrics["images"]:
        assert row["psnr_db"] > row["initial_psnr_db"] + 1, row
        assert row["psnr_db"] > row["mean_color_psnr_db"] + 1, row


def test_resuming_skips_every_finished_stage_and_keeps_the_scene(finished: Finished) -> None:
    config, _, first = finished
    before = (config.out / "scene.ply").read_bytes()
    events: list[Event] = []
    run(config, events.append, resume=True)
    assert not stages_done(events)
    skipped, done = {event.stage for event in events if isinstance(event, StageSkipped)}, {*stages_done(first)}
    assert skipped == done
    assert (config.out / "scene.ply").read_bytes() == before


def test_what_is_no_photograph_and_a_touch_change_nothing(finished: Finished, tmp_path: Path) -> None:
    config, _, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(config.out, copy)
    for path in (config.source / ".DS_Store", next(config.source.glob("*_0003*"))):
        path.touch()
    events: list[Event] = []
    run(replace(config, out=copy), events.append, resume=True)
    assert not stages_done(events)
    assert not [event for event in events if isinstance(event, Warned) and "again" in event.message]
    assert (copy / "scene.ply").read_bytes() == (config.out / "scene.ply").read_bytes()


def test_weights_for_lpips_given_later_make_resume_score_again_and_nothing_else(finished: Finished, tmp_path: Path) -> None:
    config, first, _ = finished
    copy, weights = tmp_path / "copy", write_alex_weights(tmp_path / "alex.safetensors")
    shutil.copytree(config.out, copy)
    events: list[Event] = []
    result = run(
        replace(config, out=copy, evaluate=EvaluateOptions(lpips_weights=weights, lpips_network="alex")), events.append, resume=True
    )
    assert stages_done(events) == ["evaluation"]
    rows = result.metrics["images"]
    assert result.metrics["lpips"] == pytest.approx(np.mean([row["lpips"] for row in rows])) and result.metrics["lpips"] > 0
    assert result.metrics["psnr_db"] == first.metrics["psnr_db"] and result.metrics["lpips_reason"] is None
    assert "LPIPS alex" in result.report.read_text()
    with pytest.raises(BadInput, match="no LPIPS weights"):
        run(replace(config, out=tmp_path / "new", evaluate=EvaluateOptions(lpips_weights=tmp_path / "none")))
    assert not (tmp_path / "new").exists()


def test_ours_of_the_benchmark_in_the_runs_cell_is_the_scene_of_the_run_bit_for_bit(finished: Finished, tmp_path: Path) -> None:
    run_folder = finished[0].out
    rows, _ = bench_methods(MethodBench(scene=run_folder, out=tmp_path, layout=None, methods=("ours",)))
    assert [(row.cell, row.arm) for row in rows] == [("hamlet-run-s0", "centralised"), ("hamlet-run-s0", "ours")]
    (model,) = (tmp_path / "joined").glob("hamlet-run-s0-ours-*.safetensors")
    save_ply(tmp_path / "ours.ply", load_splats(model))
    assert (tmp_path / "ours.ply").read_bytes() == (run_folder / "scene.ply").read_bytes()
    edges, cloud = ([read_json(path)["num_steps"] for path in run_folder.glob(f"{tier}/summary.json")] for tier in ("edges/*", "cloud"))
    assert len(edges) == 2 and min(edges) > 0 and rows[1].training_px == (sum(edges) + cloud[0]) * 96 * 72
    even = run_cell(run_folder, ModelCache(folder=tmp_path)).even
    assert sorted(len(even.cameras_of(device.id)) for device in even.system.devices) == [2, 2, 3, 3]


def test_a_flipped_bit_makes_resume_repeat_that_stage(finished: Finished, tmp_path: Path) -> None:
    config, _, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(config.out, copy)
    model = copy / "cloud" / "scene.ply"
    damaged = bytearray(model.read_bytes())
    damaged[-5] ^= 1
    model.write_bytes(damaged)
    events: list[Event] = []
    run(RunConfig(source=config.source, out=copy, train=TINY, plan=FOUR), events.append, resume=True)
    assert stages_done(events) == ["cloud"]
    assert model.read_bytes() == (config.out / "cloud" / "scene.ply").read_bytes()


def test_an_edge_says_how_many_gaussians_it_made_of_how_many(finished: Finished) -> None:
    config, _, events = finished
    decided = {e.decision.stage: e.decision for e in events if isinstance(e, Decided) and e.decision.topic == "retraining"}
    assert {stage for stage in decided if stage != "cloud"} == {f"edges/{path.name}" for path in (config.out / "edges").iterdir()}
    for stage in decided.keys() - {"cloud"}:
        given = sum(len(load_upload(path)) for path in (config.out / stage / "inbox").glob("*/model.safetensors"))
        left = len(load_splats(config.out / stage / "model.safetensors"))
        assert decided[stage].choice.endswith(f"; {given:,} Gaussians became {left:,}") and left < given


def test_photographs_that_would_become_too_narrow_are_refused_before_training(finished: Finished, tmp_path: Path) -> None:
    config, _, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(config.out, copy)
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["config"]["train"]["long_side_px"] = 14
    del manifest["sha256"]
    (copy / "manifest.json").write_text(json.dumps(manifest))
    narrow = RunConfig(source=config.source, out=copy, train=replace(TINY, long_side_px=14), plan=FOUR)
    with pytest.raises(BadInput, match="expected 11 or more a side"):
        run(narrow, resume=True)


def _photographs(folder: Path, source: Path, count: int) -> Path:
    folder.mkdir()
    for path in sorted(source.iterdir())[:count]:
        shutil.copy(path, folder)
    return folder


def test_bad_input_gets_one_sentence_and_leaves_nothing(hamlet: Path, tmp_path: Path) -> None:
    """Alone gives `radiant run` bad input of seven kinds, the first to a process of its own."""
    empty, one = _photographs(tmp_path / "empty", hamlet, 0), _photographs(tmp_path / "one", hamlet, 1)
    unknown_key, no_bandwidth = tmp_path / "key.toml", tmp_path / "bandwidth.toml"
    device = '[[edge]]\nid = "a"\nuplink_mbit_per_s = {}\n[[edge.device]]\nid = "d"\n'
    unknown_key.write_text(device.format(10) + "wheels = 4\n")
    no_bandwidth.write_text(device.format(0))
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.txt").write_text("keep")
    out = tmp_path / "out"
    cases = [
        ((tmp_path / "nowhere", "--out", out), "no folder"),
        ((empty, "--out", out), "photograph"),
        ((one, "--out", out), "photograph"),
        ((hamlet, "--out", out, "--system", unknown_key), "wheels"),
        ((hamlet, "--out", out, "--system", no_bandwidth), "uplink"),
        ((hamlet, "--out", full), "not empty"),
        ((hamlet, "--out", out, "--train-preset", "best"), "best"),
    ]
    for arguments, word in cases:
        finished = (radiant if arguments is cases[0][0] else refused)("run", *arguments)
        assert finished.returncode == 2, (arguments, finished.stderr)
        assert word in finished.stderr and "Traceback" not in finished.stderr, (arguments, finished.stderr)
        assert not out.exists(), arguments
    assert [path.name for path in full.iterdir()] == ["mine.txt"]


def test_a_truncated_photograph_is_skipped_named_and_no_failure(finished: Finished) -> None:
    config, result, _ = finished
    assert "cut.jpg" not in load_scene(config.out / "sfm" / "scene.safetensors").cameras.names
    assert any("cut.jpg" in warning for warning in json.loads((config.out / "manifest.json").read_text())["warnings"])
    assert "cut.jpg" in result.report.read_text()
    again = radiant("run", config.source, "--out", config.out, "--resume", "--devices", "4", *TINY_OPTIONS)
    assert again.returncode == 0 and "cut.jpg" in again.stdout + again.stderr, again.stderr


def test_a_full_disk_gets_one_sentence_and_keeps_what_was_computed(hamlet: Path, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)], capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip("only root may mount a disk of 2 MB")
    try:
        finished = radiant("run", hamlet, "--out", disk / "run", *TINY_OPTIONS)
        assert finished.returncode == 2 and "free space" in finished.stderr and "Traceback" not in finished.stderr, finished.stderr
        assert "repeat the command with --resume" in finished.stderr
        # There was no room to write more of the end than this.
        assert read_progress(disk / "run").status in ("failed", "interrupted")
        assert (disk / "run" / "sfm" / "database.db").stat().st_size > 0
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_photographs_that_do_not_overlap_are_refused(tmp_path: Path) -> None:
    import cv2

    folder = tmp_path / "noise"
    folder.mkdir()
    for index in range(4):
        noise = np.random.default_rng(index).integers(0, 256, (30, 40, 3)).astype(np.uint8)
        cv2.imwrite(str(folder / f"{index}.jpg"), cv2.resize(noise, (320, 240), interpolation=cv2.INTER_CUBIC))
    finished = radiant("run", folder, "--out", tmp_path / "out")
    assert finished.returncode == 2 and "overlap" in finished.stderr and "Traceback" not in finished.stderr
    assert not (tmp_path / "out").exists()


def test_ctrl_c_ends_with_130_and_the_run_can_be_resumed(finished: Finished, tmp_path: Path) -> None:
    """Alone interrupts a run while its real workers train, and resumes it."""
    config, _, _ = finished
    out = tmp_path / "run"
    shutil.copytree(config.out, out)
    for path in (out / "cloud", *out.glob("devices/*")):
        (path / "done.json").unlink()
    command = [
        sys.executable,
        "-m",
        "radiant_app",
        "run",
        str(config.source),
        "--out",
        str(out),
        *map(str, TINY_OPTIONS),
        "--devices",
        "4",
        "--resume",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not list(out.glob("devices/*/log.txt")) or not _workers_of(process.pid):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    workers = _workers_of(process.pid)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and "--resume" in errors
    assert all(has_ended(pid) for pid in workers), "workers must end with the run"
    result = run(RunConfig(source=config.source, out=out, train=TINY, plan=FOUR), resume=True)
    assert result.metrics["psnr_db"] > 5


def _workers_of(pid: int) -> list[int]:
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [int(child) for child in children if _is_running(int(child))]


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
