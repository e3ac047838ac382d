"""The command `radiant replan`: its options; heavy libraries are imported inside, as in `cli`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from radiant_app.cli.option_types import AsJson, Seed
from radiant_app.report.tables import finish


def replan_plan(
    source: Annotated[Path, typer.Argument(help="A plan of waypoints, or the folder of a run.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="File of the new plan; picture and exports go beside.", show_default=False)],
    system: Annotated[Path | None, typer.Option(help="TOML the plan was made for; else two edges with two devices each.")] = None,
    dead: Annotated[list[str] | None, typer.Option(help="Device or edge that is gone; repeatable.")] = None,
    slow: Annotated[list[str] | None, typer.Option(help="ID=FACTOR: takes so many times longer; repeatable.")] = None,
    busy: Annotated[list[str] | None, typer.Option(help="ID=SECONDS: begins only then; repeatable.")] = None,
    done: Annotated[list[str] | None, typer.Option(help="Device or edge that has finished; repeatable.")] = None,
    join: Annotated[Path | None, typer.Option(help="System file of edges, or of devices at edges that are there, that join.")] = None,
    captured: Annotated[Path | None, typer.Option(help="What was captured: waypoint file or folder of photographs; it stays.")] = None,
    tolerance: Annotated[float, typer.Option(min=0, help="Share by which the makespan may exceed the least, to move fewer.")] = 0.0,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """A plan after a device died, slowed down or finished, or others joined: the least makespan,
    then the fewest positions that move."""
    from radiant_app.commands.plan.replan import ReplanRequest, parse_values, replan_files, replan_table
    from radiant_app.report.progress import terminal_display
    from radiant_core.plan.revision.replan import FleetChange

    change = FleetChange(
        dead=frozenset(dead or ()),
        done=frozenset(done or ()),
        slow=parse_values(slow or (), "--slow"),
        busy_s=parse_values(busy or (), "--busy"),
    )
    request = ReplanRequest(
        source=source, out=out, system=system, change=change, join=join, captured=captured, tolerance=tolerance, seed=seed
    )
    result = replan_files(request, terminal_display())
    if not as_json:
        typer.echo(replan_table(result))
    finish(result, as_json)
