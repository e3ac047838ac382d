"""The committed figures of the quick benchmarks: today's are no worse, and a figure that became worse fails by its name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import runner
from benchmarks.baseline import bless, check_against_baseline, machine_independent
from benchmarks.metric import Metric
from benchmarks.options import BenchOptions
from benchmarks.plan import bench_plan
from benchmarks.raster import bench as raster
from benchmarks.runner import run_bench
from radiant_app.cli.app import app
from radiant_core.errors import BadInput, StageFailed

BASELINE = Path(__file__).parents[1] / "baseline.json"


@pytest.fixture(scope="module")
def planned() -> list[Metric]:
    """Figures of `radiant bench plan --quick`."""
    return bench_plan(quick=True)


@pytest.fixture(scope="module")
def rendered() -> list[Metric]:
    """Figures of `radiant bench raster --quick` after one round, without its processes that measure memory."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(raster.NUM_ROUNDS, "S", 1)
        patch.setattr(raster, "peak_rss_bytes", lambda *_: 1)
        return raster.bench_raster(quick=True, threads=1)


def test_planning_and_rendering_are_no_worse_than_the_baseline(planned: list[Metric], rendered: list[Metric]) -> None:
    assert check_against_baseline(BASELINE, "plan", planned) == len(machine_independent(planned)) > 30
    assert check_against_baseline(BASELINE, "raster", rendered) == len(machine_independent(rendered)) == 8


def test_no_time_and_no_memory_is_compared(planned: list[Metric], rendered: list[Metric]) -> None:
    kept = machine_independent([*planned, *rendered])
    assert {metric.unit for metric in kept} == {"1"}
    assert not [metric.key for metric in kept if "thread" in metric.key or "fraction" in metric.key]


@pytest.mark.parametrize("name", ["plan", "raster"])
def test_every_figure_that_becomes_worse_fails_by_its_name(name: str, request: pytest.FixtureRequest) -> None:
    metrics: list[Metric] = request.getfixturevalue({"plan": "planned", "raster": "rendered"}[name])
    for index, metric in enumerate(metrics):
        if metric not in machine_independent(metrics):
            continue
        step = 9 * metric.value * (1 if metric.direction == "lower" else -1)
        worse = [*metrics[:index], replace(metric, value=metric.value + step), *metrics[index + 1 :]]
        with pytest.raises(StageFailed, match=metric.key.replace(".", r"\.")):
            check_against_baseline(BASELINE, name, worse)
    with pytest.raises(StageFailed, match="not measured any more"):
        check_against_baseline(BASELINE, name, [])


def test_the_command_ends_with_1_and_names_what_is_worse(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, planned: list[Metric], capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "baseline.json"
    file.write_text('[{"key": "plan.200x4.street.exact.makespan_over_bound", "value": 0.5, "unit": "1", "direction": "lower"}]')
    monkeypatch.setattr(runner, "measure", lambda *_: planned)
    with pytest.raises(StageFailed, match=r"street\.exact\.makespan_over_bound was 0\.5 1 and is 1 1 \(lower is better") as failure:
        app(["bench", "plan", "--quick", "--baseline", str(file)], standalone_mode=False)
    assert failure.value.exit_code == 1
    assert "plan.200x4.street.exact.time_ms" in capsys.readouterr().out, "the table is printed all the same"


def test_blessing_replaces_the_figures_of_one_benchmark(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, planned: Sequence[Metric], capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "baseline.json"
    bless(file, "sfm", [Metric(key="sfm.town.registered", value=60, unit="1", direction="higher")])
    bless(file, "plan", [Metric(key="plan.gone", value=1, unit="1", direction="lower")])
    monkeypatch.setattr(runner, "measure", lambda *_: planned)
    run_bench("plan", None, BenchOptions(baseline=file, bless=True))
    run_bench("plan", None, BenchOptions(baseline=file))
    assert "figures are no worse than in" in capsys.readouterr().out
    assert "sfm.town.registered" in file.read_text() and "plan.gone" not in file.read_text()
    for options, reason in (
        ({"bless": True}, "--bless writes the figures into the file of --baseline"),
        ({"baseline": tmp_path / "none" / "x.json", "bless": True}, "there is no folder"),
    ):
        with pytest.raises(BadInput, match=reason):
            run_bench("plan", None, BenchOptions(**options))
    with pytest.raises(BadInput, match="--baseline is for sfm, plan, raster, job, not for train"):
        run_bench("train", None, BenchOptions(baseline=file))
