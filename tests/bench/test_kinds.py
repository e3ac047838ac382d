"""`radiant bench kinds`: two kinds of scenes made by the generator, the default against plain, resumed rows, gains with bounds."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import generate
from benchmarks.kinds import scenes as kind_scenes
from benchmarks.kinds.bench import (
    DEFAULT,
    HELPERS,
    PLAIN,
    PLAIN_LONGER,
    QUICK,
    KindRow,
    KindsBench,
    bench_kinds,
    bench_of,
    markdown,
)
from benchmarks.kinds.rows import cases_of, gains_of
from benchmarks.kinds.scenes import KINDS, make_scene
from benchmarks.kinds.statistics import statistics_tables
from benchmarks.options import BenchOptions
from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_model
from radiant_core.train.config import train_preset, with_settings
from scenegen.flight import plan_flight

BENCH = KindsBench(
    out=Path(), kinds=QUICK["kinds"], numbers=(24,), helpers=("sky", "skipped images"), long_side_px=96, num_steps=QUICK["num_steps"]
)
MARGIN_DB = 0.5
"""Two trainings of a scene this small that differ in their seed alone are up to 0.4 dB apart."""


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[KindsBench, list[KindRow]]:
    bench = replace(BENCH, out=tmp_path_factory.mktemp("kinds"))
    return bench, bench_kinds(bench)[0]


def test_the_default_is_not_worse_than_plain(measured: tuple[KindsBench, list[KindRow]]) -> None:
    bench, rows = measured
    arms = (DEFAULT, PLAIN, PLAIN_LONGER, *bench.helpers)
    assert [(row.kind, row.arm) for row in rows] == [(kind, arm) for kind in bench.kinds for arm in arms]
    means = {(row.kind, row.arm): float(np.mean(row.psnr_db)) for row in rows}
    for kind in bench.kinds:
        assert means[kind, DEFAULT] > means[kind, PLAIN] - MARGIN_DB, means
        # Both have learnt the scene: a picture of the mean colour has 12 to 15 dB.
        assert means[kind, PLAIN] > 15.5, means
    assert all(len(row.psnr_db) == 3 and row.num_steps == bench.num_steps for row in rows if row.arm != PLAIN_LONGER)
    for kind in bench.kinds:
        default, plain, longer = (next(row for row in rows if (row.kind, row.arm) == (kind, arm)) for arm in (DEFAULT, PLAIN, PLAIN_LONGER))
        assert longer.num_steps == round(bench.num_steps * np.clip(default.cpu_s / plain.cpu_s, 1, 4))


def test_a_helper_that_has_nothing_to_do_takes_the_same_steps(measured: tuple[KindsBench, list[KindRow]]) -> None:
    bench, rows = measured
    gains = {(gain.kind, gain.helper): gain for gain in gains_of(rows)}
    for kind in bench.kinds:
        # No photograph of either scene repeats another or is blurred; both show what is above the
        # horizon.
        idle = gains[kind, "skipped images"]
        assert not idle.acts and idle.psnr_db.mean == idle.psnr_db.low == idle.psnr_db.high == 0
        assert gains[kind, "sky"].acts and gains[kind, "sky"].psnr_db.low <= gains[kind, "sky"].psnr_db.high
        default, plain = (np.array(next(row for row in rows if (row.kind, row.arm) == (kind, arm)).psnr_db) for arm in (DEFAULT, PLAIN))
        assert gains[kind, PLAIN].psnr_db.mean == pytest.approx((default - plain).mean())


def test_rows_that_are_there_are_not_measured_again_and_tables_hold_them(measured: tuple[KindsBench, list[KindRow]]) -> None:
    bench, rows = measured
    before = {path: path.stat().st_mtime_ns for path in bench.out.rglob("*") if path.is_file() and path.parent != bench.out}
    again, metrics = bench_kinds(bench)
    assert again == rows
    assert before == {path: path.stat().st_mtime_ns for path in bench.out.rglob("*") if path.is_file() and path.parent != bench.out}
    found = {metric.key: metric.value for metric in metrics}
    assert found["kinds.turntable-24.default.psnr_db"] == pytest.approx(np.mean(rows[0].psnr_db))
    assert found["kinds.clouds-24.gain.skipped_images.mean_db"] == 0
    stored = json.loads((bench.out / "kinds.json").read_text())
    assert len(stored["rows"]) == len(rows) and len(stored["gains"]) == 8
    text = (bench.out / "kinds.md").read_text()
    assert text == markdown(rows) and "| · |" in text and "| skipped images | 0 of 2 | +0.00" in text
    # Default and plain, what helpers gain, and the statistic of the one helper that acts.
    assert text.count("| turntable-24 |") == 3
    (line,) = [line for line in text.splitlines() if line.startswith("| sky | turntable-24 |")]
    assert f"{rows[0].statistics['above the horizon %']:.3g} above the horizon %" in line and "| on |" in line
    assert 0 < rows[0].statistics["above the horizon %"] < 100 and rows[0].statistics["photographs"] == 21


def test_other_seeds_widen_the_bounds_to_what_seeds_differ_by() -> None:
    row = KindRow(
        kind="room", num_photographs=30, arm=DEFAULT, seed=0, cpu_s=2, num_steps=9, num_gaussians=9, psnr_db=(20, 22), psnr_cc_db=(21, 23)
    )
    rows = [
        replace(row, arm=arm, seed=seed, psnr_db=tuple(value + shift for value in row.psnr_db))
        for seed, shifts in enumerate((((DEFAULT, 1.0), ("sky", 0.5)), ((DEFAULT, 0.0), ("sky", 0.5))))
        for arm, shift in shifts
    ]
    (gain,) = gains_of(rows)
    assert gain.helper == "sky" and gain.psnr_db.mean == 0 and gain.psnr_db.low < -0.4 and gain.psnr_db.high > 0.4
    # A seed that only one of both was measured with says nothing.
    assert gains_of(rows[:3])[0].psnr_db.num_seeds == 1 and gains_of([rows[1]]) == []


def test_splits_of_a_seed_are_more_images_and_a_split_that_a_seed_lacks_says_nothing() -> None:
    row = KindRow(
        kind="room", num_photographs=30, arm=DEFAULT, seed=0, cpu_s=2, num_steps=9, num_gaussians=9, psnr_db=(20, 22), psnr_cc_db=(21, 23)
    )
    # The last eighth of 30 photographs has one less.
    both = [row, replace(row, split=7, psnr_db=(26,), psnr_cc_db=(27,))]
    rows = [
        replace(each, arm=arm, psnr_db=tuple(np.array(each.psnr_db) + shift))
        for arm, shift in ((DEFAULT, 1.5), (PLAIN, 0.0))
        for each in both
    ]
    (gain,) = gains_of(rows)
    assert gain.psnr_db.num_images == 3 and gain.psnr_db.num_seeds == 1 and gain.psnr_db.mean == pytest.approx(1.5)
    other_seed = [replace(each, seed=1) for each in rows if each.split == 0]
    (gain,) = gains_of([*rows, *other_seed])
    assert gain.psnr_db.num_images == 2 and gain.psnr_db.num_seeds == 2
    assert bench_of(BenchOptions(out=Path("out"), num_splits=2)).splits == (0, 1)


def test_a_statistic_is_right_where_the_helper_pays_or_would_cost() -> None:
    """Light is off and would cost, and is on nowhere; a sky is on and costs, surely."""
    row = KindRow(
        kind="room",
        num_photographs=30,
        arm=DEFAULT,
        seed=0,
        cpu_s=2,
        num_steps=9,
        num_gaussians=9,
        psnr_db=(20, 22, 24),
        psnr_cc_db=(21, 23, 25),
        steps="default",
        statistics={"above the horizon %": 25.0, "spread %": 1.0},
    )
    arms = {"sky": (21, 23, 25), "light always": (19, 22, 24), "light": (20, 22, 24), "skipped images": (20, 22.5, 24)}
    others = [replace(row, arm=arm, steps="default" if arm == "light" else arm, psnr_db=figures) for arm, figures in arms.items()]
    cases = {case.helper: case for case in cases_of([row, *others])}
    assert {helper: (case.is_on, case.verdict) for helper, case in cases.items()} == {
        "sky": (True, "wrong"),
        "light": (False, "rather right"),
        "skipped images": (True, "rather wrong"),
    }
    assert cases["sky"].gain.mean == -1 and cases["light"].gain.mean == pytest.approx(-1 / 3)
    text = "\n".join(statistics_tables(list(cases.values())))
    assert "| sky | above the horizon % | on | 1 | 0 | 0 | 0 | 1 | -1.00 |" in text
    assert "| light | room-30 | 1 spread % | off | -0.33" in text


def test_a_scene_is_a_project_with_the_true_cameras(tmp_path: Path) -> None:
    project = make_scene(tmp_path, "room", 9, 64)
    model = read_model(project / "sparse" / "0")
    assert len(model.images) == 9 and len(model.points.xyz) > 40
    assert sorted(path.name for path in (project / "images").iterdir()) == sorted(image.name for image in model.images)
    assert [path.name for path in (tmp_path / "scenes").iterdir()] == ["room-9-64px"]


@pytest.mark.parametrize("kind", list(KINDS))
def test_the_generator_takes_the_switches_of_every_kind(kind: str, tmp_path: Path) -> None:
    for number in (9, 300):
        config, _ = generate.parse_config(["--out", str(tmp_path), *KINDS[kind].switches(number), "--num-cameras", str(number)])
        shots = plan_flight(config)
        assert len(shots) == number and len({shot.center_m.tobytes() for shot in shots}) == number


def test_a_generator_that_fails_or_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BadInput, match="failed with exit code 2: num_cameras is 1; give a number"):
        make_scene(tmp_path, "room", 1, 64)
    assert list((tmp_path / "scenes").iterdir()) == []
    monkeypatch.setattr(kind_scenes, "sample_scenes_folder", lambda: tmp_path)
    with pytest.raises(BadInput, match=r"which this installation lacks: clone Radiant's repository"):
        make_scene(tmp_path, "room", 9, 64)


def test_every_helper_changes_the_default() -> None:
    default = train_preset("default")
    for name, change in HELPERS.items():
        assert with_settings(default, change) != default, name


def test_what_cannot_be_measured_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="kind of scene 'moon' is unknown: use turntable, room"):
        bench_of(BenchOptions(out=tmp_path, kinds=("moon",)))
    with pytest.raises(BadInput, match="helper 'magic' is unknown"):
        bench_of(BenchOptions(out=tmp_path, methods=("magic",)))
    with pytest.raises(BadInput, match="8 photographs are asked for"):
        bench_of(BenchOptions(out=tmp_path, num_photographs=8))
    with pytest.raises(BadInput, match="the benchmark kinds needs --out"):
        BenchOptions().check("kinds")
    with pytest.raises(BadInput, match="--kind is for kinds, not for train"):
        BenchOptions(kinds=("room",)).check("train")
    assert bench_of(BenchOptions(out=tmp_path, quick=True)).num_steps == QUICK["num_steps"]
