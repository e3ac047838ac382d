"""`radiant run` and `radiant demo`; heavy libraries are imported inside, as in `cli.app`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiant_app.cli.config_options import given_values, typed_options, with_config_options
from radiant_app.cli.option_types import AsJson, Verbose
from radiant_app.config.fields import config_of, with_settings
from radiant_app.config.run_config import OUTPUT
from radiant_app.report.tables import print_model, print_summary
from radiant_core.errors import BadInput

if TYPE_CHECKING:
    from radiant_app.config.run_config import RunConfig

_SET_HELP = "Any field of a run's configuration: PATH=VALUE, such as plan.method=even or train.sky=false; repeatable."


@with_config_options
def run(
    context: typer.Context,
    source: Annotated[
        Path,
        typer.Argument(
            help="Photographs, an alignment beside them, a film, a COLMAP project, a Mill 19 folder, a RUN.toml or a JOBS.toml.",
            show_default=False,
        ),
    ],
    settings: Annotated[list[str] | None, typer.Option("--set", help=_SET_HELP, rich_help_panel=OUTPUT)] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run in --out; finished stages are skipped.")] = False,
    verbose: Verbose = False,
    as_json: AsJson = False,
    **_: Any,
) -> None:
    """Turn photographs into one Gaussian model, with a report.

    radiant run PHOTOS --out RUN
    radiant run PHOTOS --out RUN --system system.toml
    radiant run PHOTOS --out RUN --resume

    A RUN.toml holds these options in sections; options typed beside it win. A JOBS.toml runs
    several scenes, continues after a failure and ends with a summary (keys:
    radiant_app/files/job_file.py).
    """
    from radiant_app.files.job_file import is_job_file, load_run_file

    values: dict[str, Any] = {"source": source}
    if source.suffix == ".toml" and not source.is_dir():
        if is_job_file(source):
            return _run_batch(context, source, resume, as_json, verbose=verbose)
        values = load_run_file(source)
    return run_and_print(config_of(values | with_settings(given_values(context), settings or ())), resume, as_json, verbose=verbose)


def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder of the run.")] = Path("demo_run"),
    resume: Annotated[bool, typer.Option("--resume", help="Continue an interrupted demo.")] = False,
    verbose: Verbose = False,
) -> None:
    """Run the whole job on the sample town: some minutes on two cores.

    radiant demo
    radiant demo --out my_demo
    """
    from radiant_app.commands.run.demo import demo_config

    run_and_print(demo_config(out), resume or out.exists(), as_json=False, verbose=verbose)


def run_and_print(config: RunConfig, resume: bool, as_json: bool, *, verbose: bool) -> None:
    """Do the run before the progress display; print where its result is and how good."""
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.run.pipeline import run as run_pipeline

    with terminal_display(with_decisions=verbose) as listen:
        result = run_pipeline(config, listen, resume=resume)
    if as_json:
        typer.echo(json.dumps(result.metrics))
        return
    print_model(config.out / "scene.ply", result.metrics)
    if unscored := result.metrics.get("num_unscored", 0):
        from radiant_app.report.html import describe_unscored

        scored = len(result.metrics["images"])
        typer.echo(f"scored on {scored} of {scored + unscored} held-out photographs: {describe_unscored(result.metrics)}")
    if result.metrics.get("emulated_makespan_s") is not None:
        emulated, planned = (result.metrics[f"{kind}_makespan_s"] for kind in ("emulated", "planned"))
        typer.echo(f"emulated: the last edge's model arrived after {emulated:.1f} s, planned {planned:.1f} s")
    if result.metrics.get("emulated_scene_s") is not None:
        typer.echo(f"emulated: the scene was finished after {result.metrics['emulated_scene_s']:.1f} s")
    hidden = 0 if verbose else listen.num_decisions
    typer.echo(f"report: {result.report}{f' ({hidden} decisions; -v prints them here)' * (hidden > 0)}")
    typer.echo(f"next: radiant inspect {quote(str(config.out))}")


def _run_batch(context: typer.Context, source: Path, resume: bool, as_json: bool, *, verbose: bool) -> None:
    from radiant_app.commands.run.batch import run_batch

    typed = typed_options(context)
    if extra := sorted(option for name, option in typed.items() if name not in ("source", "out", "resume", "as_json", "verbose")):
        raise BadInput(f"{extra[0]} stands beside a job file: write it into its [defaults].")
    result = run_batch(source, context.params["out"], partial(_job_display, verbose=verbose), resume=resume)
    if as_json:
        typer.echo(json.dumps(result.record))
    else:
        print_summary(result)
    raise typer.Exit(result.exit_code)


@contextmanager
def _job_display(title: str, *, verbose: bool) -> Iterator[Any]:
    from radiant_app.report.progress import terminal_display

    typer.echo(title, err=True)
    with terminal_display(with_decisions=verbose) as listen:
        yield listen
