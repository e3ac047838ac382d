"""Commands on a finished run: figures, exports, extensions, and what they refuse."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.export.export import export
from radiant_app.commands.export.request import ExportRequest
from radiant_app.commands.model.extend import ExtendRequest, extend
from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import RunConfig
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.sources import load_scene_of
from radiant_core.aggregate.extend import NewRegion
from radiant_core.errors import BadInput
from radiant_core.frames import enu_change, geodetic_from_enu
from radiant_core.geometry.similarity import move_splats
from radiant_core.io.colmap.model import read_model
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_plan, load_scene
from radiant_core.sfm.world_frame.world import cameras_of
from radiant_core.waypoints.region import load_region
from tests.app.pipeline_kit import TINY, Finished, radiant, refused


def test_commands_on_a_finished_run(finished: Finished, tmp_path: Path) -> None:
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
    joined = radiant("join", config.out, "--out", tmp_path / "joined.ply", "--epochs", 1, "--aggregate-preset", "paper")
    assert joined.returncode == 0 and len(load_ply(tmp_path / "joined.ply")) > 0, joined.stderr
    planned = radiant("plan", config.out, "--out", tmp_path / "plan.json", "--plan-method", "even", "--json")
    assert planned.returncode == 0 and (tmp_path / "plan.png").exists(), planned.stderr
    trained = radiant("train", config.out, "--out", tmp_path / "all.ply", "--steps", 3, "--long-side-px", 48)
    assert trained.returncode == 0 and len(load_ply(tmp_path / "all.ply")) > 100, trained.stderr
    shot = radiant("inspect", config.out, "--screenshot", tmp_path / "shot.png", "--view", "cameras")
    assert shot.returncode == 0 and (tmp_path / "shot.png").stat().st_size > 1000, shot.stderr


def test_after_resuming_the_colmap_models_of_a_run_are_in_the_frame_of_its_scene(finished: Finished, tmp_path: Path) -> None:
    config, _, _ = finished
    run(config, lambda event: None, resume=True)
    scene = load_scene(config.out / "sfm" / "scene.safetensors")
    exported = radiant("export", config.out, tmp_path / "colmap", "--format", "colmap")
    assert exported.returncode == 0, exported.stderr
    for folder in (config.out / "sfm" / "undistorted" / "sparse", tmp_path / "colmap" / "sparse" / "0"):
        cameras = cameras_of(read_model(folder)).named(scene.cameras.names)
        # 1e-6 m: two ways through one similarity in float64, each written as float64.
        np.testing.assert_allclose(cameras.cam_from_world, scene.cameras.cam_from_world, atol=1e-6)


def test_a_run_is_extended_by_another_and_by_a_region_of_the_plan(finished: Finished, tmp_path: Path) -> None:
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


def test_after_an_extension_chunks_outside_the_changed_region_keep_their_bytes(finished: Finished, tmp_path: Path) -> None:
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


def test_a_scene_with_an_origin_of_its_own_is_extended_by_a_later_run(finished: Finished, tmp_path: Path) -> None:
    """Alone extends one run by another whose GPS gives another origin."""
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


def test_commands_refuse_what_is_damaged_or_taken(finished: Finished, tmp_path: Path) -> None:
    config, _, _ = finished
    copy = tmp_path / "copy"
    shutil.copytree(config.out, copy)
    edge = next((copy / "edges").iterdir())
    (edge / "task.json").write_text("null")
    (copy / "sfm" / "result.json").write_text("[]")
    (tmp_path / "plan.json").write_text("mine")
    cases = [
        (("join", copy, "--out", tmp_path / "a.ply"), "task.json is no JSON object"),
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
        result = (radiant if arguments is cases[0][0] else refused)(*arguments)
        assert result.returncode == 2, (arguments, result.stderr)
        assert told in result.stderr and "Traceback" not in result.stderr, (arguments, result.stderr)
    (edge / "task.json").unlink()
    assert refused("join", copy, "--out", tmp_path / "a.ply").returncode == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copy", "plan.json"]


def test_doctor_finds_what_a_run_needs() -> None:
    finished = radiant("machine", "check", "--json")
    findings = json.loads(finished.stdout)
    assert finished.returncode == 0
    assert all(finding["ok"] for finding in findings if finding["needed"]), findings
