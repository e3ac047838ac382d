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
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from radiant_app.bench.cells import ModelCache, run_cell
from radiant_app.bench.methods import MethodBench, bench_methods
from radiant_app.commands.demo import sample_scenes_folder
from radiant_app.commands.export import export
from radiant_app.commands.export_request import ExportRequest
from radiant_app.commands.extend import ExtendRequest, extend
from radiant_app.config.run_config import EvaluateOptions, RunConfig, TrainOptions
from radiant_app.events import Decided, Event, StageDone, StageSkipped, Warned
from radiant_app.files.event_file import read_progress
from radiant_app.report import html
from radiant_app.report.html import TIERS
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.pipeline import RunResult, run
from radiant_app.workers.delivering import IDENTITY
from radiant_app.workers.memory import resident_bytes
from radiant_app.workers.nodes import run_node
from radiant_app.workers.sources import load_scene_of
from radiant_core.aggregate.extend import NewRegion
from radiant_core.cameras import concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.frames import enu_change, geodetic_from_enu
from radiant_core.geometry.similarity import move_splats
from radiant_core.io.colmap.model import read_model
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import load_cameras, load_plan, load_scene, load_splats, save_cameras
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.upload import load_upload, save_upload
from radiant_core.io.waypoints.region import load_region
from radiant_core.sfm.world_frame.world import cameras_of
from tests.app.alex_weights import write_alex_weights
from tests.forked import run_module

TINY = TrainOptions(long_side_px=96, num_steps=100, max_num_splats=1500)
TINY_OPTIONS = ("--steps", TINY.num_steps, "--long-side-px", TINY.long_side_px, "--max-splats", TINY.max_num_splats)


@pytest.fixture(scope="module")
def hamlet() -> Path:
    return sample_scenes_folder() / "hamlet" / "images"


@pytest.fixture(scope="module")
def finished(hamlet: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[RunConfig, RunResult, list[Event]]:
    folder = tmp_path_factory.mktemp("runs")
    shutil.copytree(hamlet, folder / "photos")
    whole = next(hamlet.iterdir()).read_bytes()
    (folder / "photos" / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    config = RunConfig(source=folder / "photos", out=folder / "hamlet", train=TINY)
    events: list[Event] = []
    return config, run(config, events.append), events


def radiant(*arguments: object) -> subprocess.CompletedProcess[str]:
    return run_module("radiant_app", *arguments)


def test_every_output_is_there_and_reads(finished: tuple[RunConfig, RunResult, list[Event]]) -> None:
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


def test_every_training_photograph_went_to_exactly_one_device(finished: tuple[RunConfig, RunResult, list[Event]]) -> None:
    config, _, _ = finished
    scene = load_scene(config.out / "sfm" / "scene.safetensors")
    held_out = held_out_mask(scene.cameras.names)
    training = sorted(name for name, held in zip(scene.cameras.names, held_out, strict=True) if not held)
    dealt = sorted(path.name for path in config.out.glob("devices/*/photos/*"))
    assert dealt == training
    _, edge_plans = load_plan(config.out / "plan.json")
    indices = np.concatenate([plan.camera_indices for plan in edge_plans])
    assert sorted(indices) == list(range(len(training)))


def test_no_photograph_lies_at_an_edge_or_the_cloud(finished: tuple[RunConfig, RunResult, list[Event]]) -> None:
    config, _, _ = finished
    manifest = json.loads((config.out / "manifest.json").read_text())
    num_photographs = {tier: sum(row["num_photographs"] for row in manifest["ledger"] if row["tier"] == tier) for tier in TIERS}
    assert num_photographs == {"device": 10, "edge": 0, "cloud": 0, "owner": 12}, "every 8th stays with the owner, who had all"
    pictures = [path for tier in ("edges", "cloud") for path in (config.out / tier).rglob("*") if path.suffix.lower() in (".jpg", ".png")]
    assert pictures == []


def test_a_finished_runs_stream_of_events_tells_of_every_stage(finished: tuple[RunConfig, RunResult, list[Event]]) -> None:
    config, _, _ = finished
    manifest = json.loads((config.out / "manifest.json").read_text())
    progress = read_progress(config.out)
    assert (progress.status, progress.is_running) == ("done", False)
    assert {stage.stage for stage in progress.stages} >= set(manifest["stages"])
    assert {stage.state for stage in progress.stages} == {"done"}


def test_training_beats_both_baselines_on_every_held_out_photograph(finished: tuple[RunConfig, RunResult, list[Event]]) -> None:
    _, result, _ = finished
    for row in result.metrics["images"]:
        assert row["psnr_db"] > row["initial_psnr_db"] + 1, row
        assert row["psnr_db"] > row["mean_color_psnr_db"] + 1, row


def test_resuming_skips_every_finished_stage_and_keeps_the_scene(finished: tuple[RunConfig, RunResult, list[Event]]) -> None:
    config, _, first = finished
    before = (config.out / "scene.ply").read_bytes()
    former = [config.out / "evaluation" / name for name in ("scene.ply", "plan.json", "cameras.safetensors")]
    for path in former:
        path.write_text("of an earlier version")
    events: list[Event] = []
    run(config, events.append, resume=True)
    assert not any(isinstance(event, StageDone) for event in events) and not any(path.exists() for path in former)
    skipped, done = ({e.stage for e in of if isinstance(e, kind)} for of, kind in ((events, StageSkipped), (first, StageDone)))
    assert skipped == done
    assert (config.out / "scene.ply").read_bytes() == before


def test_what_is_no_photograph_and_a_touch_change_nothing(finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path) -> None:
    config, _, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(config.out, copy)
    for path in (config.source / ".DS_Store", next(config.source.glob("*_0003*"))):
        path.touch()
    events: list[Event] = []
    run(replace(config, out=copy), events.append, resume=True)
    assert not [event for event in events if isinstance(event, StageDone)]
    assert not [event for event in events if isinstance(event, Warned) and "again" in event.message]
    assert (copy / "scene.ply").read_bytes() == (config.out / "scene.ply").read_bytes()


def test_weights_for_lpips_given_later_make_resume_score_again_and_nothing_else(
    finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path
) -> None:
    config, first, _ = finished
    copy, weights = tmp_path / "copy", write_alex_weights(tmp_path / "alex.safetensors")
    shutil.copytree(config.out, copy)
    events: list[Event] = []
    result = run(
        replace(config, out=copy, evaluate=EvaluateOptions(lpips_weights=weights, lpips_network="alex")), events.append, resume=True
    )
    assert [event.stage for event in events if isinstance(event, StageDone)] == ["evaluation"]
    rows = result.metrics["images"]
    assert result.metrics["lpips"] == pytest.approx(np.mean([row["lpips"] for row in rows])) and result.metrics["lpips"] > 0
    assert result.metrics["psnr_db"] == first.metrics["psnr_db"] and result.metrics["lpips_reason"] is None
    assert "LPIPS alex" in result.report.read_text()
    with pytest.raises(BadInput, match="no LPIPS weights"):
        run(replace(config, out=tmp_path / "new", evaluate=EvaluateOptions(lpips_weights=tmp_path / "none")))
    assert not (tmp_path / "new").exists()


def test_ours_of_the_benchmark_in_the_runs_cell_is_the_scene_of_the_run_bit_for_bit(
    finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path
) -> None:
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


def test_a_flipped_bit_makes_resume_repeat_that_stage(finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path) -> None:
    config, _, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(config.out, copy)
    model = copy / "cloud" / "scene.ply"
    damaged = bytearray(model.read_bytes())
    damaged[-5] ^= 1
    model.write_bytes(damaged)
    events: list[Event] = []
    run(RunConfig(source=config.source, out=copy, train=TINY), events.append, resume=True)
    assert [event.stage for event in events if isinstance(event, StageDone)] == ["cloud"]
    assert model.read_bytes() == (config.out / "cloud" / "scene.ply").read_bytes()


def test_an_edge_says_how_many_gaussians_it_made_of_how_many(finished: tuple[RunConfig, RunResult, list[Event]]) -> None:
    config, _, events = finished
    decided = {e.decision.stage: e.decision for e in events if isinstance(e, Decided) and e.decision.topic == "retraining"}
    assert {stage for stage in decided if stage != "cloud"} == {f"edges/{path.name}" for path in (config.out / "edges").iterdir()}
    for stage in decided.keys() - {"cloud"}:
        given = sum(len(load_upload(path)) for path in (config.out / stage / "inbox").glob("*/model.safetensors"))
        left = len(load_splats(config.out / stage / "model.safetensors"))
        assert decided[stage].choice.endswith(f"; {given:,} Gaussians became {left:,}") and left < given


def by_hand(node: Path, folder: Path) -> Path:
    """A copy of a node's folder, whose task may be changed: nothing there is signed."""
    shutil.copytree(node, folder)
    shutil.rmtree(folder / IDENTITY)
    return folder


def test_a_devices_memory_limits_its_gaussians(finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path) -> None:
    config, _, _ = finished
    by_hand(next((config.out / "devices").iterdir()), tmp_path / "device")
    task = read_json(tmp_path / "device" / "task.json")
    assert task["memory_bytes"] is None, "the system names no limit"
    events: list[Event] = []
    write_json(tmp_path / "device" / "task.json", {**task, "memory_bytes": 64e9})
    run_node("device", tmp_path / "device", "devices/one", events.append)
    (decision,) = (event.decision for event in events if isinstance(event, Decided) and event.decision.topic == "memory")
    assert decision.choice.startswith(f"at most {TINY.max_num_splats:,} Gaussians") and decision.figure == 64e3
    write_json(tmp_path / "device" / "task.json", {**task, "memory_bytes": 1e6})
    with pytest.raises(BadInput, match="1 MB of memory leave room for 0 Gaussians, expected 1,000 or more: give"):
        run_node("device", tmp_path / "device", "devices/one", events.append)


def test_too_little_memory_makes_a_smaller_budget_that_the_next_process_keeps(
    finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path
) -> None:
    config, _, _ = finished
    by_hand(next((config.out / "devices").iterdir()), tmp_path / "device")
    task = read_json(tmp_path / "device" / "task.json")
    wanted = {**task["train"], "max_num_splats": 1_000_000}
    # A million Gaussians need over 1 GB beside the process.
    memory_bytes = resident_bytes() + 200_000_000
    write_json(tmp_path / "device" / "task.json", {**task, "train": wanted, "memory_bytes": memory_bytes})

    def choice() -> str:
        events: list[Event] = []
        run_node("device", tmp_path / "device", "devices/one", events.append)
        return next(event.decision.choice for event in events if isinstance(event, Decided) and event.decision.topic == "memory")

    first = choice()
    (limit,) = re.findall(r"at most ([\d,]+) Gaussians", first)
    assert 1000 <= int(limit.replace(",", "")) < 500_000
    # What a later process holds is another matter: with another limit, its checkpoints would be
    # another training's.
    ballast = np.ones(5_000_000)
    assert choice() == first and ballast[-1] == 1
    kept = read_json(tmp_path / "device" / "memory.json")
    write_json(tmp_path / "device" / "memory.json", {name: value - 50_000_000 for name, value in kept.items()})
    assert choice() != first, "it is the figure in the file that counts"
    # A damaged one is taken anew, whatever the figure is now.
    (tmp_path / "device" / "memory.json").write_text("{")
    assert "Gaussians" in choice() and read_json(tmp_path / "device" / "memory.json")


def test_a_device_that_sends_more_cameras_than_it_was_dealt_is_refused_by_its_edge_and_an_edge_by_the_cloud(
    finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path
) -> None:
    config, _, _ = finished
    joining = next(folder for folder in sorted((config.out / "edges").iterdir()) if len(list((folder / "inbox").iterdir())) > 1)
    edge = by_hand(joining, tmp_path / "edge")
    task = read_json(edge / "task.json")
    photographs = [len(list((config.out / "devices" / device / "photos").iterdir())) for device in task["devices"]]
    assert task["num_dealt"] == photographs
    write_json(edge / "task.json", task)
    greedy, *others = task["devices"]
    _send_more_cameras(edge / "inbox" / greedy / "cameras.safetensors", 20_000)
    events: list[Event] = []
    run_node("edge", edge, "edges/one", events.append)
    told = f"it sends 20,000 cameras, where {photographs[0]} photographs were dealt to it."
    assert read_json(edge / "refused.json") == {greedy: told}
    assert f"the model of {greedy} is left out: {told}" in [event.message for event in events if isinstance(event, Warned)]
    assert len(load_cameras(edge / "virtual_cameras.safetensors")) == sum(photographs[1:])
    assert read_json(edge / "summary.json")["num_models"] == len(others)

    cloud = by_hand(config.out / "cloud", tmp_path / "cloud")
    task = read_json(cloud / "task.json")
    _, edge_plans = load_plan(config.out / "plan.json")
    assert task["num_dealt"] == [len(plan.camera_indices) for plan in edge_plans if plan.edge_id in task["edges"]]
    for name in task["edges"]:
        _send_more_cameras(cloud / "inbox" / name / "virtual_cameras.safetensors", 500)
    run_node("cloud", cloud, "cloud", events.append)
    assert {reason[:22] for reason in read_json(cloud / "refused.json").values()} == {"it sends 500 cameras, "}


def _send_more_cameras(path: Path, count: int) -> None:
    cameras = load_cameras(path)
    copies = [replace(cameras, names=tuple(f"{index}-{name}" for name in cameras.names)) for index in range(-(-count // len(cameras)))]
    save_cameras(path, concatenate_cameras(copies).select(np.arange(count)))


def test_a_model_out_of_its_cameras_sight_is_refused_and_the_rest_is_joined(
    finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path
) -> None:
    config, _, _ = finished
    edge = next(folder for folder in sorted((config.out / "edges").iterdir()) if len(list((folder / "inbox").iterdir())) > 1)
    by_hand(edge, tmp_path / "edge")
    senders = read_json(tmp_path / "edge" / "task.json")["devices"]
    bad, *good = senders
    place = tmp_path / "edge" / "inbox" / bad / "model.safetensors"
    model = load_upload(place)
    save_upload(place, replace(model, means=model.means + np.float32(1e5)), "float32")
    events: list[Event] = []
    run_node("edge", tmp_path / "edge", "edges/one", events.append)
    moves = read_json(tmp_path / "edge" / "corrections.json")
    assert [name for name in senders if moves[name] is not None] == good and moves[bad] is None
    assert list(read_json(tmp_path / "edge" / "refused.json")) == [bad]
    (warning,) = (event.message for event in events if isinstance(event, Warned))
    assert warning.startswith(f"the model of {bad} is left out: its own cameras see 0.0% of its Gaussians")
    for name in good:
        (tmp_path / "edge" / "inbox" / name / "model.safetensors").write_bytes(b"no model")
    outputs = run_node("edge", tmp_path / "edge", "edges/one", events.append)
    assert outputs == ["summary.json", "corrections.json", "refused.json", "frame.json", "notes.json"]
    assert set(read_json(tmp_path / "edge" / "refused.json")) == set(senders)
    assert read_json(tmp_path / "edge" / "frame.json") == {"status": "missing", "reason": "", "uncertainty": None}


def test_commands_on_a_finished_run(finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path) -> None:
    config, result, _ = finished
    scores = radiant("evaluate", config.out, "--json")
    assert json.loads(scores.stdout)["psnr_db"] == pytest.approx(result.metrics["psnr_db"], abs=1e-6), scores.stderr
    exported = radiant("export", config.out, tmp_path / "out.ply")
    assert exported.returncode == 0, exported.stderr
    headers, rows = zip(
        *((path.read_bytes().split(b"end_header\n", 1)) for path in (tmp_path / "out.ply", config.out / "scene.ply")), strict=True
    )
    # Of bytes, pytest would look for the differences for minutes; the header says where the scene lies.
    assert (rows[0] == rows[1]) is True and (b"comment origin" in headers[0]) == (load_scene_of(config.out).frame.kind == "metric")
    rendered = radiant("render", config.out, "--out", tmp_path / "pictures")
    assert rendered.returncode == 0 and len(list((tmp_path / "pictures").glob("*.png"))) == len(result.metrics["images"])
    joined = radiant("aggregate", config.out, "--out", tmp_path / "joined.ply", "--epochs", 1, "--aggregate-preset", "paper")
    assert joined.returncode == 0 and len(load_ply(tmp_path / "joined.ply")) > 0, joined.stderr
    planned = radiant("plan", config.out, "--out", tmp_path / "plan.json", "--plan-method", "even", "--json")
    assert planned.returncode == 0 and (tmp_path / "plan.png").exists(), planned.stderr
    trained = radiant("train", config.out, "--out", tmp_path / "all.ply", "--steps", 3, "--long-side-px", 48)
    assert trained.returncode == 0 and len(load_ply(tmp_path / "all.ply")) > 100, trained.stderr
    shot = radiant("inspect", config.out, "--screenshot", tmp_path / "shot.png", "--view", "cameras")
    assert shot.returncode == 0 and (tmp_path / "shot.png").stat().st_size > 1000, shot.stderr


def test_after_resuming_the_colmap_models_of_a_run_are_in_the_frame_of_its_scene(
    finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path
) -> None:
    config, _, _ = finished
    run(config, lambda event: None, resume=True)
    scene = load_scene(config.out / "sfm" / "scene.safetensors")
    exported = radiant("export", config.out, tmp_path / "colmap", "--format", "colmap")
    assert exported.returncode == 0, exported.stderr
    for folder in (config.out / "sfm" / "undistorted" / "sparse", tmp_path / "colmap"):
        cameras = cameras_of(read_model(folder)).named(scene.cameras.names)
        # 1e-6 m: two ways through one similarity in float64, and the digits of COLMAP's text.
        np.testing.assert_allclose(cameras.cam_from_world, scene.cameras.cam_from_world, atol=1e-6)


def test_a_run_is_extended_by_another_and_by_a_region_of_the_plan(
    finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path
) -> None:
    config, _, _ = finished
    display = ProgressDisplay(Console(quiet=True))
    origin = load_scene(config.out / "sfm" / "scene.safetensors").frame.origin_lat_lon_alt
    ring = geodetic_from_enu([[0.0, -200, 0], [200, -200, 0], [200, 200, 0], [0, 200, 0], [0, -200, 0]], origin)[:, 1::-1].tolist()
    region = tmp_path / "east.geojson"
    region.write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    made = extend(ExtendRequest(old=config.out, new=config.out, out=tmp_path / "x.ply", region=region, margin_m=2.0), display)
    scene, extended = load_ply(config.out / "scene.ply"), load_ply(tmp_path / "x.ply")
    away = NewRegion(polygon=load_region(region, origin), margin_m=2.0).inside_m(scene.means)
    beyond = scene.select(away < -2.0)
    assert made["unchanged"] == len(beyond) > 0 and made["new"] > 0 and made["views"] > 0 and made["gaussians"] == len(extended)
    assert np.array_equal(extended.select(np.arange(len(beyond))).means, beyond.means)
    for change, said in (
        ({"old": tmp_path}, "scene.ply"),
        ({"new": tmp_path}, "scene.ply"),
        ({"out": tmp_path / "x.ply"}, "exists"),
        ({"region": config.out / "plan.json"}, "GeoJSON"),
        ({"region": tmp_path / "none.geojson"}, "no file"),
        ({"margin_m": -1.0}, "margin"),
    ):
        asked: dict[str, Any] = {"old": config.out, "new": config.out, "out": tmp_path / "y.ply", "region": region, **change}
        with pytest.raises(BadInput, match=said):
            extend(ExtendRequest(**asked), display)
        assert not (tmp_path / "y.ply").exists()


def test_after_an_extension_chunks_outside_the_changed_region_keep_their_bytes(
    finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path
) -> None:
    out, display = finished[0].out, ProgressDisplay(Console(quiet=True))
    origin = load_scene(out / "sfm" / "scene.safetensors").frame.origin_lat_lon_alt
    border = load_plan(out / "plan.json")[0].borders[0]
    inner = border.mean(axis=0) + 0.6 * (border - border.mean(axis=0))
    ring = geodetic_from_enu(np.column_stack([inner, np.zeros(len(inner))])[[*range(len(inner)), 0]], origin)[:, 1::-1].tolist()
    (tmp_path / "inner.geojson").write_text(json.dumps({"type": "Polygon", "coordinates": [ring]}))
    asked = ExtendRequest(old=out, new=out, out=tmp_path / "x.ply", region=tmp_path / "inner.geojson", margin_m=0.5, num_epochs=1)
    made = extend(asked, display)
    assert made["new"] > 0
    for model, name in ((out / "scene.ply", "before"), (tmp_path / "x.ply", "after")):
        export(ExportRequest(model=model, out=tmp_path / name, format="lod", num_levels=2, regions=(out,)), display)
    chunks = {path.relative_to(tmp_path / "before") for path in (tmp_path / "before").rglob("[01]_*/*")}
    differ = {path.parts[0] for path in chunks if (tmp_path / "before" / path).read_bytes() != (tmp_path / "after" / path).read_bytes()}
    # Of the first region alone, whose number is 0.
    assert differ == {"0_0", "1_0"} and len({path.parts[0] for path in chunks}) >= 4


def test_a_scene_with_an_origin_of_its_own_is_extended_by_a_later_run(
    finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alone extends one run by another whose GPS gives another origin."""
    # Its pictures take longer than all stages of such a run.
    monkeypatch.setattr(html, "write_report", lambda *_: None)
    new, old = finished[0].out, tmp_path / "old"
    (tmp_path / "first").mkdir()
    for path in sorted(finished[0].source.glob("drone_*.jpg"))[:8]:
        shutil.copyfile(path, tmp_path / "first" / path.name)
    (tmp_path / "system.toml").write_text('[[edge]]\nid = "alone"\n[[edge.device]]\nid = "alone-1"\n')
    tiny = replace(TINY, long_side_px=64, num_steps=30)
    run(RunConfig(source=tmp_path / "first", system=tmp_path / "system.toml", out=old, train=tiny))
    request = ExtendRequest(old=old, new=new, out=tmp_path / "more.ply", num_epochs=1)
    made = extend(request, ProgressDisplay(Console(quiet=True)))
    origins = [load_scene(folder / "sfm" / "scene.safetensors").frame.origin_lat_lon_alt for folder in (new, old)]
    move = enu_change(*origins)
    assert np.linalg.norm(move.translation) > 1 and f"moved by {np.linalg.norm(move.translation):.2f} m" in made["frames"]
    standing, extended = load_ply(old / "scene.ply"), load_ply(tmp_path / "more.ply")
    assert made["gaussians"] == len(extended) and made["views"] > 0
    # First what lies beyond the margin, in its order and bit for bit; then what came, moved.
    kept = [row.tobytes() for row in extended.means[: made["unchanged"]]]
    assert 0 < len(kept) < len(standing) and kept == [row for row in (row.tobytes() for row in standing.means) if row in set(kept)]
    came = {row.tobytes() for row in move_splats(load_ply(new / "scene.ply"), move).means}
    assert 0 < made["new"] <= sum(row.tobytes() in came for row in extended.means[made["unchanged"] :])


def test_commands_refuse_what_is_damaged_or_taken(finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path) -> None:
    config, _, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(config.out, copy)
    edge = next((copy / "edges").iterdir())
    (edge / "task.json").write_text("null")
    (copy / "sfm" / "result.json").write_text("[]")
    (tmp_path / "plan.json").write_text("mine")
    cases = [
        (("aggregate", copy, "--out", tmp_path / "a.ply"), "task.json is no JSON object"),
        (("train", copy, "--out", tmp_path / "t.ply", "--steps", 1), "result.json is no JSON object"),
        (("train", config.out, "--out", tmp_path / "t.ply", "--seed", -1), "seed"),
        (("plan", config.out, "--out", tmp_path / "plan.png"), "ends in .json"),
        (("plan", config.out, "--out", tmp_path / "plan.json"), "exists"),
        (("export", tmp_path / "none.safetensors", tmp_path / "e.ply"), "none.safetensors"),
        (("inspect", config.out, "--screenshot", tmp_path / "shot.jpg"), "ends in .png"),
        (("bench", "plan", "--quick", "--json", tmp_path / "none" / "plan.json"), "there is no folder"),
        (("render", config.out, "--cameras", config.out / "scene.ply", "--out", tmp_path / "r"), "scene.ply"),
    ]
    for arguments, told in cases:
        result = radiant(*arguments)
        assert result.returncode == 2, (arguments, result.stderr)
        assert told in result.stderr and "Traceback" not in result.stderr, (arguments, result.stderr)
    (edge / "task.json").unlink()
    assert radiant("aggregate", copy, "--out", tmp_path / "a.ply").returncode == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copy", "plan.json"]


def test_photographs_that_would_become_too_narrow_are_refused_before_training(
    finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path
) -> None:
    config, _, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(config.out, copy)
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["config"]["train"]["long_side_px"] = 14
    del manifest["sha256"]
    (copy / "manifest.json").write_text(json.dumps(manifest))
    narrow = RunConfig(source=config.source, out=copy, train=replace(TINY, long_side_px=14))
    with pytest.raises(BadInput, match="expected 11 or more a side"):
        run(narrow, resume=True)


def _photographs(folder: Path, source: Path, count: int) -> Path:
    folder.mkdir()
    for path in sorted(source.iterdir())[:count]:
        shutil.copy(path, folder)
    return folder


def test_bad_input_gets_one_sentence_and_leaves_nothing(hamlet: Path, tmp_path: Path) -> None:
    """Alone gives `radiant run` bad input of seven kinds, each to a process of its own."""
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
        finished = radiant("run", *arguments)
        assert finished.returncode == 2, (arguments, finished.stderr)
        assert word in finished.stderr and "Traceback" not in finished.stderr, (arguments, finished.stderr)
        assert not out.exists(), arguments
    assert [path.name for path in full.iterdir()] == ["mine.txt"]


def test_a_truncated_photograph_is_skipped_named_and_no_failure(finished: tuple[RunConfig, RunResult, list[Event]]) -> None:
    config, result, _ = finished
    assert "cut.jpg" not in load_scene(config.out / "sfm" / "scene.safetensors").cameras.names
    assert any("cut.jpg" in warning for warning in json.loads((config.out / "manifest.json").read_text())["warnings"])
    assert "cut.jpg" in result.report.read_text()
    again = radiant("run", config.source, "--out", config.out, "--resume", *TINY_OPTIONS)
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
        assert "go on with the same command and --resume" in finished.stderr
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


def test_ctrl_c_ends_with_130_and_the_run_can_be_resumed(finished: tuple[RunConfig, RunResult, list[Event]], tmp_path: Path) -> None:
    """Alone interrupts a run while its real workers train, and resumes it."""
    config, _, _ = finished
    out = tmp_path / "run"
    shutil.copytree(config.out, out)
    for path in (out / "cloud", *out.glob("devices/*")):
        (path / "done.json").unlink()
    command = [sys.executable, "-m", "radiant_app", "run", str(config.source), "--out", str(out), *map(str, TINY_OPTIONS), "--resume"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not list(out.glob("devices/*/log.txt")) or not _workers_of(process.pid):
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    workers = _workers_of(process.pid)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and "--resume" in errors
    assert not [pid for pid in workers if Path(f"/proc/{pid}").exists()], "workers must end with the run"
    result = run(RunConfig(source=config.source, out=out, train=TINY), resume=True)
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


def test_doctor_finds_what_a_run_needs() -> None:
    finished = radiant("doctor", "--json")
    findings = json.loads(finished.stdout)
    assert finished.returncode == 0
    assert all(finding["ok"] for finding in findings if finding["needed"]), findings
