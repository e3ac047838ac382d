"""The options of `radiant clean`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from radiant_app.cli.option_types import AsJson
from radiant_app.report.tables import finish
from radiant_core.errors import BadInput

_POLYGON = 'a .geojson file with one polygon, or "x,y x,y x,y" in the model\'s coordinates.'


def clean(
    model: Annotated[Path, typer.Argument(help="A run, the folder of `radiant train`, or a PLY.", show_default=False)],
    keep: Annotated[str | None, typer.Option(help=f"Leave out what is outside of a polygon: {_POLYGON}")] = None,
    remove: Annotated[str | None, typer.Option(help=f"Leave out what is inside of a polygon: {_POLYGON}")] = None,
    heights: Annotated[str | None, typer.Option(help="LOW,HIGH between which --keep or --remove hold; either may be empty.")] = None,
    regions_margin: Annotated[
        float | None, typer.Option("--regions-margin", min=0, help="Leave out what is farther from the plan's regions than this.")
    ] = None,
    min_views: Annotated[int | None, typer.Option("--min-views", min=1, help="Leave out what fewer photographs show.")] = None,
    min_parallax_deg: Annotated[
        float | None, typer.Option("--min-parallax-deg", min=0, max=180, help="Leave out what they show from less far apart.")
    ] = None,
    min_opacity: Annotated[float | None, typer.Option("--min-opacity", help="Leave out what is less opaque, 0 to 1.")] = None,
    max_size: Annotated[float | None, typer.Option("--max-size", help="Leave out what has a longer standard deviation.")] = None,
    measure: Annotated[bool, typer.Option("--measure", help="Measure anew which photographs show each Gaussian.")] = False,
    undo: Annotated[bool, typer.Option("--undo", help="Take the last step back.")] = False,
    redo: Annotated[bool, typer.Option("--redo", help="Make the step again that was taken back last.")] = False,
    reset: Annotated[bool, typer.Option("--reset", help="Take all steps back.")] = False,
    pages: Annotated[bool, typer.Option("--pages", help="Make report.html and scene.html of a run anew, as it is cleaned now.")] = False,
    as_json: AsJson = False,
) -> None:
    """Leave floaters and haze out of a model wherever it is shown or exported; nothing is lost."""
    from radiant_app.report.progress import show_starting, terminal_display

    with show_starting():
        from radiant_app.commands.model.clean import CleanRequest
        from radiant_app.commands.model.clean import clean as change
        from radiant_core.geometry.cleaning import MAX_STEPS

    request = CleanRequest(
        model=model,
        keep=keep,
        remove=remove,
        heights=_heights(heights),
        regions_margin=regions_margin,
        min_views=min_views,
        min_parallax_deg=min_parallax_deg,
        min_opacity=min_opacity,
        max_size=max_size,
        undo=MAX_STEPS if reset else int(undo),
        redo=redo,
        measure=measure,
        pages=pages,
    )
    result = change(request, terminal_display())
    if not as_json:
        for step in result["steps"]:
            typer.echo(f"{step['left_out']:,} left out: what is kept is {step['keeps']}")
    finish(result, as_json)


def _heights(text: str | None) -> tuple[float | None, float | None]:
    try:
        low, high = (float(part) if part.strip() else None for part in (text or ",").split(","))
    except ValueError:
        raise BadInput(f"{text!r} are no heights: write LOW,HIGH, such as -2,30, or 2, for all above 2.") from None
    return low, high
