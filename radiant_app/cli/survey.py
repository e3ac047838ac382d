"""The options of `radiant measure`; heavy libraries are imported inside, as in `cli.app`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from radiant_app.cli.config_options import typed_options
from radiant_app.cli.option_types import AsJson
from radiant_app.report.tables import finish
from radiant_core.choices import MeasureKind
from radiant_core.errors import BadInput

_CHANGE = "Change between two dates"


def measure(
    context: typer.Context,
    run: Annotated[Path, typer.Argument(help="A run, or folder of `radiant train`.", show_default=False)],
    kind: Annotated[MeasureKind | None, typer.Option(help="What to measure; without it, the saved measures are listed.")] = None,
    at: Annotated[str | None, typer.Option(help='Places on the map: "east,north east,north …", each with or without a height.')] = None,
    name: Annotated[str | None, typer.Option(help="Name to save it under; by default its kind and a number.")] = None,
    base: Annotated[float | None, typer.Option(help="Height of a volume's level base; by default the plane through its corners.")] = None,
    resolution: Annotated[float | None, typer.Option(min=1e-6, help="Metres of a cell of the surface; by default two pixels.")] = None,
    remove: Annotated[str | None, typer.Option(help="Name of a saved measure to delete.")] = None,
    export: Annotated[Path | None, typer.Option(help="Write all saved measures as .geojson or .csv.")] = None,
    since: Annotated[
        Path | None,
        typer.Option(help="An earlier run of the same ground, to find what has changed since.", rich_help_panel=_CHANGE),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="New folder for change.tif, change.geojson and report.html.", rich_help_panel=_CHANGE),
    ] = None,
    min_area: Annotated[
        float | None,
        typer.Option(help="Square metres of the smallest patch; by default 600 square pixels of the ground.", rich_help_panel=_CHANGE),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure distances, areas, volumes and change, with σ.

    Measures are saved with the run.

    radiant measure RUN --kind volume --at "0,0 30,0 30,20" --name heap
    radiant measure RUN --since EARLIER_RUN --out changed
    """
    from radiant_app.report.progress import show_starting, terminal_display

    _require_one_question(typed_options(context))
    with show_starting():
        from radiant_app.commands.survey.change import ChangeRequest, change
        from radiant_app.commands.survey.measure import MeasureRequest, measure_run

    if since is not None and out is not None:
        compared = ChangeRequest(older=since, newer=run, out=out, resolution=resolution, min_area=min_area)
        return finish(change(compared, terminal_display()), as_json)
    request = MeasureRequest(run=run, kind=kind, places=at, name=name, base=base, resolution=resolution, remove=remove, export=export)
    result = measure_run(request, terminal_display())
    if as_json:
        return finish(result, as_json)
    for line in _lines(result):
        typer.echo(line)
    return None


def _require_one_question(typed: dict[str, str]) -> None:
    """Raise BadInput where options of a measure stand beside those of a change."""
    of_change = [option for name, option in typed.items() if name in ("since", "out", "min_area")]
    others = [option for name, option in typed.items() if name in ("kind", "at", "name", "base", "remove", "export")]
    if of_change and others:
        raise BadInput(f"{of_change[0]} is for change between two dates and {others[0]} for a measure: leave one of them out.")
    if of_change and "since" not in typed:
        raise BadInput(f"{of_change[0]} is for change between two dates: name the earlier run with --since.")
    if of_change and "out" not in typed:
        raise BadInput("--out is missing: name a new folder for what has changed.")


def _lines(result: dict[str, Any]) -> Iterator[str]:
    """A line for each measure: its figures with σ."""
    from radiant_core.io.measures_file import figures_text

    for name, row in (result["measures"] if "measures" in result else {result["name"]: result}).items():
        yield f"{name}: {figures_text(row)}"
