"""The options of `radiant change` and `radiant measure`; heavy libraries are imported inside."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from radiant_app.cli.option_types import AsJson
from radiant_app.report.tables import finish
from radiant_core.choices import MeasureKind


def change(
    older: Annotated[Path, typer.Argument(help="The earlier run, or folder of `radiant train`.", show_default=False)],
    newer: Annotated[Path, typer.Argument(help="The later one, of the same ground.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="New folder of change.tif, change.geojson and report.html.", show_default=False)],
    resolution: Annotated[float | None, typer.Option(min=1e-6, help="Metres of a cell, else two pixels of the photographs.")] = None,
    min_area: Annotated[
        float | None, typer.Option(help="Square metres of the smallest patch, else 600 square pixels of the ground.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """What changed between two dates, in height and colour: a layer, patches and a page."""
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.survey.change import ChangeRequest
        from radiant_app.commands.survey.change import change as compare

    request = ChangeRequest(older=older, newer=newer, out=out, resolution=resolution, min_area=min_area)
    finish(compare(request, terminal_display()), as_json)


def measure(
    run: Annotated[Path, typer.Argument(help="A run, or folder of `radiant train`.", show_default=False)],
    kind: Annotated[MeasureKind | None, typer.Option(help="What to measure; without it, what is kept is listed.")] = None,
    at: Annotated[str | None, typer.Option(help='Places on the map: "east,north east,north …", each with a height or none.')] = None,
    name: Annotated[str | None, typer.Option(help="Name to keep it by, else its kind and a number.")] = None,
    base: Annotated[float | None, typer.Option(help="Height of a volume's level base, else the plane through its corners.")] = None,
    resolution: Annotated[float | None, typer.Option(min=1e-6, help="Metres of a cell of the surface, else two pixels.")] = None,
    remove: Annotated[str | None, typer.Option(help="Name of a measure to take out.")] = None,
    export: Annotated[Path | None, typer.Option(help="Write all that is kept as .geojson or .csv.")] = None,
    as_json: AsJson = False,
) -> None:
    """Distances, heights, areas, volumes and profiles with their σ, kept with the run."""
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.survey.measure import MeasureRequest, measure_run

    request = MeasureRequest(run=run, kind=kind, places=at, name=name, base=base, resolution=resolution, remove=remove, export=export)
    result = measure_run(request, terminal_display())
    if as_json:
        return finish(result, as_json)
    return finish(dict(_lines(result)), as_json)


def _lines(result: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """A line for each measure: its figures with σ."""
    from radiant_core.io.measures_file import figures_text

    for name, row in (result["measures"] if "measures" in result else {result["name"]: result}).items():
        yield name, figures_text(row)
