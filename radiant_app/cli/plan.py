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


def next_flight(
    run: Annotated[Path, typer.Argument(help="A finished run, or folder of `radiant train`.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="New folder of the map, and of the flight lists.", show_default=False)],
    photographs: Annotated[int | None, typer.Option(min=1, help="Propose so many more; without it and --batteries: the map alone.")] = None,
    batteries: Annotated[int | None, typer.Option(min=1, help="Propose what so many batteries of each device last for.")] = None,
    system: Annotated[Path | None, typer.Option(help="TOML of the devices that fly; else one.")] = None,
    resolution: Annotated[float | None, typer.Option(min=1e-6, help="Metres of a cell, else four pixels of the photographs.")] = None,
    safe: Annotated[float, typer.Option(min=0.1, help="Least metres from every surface of the model.")] = 5.0,
    take_off: Annotated[float | None, typer.Option(help="Height of take-off on the map, else that of low ground.")] = None,
    min_height: Annotated[float | None, typer.Option(help="Least metres above take-off, else those of --safe.")] = None,
    max_height: Annotated[float, typer.Option(help="Most metres above take-off and above the ground below.")] = 120.0,
    no_fly: Annotated[list[Path] | None, typer.Option(help="GeoJSON polygon that is not flown over; repeatable.")] = None,
    flight_format: options.FlightFormatOption = "kmz,plan,kml",
    speed: options.SpeedOption = 8.0,
    battery: options.BatteryOption = "20m",
    crs: Annotated[str | None, typer.Option(help="System of the map, else the UTM zone.")] = None,
    seed: options.Seed = 0,
    as_json: options.AsJson = False,
) -> None:
    """What is known of a run's surface, cell by cell, and where to photograph next."""
    from radiant_app.commands.plan.flight import battery_seconds, flight_formats
    from radiant_app.commands.plan.next_flight import NextFlightRequest, plan_next_flight
    from radiant_app.report.progress import terminal_display
    from radiant_core.plan.flight.figures import Drone

    request = NextFlightRequest(
        run=run,
        out=out,
        photographs=photographs,
        batteries=batteries,
        system=system,
        resolution=resolution,
        safe_m=safe,
        lowest_m=min_height,
        highest_m=max_height,
        take_off=take_off,
        no_fly=tuple(no_fly or ()),
        formats=flight_formats(flight_format),
        drone=Drone(speed_m_per_s=speed, battery_s=battery_seconds(battery)),
        crs=crs,
        seed=seed,
    )
    finish(plan_next_flight(request, terminal_display()), as_json)


def _paper_of(plan_method: PlanMethod, raster_cell_m: float | None, settings: list[str] | None) -> PaperConfig | None:
    from radiant_app.config.fields import plan_options, with_settings

    typed = {"plan.method": plan_method, "plan.raster_cell_m": raster_cell_m, "plan.file": None}
    return plan_options(with_settings(typed, settings or (), "plan.")).paper
