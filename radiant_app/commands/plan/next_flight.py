"""`radiant plan` after a run: what is known of its surface, and where to photograph next.

OUT gets the map of what is known (`known_map`) and, where photographs or batteries are asked for,
next.geojson: each view with its reason, and in flight/ a list per device, in the order of its
flight. The exact planner deals the views to the devices of the system, at most as many as its
machines train, join and send by a deadline.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from radiant_app.commands.plan.costs import InTime, views_in_time
from radiant_app.commands.plan.flight import WRITERS
from radiant_app.commands.plan.known_map import STAGE, FoundMap, find_known, write_known
from radiant_app.commands.run.steps import stage_bar
from radiant_app.commands.survey.parts import Survey, load_survey
from radiant_app.events import Decided, Warned
from radiant_app.files.run_folder import create_folder
from radiant_app.files.system_file import even_system, load_system
from radiant_app.report.known_section import add_known_section
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.cloud_planning import place_edges_by_raster
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.export.plan import waypoints_csv
from radiant_core.frames import geodetic_from_enu
from radiant_core.io.flight.route import FlownHeights, route_of
from radiant_core.io.run_store import write_atomic, write_json
from radiant_core.next_flight.candidates import Air, Candidates, FlightRules, air_over, candidate_views, usual_take_off
from radiant_core.next_flight.choosing import COMPARED_FACETS, Chosen, choose_views
from radiant_core.next_flight.facets import Facets
from radiant_core.next_flight.sightings import Sights, known_by
from radiant_core.next_flight.way import HEADROOM, length_low_over_unknown, low_over_unknown, safe_way, shortest_order
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.wide_deadline import system_capacity
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.flight.figures import CLIMB_M_PER_S, Drone, flight_figures
from radiant_core.plan.heights import USUAL_LIMIT_M
from radiant_core.plan.regions.edge_sites import distant_edges
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.system import System
from radiant_core.plan.waypoints import Waypoints
from radiant_core.render.trajectories import Lens
from radiant_core.survey.geojson import line_feature, point_feature, to_geojson
from radiant_core.waypoints.region import load_region

if TYPE_CHECKING:
    from radiant_viewer.charts.known_chart import FlownLine

NO_LISTS = "the scene has no place on the globe: the views are in next.geojson alone, without flight lists."
SAFE_M, MOST_VIEWS = 5.0, 500
"""Distance to every surface unless another is asked for; views that batteries are filled with."""


@dataclass(frozen=True, kw_only=True)
class NextFlightRequest:
    """What was asked for; neither photographs nor batteries: the map alone."""

    run: Path
    out: Path
    photographs: int | None = None
    batteries: int | None = None
    """For each device."""
    system: Path | None = None
    """The devices that fly; None: one."""
    deadline_s: float | None = None
    """In which each edge trains, joins and sends its new photographs; None: no limit."""
    resolution: float | None = None
    safe_m: float = SAFE_M
    lowest_m: float | None = None
    """Least height above take-off; None: the safe distance."""
    highest_m: float = USUAL_LIMIT_M
    take_off: float | None = None
    """Height of take-off on the map; None: that of low ground."""
    no_fly: tuple[Path, ...] = ()
    formats: tuple[str, ...] = ("kmz", "plan", "kml")
    drone: Drone = field(default_factory=Drone)
    crs: str | None = None
    seed: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Flight:
    """One device's flight: views, in its order, its way (Q,3) on the map and which view each of its
    points is, −1 where it is only passed."""

    device: str
    views: tuple[Chosen, ...]
    way: FloatArray
    owner: NDArray[np.int64]
    flight_s: float
    batteries: int
    device_time_s: float
    """T^n of its views."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Proposal:
    known_map: FoundMap
    air: Air
    candidates: Candidates
    flights: tuple[_Flight, ...]

    @property
    def num_views(self) -> int:
        return sum(len(flight.views) for flight in self.flights)


def plan_next_flight(request: NextFlightRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write the map, and the proposal where one was asked for, into a new folder; returns the
    figures. BadInput for what cannot be used and where no view is safe; nothing stays behind."""
    _require_request(request)
    system = even_system(1, 1) if request.system is None else load_system(request.system, curves=True)
    survey = load_survey(request.run, request.crs)
    wants_flight = request.photographs is not None or request.batteries is not None
    if wants_flight and survey.run.scene.frame.kind == "unscaled":
        raise BadInput("flights are in metres, and nothing gives the scale of this scene: give GPS or --distance to 'radiant sfm'.")
    no_fly = _no_fly(request, survey, display)
    with create_folder(request.out, whole=True):
        known_map = find_known(survey, request.resolution, display)
        figures = write_known(known_map, request.out)
        proposal = _propose(request, system, known_map, no_fly, display) if wants_flight else None
        _draw(request.out, known_map, proposal)
        if request.out.resolve().parent == request.run.resolve():
            add_known_section(request.run / "report.html", request.out / "known.png", figures)
        written = {"map": str(request.out / "known.tif"), "picture": str(request.out / "known.png")}
        return {**figures, **written, **({} if proposal is None else _write_flights(request, proposal, display))}


def _require_request(request: NextFlightRequest) -> None:
    for option, count in (("--photographs", request.photographs), ("--batteries", request.batteries)):
        if count is not None and count < 1:
            raise BadInput(f"{option} is {count}, expected 1 or more.")
    if request.photographs is not None and request.photographs > MOST_VIEWS:
        raise BadInput(f"--photographs is {request.photographs}, expected at most {MOST_VIEWS}: fly, train again and ask again.")
    if request.deadline_s is not None and not 0 < request.deadline_s < math.inf:
        raise BadInput(f"--deadline is {request.deadline_s:g} s, expected more than 0.")
    if request.deadline_s is not None and request.system is None:
        raise BadInput("--deadline counts what machines cost: name them with --system.")
    if request.deadline_s is not None and request.photographs is None and request.batteries is None:
        raise BadInput("--deadline bounds a flight, and only the map was asked for: give --photographs or --batteries.")
    unknown = [name for name in request.formats if name not in WRITERS]
    if unknown:
        raise BadInput(f"--flight-format names {unknown[0]!r}, expected some of csv (always written), {', '.join(WRITERS)} with commas.")


def _no_fly(request: NextFlightRequest, survey: Survey, display: ProgressDisplay) -> tuple[shapely.Polygon, ...]:
    if request.no_fly and survey.run.scene.frame.kind != "metric":
        raise BadInput(f"{request.no_fly[0]} is in degrees, and this model has no place on earth: leave --no-fly out.")
    land = []
    for path in request.no_fly:
        corners = load_region(path, survey.run.scene.frame.origin_lat_lon_alt, lambda text: display(Warned(stage=STAGE, message=text)))
        places = survey.map_frame.from_world(np.column_stack([corners, np.full(len(corners), survey.ground.level)]))
        land.append(shapely.Polygon(places[:, :2]))
    return tuple(land)


def _propose(
    request: NextFlightRequest, system: System, known_map: FoundMap, no_fly: tuple[shapely.Polygon, ...], display: ProgressDisplay
) -> _Proposal:
    facets = known_map.layers.facets
    take_off = usual_take_off(facets) if request.take_off is None else request.take_off
    lowest = request.safe_m if request.lowest_m is None else request.lowest_m
    rules = FlightRules(safe=request.safe_m, take_off=take_off, lowest=lowest, highest=request.highest_m, no_fly=no_fly)
    air = air_over(facets, rules)
    candidates = candidate_views(air, known_map.survey.map_frame, usual_lens(known_map), known_map.survey.ground.reach)
    facets = _compared(facets, display)
    sights = Sights(facets, known_map.survey.map_frame)
    with stage_bar(display, "candidates") as report:
        flown = sights.all_of(known_map.trained)
        sightings = sights.all_of(candidates.cameras, lambda num_done, total: report(num_done, total, "views"))
    # Batteries are filled with as many views as the devices can hold; 0 is refused by the plan.
    count = (system_capacity(system, MOST_VIEWS) or MOST_VIEWS) if request.photographs is None else request.photographs
    with stage_bar(display, "choosing") as report:
        knowledge = known_by(sights, known_map.trained, flown)
        chosen = choose_views(facets, knowledge, flown, sightings, count, lambda num_done, total: report(num_done, total, "views"))
    if not chosen:
        raise BadInput("no safe view adds anything to what is known: nothing is to be flown.")
    in_time = InTime(system=system, num_views=len(chosen))
    if request.deadline_s is not None:
        in_time = views_in_time(system, len(chosen), request.deadline_s, asked=request.photographs is not None)
    for message in in_time.warnings:
        display(Warned(stage=STAGE, message=message))
    frame = known_map.survey.run.scene.frame
    for message in distant_edges(system, frame.origin_lat_lon_alt if frame.kind == "metric" else None):
        display(Warned(stage=STAGE, message=message))
    flights = _within_batteries(request, in_time.system, air, candidates, chosen[: in_time.num_views], known_map)
    _tell(request, in_time, candidates, flights, display)
    _warn_of_unknown(air, candidates, flights, known_map.survey.run.unit, display)
    return _Proposal(known_map=known_map, air=air, candidates=candidates, flights=flights)


def _compared(facets: Facets, display: ProgressDisplay) -> Facets:
    """The facets at which candidate views are compared."""
    sample = facets.sample(COMPARED_FACETS)
    if len(sample) < len(facets):
        decision = Decision(
            stage=STAGE, topic="surface compared", choice=f"{len(sample):,} of {len(facets):,} facets", figure=float(len(sample)),
            unit="facets", reason="every candidate view is followed to each of them; areas are scaled to the whole",
            otherwise="--resolution",
        )  # fmt: skip
        display(Decided(decision=decision))
    return sample


def usual_lens(known_map: FoundMap) -> Lens:
    """The lens of most of the run's photographs."""
    cameras = known_map.trained
    sizes, counts = np.unique(cameras.sizes_wh, axis=0, return_counts=True)
    width, height = sizes[counts.argmax()].tolist()
    focal_px = float(np.median(cameras.Ks[(cameras.sizes_wh == [width, height]).all(axis=1), 0, 0]))
    return Lens(size_wh=(width, height), field_of_view_deg=math.degrees(2 * math.atan(max(width, height) / 2 / focal_px)))


def _within_batteries(
    request: NextFlightRequest, system: System, air: Air, candidates: Candidates, chosen: Sequence[Chosen], known_map: FoundMap
) -> tuple[_Flight, ...]:
    """The flights of all chosen views, or of as many of the best as the batteries last for."""
    flights = _flights(request, system, air, candidates, chosen, known_map)
    if request.batteries is None or max(flight.batteries for flight in flights) <= request.batteries:
        return flights
    fits, beyond, best = 0, len(chosen), tuple[_Flight, ...]()
    while beyond - fits > 1:
        count = (fits + beyond) // 2
        flights = _flights(request, system, air, candidates, chosen[:count], known_map)
        if max(flight.batteries for flight in flights) <= request.batteries:
            fits, best = count, flights
        else:
            beyond = count
    if not best:
        raise BadInput(f"{request.batteries} batteries of {request.drone.battery_s:g} s last for no single view: give more or longer ones.")
    return best


def _flights(
    request: NextFlightRequest, system: System, air: Air, candidates: Candidates, chosen: Sequence[Chosen], known_map: FoundMap
) -> tuple[_Flight, ...]:
    places = candidates.places[[view.row for view in chosen]]
    positions = np.ascontiguousarray(known_map.survey.map_frame.to_world(places)[:, :2])
    frame = known_map.survey.run.scene.frame
    placed = place_edges_by_raster(system, positions, frame.origin_lat_lon_alt if frame.kind == "metric" else None, None, request.seed)
    cloud = plan_regions(positions, placed)
    if isinstance(cloud, PlanInfeasible):
        raise BadInput(f"plan: {cloud.reason}")
    flights = []
    for plan in split_edges(positions, cloud, placed):
        for device in plan.device_ids:
            rows = plan.cameras_of(device)
            if len(rows):
                rows = rows[shortest_order(places[rows])]
                time_s = float(plan.device_time_s[plan.device_ids.index(device)])
                flights.append(_flight(device, [chosen[row] for row in rows.tolist()], places[rows], air, request.drone, time_s))
        if len(plan.camera_indices) and not plan.device_ids:
            raise BadInput(f"edge {plan.edge_id!r} has no devices that fly: give one whose edges have devices, or leave --system out.")
    return tuple(flights)


def _flight(device: str, views: Sequence[Chosen], places: FloatArray, air: Air, drone: Drone, device_time_s: float) -> _Flight:
    way, owner = safe_way(air, places)
    heights = way[:, 2] - air.rules.take_off
    climbs_s = float(np.abs(np.diff(heights)).sum()) / CLIMB_M_PER_S
    flight_s = flight_figures(way[:, :2], heights, drone).flight_s + climbs_s
    batteries = math.ceil(flight_s / drone.battery_s)
    return _Flight(
        device=device, views=tuple(views), way=way, owner=owner, flight_s=flight_s, batteries=batteries, device_time_s=device_time_s
    )


def _tell(
    request: NextFlightRequest, in_time: InTime, candidates: Candidates, flights: Sequence[_Flight], display: ProgressDisplay
) -> None:
    count = sum(len(flight.views) for flight in flights)
    limit = limit_of(request, count, in_time.num_views)
    if in_time.left_out is not None and count == in_time.num_views:
        reason = in_time.left_out
        display(Decided(decision=Decision(
            stage=STAGE, topic="deadline", choice=in_time.choice, figure=request.deadline_s, unit="s", reason=reason, otherwise="--deadline"
        )))  # fmt: skip
        limit = "deadline"
    end = "where no other view adds anything" if request.photographs else "where no other view adds anything or devices hold no more"
    decision = Decision(
        stage=STAGE,
        topic="next flight",
        choice=f"{count} of {len(candidates)} safe views",
        figure=float(sum(view.gain for flight in flights for view in flight.views)),
        unit="m² of surface, from all sides",
        reason=f"the greedy choice by gain stops {f'at the {limit} asked for' if limit else end}",
        otherwise=f"--{limit}" if limit else "",
    )
    display(Decided(decision=decision))


def limit_of(request: NextFlightRequest, count: int, num_chosen: int) -> str:
    """The option that ended the choice after `count` of the `num_chosen` views that add something;
    empty where none did."""
    if request.batteries is not None and count < num_chosen:
        return "batteries"
    return "photographs" if request.photographs is not None and count >= request.photographs else ""


def _warn_of_unknown(air: Air, candidates: Candidates, flights: Sequence[_Flight], unit: str, display: ProgressDisplay) -> None:
    """Say how much of the flights is low over land that the model does not show."""
    rows = [view.row for flight in flights for view in flight.views]
    num_low = int(low_over_unknown(air, candidates.places[rows]).sum())
    length = sum(length_low_over_unknown(air, flight.way) for flight in flights)
    whole = sum(float(np.linalg.norm(np.diff(flight.way, axis=0), axis=1).sum()) for flight in flights)
    if length or num_low:
        where = f"{num_low} of {len(rows)} views and {length:.0f} of {whole:.0f} {unit} of the way"
        low = f"are near land that the model does not show, too low for anything {HEADROOM:g} times as tall as the tallest that it shows"
        display(Warned(stage=STAGE, message=f"{where} {low}: look for that before flying."))


def _write_flights(request: NextFlightRequest, proposal: _Proposal, display: ProgressDisplay) -> dict[str, Any]:
    survey, take_off = proposal.known_map.survey, proposal.air.rules.take_off
    features: list[dict[str, Any]] = []
    for flight in proposal.flights:
        features.append(line_feature(survey.map_frame, flight.way, {"device": flight.device, "flight_s": round(flight.flight_s)}))
        for number, view in enumerate(flight.views, 1):
            heading, pitch = proposal.candidates.heading_pitch_deg[view.row].tolist()
            about = {"device": flight.device, "number": number, "heading": heading, "pitch": pitch, "reason": view.reason(survey.run.unit)}
            place = proposal.candidates.places[view.row]
            height = {"height_above_take_off": round(float(place[2] - take_off), 2), "over_known": bool(proposal.air.knows(place[None])[0])}
            features.append(point_feature(survey.map_frame, place, {"name": _name(flight, number), **about, **height}))
    write_json(request.out / "next.geojson", to_geojson(survey.map_frame, features, {"take_off": round(take_off, 3)}))
    if survey.run.scene.frame.kind == "metric":
        _write_lists(request, proposal)
        lists = str(request.out / "flight")
    else:
        display(Warned(stage=STAGE, message=NO_LISTS))
        lists = "none"
    rows = [
        {
            "device": flight.device,
            "views": len(flight.views),
            "flight_s": round(flight.flight_s),
            "batteries": flight.batteries,
            **({} if request.deadline_s is None else {"training_s": round(flight.device_time_s, 1)}),
        }
        for flight in proposal.flights
    ]
    return {"views": proposal.num_views, "take_off": round(take_off, 2), "flight": rows, "lists": lists}


def _name(flight: _Flight, number: int) -> str:
    return f"{flight.device}-{number:03d}"


def _write_lists(request: NextFlightRequest, proposal: _Proposal) -> None:
    folder = request.out / "flight"
    folder.mkdir()
    for flight in proposal.flights:
        waypoints = _waypoints(flight, proposal)
        everything = np.arange(len(waypoints))
        write_atomic(folder / f"{flight.device}.csv", waypoints_csv(waypoints, everything).encode())
        route = route_of(flight.device, waypoints, everything, FlownHeights(), request.drone.speed_m_per_s)
        for ending in request.formats:
            write_atomic(folder / f"{flight.device}.{ending}", WRITERS[ending](route))


def _waypoints(flight: _Flight, proposal: _Proposal) -> Waypoints:
    """The way with heights above take-off; points that are only passed look as the view before."""
    survey = proposal.known_map.survey
    lat_lon_alt = geodetic_from_enu(survey.map_frame.to_world(flight.way), survey.run.scene.frame.origin_lat_lon_alt)
    lat_lon_alt[:, 2] = flight.way[:, 2] - proposal.air.rules.take_off
    last = np.maximum.accumulate(flight.owner)
    angles = proposal.candidates.heading_pitch_deg[[flight.views[int(view)].row for view in last]]
    names = [_name(flight, int(view) + 1) if view >= 0 else f"{flight.device}-pass-{index:03d}" for index, view in enumerate(flight.owner)]
    return Waypoints(names=tuple(names), lat_lon_alt=lat_lon_alt, heading_pitch_deg=angles, counts_from="takeoff")


def _draw(folder: Path, known_map: FoundMap, proposal: _Proposal | None) -> None:
    from radiant_viewer.charts.known_chart import known_picture
    from radiant_viewer.pictures.images import save_png

    lines = () if proposal is None else tuple(_line(flight, proposal.candidates) for flight in proposal.flights)
    save_png(folder / "known.png", known_picture(known_map.layers, known_map.survey.run.unit, lines))


def _line(flight: _Flight, candidates: Candidates) -> FlownLine:
    from radiant_viewer.charts.known_chart import FlownLine

    rows = [view.row for view in flight.views]
    return FlownLine(name=flight.device, way=flight.way, places=candidates.places[rows], aims=candidates.aims[rows])
