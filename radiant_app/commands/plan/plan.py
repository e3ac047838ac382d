"""`radiant plan`: regions and quotas from positions alone, of a scene, waypoints or photographs.

Beside plan.json stand its picture, the system it is for and, where the positions are on the globe,
`<stem>_waypoints/<device>.csv` and `<stem>_regions.geojson`. All are written into a hidden folder
first and moved when the last is whole.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from radiant_app.commands.plan.content import ContentRequest, PlanContent, content_of_scene, content_of_waypoints
from radiant_app.commands.plan.flight import FlightRequest, as_listed, flight_rows, heights_to_fly, lines_text, write_routes
from radiant_app.commands.plan.optics import with_camera
from radiant_app.commands.plan.pictures import (
    ENDINGS,
    GANTT,
    LISTS,
    MAP,
    METHODS,
    REGIONS,
    SLACKS,
    SYSTEM,
    plan_gantt,
    sibling,
    side_pictures,
)
from radiant_app.commands.plan.tables import method_row
from radiant_app.commands.run.steps import require_file_to_be, stage_bar, training_part, warn_of
from radiant_app.config.run_config import RunConfig, TrainOptions
from radiant_app.events import Decided, Event
from radiant_app.files.constraints_file import load_constraints
from radiant_app.files.out_folder import folder_made_for, write_folder_atomically
from radiant_app.files.system_file import dump_system, even_system, load_system
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.cloud_planning import place_edges_by_raster, raster_decision
from radiant_app.run.cutting import Cut, choose_cut, follow_cut, plan_places
from radiant_app.run.grouping import choose_run_groups
from radiant_app.run.predictions import (
    depends_on_training,
    planned_training,
    prediction_warnings,
    refining_law_of,
    training_key_of,
    with_camera_limits,
    with_short_joins,
    with_step_law,
)
from radiant_app.run.training_costs import scaled_to_training
from radiant_app.workers.regions import plan_from_raster
from radiant_app.workers.sources import load_scene_of
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.choices import CutBy, PlanMethod
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.export.plan import COLUMNS, save_device_waypoints, save_regions_geojson
from radiant_core.georef.crs import grid_warnings, parse_crs
from radiant_core.georef.features import crs_member
from radiant_core.io.records import save_plan
from radiant_core.io.run_store import write_atomic
from radiant_core.numerics import FloatArray
from radiant_core.plan.baselines import ComparedPlan, compare
from radiant_core.plan.counts.slack_curve import SlackPoint, slack_curve
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.devices.idle import idle_reasons
from radiant_core.plan.flight.whole_lines import keep_lines
from radiant_core.plan.heights import said_heights
from radiant_core.plan.looks import camera_looks
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.edge_sites import distant_edges
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.system import System
from radiant_core.plan.timeline.refining import LEAST_DEVICES, RefiningLaw, predict_refining
from radiant_core.plan.waypoints import NO_ALTITUDES, Waypoints
from radiant_core.scene import SfmScene
from radiant_core.train.config import Preset
from radiant_core.train.needs import Overrides
from radiant_core.waypoints.reader import FoundWaypoints, exif_waypoints, read_waypoints

if TYPE_CHECKING:
    from radiant_viewer.pictures.images import Image

Report = Callable[[float, float, str], None]
NO_HEIGHTS = "Heights stand in the lists as {column}, which flight planners do not fly: {advice}."
GROUND = "give the ground's altitude with --ground for heights above it, or --height with one above take-off for all"
LEVEL = "give --heights takeoff where the ground is level"
NO_CONTENT = "content: nobody knows before capture how much each image will show; compare the methods on a scene"
PHASES = ("reading positions", "planning", "drawing", "writing")


@dataclass(frozen=True, kw_only=True)
class PlanRequest:
    """What `radiant plan` was asked for."""

    source: Path
    """Folder of a scene or run, waypoint file, or folder of photographs."""
    out: Path
    """The plan file to write, .json."""
    system: Path | None
    method: PlanMethod
    seed: int
    paper: PaperConfig | None = None
    """Knobs of Alg. 1, of the plan and of what it is compared with; None: by default."""
    compare: bool = False
    """Whether all other methods are measured on the same positions."""
    train_preset: Preset = "default"
    """What will be trained: it decides what memory holds and whether measured curves are of it."""
    overrides: Overrides = Overrides()
    """Sizes and steps of that training."""
    raster_cell_m: float | None = None
    """Side of the cells of a count raster that the cloud plans from; None: from positions."""
    slack: float | None = None
    """Factor on the shortest makespan allowed where that brings cameras nearer to their edges."""
    slack_curve: bool = False
    """Whether several slacks are planned, too, for a table and a picture of what each buys."""
    cut_by: CutBy = "auto"
    """Of a scene: whether regions are cut where cameras stand or where they look."""
    constraints: Path | None = None
    """File of what is fixed, locked or pinned."""
    content: ContentRequest = field(default_factory=ContentRequest)
    """What is known of cameras and ground, and which buffer captures are wanted."""
    crs: str | None = None
    """System of the regions' file; None: longitude and latitude."""
    require_grids: bool = False
    """Whether a system, of the regions or of what is read, that lacks a grid is refused."""
    flight: FlightRequest = field(default_factory=FlightRequest)
    """How devices fly waypoints, and which lists are wanted beside CSV."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _PlanInput:
    """Positions (C,2) m about `origin`, names (C), content (C,) where known, the scene if any."""

    positions: FloatArray
    origin: FloatArray | None
    names: Sequence[str]
    content: FloatArray | None = None
    scene: SfmScene | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class _Plan:
    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]
    system: System
    """As planned, its edges placed."""
    compared: tuple[ComparedPlan, ...] = ()
    warnings: tuple[str, ...] = ()
    """What its predictions are to be taken with."""
    cut: Decision | None = None
    """What a scene's regions are cut by; None for waypoints."""
    curve: tuple[SlackPoint, ...] = ()
    refining: RefiningLaw | None = None
    """How the scene is refined; None where costs are not those of a training."""
    costs: str | None = None
    """What was made of profiles of other trainings; None where there was none."""
    training: tuple[Decision, ...] = ()
    """Whether a run with this plan trains one model together or joins several."""


def plan(request: PlanRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write the plan and what goes beside it; returns what the command line prints. Raises BadInput
    for an unusable input, system or place, where nothing stays behind."""
    _require_places(request.out)
    if request.crs is not None:
        crs_member(parse_crs(request.crs))
    if _is_scene(request.source):
        _require_nothing_to_fly(request)
    system = even_system(2, 2) if request.system is None else load_system(request.system, curves=True)
    with stage_bar(display, "plan") as report:
        report(0, len(PHASES), PHASES[0])
        if _is_scene(request.source):
            result = _plan_scene(request, system, report)
        else:
            source_waypoints = _positions_of(request.source, report, flies=not request.flight.is_plain)
            content, flight, decision = with_camera(request.content, request.flight, source_waypoints)
            display(Decided(decision=decision))
            result = _plan_waypoints(replace(request, content=content, flight=flight), system, source_waypoints, report)
    return {**result, "warnings": warn_of("plan", result["warnings"], display)}


def _require_nothing_to_fly(request: PlanRequest) -> None:
    """Raise BadInput for what only positions before capture have: a scene was flown already."""
    if request.crs is not None:
        raise BadInput("--crs is of the regions' file, and a scene's plan has none: write it with radiant export RUN FILE.geojson --crs.")
    if not request.flight.is_plain:
        raise BadInput("--whole-lines, --flight-format and heights are of flights to come, and a scene was flown: give waypoints.")


def _is_scene(source: Path) -> bool:
    return any((source / name).is_file() for name in ("scene.safetensors", "sfm/scene.safetensors", "manifest.json"))


def _plan_scene(request: PlanRequest, system: System, report: Report) -> dict[str, Any]:
    from radiant_viewer.runs.run_pictures import plan_picture

    scene = training_part(load_scene_of(request.source))
    origin = scene.frame.origin_lat_lon_alt if scene.frame.kind == "metric" else None
    positions = scene.cameras.centers[:, :2]
    cameras = _PlanInput(positions=positions, origin=origin, names=scene.cameras.names, content=_points_seen(scene), scene=scene)
    draft = _make_plan(cameras, system, request, report)
    content = content_of_scene(scene, draft.cloud, draft.edges, draft.system, request.content)
    report(2, len(PHASES), PHASES[2])
    pictures = side_pictures(draft.cloud.places_of(positions), scene.frame.unit, draft.cloud, draft.compared, draft.curve)
    pictures[GANTT] = plan_gantt(draft.system, draft.edges)
    pictures[MAP] = plan_picture(scene, draft.cloud, draft.edges, forecasts=content.forecasts, buffers=content.buffers)
    report(3, len(PHASES), PHASES[3])
    _write(request, draft, content, pictures)
    unit = {} if scene.frame.unit == "m" else {"unit": scene.frame.unit}
    return {**_summary(request.out, draft, ()), **content.summary(), **unit}


def _plan_waypoints(request: PlanRequest, system: System, source_waypoints: FoundWaypoints, report: Report) -> dict[str, Any]:
    from radiant_viewer.runs.run_pictures import waypoint_plan_picture

    grids = _grid_warnings(request, source_waypoints)
    waypoints, about_heights = _above_ground(source_waypoints.waypoints, request)
    positions = waypoints.positions_m
    draft = _make_plan(_PlanInput(positions=positions[:, :2], origin=waypoints.origin, names=waypoints.names), system, request, report)
    lines = None
    if request.flight.whole_lines is not None:
        lines = keep_lines(positions[:, :2], draft.cloud, draft.edges, draft.system, request.flight.whole_lines)
        draft = replace(draft, cloud=lines.cloud, edges=lines.edges)
    content = content_of_waypoints(waypoints, draft.cloud, draft.edges, draft.system, request.content)
    report(2, len(PHASES), PHASES[2])
    pictures = side_pictures(draft.cloud.places_of(positions[:, :2]), "m", draft.cloud, draft.compared, draft.curve)
    pictures[GANTT] = plan_gantt(draft.system, draft.edges)
    pictures[MAP] = waypoint_plan_picture(positions, draft.cloud, draft.edges, forecasts=content.forecasts, buffers=content.buffers)
    report(3, len(PHASES), PHASES[3])
    flown = _write(request, draft, content, pictures, waypoints)
    written = {"waypoints": str(sibling(request.out, LISTS)), "regions": str(sibling(request.out, REGIONS))}
    # What the file lacks was given.
    source_warnings = [warning for warning in source_waypoints.warnings if request.flight.height_m is None or NO_ALTITUDES not in warning]
    warnings = (*source_warnings, *grids, *about_heights, *_unflown(as_listed(waypoints, request.flight)))
    flying: dict[str, Any] = {} if lines is None else {"flight_lines": lines_text(lines)}
    flying["heights"] = said_heights(waypoints.lat_lon_alt[:, 2], waypoints.height_codes)
    flying |= {} if flown is None else {"flight_heights": flown}
    idle = idle_reasons(draft.cloud, draft.edges, draft.system)
    flying["flight"] = flight_rows(draft.edges, waypoints, request.flight.drone, idle)
    return {"planned": len(waypoints), **_summary(request.out, draft, warnings), **content.summary(), **flying, **written}


def _grid_warnings(request: PlanRequest, source_waypoints: FoundWaypoints) -> tuple[str, ...]:
    """What the system of the regions' file lacks here; BadInput where that, or what the waypoints'
    own lacks, is to be refused."""
    if request.require_grids and source_waypoints.shortfall is not None:
        raise BadInput(f"{request.source}: {source_waypoints.shortfall.removesuffix('.')}, or leave out --require-grids.")
    if request.crs is None:
        return ()
    return grid_warnings(parse_crs(request.crs), source_waypoints.waypoints.lat_lon_alt, require_grids=request.require_grids)


def _above_ground(waypoints: Waypoints, request: PlanRequest) -> tuple[Waypoints, tuple[str, ...]]:
    ground_m = request.content.ground_m
    if ground_m is not None and not waypoints.altitude_known:
        raise BadInput(
            f"--ground is {ground_m:g} m, and no position in {request.source} has an altitude: leave --ground out, and give --height."
        )
    return heights_to_fly(waypoints, request.flight, ground_m)


def _unflown(waypoints: Waypoints) -> tuple[str, ...]:
    """What is to be known of altitudes that say nothing of heights above take-off."""
    if waypoints.ground_m is not None:
        return ()
    columns = [COLUMNS[kind] for kind in waypoints.height_kinds if kind not in ("unknown", "takeoff")]
    if not columns:
        return ()
    advice = LEVEL if waypoints.height_kinds == ("ground",) else GROUND
    return (NO_HEIGHTS.format(column=" and ".join(columns), advice=advice),)


def _write(
    request: PlanRequest, draft: _Plan, content: PlanContent, pictures: Mapping[str, Image], waypoints: Waypoints | None = None
) -> str | None:
    """Write the plan and what goes beside it; what heights in flight lists count from."""
    from radiant_viewer.pictures.images import save_png

    out, flown = request.out, None
    crs = None if request.crs is None else parse_crs(request.crs)
    with folder_made_for(out), write_folder_atomically(out.parent) as folder:
        path = folder / out.name
        for ending, picture in pictures.items():
            save_png(sibling(path, ending), picture)
        write_atomic(sibling(path, SYSTEM), dump_system(draft.system).encode())
        if waypoints is not None:
            lists = sibling(path, LISTS)
            lists.mkdir()
            save_device_waypoints(lists, draft.cloud, draft.edges, as_listed(waypoints, request.flight), content.buffers)
            flown = write_routes(lists, draft.edges, waypoints, request.flight)
            save_regions_geojson(sibling(path, REGIONS), draft.cloud, draft.edges, waypoints, content.buffers, crs)
        save_plan(path, draft.cloud, draft.edges, waypoints, slack_curve=draft.curve, warnings=draft.warnings, content=content.record())
    return flown


def _positions_of(source: Path, report: Report, *, flies: bool) -> FoundWaypoints:
    """The waypoints of a file, or the positions of a folder's photographs; where nothing `flies`
    them again, but every 8th by name."""
    if not source.exists():
        raise BadInput(f"{source} does not exist: give a scene folder, a waypoint file (.csv, .geojson, .kml) or a folder of photographs.")
    if not source.is_dir():
        return read_waypoints(source)
    folder = source / "images" if (source / "images").is_dir() else source
    exif = exif_waypoints(folder, lambda num_done, total: report(num_done / total, len(PHASES), PHASES[0]))
    if flies:  # lines without gaps; a run holds out photographs of the new flight
        return exif
    names = (*exif.waypoints.names, *exif.without_gps)
    held_out = held_out_mask(names)
    if held_out[: len(exif.waypoints)].all():
        raise BadInput(
            f"all {len(exif.waypoints)} photographs with GPS in {folder} are held out for scoring (every 8th by name): give more."
        )
    waypoints = exif.waypoints.select(np.flatnonzero(~held_out[: len(exif.waypoints)]))
    note = f"{int(held_out.sum())} of {len(names)} photographs, every 8th by name, are held out for scoring and not planned."
    return replace(exif, waypoints=waypoints, warnings=(*exif.warnings, note))


def _points_seen(scene: SfmScene) -> FloatArray | None:
    """Sparse points that each camera sees (C,), the content of its image; None if unknown."""
    if not len(scene.observations):
        return None
    return np.bincount(scene.observations[:, 1], minlength=len(scene.cameras)).astype(np.float64)


def _make_plan(cameras: _PlanInput, system: System, request: PlanRequest, report: Report) -> _Plan:
    report(1, len(PHASES), PHASES[1])
    num_cameras = len(cameras.positions)
    training, law, note, warnings = None, None, None, ()
    if depends_on_training(system):
        train = planned_training(request.train_preset, request.overrides)
        training = training_key_of(train, request.train_preset)
        scaled = scaled_to_training(system, train, request.train_preset, num_cameras)
        note = scaled.note
        system = with_short_joins(with_step_law(scaled.system, train, num_cameras), train, num_cameras, AggregateConfig())
        system, _, warnings = with_camera_limits(system, train, num_cameras)
        law = refining_law_of(train, AggregateConfig(), num_cameras, len(system.devices))
    constraints_file = None if request.constraints is None else load_constraints(request.constraints, cameras.names)
    start, constraints = (None, None) if constraints_file is None else (constraints_file.start, constraints_file.constraints)

    def place(places: FloatArray) -> System:
        return place_edges_by_raster(system, places, cameras.origin, request.raster_cell_m, request.seed)

    cut = _cut(cameras, request, start, place)
    positions, looks = (cameras.positions, None) if cut is None else (cut.places_of(cameras.positions), cut.looks)
    system = place(positions)
    warnings = (*warnings, *distant_edges(system, cameras.origin))
    if request.raster_cell_m is not None:
        if request.slack is not None or constraints is not None:
            raise BadInput("--slack and --constraints need positions and --raster-cell-m plans without them: choose one.")
        cloud = plan_from_raster(system, positions, request.raster_cell_m, request.method, request.paper)
        warnings = (*warnings, _raster_note(request.raster_cell_m, cloud))
    else:
        cloud = plan_regions(
            positions,
            system,
            method=request.method,
            paper=request.paper,
            slack=request.slack,
            constraints=constraints,
            start=start,
        )
    if isinstance(cloud, PlanInfeasible):
        raise BadInput(f"plan: {cloud.reason}")
    compared = compare(positions, system, content=cameras.content, paper=request.paper) if request.compare else ()
    curve: tuple[SlackPoint, ...] = ()
    if request.slack_curve:
        curve = slack_curve(positions, system, progress=lambda share: report(1 + share, len(PHASES), PHASES[1]))
    edges = split_edges(positions, cloud, system)
    if training is not None:
        warnings = (*warnings, *prediction_warnings(system, edges, training))
    return _Plan(
        cloud=replace(cloud, looks=looks),
        edges=edges,
        system=system,
        compared=compared,
        warnings=warnings,
        cut=None if cut is None else cut.decision,
        curve=curve,
        refining=law,
        costs=note,
        training=_trained_as(request, system, edges),
    )


def _trained_as(request: PlanRequest, system: System, edges: Sequence[EdgePlan]) -> tuple[Decision, ...]:
    """What a run of these settings would decide about training together; nothing where one device
    works, or edges deal by themselves."""
    num_working = sum(bool(len(plan.cameras_of(device))) for plan in edges for device in plan.device_ids)
    if num_working < LEAST_DEVICES or not all(plan.dealt for plan in edges):
        return ()
    overrides, heard = request.overrides, list[Decision]()
    train = TrainOptions(
        preset=request.train_preset,
        long_side_px=overrides.long_side_px,
        num_steps=overrides.num_steps,
        max_num_splats=overrides.max_num_splats,
        settings=overrides.settings,
    )

    def listen(event: Event) -> None:
        if isinstance(event, Decided):
            heard.append(event.decision)

    config = RunConfig(source=request.source, out=request.out.parent / "run", system=request.system, train=train)
    choose_run_groups(config, system, edges, listen)
    return tuple(heard)


def _cut(cameras: _PlanInput, request: PlanRequest, start: CloudPlan | None, place: Callable[[FloatArray], System]) -> Cut | None:
    """What a scene's plan is cut by; None for waypoints, of which only positions are known. A plan
    around constraints is cut as the plan that they refer to."""
    scene = cameras.scene
    if start is not None:
        if request.cut_by not in ("auto", start.cut_by):
            raise BadInput(f"--cut-by is {request.cut_by}, the plan that the constraints refer to is cut by {start.cut_by}: leave it out.")
        looks = camera_looks(scene) if scene is not None and start.looks is not None else start.looks
        if looks is not None and len(looks) != len(cameras.positions):
            raise BadInput(f"the plan that the constraints refer to is of {len(looks)} cameras, there are {len(cameras.positions)}.")
        return follow_cut(looks)
    if scene is None:
        if request.cut_by == "looks":
            raise BadInput("--cut-by is looks, and positions alone do not say where cameras look: give a scene, or leave it out.")
        return None
    return choose_cut(
        scene, request.cut_by, request.method, lambda places: plan_places(places, place(places), request.method, request.paper)
    )


def _raster_note(cell_m: float, plan: CloudPlan) -> str:
    decision = raster_decision(cell_m, plan)
    return f"Planned from {decision.choice}, {decision.figure:.1f} {decision.unit}: {decision.reason}."


def _summary(out: Path, draft: _Plan, warnings: tuple[str, ...]) -> dict[str, Any]:
    cloud, warnings = draft.cloud, (*warnings, *draft.warnings)
    training = tuple(f"{one.choice} ({one.figure:.1f} {one.unit}): {one.reason}." for one in draft.training)
    idle = idle_reasons(cloud, draft.edges, draft.system)
    later = [plan.edge_id for plan in draft.edges if not plan.dealt]
    if later:
        warnings = (*warnings, f"Dealt by the edge itself, later: {', '.join(later)}.")
    if cloud.constrained:
        outside = f"{cloud.num_outside} cameras lie outside their region as drawn" if cloud.num_outside else "all cameras in their regions"
        warnings = (*warnings, f"Planned around constraints: {'; '.join(cloud.constrained)}; {outside}.")
    if idle:
        why = "; ".join(f"{name} ({reason})" for name, reason in idle.items())
        warnings = (*warnings, f"Devices without anything to capture: {why}.")
    return {
        **({} if draft.costs is None else {"costs": draft.costs}),
        "makespan_s": cloud.makespan_s,
        "lower_bound_s": cloud.lower_bound_s,
        **({} if draft.refining is None else {"refining_s": predict_refining(draft.system, draft.edges, draft.refining)}),
        "status": cloud.status,
        "method": cloud.method,
        "counts": ", ".join(f"{name} {count}" for name, count in zip(cloud.edge_ids, cloud.counts, strict=True)),
        **({} if draft.cut is None else {"cut": f"{draft.cut.choice}: {draft.cut.reason}"}),
        **({"training": training} if training else {}),
        "warnings": warnings,
        "plan": str(out),
        "picture": str(sibling(out, MAP)),
        "gantt": str(sibling(out, GANTT)),
        **(_comparison(out, draft.compared) if draft.compared else {}),
        **({"slack_curve": [asdict(point) for point in draft.curve], "slack_picture": str(sibling(out, SLACKS))} if draft.curve else {}),
    }


def _comparison(out: Path, compared: Sequence[ComparedPlan]) -> dict[str, Any]:
    without = {} if any(row.method == "content" for row in compared) else {"methods_left_out": NO_CONTENT}
    return {"methods": [method_row(row) for row in compared], **without, "comparison": str(sibling(out, METHODS))}


def _require_places(out: Path) -> None:
    if out.suffix != ".json":
        raise BadInput(f"{out} is no name for a plan: choose one that ends in .json; the picture goes beside it as .png.")
    for path in (out, *(sibling(out, ending) for ending in ENDINGS)):
        require_file_to_be(path)
