"""`radiant machine check` and `profile`: their options; heavy libraries are imported inside, as in
`cli.app`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from radiant_app.cli.config_options import option
from radiant_app.cli.help import Command, Commands
from radiant_app.cli.option_types import AsJson, LongSide, MaxSplats, NumSteps
from radiant_app.config.run_config import GROUPS
from radiant_app.report.tables import finish
from radiant_core.errors import BadInput
from radiant_core.train.config import Preset

CurvesOf = Annotated[
    Path | None, typer.Argument(help="Photographs, a COLMAP project, a folder of `radiant sfm`, a run; by default the sample town.")
]
TrainedOption = Annotated[Preset, option("train.preset", help="Training that the curves describe.", group=GROUPS["train"])]
WorkersOption = Annotated[int, option("execution.max_workers", help="Processes side by side, as in `radiant run`; 0: one per core.")]
ThreadsOption = Annotated[
    int | None,
    typer.Option(min=1, max=1024, help="Threads of a process; by default its share of the cores.", rich_help_panel=GROUPS["execution"]),
]
machine = typer.Typer(
    cls=Commands,
    help="Check what this machine has, and measure how fast it trains.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    no_args_is_help=True,
)


@machine.command(cls=Command)
def check(
    photographs: Annotated[int, typer.Option(min=1, help="Estimate a run of this many photographs.")] = 100,
    profile: Annotated[Path | None, typer.Option(help="Curve file of this machine, by `radiant machine profile`; else a guess.")] = None,
    as_json: AsJson = False,
) -> None:
    """Show what this machine has, what is missing and how to get it, and what a run takes here.

    radiant machine check
    radiant machine check --profile machine.toml --photographs 200
    """
    from radiant_app.report.progress import show_starting

    with show_starting():
        from radiant_app.commands.machine.doctor import examine, table

        findings = examine(photographs, profile)
    typer.echo(json.dumps([vars(finding) for finding in findings], indent=2) if as_json else table(findings))
    if any(not finding.ok and finding.needed for finding in findings):
        raise typer.Exit(1)


@machine.command(cls=Command)
def profile(
    source: CurvesOf = None,
    out: Annotated[Path | None, typer.Option("--out", help="Curve file to write, .toml or .json.")] = None,
    from_run: Annotated[Path | None, typer.Option("--from", help="Use the stage times of this finished run instead of measuring.")] = None,
    list_known: Annotated[bool, typer.Option("--list", help="List the machines in the library, each with its source.")] = False,
    time: Annotated[str, typer.Option(help="Time for measuring; structure from motion comes on top.")] = "4m",
    machine: Annotated[str | None, typer.Option(help="Name of this machine; by default processor and threads.")] = None,
    train_preset: TrainedOption = "default",
    long_side_px: LongSide = None,
    steps: NumSteps = None,
    max_splats: MaxSplats = None,
    workers: WorkersOption = 0,
    threads: ThreadsOption = None,
    as_json: AsJson = False,
) -> None:
    """Measure this machine for the planner in a short real run: cost curves with their errors.

    radiant machine profile --out machine.toml
    radiant machine profile --from RUN --out machine.toml
    """
    from radiant_app.commands.machine import profile as profile_command

    if list_known:
        typer.echo(profile_command.library_table())
        return
    if out is None:
        raise BadInput("--out is missing: name the curve file, or give --list.")
    from radiant_app.report.progress import terminal_display

    if from_run is not None:
        if source is not None:
            raise BadInput("--from takes the times of a run that is done: leave out the photographs.")
        result = profile_command.profile_of_run(from_run, out, machine, terminal_display())
    else:
        from radiant_app.config.run_config import ExecutionOptions
        from radiant_app.quantities import seconds_of
        from radiant_core.train.needs import Overrides

        request = profile_command.ProfileRequest(
            out=out,
            source=source,
            preset=train_preset,
            overrides=Overrides(long_side_px=long_side_px, num_steps=steps, max_num_splats=max_splats),
            time_s=seconds_of(time),
            num_workers=ExecutionOptions(max_workers=workers).num_workers,
            num_threads=threads,
            machine=machine,
        )
        with terminal_display() as display:
            result = profile_command.profile(request, display)
    if as_json:
        typer.echo(json.dumps(result))
        return
    if result["check"]:
        typer.echo(profile_command.check_table(result["check"]))
    shown = ("machine", "training", "measured_steps", "largest_count", "exchange", "profile")
    finish({name: result[name] for name in shown}, as_json=False)
