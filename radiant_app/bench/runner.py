"""`radiant bench NAME`: runs one benchmark, prints its figures as a table and writes them as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import typer

from radiant_app.demo import sample_scenes_folder
from radiant_core.errors import BadInput
from radiant_core.evaluate.metric import Metric, metrics_to_json
from radiant_core.io.run_store import write_json

_OF_A_RUN = ("upload", "teachers")
"""Benchmarks whose --scene is the folder of a finished run."""


@dataclass(frozen=True, kw_only=True)
class BenchOptions:
    """What the benchmarks may be asked for; each takes what it knows."""

    quick: bool = False
    """Fewer and smaller cases."""
    scene: Path | None = None
    """Scene with known cameras (sfm), or a finished run (upload, teachers)."""
    threads: int | None = None
    """Threads of the rasterizer (raster)."""


def run_bench(name: str, json_file: Path | None, options: BenchOptions) -> None:
    """Run the benchmark `name` and report; BadInput for an unknown name or an unwritable file."""
    if json_file is not None and not json_file.parent.is_dir():
        raise BadInput(f"there is no folder {json_file.parent} to write {json_file.name} into: make it first.")
    if options.scene is not None and name not in ("sfm", *_OF_A_RUN):
        raise BadInput(f"--scene is for the benchmarks sfm, {' and '.join(_OF_A_RUN)}, not for {name}: leave it out.")
    if options.scene is None and name in _OF_A_RUN:
        raise BadInput(f"the benchmark {name} measures a finished run: name its folder with --scene.")
    metrics = measure(name, options)
    typer.echo(table(metrics))
    if json_file is not None:
        write_json(json_file, metrics_to_json(metrics))
        typer.echo(f"written: {json_file}")


def measure(name: str, options: BenchOptions) -> Sequence[Metric]:
    """The figures of one benchmark."""
    if name == "sfm":
        from radiant_app.bench.sfm import bench_sfm

        return bench_sfm(options.scene or sample_scenes_folder() / "town", options.quick)
    if name == "plan":
        from radiant_app.bench.plan import bench_plan

        return bench_plan(options.quick)
    if name == "raster":
        from radiant_app.bench.raster import bench_raster, build_description

        typer.echo(build_description(options.threads))
        return bench_raster(options.quick, options.threads)
    if name == "upload" and options.scene is not None:
        from radiant_app.bench.upload import bench_upload

        return bench_upload(options.scene, options.quick)
    if name == "teachers" and options.scene is not None:
        from radiant_app.bench.teachers import bench_teachers

        return bench_teachers(options.scene, options.quick)
    raise BadInput(f"benchmark {name!r} is unknown: use sfm, plan, raster, upload or teachers.")


def table(metrics: Sequence[Metric]) -> str:
    """Key, value and unit per line, aligned."""
    width = max((len(metric.key) for metric in metrics), default=0)
    return "\n".join(f"{metric.key:<{width}}  {metric.value:>12.6g} {metric.unit}" for metric in metrics)
