"""The options of `radiant plan`; heavy libraries are imported inside, as in `cli.app`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from radiant_app.cli import option_types as options
from radiant_app.cli.config_options import typed_options, with_options_of
from radiant_app.report.tables import finish
from radiant_core.choices import PlanMethod
from radiant_core.errors import BadInput
from radiant_core.plan.regions.paper_config import PaperConfig

if TYPE_CHECKING:
    from radiant_app.commands.plan.plan import PlanRequest


def plan_again(
    after: options.AfterOption = None,
    dead: options.DeadOption = None,
    slow: options.SlowOption = None,
    busy: options.BusyOption = None,
    done: options.DoneOption = None,
    join: options.JoiningOption = None,
    captured: options.CapturedOption = None,
    tolerance: options.ToleranceOption = 0.0,
    *,
    out: Path,
    system: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Plan for the least makespan, then the fewest positions that move, after what happened."""
    from radiant_app.commands.plan.replan import ReplanRequest, parse_values, replan_files, replan_table
    from radiant_app.report.progress import terminal_display
    from radiant_core.plan.revision.replan import FleetChange

    assert after is not None
    change = FleetChange(
        dead=frozenset(dead or ()),
        done=frozenset(done or ()),
        slow=parse_values(slow or (), "--slow"),
        busy_s=parse_values(busy or (), "--busy"),
    )
    request = ReplanRequest(
        source=after, out=out, system=system, change=change, join=join, captured=captured, tolerance=tolerance, seed=seed
    )
    result = replan_files(request, terminal_display())
    if not as_json:
        typer.echo(replan_table(result))
    finish(result, as_json)


@with_options_of(plan_again)
def plan(
    context: typer.Context,
    source: options.PlanSource = None,
    *,
    out: options.PlanOut,
    system: options.SystemFile = None,
    plan_method: options.PlanMethodOption = "exact",
    compare: options.CompareOption = False,
    slack: options.SlackOption = None,
    slack_curve: options.SlackCurveOption = False,
    constraints: options.ConstraintsOption = None,
    cut_by: options.CutByOption = "auto",
    raster_cell_m: options.RasterCellOption = None,
    ground: options.GroundOption = None,
    field_of_view: options.FieldOfViewOption = 73.7,
    buffer: options.BufferOption = None,
    deadline: options.DeadlineOption = None,
    train_preset: options.PlannedTraining = "default",
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
    **later: Any,
) -> None:
    """Divide a scene among edges and devices, before or after capture.

    Each edge gets a region, each device its waypoints or photographs.

    radiant plan flight.csv --system system.toml --out plan/plan.json
    radiant plan PHOTOS --system system.toml --out plan/plan.json --compare
    radiant plan --after plan/plan.json --dead north-1 --out plan2/plan.json
    """
    from radiant_app.commands.plan.plan import plan as make_plan
    from radiant_app.commands.plan.tables import plan_tables
    from radiant_app.report.progress import terminal_display

    _require_one_source(typed_options(context), source, later)
    if source is None:
        return plan_again(**later, out=out, system=system, seed=seed, as_json=as_json)
    result = make_plan(_request_of(context.params), terminal_display())
    for table in [] if as_json else plan_tables(result):
        typer.echo(table)
    return finish(result, as_json)


def _require_one_source(typed: Mapping[str, str], source: Path | None, later: Mapping[str, Any]) -> None:
    """Raise BadInput where what is planned is not named once, and for options of the other kind."""
    if later["after"] is None:
        if wrong := [option for name, option in typed.items() if name in later]:
            raise BadInput(f"{wrong[0]} is for planning again: name the plan or run with --after.")
        if source is None:
            raise BadInput("source is missing: name waypoints, photographs, a scene or a run; or --after and a plan or run.")
        return
    if source is not None:
        raise BadInput(f"--after plans {later['after']} again, and {source} is another source: leave one of them out.")
    if wrong := [option for name, option in typed.items() if name not in {*later, "out", "system", "seed", "as_json"}]:
        raise BadInput(f"{wrong[0]} is for a new plan, and --after keeps to the plan that there is: leave one of them out.")


def _request_of(typed: Mapping[str, Any]) -> PlanRequest:
    """The request of options by name, those of `plan`."""
    from radiant_app.commands.plan.content import content_request
    from radiant_app.commands.plan.flight import DroneText, HeightOptions, flight_request
    from radiant_app.commands.plan.plan import PlanRequest
    from radiant_core.train.needs import Overrides

    given = {name: typed[name] for name in ("source", "out", "system", "seed", "compare", "slack", "slack_curve", "cut_by", "constraints")}
    given |= {name: typed[name] for name in ("crs", "require_grids", "train_preset")}
    heights = HeightOptions(*(typed[name] for name in ("heights", "height", "min_height", "max_height", "geoid")))
    drone = DroneText(*(typed[name] for name in ("speed", "battery", "image_width", "field_of_view")))
    return PlanRequest(
        **given,
        method=typed["plan_method"],
        paper=_paper_of(typed["plan_method"], typed["raster_cell_m"], typed["settings"]),
        raster_cell_m=typed["raster_cell_m"] or None,
        flight=flight_request(typed["whole_lines"], typed["flight_format"], heights, drone),
        content=content_request(*(typed[name] for name in ("ground", "field_of_view", "buffer", "deadline"))),
        overrides=Overrides(long_side_px=typed["long_side_px"], num_steps=typed["steps"], max_num_splats=typed["max_splats"]),
    )


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
    """Map what photographs fix of a surface, and plan where to fly next.

    Without --photographs and --batteries only the map is written.

    radiant next-flight RUN --out next --photographs 13
    radiant next-flight RUN --out next --batteries 1 --system system.toml
    """
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
