"""The options of `radiant bench`, which finds this file in the source, and what runs it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.options import BenchName, BenchOptions, HoldOut
from radiant_app.cli.help import WIDTH, Command
from radiant_app.cli.option_types import LongSide, LpipsNet, LpipsWeights
from radiant_core.choices import CutBy

BenchScene = Annotated[
    Path | None,
    typer.Option(
        help="sfm: scene with known cameras; job: photographs; train: photographs, a COLMAP project, a run; methods, paper: of sfm, a run."
    ),
]
BenchPlot = Annotated[Path | None, typer.Option(help="train, methods: PNG of the curves.")]
FIELDS = {
    "preset": "presets",
    "budget": "budgets_s",
    "seeds": "num_seeds",
    "splits": "num_splits",
    "photographs": "num_photographs",
    "steps": "num_steps",
    "lpips_net": "lpips_network",
    "method": "methods",
    "kind": "kinds",
    "placements": "num_placements",
}
"""Field of `BenchOptions` by parameter, where their names differ."""
SEVERAL = ("presets", "budgets_s", "methods", "kinds")
"""Fields whose options may be given again."""
app = typer.Typer(context_settings=WIDTH, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command(cls=Command)
def bench(
    context: typer.Context,
    name: Annotated[BenchName, typer.Argument(help="What to measure.")],
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer and smaller cases.")] = False,
    scene: BenchScene = None,
    threads: Annotated[int | None, typer.Option(min=1, max=1024, help="Threads of the rasterizer; all cores without it.")] = None,
    preset: Annotated[list[str] | None, typer.Option(help="train: presets to compare, else default and standard.")] = None,
    budget: Annotated[list[float] | None, typer.Option(min=0.1, help="train: CPU seconds, else 60, 180 and 600.")] = None,
    seeds: Annotated[int | None, typer.Option(min=1, max=100, help="train, methods, paper, kinds: models of each kind.")] = None,
    splits: Annotated[int, typer.Option(min=1, max=8, help="train, kinds: eighths of the photographs, or lines, held out in turn.")] = 1,
    photographs: Annotated[int | None, typer.Option(min=2, help="train: so many of the training photographs; kinds: of a scene.")] = None,
    hold_out: Annotated[
        HoldOut, typer.Option(help="train, methods: every eighth photograph, a flight line, or each in turn.")
    ] = "interleaved",
    off_path: Annotated[Path | None, typer.Option(help="train, methods: folder of views never flown, scored as well.")] = None,
    long_side_px: LongSide = None,
    steps: Annotated[int | None, typer.Option(min=1, help="methods, paper: steps of a device, else 500; kinds: else 1,500.")] = None,
    field_steps: Annotated[int | None, typer.Option(min=1, help="methods, paper: steps of a radiance field; 1,000 without it.")] = None,
    lpips_weights: LpipsWeights = None,
    lpips_net: LpipsNet = "vgg",
    ablations: Annotated[bool, typer.Option("--ablations", help="train: switch one thing off at a time.")] = False,
    plot: BenchPlot = None,
    method: Annotated[
        list[str] | None,
        typer.Option(help="Only these; sfm: arms; methods: those compared; paper: sections; train: ablations; kinds: helpers."),
    ] = None,
    kind: Annotated[list[str] | None, typer.Option(help="kinds: scenes such as turntable or street; else all.")] = None,
    layout: Annotated[str, typer.Option(help="methods: edges x devices per edge; run: plan and settings of the run.")] = "2x2",
    placements: Annotated[int, typer.Option(min=1, max=100, help="methods: placements of the edges.")] = 1,
    cut_by: Annotated[CutBy, typer.Option(help="methods: what regions are cut by, as in a run.")] = "auto",
    max_gaussians: Annotated[int | None, typer.Option(min=1, help="methods: reduce every method's model to as many.")] = None,
    out: Annotated[Path | None, typer.Option("--out", help="methods, paper, train, kinds, job: folder of models; resumed.")] = None,
    baseline: Annotated[Path | None, typer.Option(help="sfm, plan, raster, job: earlier figures; exit code 1 where one is worse.")] = None,
    bless: Annotated[bool, typer.Option("--bless", help="Write the figures into the baseline instead of comparing.")] = False,
) -> None:
    """Measure run time beside error (benchmarks/README.md).

    radiant bench plan --quick
    radiant bench train --scene SCENE --plot curves.png
    radiant bench methods --scene SCENE --out OUT
    """
    from benchmarks.runner import run_bench

    run_bench(name, json_file, _options_of(context.params))


def _options_of(typed: Mapping[str, Any]) -> BenchOptions:
    values: dict[str, Any] = {FIELDS.get(name, name): value for name, value in typed.items() if name not in ("name", "json_file")}
    values |= {name: tuple(values[name] or ()) for name in SEVERAL}
    return BenchOptions(**values)


def main(arguments: Sequence[str]) -> object:
    """Run `radiant bench` with `arguments`; raises what the benchmark raises."""
    return app(arguments, prog_name="radiant bench", standalone_mode=False)
