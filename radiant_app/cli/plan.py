"""The options of `radiant plan`; heavy libraries are imported inside, as in `cli.app`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from radiant_app.cli import option_types as options
from radiant_app.cli.config_options import options_of, typed_options, with_options_of
from radiant_app.report.figure_words import OF_POSITIONS
from radiant_app.report.tables import finish
from radiant_core.choices import PlanMethod
from radiant_core.errors import BadInput
from radiant_core.plan.regions.paper_config import PaperConfig

HIGHEST_M = 120.0
"""Above take-off and ground, the usual limit."""

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
    finish(result, as_json, OF_POSITIONS)


def plan_next_flight(
    next_run: options.NextOption = None,
    photographs: options.PhotographsOption = None,
    batteries: options.BatteriesOption = None,
    resolution: options.CellOption = None,
    safe: options.SafeOption = 5.0,
    take_off: options.TakeOffOption = None,
    no_fly: options.NoFlyOption = None,
    *,
    typed: Mapping[str, Any],
) -> None:
    """Map what photographs fix of a surface, and plan where to fly next; `typed`: the options that
    every plan has, by name."""
    from radiant_app.commands.plan.flight import battery_seconds, flight_formats
    from radiant_app.commands.plan.next_flight import NextFlightRequest
    from radiant_app.commands.plan.next_flight import plan_next_flight as plan_next
    from radiant_app.commands.plan.tables import next_flight_lines
    from radiant_app.report.progress import terminal_display
    from radiant_core.plan.flight.figures import Drone

    assert next_run is not None
    request = NextFlightRequest(
        run=next_run,
        out=typed["out"],
        photographs=photographs,
        batteries=batteries,
        system=typed["system"],
        deadline_s=typed["deadline"],
        resolution=resolution,
        safe_m=safe,
        lowest_m=typed["min_height"],
        highest_m=HIGHEST_M if typed["max_height"] is None else typed["max_height"],
        take_off=take_off,
        no_fly=tuple(no_fly or ()),
        formats=flight_formats(typed["flight_format"] or "kmz,plan,kml"),
        drone=Drone(speed_m_per_s=typed["speed"], battery_s=battery_seconds(typed["battery"])),
        crs=typed["crs"],
        seed=typed["seed"],
    )
    result = plan_next(request, terminal_display())
    if typed["as_json"]:
        return finish(result, as_json=True)
    return typer.echo("\n".join(next_flight_lines(result, next_run)))


@with_options_of(plan_again, plan_next_flight)
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
    field_of_view: options.FieldOfViewOption = None,
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
    image_width: options.ImageWidthOption = None,
    image_height: options.ImageHeightOption = None,
    seed: options.Seed = 0,
    as_json: options.AsJson = False,
    **later: Any,
) -> None:
    """Divide a scene among edges and devices, before or after capture.

    Each edge gets a region, each device its waypoints or photographs.

    radiant plan flight.csv --system system.toml --out plan/plan.json
    radiant plan PHOTOS --system system.toml --out plan/plan.json --compare
    radiant plan --after plan/plan.json --dead north-1 --out plan2/plan.json
    radiant plan --next RUN --photographs 13 --out next
    """
    from radiant_app.commands.plan.plan import plan as make_plan
    from radiant_app.commands.plan.tables import plan_tables
    from radiant_app.report.progress import terminal_display

    _require_one_source(typed_options(context), source, later)
    again, next_one = ({parameter.name: later[parameter.name] for parameter in options_of(part)} for part in (plan_again, plan_next_flight))
    if again["after"] is not None:
        return plan_again(**again, out=out, system=system, seed=seed, as_json=as_json)
    if next_one["next_run"] is not None:
        return plan_next_flight(**next_one, typed=context.params)
    result = make_plan(_request_of(context.params), terminal_display())
    for table in [] if as_json else plan_tables(result):
        typer.echo(table)
    return finish(result, as_json)


@dataclass(frozen=True, kw_only=True)
class _Instead:
    """What a plan is made of in place of a source."""

    flag: str
    subject: str
    named: str
    does: str
    stays: str
    options: frozenset[str]
    """Its own, by parameter."""
    shared: frozenset[str]
    """Those of every plan that it has too."""


def _instead() -> Mapping[str, _Instead]:
    """By the parameter that names it."""
    return {
        "after": _Instead(
            flag="--after",
            subject="planning again",
            named="the plan or run",
            does="plans {} again",
            stays="the plan that there is",
            options=frozenset(parameter.name for parameter in options_of(plan_again)),
            shared=frozenset({"out", "system", "seed", "as_json"}),
        ),
        "next_run": _Instead(
            flag="--next",
            subject="the next flight",
            named="a finished run",
            does="plans another flight for {}",
            stays="the run that there is",
            options=frozenset(parameter.name for parameter in options_of(plan_next_flight)),
            shared=frozenset(
                {"out", "system", "deadline", "min_height", "max_height", "flight_format", "speed", "battery", "crs", "seed", "as_json"}
            ),
        ),
    }


def _require_one_source(typed: Mapping[str, str], source: Path | None, later: Mapping[str, Any]) -> None:
    """Raise BadInput where what is planned is not named once, and for options of another kind."""
    kinds = _instead()
    chosen_kinds = [kind for name, kind in kinds.items() if later[name] is not None]
    for kind in kinds.values():
        if kind not in chosen_kinds and (wrong := [option for name, option in typed.items() if name in kind.options]):
            raise BadInput(f"{wrong[0]} is for {kind.subject}: name {kind.named} with {kind.flag}.")
    if not chosen_kinds and source is None:
        raise BadInput("source is missing: name waypoints, photographs, a scene or a run; or --after and a plan or run.")
    if len(chosen_kinds) > 1:
        raise BadInput("--after plans again and --next plans another flight: ask for one of them.")
    for name, kind in kinds.items():
        if kind not in chosen_kinds:
            continue
        if source is not None:
            raise BadInput(f"{kind.flag} {kind.does.format(later[name])}, and {source} is another source: leave one of them out.")
        if wrong := [option for option_of, option in typed.items() if option_of not in kind.options | kind.shared]:
            raise BadInput(f"{wrong[0]} is for a new plan, and {kind.flag} keeps to {kind.stays}: leave one of them out.")


def _request_of(typed: Mapping[str, Any]) -> PlanRequest:
    """The request of options by name, those of `plan`."""
    from radiant_app.commands.plan.content import content_request
    from radiant_app.commands.plan.flight import DroneText, HeightOptions, flight_request
    from radiant_app.commands.plan.plan import PlanRequest
    from radiant_core.train.needs import Overrides

    same_named = {
        name: typed[name] for name in ("source", "out", "system", "seed", "compare", "slack", "slack_curve", "cut_by", "constraints")
    }
    same_named |= {name: typed[name] for name in ("crs", "require_grids", "train_preset")}
    heights = HeightOptions(*(typed[name] for name in ("heights", "height", "min_height", "max_height", "geoid")))
    drone = DroneText(*(typed[name] for name in ("speed", "battery", "image_width", "field_of_view", "image_height")))
    return PlanRequest(
        **same_named,
        method=typed["plan_method"],
        paper=_paper_of(typed["plan_method"], typed["raster_cell_m"], typed["settings"]),
        raster_cell_m=typed["raster_cell_m"] or None,
        flight=flight_request(typed["whole_lines"], typed["flight_format"], heights, drone),
        content=content_request(*(typed[name] for name in ("ground", "field_of_view", "buffer", "deadline"))),
        overrides=Overrides(long_side_px=typed["long_side_px"], num_steps=typed["steps"], max_num_splats=typed["max_splats"]),
    )


def _paper_of(plan_method: PlanMethod, raster_cell_m: float | None, settings: list[str] | None) -> PaperConfig | None:
    from radiant_app.config.fields import plan_options, with_settings

    typed = {"plan.method": plan_method, "plan.raster_cell_m": raster_cell_m, "plan.file": None}
    return plan_options(with_settings(typed, settings or (), "plan.")).paper
