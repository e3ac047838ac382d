"""`radiant bench paper`: one page of all parts from models that are made once; its figures are those of the models they name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shapely import LineString, Polygon

from benchmarks.methods.arms import load_arms
from benchmarks.methods.bench import METHODS, epochs_arm
from benchmarks.methods.cells import Layout, bench_settings
from benchmarks.methods.together import TOGETHER
from benchmarks.options import BenchOptions
from benchmarks.paper import table as paper_table
from benchmarks.paper.bench import BY_NAME, PAGE_ORDER, PARTS, PaperBench, bench_paper
from benchmarks.paper.parts import _worst_window, border_length_m
from benchmarks.paper.published import MILL_19
from benchmarks.runner import run_bench
from radiant_core.errors import BadInput
from radiant_core.evaluate.lpips import load_lpips
from radiant_core.io.run_store import read_json
from radiant_core.render.rendered_view import render_views
from tests.app.alex_weights import write_alex_weights

pytestmark = pytest.mark.usefixtures("short_rounds", "small_fields")


def test_a_page_of_every_part_is_made_once_and_kept(hamlet_scene: Path, paper_models: Path) -> None:
    bench = PaperBench(scene=hamlet_scene, out=paper_models, long_side_px=48, num_steps=8, quick=True)
    metrics = bench_paper(bench)
    page = (bench.out / "paper.md").read_text()
    record = read_json(bench.out / "paper.json")
    assert (
        page.count("\n## ") == len(PAGE_ORDER) - len(BY_NAME) == len(record["parts"])
        and "Scene scene: 10 photographs to train on, 2 held out" in page
    )
    for name in ("main", "regions", "epochs", "balance", "border", "costs", "convergence", "partitions"):
        assert f"({name}.png)" in page and (bench.out / f"{name}.png").stat().st_size > 5_000
    assert "Band and interior are insufficient: borders lie in" in page
    rows = {row["arm"]: row for row in record["parts"]["main"]["figures"]}
    assert set(rows) == {*METHODS} - {"ours edges", "fed3dgs", *(arm.name for arm in TOGETHER)}
    # After so short trainings the cloud leaves fitting to the devices.
    assert rows["crop"]["training_px"] == 0 <= rows["ours"]["training_px"] < rows["paper"]["training_px"]
    planned = record["parts"]["plan"]["figures"]
    assert planned["costs"]["photographs"] == [2, 5, 10]
    assert set(planned["convergence"]) == {"exact", "paper", "paper-halved", "paper-literal"}
    balance = record["parts"]["balance"]["figures"]
    for devices in balance["devices"].values():
        assert sum(device["num_photographs"] for device in devices) == 10
    slowest = {name: max(device["cpu_s"] / device["speed"] for device in own) for name, own in balance["devices"].items()}
    assert balance["saved_percent"]["measured"] == pytest.approx(100 * (1 - slowest["balanced"] / slowest["even"]))
    found = {metric.key: metric.value for metric in metrics}
    assert found["paper.scene.main.scene-2x1-p0-s0.ours.psnr_db"] == pytest.approx(np.mean(rows["ours"]["psnr_db"]))
    stamps = {path: path.stat().st_mtime_ns for folder in ("models", "joined") for path in (bench.out / folder).iterdir()}
    again = {metric.key: metric.value for metric in bench_paper(replace(bench, parts=("balance",)))}
    assert again == {key: value for key, value in found.items() if ".balance." in key}
    assert (bench.out / "paper.md").read_text().count("\n## ") == 1
    assert stamps == {path: path.stat().st_mtime_ns for folder in ("models", "joined") for path in (bench.out / folder).iterdir()}


def test_the_main_table_is_made_row_by_row_and_no_row_twice(
    hamlet: Path, hamlet_scene: Path, paper_models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = paper_table.table_methods(2)
    assert [method.name.removesuffix("-style") for method in every] == [*MILL_19, "F3DGS"]
    some = ("3DGS", "Mega-NeRF-style", "Fed3DGS", "Even, system 1", "F3DGS-style")
    monkeypatch.setattr(paper_table, "table_methods", lambda steps: [method for method in every if method.name in some])
    bench = PaperBench(scene=hamlet_scene, out=paper_models, parts=("table2",), long_side_px=48, num_steps=8, quick=True, field_steps=2)
    found = {metric.key: metric.value for metric in bench_paper(bench)}
    rows = {row["method"]: row for row in read_json(bench.out / "paper.json")["parts"]["table2"]["figures"]["table"]}
    assert tuple(rows) == some and all(np.isfinite(row["psnr_db"]) and row["lpips"] is None for row in rows.values())
    trained = load_arms(hamlet_scene, bench.out, Layout(num_edges=2, num_devices=1), bench_settings(48, 8)).scene.training.cameras.names
    photographs = sum((hamlet / name).stat().st_size for name in trained)
    assert rows["3DGS"]["sent_bytes"] == rows["Mega-NeRF-style"]["sent_bytes"] == photographs > 0
    assert rows["Mega-NeRF-style"]["num_gaussians"] == 0 < rows["Mega-NeRF-style"]["num_parameters"]
    emulated = {name for name, row in rows.items() if row["scene_s"] is not None}
    assert emulated == {"Fed3DGS", "Even, system 1"} and rows["Even, system 1"]["privacy"] and not rows["Fed3DGS"]["privacy"]
    page = (bench.out / "table2.md").read_text()
    assert "not made yet" not in page and "give --lpips-weights" in page and "| the paper, Mill 19 |" in page
    assert found["paper.scene.table2.s0.Mega-NeRF-style.psnr_db"] == rows["Mega-NeRF-style"]["psnr_db"]
    stamps = {path: path.stat().st_mtime_ns for folder in ("models", "joined") for path in (bench.out / folder).iterdir()}
    bench_paper(replace(bench, lpips=load_lpips(write_alex_weights(tmp_path / "alex.safetensors"), "alex")))
    scored = {row["method"]: row for row in read_json(bench.out / "paper.json")["parts"]["table2"]["figures"]["table"]}
    assert all(row["lpips"] > 0 for row in scored.values())
    assert {name: {**row, "lpips": None} for name, row in scored.items()} == rows
    again = {path: path.stat().st_mtime_ns for folder in ("models", "joined") for path in (bench.out / folder).iterdir()}
    assert {path.name for path in again if again[path] != stamps.get(path)} == {path.name for path in again if "perceptual" in path.name}


def test_a_row_that_is_not_made_stands_there_as_not_made(hamlet_scene: Path, tmp_path: Path) -> None:
    arms = load_arms(hamlet_scene, tmp_path, Layout(num_edges=2, num_devices=1), bench_settings(48, 8))
    lines = paper_table.table_lines(arms, paper_table.table_methods(1), {})
    assert sum("not made yet" in line for line in lines) == 13
    assert "| hierarchical | Radiant, system 2 | not made yet | – | – | – | – | – | – | – | – | yes | yes |" in lines
    assert "| FedNeRF | 20.12, –, – | 17.51, –, – |" in lines


def test_seeds_of_fields_are_made_last(hamlet_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arms = load_arms(hamlet_scene, tmp_path, Layout(num_edges=2, num_devices=1), bench_settings(48, 8))
    made: list[tuple[int, str]] = []

    def row_figures(arms: object, cell: object, method: paper_table.Method, seed: int) -> paper_table.Figures:
        made.append((seed, method.name))
        if len(made) > 13 + 2 * 8:
            raise InterruptedError
        facts = {name: getattr(method, name) for name in ("architecture", "scalability", "privacy")}
        figures = {
            "psnr_db": 20.0,
            "ssim": 0.5,
            "lpips": None,
            "flip": 0.2,
            "cpu_s": 1.0,
            "sent_bytes": 1,
            "num_gaussians": 1,
            "num_parameters": 0,
        }
        return paper_table.Figures(
            method=method.name, seed=seed, cell="c", arm="a", scene_s=None, psnr_of_each_db=(20.0, 20.0 + seed), **facts, **figures
        )

    monkeypatch.setattr(paper_table, "row_figures", row_figures)
    monkeypatch.setattr(paper_table, "system_cell", lambda *arguments: arms.first)
    monkeypatch.setattr(paper_table, "_costs", lambda *arguments: None)
    monkeypatch.setattr(type(arms), "cell", lambda *arguments: arms.first)
    with pytest.raises(InterruptedError):
        paper_table.table_part(arms, range(3), quick=False)
    fields = {"GP-NeRF-style", "Switch-NeRF-style", "Drone-NeRF-style", "Mega-NeRF-style", "FedNeRF-style"}
    assert {seed for seed, _ in made[:13]} == {0} and not fields & {name for _, name in made[13:-1]}
    assert [seed for seed, _ in made[13:]] == [1] * 8 + [2] * 8 + [1] and made[-1][1] in fields
    page = (tmp_path / "table2.md").read_text()
    assert "Not of all seeds yet: GP-NeRF-style (1), Switch-NeRF-style (1)," in page and "Means over seeds (0, 1, 2)" in page


def test_rows_of_several_seeds_are_means_compared_by_seed(hamlet_scene: Path, paper_models: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    every = paper_table.table_methods(2)
    some = ("3DGS", "Even, system 1")
    monkeypatch.setattr(paper_table, "table_methods", lambda steps: [method for method in every if method.name in some])
    monkeypatch.setattr(paper_table, "COMPARED", "Even, system 1")
    bench_paper(PaperBench(scene=hamlet_scene, out=paper_models, parts=("table2",), num_seeds=2, long_side_px=48, num_steps=8, quick=True))
    table = read_json(paper_models / "paper.json")["parts"]["table2"]["figures"]["table"]
    psnr_db = {(row["method"], row["seed"]): row["psnr_db"] for row in table}
    assert set(psnr_db) == {(name, seed) for name in some for seed in (0, 1)} and len(set(psnr_db.values())) == 4
    page = (paper_models / "table2.md").read_text().splitlines()
    first, second = (next(line.split(" | ") for line in page if f" | {name} | " in line) for name in some)
    assert second[2:4] == [f"{np.mean([psnr_db['Even, system 1', seed] for seed in (0, 1)]):.2f}", "–"]
    ahead = np.mean([psnr_db["3DGS", seed] - psnr_db["Even, system 1", seed] for seed in (0, 1)])
    mean, low, _, high = first[3].replace("(", "").replace(")", "").split()
    assert float(mean) == pytest.approx(ahead, abs=0.0051) and float(low) < ahead < float(high)


def test_kept_figures_are_those_of_the_kept_model(hamlet_scene: Path, paper_models: Path) -> None:
    layout = Layout(num_edges=2, num_devices=1)
    arms = load_arms(hamlet_scene, paper_models, layout, bench_settings(48, 8))
    cell = arms.first
    row = arms.row(cell, METHODS["crop"])
    assert epochs_arm("ours", 0).name == epochs_arm("paper", 0).name == "crop"
    assert (epochs_arm("paper", 10).name, epochs_arm("ours", 4).name) == ("paper 10 epochs", "ours 4 epochs")
    views = arms.views(cell, METHODS["crop"])
    errors = [((view.image - photograph) ** 2).mean() for view, photograph in zip(views, arms.photographs, strict=True)]
    np.testing.assert_allclose(row.psnr_db, -10 * np.log10(errors), rtol=1e-5)
    reference = render_views(cell.centralised_model.splats, arms.scene.held_out_views.cameras)
    assert [mask.labels.shape for mask in arms.masks(cell)] == [view.depth.shape for view in reference]
    for layout in (Layout(num_edges=2, num_devices=1), Layout(num_edges=2, num_devices=2)):
        recipe = arms.cell(layout).recipe
        plan, edge_plans = recipe.cloud_plan, recipe.edge_plans
        outlines = [strip for own in edge_plans for strip in own.strips if len(strip)]
        # Lines inside the scene's outline, found by shapely from the strips alone.
        whole = Polygon(np.concatenate(outlines)).convex_hull
        rings = [LineString([*strip, strip[0]]) for strip in outlines]
        inner = sum(ring.difference(whole.boundary.buffer(1e-6)).length for ring in rings) / 2
        assert border_length_m(plan, edge_plans) == pytest.approx(inner, rel=1e-4) and inner > 0


def test_the_worst_window_is_where_the_errors_are() -> None:
    errors = [np.zeros((20, 40)), np.zeros((20, 40)), np.zeros((20, 40))]
    errors[0][3, 3], errors[1][9:11, 20:24], errors[2] = 5.0, 1.0, errors[2] - 1
    assert _worst_window(errors) == (1, (slice(5, 14), slice(11, 29)))
    errors[1][19, 39] = 20.0
    assert _worst_window(errors) == (1, (slice(11, 20), slice(22, 40)))
    assert errors[1][11:20, 22:40].sum() == 20 and _worst_window(errors[2:])[0] == 0
    assert _worst_window([np.zeros((1, 1))]) == (0, (slice(0, 1), slice(0, 1)))


def test_what_is_wrong_is_told_before_anything_is_made(hamlet_scene: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=f"'magic' of the paper's figures is unknown: use {', '.join(PARTS)}"):
        PaperBench(scene=hamlet_scene, out=tmp_path, parts=("main", "magic"))
    assert {*PAGE_ORDER} == {*PARTS} - {"fed3dgs"}
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="is a file: name a folder"):
        bench_paper(PaperBench(scene=hamlet_scene, out=tmp_path / "file"))
    for options, told in (
        ({"scene": hamlet_scene}, "paper needs --scene"),
        ({"scene": hamlet_scene, "out": tmp_path, "num_placements": 2}, "--placements"),
    ):
        with pytest.raises(BadInput, match=told):
            run_bench("paper", None, BenchOptions(**options))
