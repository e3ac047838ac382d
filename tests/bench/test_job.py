"""`radiant bench job`: every process of a run is there with its CPU seconds, and the parts of a step add up."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.job import arithmetic_s, bench_job


@pytest.mark.stress
def test_the_job_of_the_hamlet_by_process_and_by_part_of_a_step(tmp_path: Path) -> None:
    figures = {metric.key.removeprefix("job.hamlet."): metric.value for metric in bench_job(None, tmp_path, quick=True)}
    by_process = {key: value for key, value in figures.items() if key.endswith(".cpu_s")}
    assert {"sfm.cpu_s", "cloud.cpu_s", "evaluation.cpu_s", "run.cpu_s"} <= by_process.keys() and min(by_process.values()) > 0
    assert figures["cpu_s"] == pytest.approx(sum(by_process.values())) and figures["over_arithmetic"] > 1
    step = {key.removeprefix("step.").removesuffix("_ms"): value for key, value in figures.items() if key.startswith("step.")}
    assert step.keys() == {"rendering", "blending_backward", "projection_backward", "loss", "adam", "density", "python_and_torch"}
    assert min(step.values()) > 0 and step["rendering"] > 0.05 * sum(step.values())


def test_the_arithmetic_is_the_same_each_time() -> None:
    assert 0.5 < arithmetic_s() / arithmetic_s() < 2
