"""The options of `radiant plan`; heavy libraries are imported inside, as in `cli`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from radiant_app.cli import option_types as options
from radiant_app.report.tables import finish
from radiant_core.choices import PlanMethod
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.train.config import Preset


def plan(
    source: options.PlanSource,
    out: Annotated[Path, typer.Option("--out", help="File of the plan; picture and exports go beside.", show_default=False)],
    system: options.SystemFile = None,
    plan_method: options.PlanMethodOption = "exact",
    compare: Annotated[bool, typer.Option("--compare", help="Print a table of all methods on the same positions.")] = False,
    slack: Annotated[float | None, typer.Option(min=1, help="Makespan may be so many times the shortest for shorter ways: 1.1.")] = None,
    slack_curve: Annotated[bool, typer.Option("--slack-curve", help="Table and picture of what several slacks buy.")] = False,
    constraints: Annotated[Path | None, typer.Option(help="TOML of fixed weights, locked regions, pinned cameras.")] = None,
    cut_by: options.CutByOption = "auto",
    raster_cell_m: options.RasterCellOption = None,
    ground: options.GroundOption = None,
    field_of_view: options.FieldOfViewOption = 73.7,
    buffer: options.BufferOption = None,
    deadline: options.DeadlineOption = None,
    train_preset: Annotated[Preset, typer.Option(help="What will be trained, for limits by memory and measured curves.")] = "default",
    long_side_px: options.LongSide = None,
    steps: options.NumSteps = None,
    max_splats: options.MaxSplats = None,
    settings: options.PlanSettings = None,
    crs: options.CrsOption = None,
    require_grids: options.RequireCrsGridsOption = False,
    whole_lines: options.WholeLinesOption = None,
    flight_format: options.FlightFormatOption = None,
    heights: options.HeightsOption = None,
    height: options.FlightHeightOption = None,
    min_height: options.MinHeightOption = None,
    max_height: options.MaxHeightOption = None,
    geoid: options.GeoidOption = None,
    speed: options.SpeedOption = 8.0,
    battery: options.BatteryOption = "20m",
    image_width: options.ImageWidthOption = 4000,
    seed: options.Seed = 0,
    as_json: options.AsJson = False,
) -> None:
    """Regions per edge and waypoints or photographs per device, by position; before capture too."""
    from radiant_app.commands.plan.content import content_request
    from radiant_app.commands.plan.flight import DroneText, HeightOptions, flight_request
    from radiant_app.commands.plan.plan import PlanRequest
    from radiant_app.commands.plan.plan import plan as make_plan
    from radiant_app.commands.plan.tables import plan_tables
    from radiant_app.report.progress import terminal_display
    from radiant_core.train.needs import Overrides

    asked, drone = HeightOptions(heights, height, min_height, max_height, geoid), DroneText(speed, battery, image_width, field_of_view)
    request = PlanRequest(
        source=source,
        out=out,
        system=system,
        method=plan_method,
        paper=_paper_of(plan_method, raster_cell_m, settings),
        seed=seed,
        compare=compare,
        slack=slack,
        slack_curve=slack_curve,
        cut_by=cut_by,
        constraints=constraints,
        raster_cell_m=raster_cell_m or None,
        crs=crs,
        require_grids=require_grids,
        flight=flight_request(whole_lines, flight_format, asked, drone),
        content=content_request(ground, field_of_view, buffer, deadline),
        train_preset=train_preset,
        overrides=Overrides(long_side_px=long_side_px, num_steps=steps, max_num_splats=max_splats),
    )
    result = make_plan(request, terminal_display())
    for table in [] if as_json else plan_tables(result):
        typer.echo(table)
    finish(result, as_json)


def _paper_of(plan_method: PlanMethod, raster_cell_m: float | None, settings: list[str] | None) -> PaperConfig | None:
    from radiant_app.config.fields import plan_options, with_settings

    typed = {"plan.method": plan_method, "plan.raster_cell_m": raster_cell_m, "plan.file": None}
    return plan_options(with_settings(typed, settings or (), "plan.")).paper
