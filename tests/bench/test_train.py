"""`radiant bench train`: every preset at its budgets and at half of them, differences with bounds, ablations, the picture."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from benchmarks.off_path import load_off_path
from benchmarks.options import BenchOptions
from benchmarks.runner import run_bench
from benchmarks.train import (
    TrainBench,
    TrainedRow,
    _by_seed_and_image,
    _load,
    _train_row,
    bench_of,
    bench_train,
    curves_of,
    split_source,
)
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.splats import Splats
from radiant_core.train.config import train_preset
from tests.app.hamlet_views import add_off_path


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The hamlet as a COLMAP project: nothing has to be reconstructed."""
    folder = tmp_path_factory.mktemp("bench") / "hamlet"
    shutil.copytree(sample_scenes_folder() / "hamlet" / "images", folder / "images")
    shutil.copytree(sample_scenes_folder() / "hamlet" / "known", folder / "sparse" / "0")
    return folder


def test_presets_meet_at_their_budgets_and_the_difference_has_bounds(project: Path) -> None:
    rows, metrics = bench_train(TrainBench(scene=project, budgets_s=(0.8,), seeds=(0, 1), long_side_px=96))
    assert {(row.variant, row.budget_s, row.seed) for row in rows} == {
        (variant, budget_s, seed) for variant, budget_s in (("default", 0.4), ("default", 0.8), ("standard", 0.8)) for seed in (0, 1)
    }
    for row in rows:
        # A budget ends with the step that exceeds it, and first points are placed whatever they
        # take.
        assert row.num_steps > 0 and row.num_gaussians > 100 and len(row.psnr_db) == 2 and row.cpu_s < row.budget_s + 2
    found = {metric.key: metric.value for metric in metrics}
    assert found["train.hamlet.default.0.8s.psnr_db"] == pytest.approx(
        sum(row.mean_psnr_db for row in rows if (row.variant, row.budget_s) == ("default", 0.8)) / 2
    )
    for label, mark in product(("equal_time", "half_time"), ("", "cc_")):
        key = f"train.hamlet.default.0.8s.over_standard_at_{label}.{mark}"
        assert found[f"{key}low_db"] <= found[f"{key}mean_db"] <= found[f"{key}high_db"]
        assert found[f"{key}at_least_db"] <= found[f"{key}mean_db"]
    # A correction of colours that may change nothing can only help.
    assert all(row.mean_psnr_cc_db > row.mean_psnr_db - 0.1 for row in rows)
    curves = curves_of(rows)
    assert {name: len(points) for name, points in curves.items()} == {"default": 4, "standard": 2}


def test_more_splits_hold_out_other_photographs_and_all_of_them_are_compared(project: Path) -> None:
    bench = TrainBench(scene=project, budgets_s=(0.4,), splits=(0, 1), seeds=(0,), long_side_px=96)
    rows, metrics = bench_train(bench)
    assert {(row.split, row.seed) for row in rows if row.variant == "standard"} == {(0, 0), (1, 0)}
    splits = [split_source(_load(project, project), "interleaved", first, bench) for first in (0, 1)]
    names = [set(split.held_out.cameras.names) for split in splits]
    assert not names[0] & names[1] and all(not own & set(split.training.cameras.names) for own, split in zip(names, splits, strict=True))
    means = [
        np.mean([row.psnr_db for row in rows if (row.variant, row.budget_s, row.split) == ("default", 0.2, split)]) for split in (0, 1)
    ]
    references = [np.mean([row.psnr_db for row in rows if (row.variant, row.split) == ("standard", split)]) for split in (0, 1)]
    found = {metric.key: metric.value for metric in metrics}
    # The hamlet holds out as many photographs in either split.
    expected = np.mean(means) - np.mean(references)
    assert found["train.hamlet.default.0.4s.over_standard_at_half_time.mean_db"] == pytest.approx(expected)


def test_figures_are_paired_by_seed_split_and_image() -> None:
    def row(seed: int, split: int, psnr_db: tuple[float, ...]) -> TrainedRow:
        counts = {"cpu_s": 1.0, "num_steps": 1, "num_gaussians": 1}
        return TrainedRow(variant="default", budget_s=1.0, seed=seed, psnr_db=psnr_db, psnr_cc_db=psnr_db, split=split, **counts)

    rows = [row(1, 1, (14.0, 15.0)), row(0, 0, (1.0, 2.0, 3.0)), row(1, 0, (11.0, 12.0, 13.0)), row(0, 1, (4.0, 5.0))]
    np.testing.assert_array_equal(_by_seed_and_image(rows, "psnr_db"), [[1, 2, 3, 4, 5], [11, 12, 13, 14, 15]])


def test_more_splits_than_a_set_allows_are_refused_with_what_it_allows(project: Path) -> None:
    with pytest.raises(BadInput, match=r"12 placed photographs, of which split 5 holds out 1, .*: ask for 4 splits\."):
        bench_train(TrainBench(scene=project, budgets_s=(0.4,), splits=tuple(range(8)), long_side_px=96))
    assert bench_of(BenchOptions(num_splits=3)).splits == (0, 1, 2)


def test_ablations_are_paired_with_the_whole(project: Path) -> None:
    changes = {"no densification": {"density.kind": "none"}, "as it is": {}}
    bench = TrainBench(scene=project, presets=("default",), budgets_s=(0.5,), seeds=(0,), long_side_px=96, ablations=True, changes=changes)
    rows, metrics = bench_train(bench)
    assert [row.variant for row in rows] == ["default", "no densification"]
    keys = {metric.key for metric in metrics}
    assert "train.hamlet.no_densification.0.5s.over_default.mean_db" in keys
    assert not any("as_it_is" in key for key in keys)


def test_rows_that_are_there_are_not_measured_again(project: Path, tmp_path: Path) -> None:
    bench = TrainBench(scene=project, presets=("default",), budgets_s=(0.4,), long_side_px=96, out=tmp_path)
    first, _ = bench_train(bench)
    records = sorted((tmp_path / "rows").iterdir())
    assert len(records) == len(first) == 2
    again, metrics = bench_train(bench)
    assert again == first and metrics
    records[0].unlink()
    bench_train(bench)
    assert records[0].is_file()


def test_masked_pixels_are_neither_trained_on_nor_scored(tmp_path: Path) -> None:
    project = tmp_path / "hamlet"
    shutil.copytree(sample_scenes_folder() / "hamlet" / "images", project / "images")
    shutil.copytree(sample_scenes_folder() / "hamlet" / "known", project / "sparse" / "0")
    source = _load(project, tmp_path)
    assert source.masks is None
    masks = _masks_of_the_left_half(tmp_path / "masks", project / "images")
    config = replace(train_preset("default"), long_side_px=96)
    whole = _train_row(split_source(source, "interleaved", 0, TrainBench(scene=project)), "default", config, 0.3, 0)
    masked = _train_row(split_source(replace(source, masks=masks), "interleaved", 0, TrainBench(scene=project)), "default", config, 0.3, 0)
    assert np.isfinite(masked.psnr_db).all() and masked.psnr_db != whole.psnr_db


def _masks_of_the_left_half(folder: Path, images: Path) -> Path:
    folder.mkdir()
    for image in images.iterdir():
        photograph = cv2.imread(str(image))
        assert photograph is not None
        height, width = photograph.shape[:2]
        mask = np.zeros((height, width), np.uint8)
        mask[:, : width // 2] = 255
        cv2.imwrite(str(folder / f"{image.stem}.png"), mask)
    return folder


def test_the_command_writes_figures_and_a_picture(project: Path, tmp_path: Path) -> None:
    options = BenchOptions(quick=True, scene=project, budgets_s=(0.4,), long_side_px=96, plot=tmp_path / "curves.png")
    run_bench("train", tmp_path / "train.json", options)
    rows = json.loads((tmp_path / "train.json").read_text())
    assert any(row["key"] == "train.hamlet.standard.0.4s.num_gaussians" for row in rows)
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")


def test_options_that_do_not_belong_together_are_refused(project: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="--budget is for train, not for raster"):
        run_bench("raster", None, BenchOptions(budgets_s=(1.0,)))
    with pytest.raises(BadInput, match="there is no folder"):
        run_bench("train", None, BenchOptions(scene=project, plot=tmp_path / "nowhere" / "a.png"))
    with pytest.raises(BadInput, match="give one or more of each"):
        TrainBench(scene=project, budgets_s=(float("nan"),))
    with pytest.raises(BadInput, match="--splits is for train"):
        run_bench("raster", None, BenchOptions(num_splits=2))
    with pytest.raises(BadInput, match="train preset 'best' is unknown"):
        bench_train(TrainBench(scene=project, presets=("best",), budgets_s=(0.1,)))
    with pytest.raises(BadInput, match="ablation 'no magic' is unknown"):
        bench_of(BenchOptions(ablations=True, methods=("no magic",)))
    with pytest.raises(BadInput, match="give --ablations as well"):
        bench_of(BenchOptions(methods=("no sky",)))
    assert list(bench_of(BenchOptions(ablations=True, methods=("no sky",))).changes) == ["no sky"]
    assert bench_of(BenchOptions(ablations=True)).seeds == (0, 1, 2) and bench_of(BenchOptions()).budgets_s == (60.0, 180.0, 600.0)


@pytest.fixture(scope="module")
def off_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four views of the hamlet that were never flown."""
    return add_off_path(tmp_path_factory.mktemp("off_path"), 4)


def test_a_model_is_scored_at_views_that_were_never_flown(project: Path, off_path: Path, tmp_path: Path) -> None:
    bench = TrainBench(scene=project, presets=("default",), budgets_s=(0.8,), long_side_px=96, off_path=off_path, out=tmp_path)
    rows, metrics = bench_train(bench)
    for row in rows:
        assert row.off_path is not None and row.off_path.kinds == ("across", "half", "lower", "street")
        assert all(8 < value < 40 for value in row.off_path.psnr_db) and np.mean(row.off_path.psnr_db) < row.mean_psnr_db
        assert all(share is None or 0 <= share <= 1 for share in row.off_path.haze)
    found = {metric.key: metric.value for metric in metrics}
    assert found["train.hamlet.default.0.8s.off_path.psnr_db"] == pytest.approx(rows[-1].off_path.mean("psnr_db"))  # pyright: ignore
    assert found["train.hamlet.off_path.center_residual"] < 0.01 and found["train.hamlet.off_path.rotation_residual"] < 0.01
    assert bench_train(bench)[0] == rows


def test_views_follow_the_scene_into_its_frame_and_foreign_ones_are_refused(project: Path, off_path: Path) -> None:
    cameras = _load(project, project).scene.cameras
    angle = np.radians(40.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    move = Sim3(scale=0.3, rotation=turn, translation=np.array([5.0, -7.0, 2.0]))
    moved = replace(cameras, cam_from_world=move.apply_to_poses(cameras.cam_from_world))
    here, there = load_off_path(off_path, cameras, 96), load_off_path(off_path, moved, 96)
    np.testing.assert_allclose(there.cameras.centers, move.apply(here.cameras.centers), atol=1e-6)
    np.testing.assert_allclose(there.truths[0][0], 0.3 * here.truths[0][0], rtol=1e-9)
    np.testing.assert_array_equal(there.truths[0][1], here.truths[0][1])
    bent = cameras.cam_from_world.copy()
    bent[3, :3, 3] += 2.0
    with pytest.raises(BadInput, match="off those of"):
        load_off_path(off_path, replace(cameras, cam_from_world=bent), 96)
    turned = cameras.cam_from_world.copy()
    turned[3, :3] = turn @ turned[3, :3]
    with pytest.raises(BadInput, match="off those of"):
        load_off_path(off_path, replace(cameras, cam_from_world=turned), 96)
    with pytest.raises(BadInput, match="shares 2 cameras"):
        load_off_path(off_path, cameras.select([0, 1]), 96)
    with pytest.raises(BadInput, match="holds no known/"):
        load_off_path(project, cameras, 96)


def test_a_model_of_the_truth_has_little_haze_and_an_empty_one_is_all_haze(project: Path, off_path: Path) -> None:
    views = load_off_path(off_path, _load(project, project).scene.cameras, 64)
    points = []
    for (depth, _), K, pose in zip(views.truths, views.cameras.Ks, views.cameras.cam_from_world, strict=True):
        rows, columns = np.nonzero(np.isfinite(depth))
        rays = np.column_stack([columns + 0.5, rows + 0.5, np.ones(len(rows))]) @ np.linalg.inv(K).T
        points.append((rays * depth[rows, columns][:, None] - pose[:3, 3]) @ pose[:3, :3])
    # Small opaque dots where the views see the surface: each view's own pixels are covered.
    means = np.concatenate(points).astype(np.float32)
    count = len(means)
    nearest = KDTree(views.cameras.centers).query(means)[0]
    dots = Splats(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        log_scales=np.repeat(np.log(0.4 * nearest / views.cameras.Ks[0, 0, 0])[:, None], 3, axis=1).astype(np.float32),
        logit_opacities=np.full(count, 5.0, np.float32),
        sh0=np.zeros((count, 1, 3), np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )
    true, empty = views.score(dots), views.score(dots.select(np.zeros(0, np.int64)))
    assert true.mean("haze") < 0.25 and empty.mean("haze") == empty.mean("haze_seen") == 1.0  # pyright: ignore


def test_a_whole_flight_line_is_held_out(tmp_path: Path) -> None:
    project = tmp_path / "town"
    (project / "images").mkdir(parents=True)
    shutil.copytree(sample_scenes_folder() / "town" / "known", project / "sparse" / "0")
    for path in (sample_scenes_folder() / "town" / "images").iterdir():
        (project / "images" / path.name).symlink_to(path)
    source = _load(project, tmp_path)
    split = split_source(source, "line", 0, TrainBench(scene=project))
    numbers = sorted(int(name[6:10]) for name in split.held_out.cameras.names)
    assert len(numbers) >= 4 and np.ptp(numbers) == len(numbers) - 1
    assert np.ptp(split.held_out.cameras.centers[:, 0]) > 5 * np.ptp(split.held_out.cameras.centers[:, 1])
    with pytest.raises(BadInput, match="ask for at most"):
        split_source(source, "line", 50, TrainBench(scene=project))


def test_a_flight_line_is_reported_beside_the_interleaved_split(project: Path, tmp_path: Path) -> None:
    bench = TrainBench(scene=project, presets=("default",), budgets_s=(0.4,), long_side_px=96, hold_out="both", out=tmp_path)
    rows, metrics = bench_train(bench)
    assert [(row.part, row.budget_s) for row in rows] == list(product(("interleaved", "line"), (0.2, 0.4)))
    assert [len(row.psnr_db) for row in rows] == [2, 2, 5, 5] and all(len(row.flip) == len(row.psnr_db) for row in rows)
    found = {metric.key: metric.value for metric in metrics}
    for scene, row in (("hamlet", rows[1]), ("hamlet-line", rows[3])):
        assert found[f"train.{scene}.default.0.4s.psnr_db"] == pytest.approx(row.mean_psnr_db)
        if None not in row.flip:
            assert found[f"train.{scene}.default.0.4s.flip"] == pytest.approx(np.mean(np.array(row.flip, float)))
    assert set(curves_of(rows)) == {"interleaved: default", "line: default"}
    assert bench_train(bench)[0] == rows
    alone, _ = bench_train(replace(bench, hold_out="line"))
    assert alone == rows[2:] and set(curves_of(alone)) == {"default"}
