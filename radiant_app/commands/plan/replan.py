"""`radiant plan --after`: a plan or run after devices died, slowed down, were busy, finished or
joined.

A plan file: positions are its waypoints, captured are those that `--captured` names; its system is
`--system`. A run: its training cameras, its own system with curves corrected by what has finished.
There, finished nodes are done; a device that has begun keeps exactly what it has; and with
`--frames gps` or `known` every position is captured where it is. Beside the new plan stand its
picture, a Gantt chart, its system, what moved (CSV) and, for waypoints, what `radiant plan` writes.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.commands.plan.costs import costed_by_training
from radiant_app.commands.plan.flight import NO_COLUMN
from radiant_app.commands.plan.pictures import GANTT, LISTS, MAP, REGIONS, SYSTEM, sibling
from radiant_app.commands.run.steps import require_file_to_be, stage_bar, training_part, warn_of
from radiant_app.files.out_folder import folder_made_for, write_folder_atomically
from radiant_app.files.run_folder import Manifest, read_manifest
from radiant_app.files.system_file import dump_system, even_system, load_system
from radiant_app.report.prediction_error import SYSTEM_NAME, curves_note, gantt_rows, measured_seconds
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.sources import DELIVERED, load_scene_of
from radiant_core.errors import BadInput
from radiant_core.export.plan import save_device_waypoints, save_regions_geojson
from radiant_core.frames import enu_from_geodetic
from radiant_core.io.csv_cells import cell_of_text
from radiant_core.io.records import load_plan, load_plan_waypoints, save_plan
from radiant_core.io.run_store import write_atomic
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan, EdgePlan, require_plan_of
from radiant_core.plan.regions.edge_sites import distant_edges, place_edges
from radiant_core.plan.revision.captured import nearest_planned, require_same_system
from radiant_core.plan.revision.replan import FleetChange, Replan, ReplanInfeasible, extend_system, replan
from radiant_core.plan.system import System
from radiant_core.plan.timeline.prediction import correct_system, planned_stages
from radiant_core.plan.waypoints import Waypoints
from radiant_core.scene import SfmScene
from radiant_core.waypoints.reader import exif_waypoints, read_waypoints

MOVED = "_moved.csv"
ENDINGS = (MAP, GANTT, MOVED, SYSTEM, LISTS, REGIONS)


@dataclass(frozen=True, kw_only=True)
class ReplanRequest:
    """What `radiant plan --after` was asked for."""

    source: Path
    """A plan file, or the folder of a run."""
    out: Path
    """The plan file to write, .json."""
    system: Path | None = None
    """The system of a plan file; a run contains its own."""
    change: FleetChange = field(default_factory=FleetChange)
    join: Path | None = None
    """System file of edges, or of devices at edges that are there, that join."""
    captured: Path | None = None
    """Waypoint file or folder of photographs: what was captured of a plan file's waypoints."""
    tolerance: float = 0.0
    seed: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class _Before:
    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]
    positions: FloatArray
    """(P,3) m"""
    system: System
    change: FleetChange
    captured: NDArray[np.bool_]
    origin: FloatArray | None
    waypoints: Waypoints | None
    names: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def parse_values(texts: Sequence[str], option: str) -> dict[str, float]:
    """ID=NUMBER of a repeated option; BadInput says what came."""
    values: dict[str, float] = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            values[name] = float(number)
        except ValueError:
            raise BadInput(f"{option} {text!r} is no ID=NUMBER: write for example {option} north-1=2.") from None
    return values


def replan_files(request: ReplanRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write the new plan and the files beside it; returns what the command line prints. BadInput
    for what cannot be used and where machines cannot hold what is left; nothing stays behind."""
    if request.out.suffix != ".json":
        raise BadInput(f"{request.out} is no name for a plan: choose one that ends in .json.")
    for path in (request.out, *(sibling(request.out, ending) for ending in ENDINGS)):
        require_file_to_be(path)
    before = _read_run(request) if request.source.is_dir() else _read_plan(request)
    joining = None if request.join is None else load_system(request.join)
    places = before.cloud.places_of(before.positions[:, :2])
    placed = place_edges(_grow_system(before, joining), places, before.origin, request.seed)
    placed, warnings = costed_by_training(placed, len(before.positions))
    # Of edges that were there, the place in the plan is used.
    warnings = (*warnings, *(() if joining is None else distant_edges(joining, before.origin)))
    old, joined = _split_system(placed, before.system)
    positions = before.positions[:, :2]
    with stage_bar(display, "replan") as report:
        report(0, 2, "planning")
        new = replan(
            before.cloud, before.edges, positions, old, before.change, captured=before.captured, joining=joined, tolerance=request.tolerance
        )
        if isinstance(new, ReplanInfeasible):
            raise BadInput(f"replan: {new.reason}")
        report(1, 2, "writing")
        _write(request.out, before, new)
    result = _summary(request.out, before, new, (*warnings, *before.warnings))
    return {**result, "warnings": warn_of("replan", result["warnings"], display)}


def _grow_system(before: _Before, joining: System | None) -> System:
    """The system with the joining edges and devices; existing edges are placed as in the plan."""
    sites = before.cloud.sites.tolist()
    edges = tuple(replace(edge, position=(x, y), lat_lon_deg=None) for edge, (x, y) in zip(before.system.edges, sites, strict=True))
    system = replace(before.system, edges=edges)
    return system if joining is None else extend_system(system, joining)


def _split_system(grown: System, earlier: System) -> tuple[System, System | None]:
    devices = {device.id for device in earlier.devices}
    old, new = (
        [replace(edge, devices=part) for edge in grown.edges if (part := tuple(d for d in edge.devices if (d.id in devices) == is_old))]
        for is_old in (True, False)
    )
    return replace(grown, edges=tuple(old)), System(edges=tuple(new)) if new else None


def _read_plan(request: ReplanRequest) -> _Before:
    cloud, edges = load_plan(request.source)
    waypoints = load_plan_waypoints(request.source)
    if waypoints is None:
        raise BadInput(f"{request.source} has no waypoints: give the run's folder, or a plan that `radiant plan` made from waypoints.")
    system = even_system(2, 2) if request.system is None else load_system(request.system)
    require_same_system(edges, system)
    captured = np.zeros(len(waypoints), bool)
    if request.captured is not None:
        captured_waypoints = exif_waypoints(request.captured) if request.captured.is_dir() else read_waypoints(request.captured)
        there = enu_from_geodetic(captured_waypoints.waypoints.lat_lon_alt, waypoints.origin)[:, :2]
        captured[nearest_planned(waypoints.positions_m[:, :2], there)] = True
    return _Before(
        cloud=cloud,
        edges=edges,
        positions=waypoints.positions_m,
        system=system,
        change=request.change,
        captured=captured,
        origin=waypoints.origin,
        waypoints=waypoints,
        names=waypoints.names,
    )


def _read_run(request: ReplanRequest) -> _Before:
    run = request.source
    if request.system is not None or request.captured is not None:
        raise BadInput("a run knows its system and what was captured: leave out --system and --captured, or give a plan file.")
    manifest = read_manifest(run)
    if not (run / SYSTEM_NAME).is_file():
        raise BadInput(f"{run} has no {SYSTEM_NAME}: it has not been planned yet, or by an earlier version; run it with --resume.")
    in_the_field = manifest.config.get("frames", "shared") != "shared"
    _, dealt = load_plan(run / "plan.json")
    (cloud, edges), scene = _load_delivered(run) if in_the_field else (load_plan(run / "plan.json"), training_part(load_scene_of(run)))
    require_plan_of(len(scene.cameras), cloud, edges)
    system = load_system(run / SYSTEM_NAME)
    measured = measured_seconds(run, manifest)
    system = correct_system(system, planned_stages(system, dealt), measured)
    change = _add_progress(run, manifest, system, edges, request.change)
    keeps = change.done | change.closed
    captured = np.full(len(scene.cameras), in_the_field)
    for plan in edges:
        for device in plan.device_ids:
            if device in keeps:
                captured[plan.cameras_of(device)] = True
    origin = scene.frame.origin_lat_lon_alt if scene.frame.kind == "metric" else None
    return _Before(
        cloud=cloud,
        edges=edges,
        positions=scene.cameras.centers,
        system=system,
        change=change,
        captured=captured,
        origin=origin,
        waypoints=None,
        names=scene.cameras.names,
        warnings=(*_warn_undelivered(dealt, edges), *_warn_delivered(request.change.dead - change.dead)),
    )


def _load_delivered(run: Path) -> tuple[tuple[CloudPlan, tuple[EdgePlan, ...]], SfmScene]:
    """Load plan and scene of a run on devices: only delivered photographs have known positions."""
    folder = run / DELIVERED
    if not folder.is_dir():
        raise BadInput(f"{run} keeps photographs on their devices and has delivered no scene yet: finish it by --resume, or plan anew.")
    return load_plan(folder / "plan.json"), load_scene_of(folder)


def _warn_undelivered(dealt: Sequence[EdgePlan], delivered: Sequence[EdgePlan]) -> tuple[str, ...]:
    """A sentence where devices have photographs in the plan of a run and none were delivered."""
    arrived = {device: len(plan.cameras_of(device)) for plan in delivered for device in plan.device_ids}
    lost = {device: len(plan.cameras_of(device)) for plan in dealt for device in plan.device_ids if not arrived.get(device)}
    names = [f"{device} ({count})" for device, count in lost.items() if count]
    return (f"Not in this plan are the photographs that never arrived, of {', '.join(names)}: have them taken again.",) if names else ()


def _warn_delivered(names: Collection[str]) -> tuple[str, ...]:
    """A sentence about dead machines of which nothing is missing."""
    return (f"Nothing changes by the loss of {', '.join(sorted(names))}, whose models have arrived.",) if names else ()


def _add_progress(run: Path, manifest: Manifest, system: System, edges: Sequence[EdgePlan], change: FleetChange) -> FleetChange:
    """`change` with a run's progress: sealed nodes are done, others busy for their planned time."""
    sealed = {path.parent.name for kind in ("devices", "edges") for path in run.glob(f"{kind}/*/done.json")}
    delivered = {device.id for edge in system.edges if edge.id in sealed for device in edge.devices} | sealed
    dead = change.dead - delivered  # what a dead machine has delivered is not lost
    done_nodes = (change.done | sealed) - dead
    expected = {row.node: row.stop_s for row in planned_stages(system, edges)}
    nodes = [node for node in (*manifest.stages, *manifest.emulated) if node.startswith("devices/") and node.count("/") == 1]
    working = frozenset(node.removeprefix("devices/") for node in nodes) - done_nodes - dead
    busy_s = {name: expected.get(f"devices/{name}", 0.0) * change.slow.get(name, 1.0) for name in working}
    return replace(change, dead=dead, done=done_nodes, closed=change.closed | working, busy_s={**busy_s, **change.busy_s})


def _write(out: Path, before: _Before, new: Replan) -> None:
    from radiant_viewer.charts.gantt_chart import gantt_picture
    from radiant_viewer.pictures.images import save_png
    from radiant_viewer.runs.replan_picture import replan_picture

    picture = replan_picture(before.positions, new)
    rows = _gantt_rows(new)
    to_come = any(row.predicted for row in rows)
    title = "What is still to come, predicted" if to_come else "As it was planned: all is done"
    gantt = gantt_picture(rows if to_come else gantt_rows(new.system, new.edges), title, curves_note(new.system))
    with folder_made_for(out), write_folder_atomically(out.parent) as folder:
        save_png(folder / sibling(out, MAP).name, picture)
        save_png(folder / sibling(out, GANTT).name, gantt)
        write_atomic(folder / sibling(out, MOVED).name, _moved_csv(before, new).encode())
        write_atomic(folder / sibling(out, SYSTEM).name, dump_system(new.system).encode())
        if before.waypoints is not None:
            lists = folder / sibling(out, LISTS).name
            lists.mkdir()
            save_device_waypoints(lists, new.cloud, new.edges, before.waypoints)
            save_regions_geojson(folder / sibling(out, REGIONS).name, new.cloud, new.edges, before.waypoints)
        save_plan(folder / out.name, new.cloud, new.edges, before.waypoints)


def _gantt_rows(new: Replan) -> list[Any]:
    """Rows of what is still to come: machines that are done have no bars, busy ones begin later."""
    from radiant_viewer.charts.charts import TimelineSpan

    ends = {f"devices/{d.id}": float(time_s) for d, time_s in zip(new.system.devices, new.time_after_s, strict=True)}
    ends |= {f"edges/{name}": float(time_s) for name, time_s in zip(new.cloud.edge_ids, new.cloud.edge_time_s, strict=True)}
    rows: list[Any] = []
    for row in gantt_rows(new.system, new.edges):
        shift_s = ends[row.name] - row.stop_s
        moved = [
            TimelineSpan(stage=span.stage, start_s=max(0.0, span.start_s + shift_s), stop_s=max(0.0, span.stop_s + shift_s))
            for span in row.predicted
        ]
        rows.append(replace(row, predicted=tuple(span for span in moved if span.stop_s > span.start_s)))
    return rows


def _moved_csv(before: _Before, new: Replan) -> str:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(("name", "x_m", "y_m", "from", "to"))
    ids = [device.id for device in new.system.devices]
    for index in np.flatnonzero(new.moved).tolist():
        x, y = before.positions[index, :2].tolist()
        writer.writerow(
            (cell_of_text(before.names[index]), f"{x:.3f}", f"{y:.3f}", ids[new.device_before[index]], ids[new.device_after[index]])
        )
    return text.getvalue()


def _summary(out: Path, before: _Before, new: Replan, more: tuple[str, ...]) -> dict[str, Any]:
    lost, num_devices = int(new.lost.sum()), len(new.system.devices)
    warnings = [*more, *([f"{NO_COLUMN}: {problem}"] if (problem := before.waypoints and before.waypoints.height_problem) else [])]
    if lost:
        warnings.append(f"{lost} captured positions of dead devices are lost: leave them out of --captured to plan them again.")
    if not new.fewest_proved:
        warnings.append(
            "It is not proved that this is the fewest positions that could move: devices of an edge send unequal bytes, or too many move."
        )
    ends = [np.bincount(owners, minlength=num_devices) for owners in (new.device_before, new.device_after)]
    rows = [
        {
            "device": device.id,
            "positions_before": int(had),
            "positions_after": int(has),
            "gave": int((new.moved & (new.device_before == index)).sum()),
            "got": int((new.moved & (new.device_after == index)).sum()),
            "time_before_s": _finite(float(new.time_before_s[index])),
            "time_after_s": float(new.time_after_s[index]),
        }
        for index, (device, had, has) in enumerate(zip(new.system.devices, *ends, strict=True))
    ]
    written = {"waypoints": str(sibling(out, LISTS)), "regions": str(sibling(out, REGIONS))}
    return {
        "moved": int(new.moved.sum()),
        "captured": int(before.captured.sum()),
        "lost": lost,
        "makespan_before_s": _finite(new.makespan_before_s),
        "makespan_s": new.cloud.makespan_s,
        "lower_bound_s": new.cloud.lower_bound_s,
        "status": new.cloud.status,
        "fewest_moves_proved": new.fewest_proved,
        "warnings": warnings,
        "plan": str(out),
        "picture": str(sibling(out, MAP)),
        "gantt": str(sibling(out, GANTT)),
        "moved_list": str(sibling(out, MOVED)),
        "system": str(sibling(out, SYSTEM)),
        **(written if before.waypoints is not None else {}),
        "devices": rows,
    }


def replan_table(result: dict[str, Any]) -> str:
    """Before and after of every device, aligned, and of the makespan."""
    width = max([len("makespan"), *(len(row["device"]) for row in result["devices"])])
    lines = [f"{'device':<{width}} {'positions':>19} {'gave':>6} {'got':>6} {'time (s)':>21}"]
    for row in result["devices"]:
        counts = f"{row['positions_before']:>8} → {row['positions_after']:>8}"
        lines.append(
            f"{row['device']:<{width}} {counts:>19} {row['gave']:>6} {row['got']:>6} {_times(row['time_before_s'], row['time_after_s'])}"
        )
    lines.append(f"{'makespan':<{width}} {'':>19} {'':>6} {'':>6} {_times(result['makespan_before_s'], result['makespan_s'])}")
    return "\n".join(lines)


def _times(before_s: float | None, after_s: float) -> str:
    return f"{'never' if before_s is None else format(before_s, '.1f'):>9} → {after_s:>9.1f}"


def _finite(seconds: float) -> float | None:
    return seconds if np.isfinite(seconds) else None
