"""`radiant bench NAME`: runs one benchmark, prints its figures as a table and writes them as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import typer

from radiant_app.commands.demo import sample_scenes_folder
from radiant_core.errors import BadInput
from radiant_core.evaluate.metric import Metric, metrics_to_json
from radiant_core.io.run_store import write_json

_OF_A_RUN = ("upload", "teachers", "borders")
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
    presets: tuple[str, ...] = ()
    """Presets to compare (train); empty for default and standard."""
    budgets_s: tuple[float, ...] = ()
    """CPU seconds of training (train); empty for its own."""
    num_seeds: int | None = None
    """Models per preset, budget and split (train)."""
    num_splits: int = 1
    """How many eighths of the photographs are held out, one after the other (train)."""
    long_side_px: int | None = None
    """Size of the training images (train)."""
    ablations: bool = False
    """Whether one thing at a time is switched off (train)."""
    plot: Path | None = None
    """PNG for the curves (train, methods, fed3dgs), or the folder of the figures (plan)."""
    methods: tuple[str, ...] = ()
    """Methods to compare (methods), parts of the page (paper) or ablations (train); empty for all."""
    layout: str = "2x2"
    """Edges x devices per edge (methods)."""
    num_placements: int = 1
    """Placements of the edges (methods)."""
    max_gaussians: int | None = None
    """To which every method's model is reduced (methods)."""
    out: Path | None = None
    """Folder of models and rows, which a later call goes on with (methods, paper, train), and of the page (paper)."""


def run_bench(name: str, json_file: Path | None, options: BenchOptions) -> None:
    """Run the benchmark `name` and report; BadInput for an unknown name or an unwritable file."""
    if json_file is not None and not json_file.parent.is_dir():
        raise BadInput(f"there is no folder {json_file.parent} to write {json_file.name} into: make it first.")
    if options.scene is not None and name not in ("sfm", "train", "methods", "paper", *_OF_A_RUN):
        raise BadInput(f"--scene is for sfm, train, methods, paper, {' and '.join(_OF_A_RUN)}, not for {name}: leave it out.")
    if name != "train" and (options.presets or options.budgets_s or options.ablations):
        raise BadInput(f"--preset, --budget and --ablations are for the benchmark train, not for {name}: leave them out.")
    if name != "train" and options.num_splits > 1:
        raise BadInput(f"--splits is for the benchmark train, not for {name}: leave it out.")
    if name not in ("train", "methods", "paper") and options.num_seeds:
        raise BadInput(f"--seeds is for the benchmarks train, methods and paper, not for {name}: leave it out.")
    if name not in ("methods", "paper", "train") and (options.methods or options.out):
        raise BadInput(f"--method and --out are for the benchmarks methods, paper and train, not for {name}: leave them out.")
    if name != "methods" and options.num_placements > 1:
        raise BadInput(f"--placements is for the benchmark methods, not for {name}: leave it out.")
    if name != "methods" and options.max_gaussians is not None:
        raise BadInput(f"--max-gaussians is for the benchmark methods, not for {name}: leave it out.")
    if name in ("methods", "paper") and (options.scene is None or options.out is None):
        raise BadInput(f"the benchmark {name} needs --scene, a run or a folder of 'radiant sfm', and --out, a folder for its models.")
    if options.plot is not None and name not in ("train", "plan", "methods", "fed3dgs"):
        raise BadInput(f"--plot is for the benchmarks train, plan, methods and fed3dgs, not for {name}: leave it out.")
    if options.plot is not None and not options.plot.parent.is_dir():
        raise BadInput(f"there is no folder {options.plot.parent} to write {options.plot.name} into: make it first.")
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
        from radiant_app.bench.plan_scale import bench_plan_scale

        if options.plot is not None:
            from radiant_app.bench.plan_figures import bench_plan_figures

            return bench_plan_figures(options.plot, options.quick)
        return [*bench_plan(options.quick), *bench_plan_scale(options.quick)]
    if name == "borders" and options.scene is not None:
        from radiant_app.bench.borders import bench_borders

        baseline = options.scene / "baseline.ply"
        return bench_borders(options.scene, baseline if baseline.is_file() else None)
    if name == "fed3dgs":
        from radiant_app.bench.fed3dgs import bench_fed3dgs

        return bench_fed3dgs(options.quick, options.plot)
    if name == "raster":
        from radiant_app.bench.raster import bench_raster, build_description

        typer.echo(build_description(options.threads))
        return bench_raster(options.quick, options.threads)
    if name == "viewer":
        from radiant_app.bench.viewer import bench_viewer

        return bench_viewer(options.quick)
    if name == "train":
        return _measure_training(options)
    if name == "methods" and options.scene is not None and options.out is not None:
        return _measure_methods(options, options.scene, options.out)
    if name == "paper" and options.scene is not None and options.out is not None:
        return _measure_paper(options, options.scene, options.out)
    if name == "upload" and options.scene is not None:
        from radiant_app.bench.upload import bench_upload

        return bench_upload(options.scene, options.quick)
    if name == "teachers" and options.scene is not None:
        from radiant_app.bench.teachers import bench_teachers

        return bench_teachers(options.scene, options.quick)
    raise BadInput(
        f"benchmark {name!r} is unknown: use sfm, plan, borders, fed3dgs, raster, train, methods, paper, upload, teachers or viewer."
    )


def _measure_training(options: BenchOptions) -> Sequence[Metric]:
    from radiant_app.bench.train import TrainBench, bench_of, bench_train, curves_of

    bench: TrainBench = bench_of(options)
    rows, metrics = bench_train(bench)
    if options.plot is not None:
        from radiant_viewer.charts.curve_chart import curve_picture
        from radiant_viewer.pictures.images import save_png

        seeds = f"{len(bench.seeds)} seed" + "s" * (len(bench.seeds) > 1)
        splits = f", {len(bench.splits)} splits" * (len(bench.splits) > 1)
        detail = f"{bench.scene.name}, {bench.long_side_px} px, {seeds}{splits}; every dot is one model"
        save_png(options.plot, curve_picture(curves_of(rows), "Training: quality against time and size", detail))
        typer.echo(f"written: {options.plot}")
    return metrics


def _measure_methods(options: BenchOptions, scene: Path, out: Path) -> Sequence[Metric]:
    from radiant_app.bench.method_cells import layout_of
    from radiant_app.bench.methods import MethodBench, bench_methods, curves_of, methods_table

    sizes = {"long_side_px": options.long_side_px or (160 if options.quick else 384), "num_steps": 60 if options.quick else 500}
    repeats = {"num_placements": options.num_placements, "num_seeds": options.num_seeds or 1, "max_gaussians": options.max_gaussians}
    bench = MethodBench(scene=scene, out=out, layout=layout_of(options.layout), methods=options.methods, **sizes, **repeats)
    rows, metrics = bench_methods(bench)
    typer.echo(methods_table(rows))
    if options.plot is not None:
        from radiant_viewer.charts.curve_chart import curve_picture
        from radiant_viewer.pictures.images import save_png

        detail = f"{rows[0].scene}, {bench.layout}, {bench.long_side_px} px; CPU time after the devices' trainings"
        save_png(options.plot, curve_picture(curves_of(rows), "Joining: quality against time and size", detail))
        typer.echo(f"written: {options.plot}")
    return metrics


def _measure_paper(options: BenchOptions, scene: Path, out: Path) -> Sequence[Metric]:
    from radiant_app.bench.paper import PaperBench, bench_paper

    sizes = {"long_side_px": options.long_side_px or (96 if options.quick else 384), "num_steps": 30 if options.quick else 500}
    repeats = {"parts": options.methods, "num_seeds": options.num_seeds or 1, "quick": options.quick}
    metrics = bench_paper(PaperBench(scene=scene, out=out, **sizes, **repeats))
    typer.echo(f"written: {out / 'paper.md'}")
    return metrics


def table(metrics: Sequence[Metric]) -> str:
    """Key, value and unit per line, aligned."""
    width = max((len(metric.key) for metric in metrics), default=0)
    return "\n".join(f"{metric.key:<{width}}  {metric.value:>12.6g} {metric.unit}" for metric in metrics)
