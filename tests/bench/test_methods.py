"""`radiant bench methods`: every method on the same devices' models, kept by cell, scored by the same seams."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.methods.bench import METHODS, MethodBench, bench_methods, curves_of, methods_table
from benchmarks.methods.cells import Layout, ModelCache, bench_settings, deal_cell, layout_of, load_bench_scene, random_sites
from benchmarks.methods.rivals import RIVALS
from benchmarks.options import BenchOptions
from benchmarks.runner import run_bench
from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from tests.app.hamlet_views import add_off_path
from tests.bench.small_fields import LOG2_ENTRIES, RAYS_A_STEP

pytestmark = pytest.mark.usefixtures("short_rounds", "small_fields")
NUM_ENTRIES = 16 * 2**LOG2_ENTRIES


@pytest.fixture(scope="module")
def bench(hamlet_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> MethodBench:
    """Very small."""
    out = tmp_path_factory.mktemp("methods") / "out"
    return MethodBench(scene=hamlet_scene, out=out, long_side_px=64, num_steps=12, layout=Layout(num_edges=2, num_devices=1))


def test_all_methods_are_compared_and_rows_are_kept(bench: MethodBench) -> None:
    rows, metrics = bench_methods(replace(bench, methods=("crop", "paper", "ours", "ours edges", "photographs")))
    made = {row.arm: row for row in rows}
    assert list(made) == ["centralised", "crop", "paper", "ours", "ours edges", "photographs"]
    assert all(len(row.psnr_db) == 2 and np.isfinite(row.psnr_db).all() and row.num_gaussians > 100 for row in rows)
    # An edge with one device joins nothing, and the cloud leaves fitting to the devices.
    assert made["crop"].training_px == made["ours"].training_px == 0 < made["paper"].training_px
    assert made["crop"].num_gaussians < made["paper"].num_gaussians
    found = {metric.key: metric.value for metric in metrics}
    key = "methods.scene.ours.over_paper"
    assert found[f"{key}.low_db"] <= found[f"{key}.mean_db"] <= found[f"{key}.high_db"]
    assert found[f"{key}.mean_db"] == pytest.approx(np.mean(made["ours"].psnr_db) - np.mean(made["paper"].psnr_db))
    for name in ("", "cc_"):
        low, mean, high = (found[f"methods.scene.crop.over_centralised.{name}{figure}_db"] for figure in ("at_least", "mean", "high"))
        assert low <= mean <= high
    assert "methods.scene.ours.over_ours.mean_db" not in found and "methods.scene.crop.over_ours.mean_db" in found
    table = methods_table(rows)
    assert table.count("\n") == len(rows) + 1 and "| scene | ours |" in table
    flips = [value for value in made["ours"].flip if value is not None]
    flip = f"{np.mean(flips):.4f}" if len(flips) == 2 else "–"
    assert f"| scene | ours | {made['ours'].mean_psnr_db:.2f} | {np.mean(made['ours'].psnr_cc_db):.2f} | {flip} |" in table
    assert f"| scene | ours | {made['ours'].mean_psnr_db:.2f} | – | – |" in methods_table(
        [replace(row, flip=(), psnr_cc_db=()) for row in rows]
    )
    assert all(corrected >= plain - 1e-6 for row in rows for corrected, plain in zip(row.psnr_cc_db, row.psnr_db, strict=True))
    assert set(curves_of(rows)) == set(made)
    stamps = {path: path.stat().st_mtime_ns for path in (bench.out / "joined").iterdir()}
    again, _ = bench_methods(replace(bench, methods=("paper",)))
    assert [row for row in again if row.arm == "paper"] == [made["paper"]]
    assert stamps == {path: path.stat().st_mtime_ns for path in (bench.out / "joined").iterdir()}


def test_every_method_is_scored_at_views_that_were_never_flown(bench: MethodBench, tmp_path: Path) -> None:
    plain, _ = bench_methods(replace(bench, methods=("crop",)))
    rows, metrics = bench_methods(replace(bench, methods=("crop",), off_path=add_off_path(tmp_path, 2)))
    assert [replace(row, off_path=None) for row in rows] == plain
    assert all(row.off_path is not None and np.isfinite(row.off_path.psnr_db).all() for row in rows)
    assert rows[0].off_path != rows[1].off_path
    assert {"methods.scene.crop.off_path.haze", "methods.scene.centralised.off_path.lower.psnr_db"} <= {metric.key for metric in metrics}


def test_a_flight_line_is_held_out_beside_the_interleaved_split(bench: MethodBench) -> None:
    plain, _ = bench_methods(replace(bench, methods=("crop",)))
    rows, metrics = bench_methods(replace(bench, methods=("crop",), hold_out="both"))
    assert rows[:2] == plain and [(row.scene, row.arm) for row in rows[2:]] == [("scene-line", "centralised"), ("scene-line", "crop")]
    assert [len(row.psnr_db) for row in rows] == [2, 2, 5, 5] and all(len(row.flip) == len(row.psnr_db) for row in rows)
    assert bench_methods(replace(bench, methods=("crop",), hold_out="line"))[0] == rows[2:]
    found = {metric.key: metric.value for metric in metrics}
    assert found["methods.scene-line.crop.psnr_db"] == pytest.approx(rows[3].mean_psnr_db)
    assert found["methods.scene.crop.psnr_db"] == pytest.approx(rows[1].mean_psnr_db)
    assert "| scene-line | crop |" in methods_table(rows) and "scene-line: crop" in curves_of(rows)


def test_models_are_reduced_to_as_many_gaussians(bench: MethodBench) -> None:
    every, _ = bench_methods(replace(bench, methods=("crop", "ours")))
    most = min(row.num_gaussians for row in every)
    equal, _ = bench_methods(replace(bench, methods=("crop", "ours"), max_gaussians=most))
    assert [row.num_gaussians for row in equal] == [most] * 3
    # The smallest is the same; what shows least costs the others little, but something.
    losses_db = [np.mean(row.psnr_db) - np.mean(less.psnr_db) for row, less in zip(every, equal, strict=True)]
    assert min(losses_db) == 0 and 0.01 < max(losses_db) < 5
    assert [row.cpu_s for row in equal] == [row.cpu_s for row in every]  # nothing was joined again


def test_one_device_has_all_photographs_and_its_own_steps(bench: MethodBench) -> None:
    rows, _ = bench_methods(replace(bench, methods=("one device",)))
    whole, alone = rows
    assert (whole.arm, alone.arm) == ("centralised", "one device")
    assert 0 < alone.training_px < whole.training_px and alone.psnr_db != whole.psnr_db
    mean = alone.training_px * bench.layout.num_edges * bench.layout.num_devices if bench.layout else 0
    assert mean == pytest.approx(whole.training_px, rel=0.2), "as many as each of the devices, which make up the other's"


def test_one_model_of_all_has_room_for_as_many_gaussians_as_all_devices(hamlet_scene: Path, tmp_path: Path) -> None:
    scene, settings = load_bench_scene(hamlet_scene, 64), bench_settings(64, 200)
    settings = replace(settings, train=replace(settings.train, max_num_splats=150))
    cell = deal_cell(scene, ModelCache(folder=tmp_path), settings, Layout(num_edges=2, num_devices=1))
    own = [len(model.splats) for model in cell.devices.values()]
    assert max(own) <= 150 < len(cell.centralised_model.splats) <= 300


def test_rivals_train_and_join_on_the_same_work(bench: MethodBench) -> None:
    rows, _ = bench_methods(replace(bench, methods=("even", "vastgaussian")))
    made = {row.arm: row for row in rows}
    assert set(made) == {"centralised", "even", "vastgaussian"}
    assert made["vastgaussian"].training_px > 0 and made["even"].num_gaussians > 100


def test_fields_and_federated_rivals_are_made_when_they_are_named(bench: MethodBench) -> None:
    named = replace(bench, methods=("mega-nerf", "fednerf", "f3dgs"), field_steps=6)
    rows, metrics = bench_methods(named)
    made = {row.arm: row for row in rows}
    assert list(made) == ["centralised", "mega-nerf", "fednerf", "f3dgs"]
    assert all(len(row.psnr_db) == 2 and np.isfinite(row.psnr_db).all() for row in rows)
    # Mega: two fields of 16 tables of pairs, and their networks; one field for FedNeRF.
    assert (
        made["mega-nerf"].num_parameters == 2 * made["fednerf"].num_parameters > 2 * NUM_ENTRIES * 2
        and made["mega-nerf"].num_gaussians == 0
    )
    assert made["mega-nerf"].training_px == 6 * RAYS_A_STEP and made["f3dgs"].num_gaussians > 100
    assert len(made["fednerf"].rounds) == 3 and made["fednerf"].rounds[0].psnr_db is None
    # Two clients send a field, and a number for each entry of its grid, in 4 bytes each.
    assert made["fednerf"].rounds[0].sent_bytes == 2 * 4 * (made["fednerf"].num_parameters + NUM_ENTRIES)
    assert len(made["f3dgs"].rounds) == 5 and made["f3dgs"].rounds[-1].psnr_db == pytest.approx(made["f3dgs"].mean_psnr_db, abs=1e-3)
    table = methods_table(rows)
    assert "numbers |" in table and "| | f3dgs, round 5 |" in table and "MB sent" in table
    assert set(curves_of(rows)) == {"centralised", "f3dgs"}
    assert "methods.scene.mega-nerf.num_parameters" in {metric.key for metric in metrics}
    stamps = {path: path.stat().st_mtime_ns for path in (bench.out / "joined").iterdir()}
    assert bench_methods(replace(named, max_gaussians=200))[0][1] == made["mega-nerf"]
    assert bench_methods(named)[0] == rows
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())
    longer = bench_methods(replace(named, methods=("mega-nerf",), field_steps=4))[0][1]
    assert longer.training_px == 4 * RAYS_A_STEP


def test_a_layout_is_edges_times_devices() -> None:
    assert layout_of("3x2") == Layout(num_edges=3, num_devices=2) and str(layout_of("3x2")) == "3x2"
    three = layout_of("3x2")
    assert three is not None and len(three.system().devices) == 6 and layout_of("run") is None
    for wrong in ("", "2", "2x", "0x2", "2x2x2", "axb", "-1x2"):
        with pytest.raises(BadInput, match="layout"):
            layout_of(wrong)


def test_random_sites_are_apart_inside_the_hull_and_make_other_plans() -> None:
    grid = np.stack(np.meshgrid(np.arange(8.0), np.arange(6.0)), axis=-1).reshape(-1, 2) * 10
    dealt = set()
    for placement in range(1, 6):
        sites = random_sites(grid, 2, placement)
        assert np.array_equal(sites, random_sites(grid, 2, placement))
        assert (sites >= -1).all() and (sites <= [71, 51]).all() and np.hypot(*(sites[0] - sites[1])) > 25
        plan = plan_regions(grid, place_edges(Layout(num_edges=2, num_devices=2).system(sites=sites), grid, None, 0), method="exact")
        assert isinstance(plan, CloudPlan)
        dealt.add(frozenset(tuple(np.flatnonzero(plan.edge_of_camera == edge)) for edge in (0, 1)))
    assert len(dealt) == 5
    for crowded in (np.zeros((3, 2)), np.arange(10.0)[:, None] * [[3.0, 1.0]]):
        assert random_sites(crowded, 4, 1).shape == (4, 2)


def test_unknown_methods_are_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=f"'magic' is unknown: use {', '.join((*METHODS, *RIVALS))}"):
        MethodBench(scene=tmp_path, out=tmp_path, methods=("ours", "magic"))
    with pytest.raises(BadInput, match=r"radiant sfm"):
        bench_methods(MethodBench(scene=tmp_path, out=tmp_path / "out"))
    with pytest.raises(BadInput, match="no edge that received models"):
        bench_methods(MethodBench(scene=tmp_path, out=tmp_path / "out", layout=layout_of("run")))


def test_the_command_prints_a_table_and_draws_a_picture(bench: MethodBench, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    methods = ("crop", "ours")
    run_bench("methods", None, BenchOptions(quick=True, scene=bench.scene, out=tmp_path, methods=methods, plot=tmp_path / "joining.png"))
    assert "| scene | ours |" in capsys.readouterr().out
    assert (tmp_path / "joining.png").stat().st_size > 10_000
    for options, told in (
        ({"scene": bench.scene}, "needs --scene"),
        ({"scene": bench.scene, "out": tmp_path, "presets": ("default",)}, "--preset"),
        ({"scene": bench.scene, "out": tmp_path, "max_gaussians": 0}, "expected at least 1"),
        ({"scene": bench.scene, "out": tmp_path, "layout": "run", "num_seeds": 2}, "leave out --seeds"),
        ({"scene": bench.scene, "out": tmp_path, "layout": "run", "hold_out": "line"}, "leave out --hold-out"),
    ):
        with pytest.raises(BadInput, match=told):
            run_bench("methods", None, BenchOptions(**options))
    with pytest.raises(BadInput, match="--max-gaussians is for"):
        run_bench("plan", None, BenchOptions(max_gaussians=5))
    with pytest.raises(BadInput, match="--out is for train, methods, paper"):
        run_bench("plan", None, BenchOptions(out=tmp_path))
