"""The options of `radiant profile`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from radiant_app.cli.option_types import AsJson, LongSide, MaxSplats, NumSteps
from radiant_core.errors import BadInput
from radiant_core.train.config import Preset


def profile(
    source: Annotated[
        Path | None, typer.Argument(help="Photographs, a COLMAP project, a folder of `radiant sfm`, a run; else the town.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Curve file to write, .toml or .json.")] = None,
    from_run: Annotated[Path | None, typer.Option("--from", help="Take the stage times of this finished run instead of measuring.")] = None,
    list_known: Annotated[bool, typer.Option("--list", help="Show the library's machines, each with its source.")] = False,
    time: Annotated[str, typer.Option(help="Time of measuring; structure from motion comes on top.")] = "4m",
    workers: Annotated[int, typer.Option(min=0, help="Processes side by side, as by `radiant run`; 0: one per core.")] = 0,
    threads: Annotated[int | None, typer.Option(min=1, max=1024, help="Threads of a process; its share of the cores without it.")] = None,
    machine: Annotated[str | None, typer.Option(help="Name of this machine; else processor and threads.")] = None,
    train_preset: Annotated[Preset, typer.Option(help="Training that the curves are to hold for.")] = "default",
    long_side_px: LongSide = None,
    steps: NumSteps = None,
    max_splats: MaxSplats = None,
    as_json: AsJson = False,
) -> None:
    """Cost curves of this machine for the planner by a short real run, and their errors."""
    from radiant_app.commands.machine import profile as profile_command

    if list_known:
        typer.echo(profile_command.library_table())
        return
    if out is None:
        raise BadInput("--out is missing: name the curve file, or give --list.")
    if from_run is not None:
        if source is not None:
            raise BadInput("--from takes the times of a run that is done: leave out the photographs.")
        result = profile_command.profile_of_run(from_run, out, machine)
    else:
        from radiant_app.config.run_config import ExecutionOptions
        from radiant_app.quantities import seconds_of
        from radiant_app.report.progress import terminal_display
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
    for name in ("machine", "training", "measured_steps", "largest_count", "exchange", "warnings", "profile"):
        typer.echo(f"{name}: {result[name]}")
