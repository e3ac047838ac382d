"""`radiant bench NAME`: run one benchmark, print its figures, write and compare them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from benchmarks.baseline import bless, check_against_baseline
from benchmarks.metric import Metric, metrics_to_json
from benchmarks.options import BenchName, BenchOptions
from radiant_core.errors import BadInput
from radiant_core.io.run_store import write_json

if TYPE_CHECKING:
    from benchmarks.charts.curve_chart import CurvePoint


def run_bench(name: BenchName, json_file: Path | None, options: BenchOptions) -> None:
    """Run the benchmark `name` and report. Raises BadInput for unusable options and files,
    StageFailed for a figure worse than in `options.baseline`."""
    options.check(name)
    for file in (json_file, options.plot, options.baseline if options.bless else None):
        if file is not None and not file.parent.is_dir():
            raise BadInput(f"there is no folder {file.parent} to write {file.name} into: make it first.")
    metrics = measure(name, options)
    typer.echo(table(metrics))
    if json_file is not None:
        write_json(json_file, metrics_to_json(metrics))
        typer.echo(f"written: {json_file}")
    if options.baseline is not None and options.bless:
        bless(options.baseline, name, metrics)
        typer.echo(f"written: {options.baseline}")
    elif options.baseline is not None:
        num_compared = check_against_baseline(options.baseline, name, metrics)
        typer.echo(f"{num_compared} figures are no worse than in {options.baseline}")


def measure(name: BenchName, options: BenchOptions) -> Sequence[Metric]:
    """The figures of one benchmark."""
    match name:
        case "sfm":
            from benchmarks.sfm import bench_sfm

            return bench_sfm(options.scene, options.quick, options.methods)
        case "plan":
            from benchmarks.plan import bench_plan

            return bench_plan(options.quick)
        case "raster":
            from benchmarks.raster.bench import bench_raster, build_description

            typer.echo(build_description(options.threads))
            return bench_raster(options.quick, options.threads)
        case "train":
            return _measure_training(options)
        case "methods":
            return _measure_methods(options)
        case "paper":
            return _measure_paper(options)
        case "together":
            return _measure_together(options)
        case "kinds":
            return _measure_kinds(options)
        case "job":
            from benchmarks.job import bench_job

            assert options.out is not None, "checked with the options"
            return bench_job(options.scene, options.out, options.quick)


def _measure_training(options: BenchOptions) -> Sequence[Metric]:
    from benchmarks.train import bench_of, bench_train, curves_of

    bench = bench_of(options)
    rows, metrics = bench_train(bench)
    seeds = f"{len(bench.seeds)} seed" + "s" * (len(bench.seeds) > 1)
    splits = f", {len(bench.splits)} splits" * (len(bench.splits) > 1)
    detail = f"{bench.scene.name}, {bench.long_side_px} px, {seeds}{splits}; every dot is one model"
    _draw(options.plot, curves_of(rows), "Training: quality against time and size", detail)
    return metrics


def _measure_methods(options: BenchOptions) -> Sequence[Metric]:
    from benchmarks.methods.bench import MethodBench, bench_methods, curves_of, methods_table
    from benchmarks.methods.cells import layout_of
    from benchmarks.methods.rivals import FIELD_STEPS, QUICK_FIELD_STEPS

    assert options.scene is not None and options.out is not None, "checked with the options"
    bench = MethodBench(
        scene=options.scene,
        out=options.out,
        layout=layout_of(options.layout),
        methods=options.methods,
        num_placements=options.num_placements,
        num_seeds=options.num_seeds or 1,
        long_side_px=options.long_side_px or (160 if options.quick else 384),
        num_steps=options.num_steps or (60 if options.quick else 500),
        cut_by=options.cut_by,
        max_gaussians=options.max_gaussians,
        hold_out=options.hold_out,
        off_path=options.off_path,
        field_steps=options.field_steps or (QUICK_FIELD_STEPS if options.quick else FIELD_STEPS),
    )
    rows, metrics = bench_methods(bench)
    typer.echo(methods_table(rows))
    dealt = "the plan and settings of its run" if bench.layout is None else f"{bench.layout}, {bench.long_side_px} px"
    detail = f"{', '.join(dict.fromkeys(row.scene for row in rows))}, {dealt}; CPU time after the devices' trainings"
    _draw(options.plot, curves_of(rows), "Joining: quality against time and size", detail)
    return metrics


def _measure_paper(options: BenchOptions) -> Sequence[Metric]:
    from benchmarks.methods.rivals import FIELD_STEPS, QUICK_FIELD_STEPS
    from benchmarks.paper.bench import PaperBench, bench_paper
    from radiant_core.evaluate.lpips import load_lpips

    assert options.scene is not None and options.out is not None, "checked with the options"
    bench = PaperBench(
        scene=options.scene,
        out=options.out,
        parts=options.methods,
        num_seeds=options.num_seeds or 1,
        long_side_px=options.long_side_px or (96 if options.quick else 384),
        num_steps=options.num_steps or (30 if options.quick else 500),
        quick=options.quick,
        field_steps=options.field_steps or (QUICK_FIELD_STEPS if options.quick else FIELD_STEPS),
        lpips=None if options.lpips_weights is None else load_lpips(options.lpips_weights, options.lpips_network),
    )
    metrics = bench_paper(bench)
    typer.echo(f"written: {options.out / 'paper.md'}")
    return metrics


def _measure_together(options: BenchOptions) -> Sequence[Metric]:
    from benchmarks.methods.scaling import ScalingBench, bench_together

    assert options.scene is not None and options.out is not None, "checked with the options"
    some = {"devices": (1, 2), "num_views": (200, 400), "target_db": 20.0} if options.quick else {}
    return bench_together(
        ScalingBench(scene=options.scene, out=options.out, long_side_px=options.long_side_px or (160 if options.quick else 384), **some)
    )


def _measure_kinds(options: BenchOptions) -> Sequence[Metric]:
    from benchmarks.kinds.bench import bench_kinds, bench_of

    metrics = bench_kinds(bench_of(options))[1]
    typer.echo(f"written: {options.out}/kinds.md")
    return metrics


def _draw(plot: Path | None, curves: Mapping[str, Sequence[CurvePoint]], title: str, detail: str) -> None:
    if plot is not None:
        from benchmarks.charts.curve_chart import curve_picture
        from radiant_viewer.pictures.images import save_png

        save_png(plot, curve_picture(curves, title, detail))
        typer.echo(f"written: {plot}")


def table(metrics: Sequence[Metric]) -> str:
    """Key, value and unit per line, aligned."""
    width = max((len(metric.key) for metric in metrics), default=0)
    return "\n".join(f"{metric.key:<{width}}  {metric.value:>12.6g} {metric.unit}" for metric in metrics)
