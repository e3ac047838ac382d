"""`radiant plan`: regions and quotas from positions alone, of a scene, of waypoints before capture, or of photographs' GPS.

Beside plan.json stand its picture and, where the positions are on the globe, `<stem>_waypoints/<device>.csv` and
`<stem>_regions.geojson`. All are written into a hidden folder first and moved when the last is whole.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from radiant_app.commands import require_file_to_be, stage_bar, training_part
from radiant_app.config import PlanMethod
from radiant_app.prediction_error import curves_note, gantt_rows
from radiant_app.progress import ProgressDisplay
from radiant_app.sources import load_scene_of
from radiant_app.system_file import even_system, load_system
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io.plan_export import save_device_waypoints, save_regions_geojson
from radiant_core.io.records import save_plan
from radiant_core.io.waypoints import FoundWaypoints, exif_waypoints, read_waypoints
from radiant_core.numerics import FloatArray
from radiant_core.plan.comparators import Compared, compare
from radiant_core.plan.device_split import split_edges
from radiant_core.plan.edge_sites import place_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.system import System

if TYPE_CHECKING:
    from radiant_viewer.images import Image

Report = Callable[[float, float, str], None]
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
    compare: bool = False
    """Whether all other methods are measured on the same positions."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Plan:
    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]
    system: System
    compared: tuple[Compared, ...] = ()

    def gantt(self) -> Image:
        """What each machine will do when."""
        from radiant_viewer.gantt_chart import gantt_picture

        return gantt_picture(gantt_rows(self.system, self.edges), "Predicted stages", curves_note(self.system))


def plan(request: PlanRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write the plan and what goes beside it; returns what the command line prints.

    Raises BadInput with one sentence when the input, the system or the place to write to cannot be used; nothing stays behind.
    """
    _require_places(request.out)
    system = even_system(2, 2) if request.system is None else load_system(request.system)
    with stage_bar(display, "plan") as report:
        report(0, len(PHASES), PHASES[0])
        if _is_scene(request.source):
            return _plan_scene(request, system, report)
        found = _positions_of(request.source, report)
        return _plan_waypoints(request, system, found, report)


def _is_scene(source: Path) -> bool:
    return any((source / name).is_file() for name in ("scene.safetensors", "sfm/scene.safetensors", "manifest.json"))


def _plan_scene(request: PlanRequest, system: System, report: Report) -> dict[str, Any]:
    """Plan the training cameras of a scene; the plan and its picture."""
    from radiant_viewer.images import save_png
    from radiant_viewer.views import plan_picture

    scene = training_part(load_scene_of(request.source))
    origin = scene.frame.origin_lat_lon_alt if scene.frame.kind == "metric" else None
    made = _made_plan(scene.cameras.centers[:, :2], origin, system, request, report)
    report(2, len(PHASES), PHASES[2])
    picture = plan_picture(scene, made.cloud, made.edges)
    report(3, len(PHASES), PHASES[3])
    with moved_when_whole(request.out.parent) as folder:
        save_png(folder / _picture(request.out).name, picture)
        save_png(folder / _gantt(request.out).name, made.gantt())
        save_plan(folder / request.out.name, made.cloud, made.edges)
    return _summary(request.out, made, ())


def _plan_waypoints(request: PlanRequest, system: System, found: FoundWaypoints, report: Report) -> dict[str, Any]:
    """Plan waypoints; the plan with them inside, its picture, lists per device and the regions."""
    from radiant_viewer.images import save_png
    from radiant_viewer.views import waypoint_plan_picture

    waypoints = found.waypoints
    positions = waypoints.positions_m
    made = _made_plan(positions[:, :2], waypoints.origin, system, request, report)
    report(2, len(PHASES), PHASES[2])
    picture = waypoint_plan_picture(positions, made.cloud, made.edges)
    report(3, len(PHASES), PHASES[3])
    with moved_when_whole(request.out.parent) as folder:
        save_png(folder / _picture(request.out).name, picture)
        save_png(folder / _gantt(request.out).name, made.gantt())
        lists = folder / _lists(request.out).name
        lists.mkdir()
        save_device_waypoints(lists, made.cloud, made.edges, waypoints)
        save_regions_geojson(folder / _regions(request.out).name, made.cloud, made.edges, waypoints)
        save_plan(folder / request.out.name, made.cloud, made.edges, waypoints)
    written = {"waypoints": str(_lists(request.out)), "regions": str(_regions(request.out))}
    return {"planned": len(waypoints), **_summary(request.out, made, found.warnings), **written}


def _positions_of(source: Path, report: Report) -> FoundWaypoints:
    """The waypoints of a file, all of them, or the positions of a folder's photographs without every 8th by name, as a run holds out."""
    if not source.exists():
        raise BadInput(f"{source} does not exist: give a scene folder, a waypoint file (.csv, .geojson, .kml) or a folder of photographs.")
    if not source.is_dir():
        return read_waypoints(source)
    folder = source / "images" if (source / "images").is_dir() else source
    found = exif_waypoints(folder, lambda done, total: report(done / total, len(PHASES), PHASES[0]))
    names = (*found.waypoints.names, *found.without_gps)
    held_out = held_out_mask(names)
    if held_out[: len(found.waypoints)].all():
        raise BadInput(
            f"all {len(found.waypoints)} photographs with GPS in {folder} are held out for scoring (every 8th by name): give more of them."
        )
    kept = found.waypoints.select(np.flatnonzero(~held_out[: len(found.waypoints)]))
    note = f"{int(held_out.sum())} of {len(names)} photographs, every 8th by name, are held out for scoring and not planned."
    return replace(found, waypoints=kept, warnings=(*found.warnings, note))


def _made_plan(positions: FloatArray, origin: FloatArray | None, system: System, request: PlanRequest, report: Report) -> _Plan:
    report(1, len(PHASES), PHASES[1])
    system = place_edges(system, positions, origin, request.seed)
    cloud = plan_regions(positions, system, method=request.method)
    if isinstance(cloud, PlanInfeasible):
        raise BadInput(f"plan: {cloud.reason}")
    compared = compare(positions, system) if request.compare else ()
    return _Plan(cloud=cloud, edges=split_edges(positions, cloud, system), system=system, compared=compared)


def _summary(out: Path, made: _Plan, warnings: tuple[str, ...]) -> dict[str, Any]:
    cloud = made.cloud
    idle = [name for plan in made.edges for name in plan.device_ids if not len(plan.cameras_of(name))]
    if idle:
        warnings = (*warnings, f"Devices without anything to capture: {', '.join(idle)}.")
    return {
        "makespan_s": cloud.makespan_s,
        "lower_bound_s": cloud.lower_bound_s,
        "status": cloud.status,
        "method": cloud.method,
        "counts": ", ".join(f"{name} {count}" for name, count in zip(cloud.edge_ids, cloud.counts, strict=True)),
        "warnings": " ".join(warnings) or "none",
        "plan": str(out),
        "picture": str(_picture(out)),
        "gantt": str(_gantt(out)),
        **({"methods": [_row(row) for row in made.compared]} if made.compared else {}),
    }


def _row(row: Compared) -> dict[str, Any]:
    return {
        "method": row.method,
        "makespan_s": row.makespan_s,
        "makespan_over_bound": row.over_bound,
        "cameras_in_no_region": row.num_orphans,
        "squared_distance_m2": row.squared_distance_m2,
        "iterations": len(row.history) - 1,
        "last_imbalance": row.history[-1],
    }


def method_table(rows: list[dict[str, Any]]) -> str:
    """The rows of `--compare`, aligned."""
    lines = [f"{'method':<14} {'makespan':>12} {'/ bound':>9} {'no region':>9} {'Σ distance²':>13} {'iterations':>10} {'imbalance':>9}"]
    lines += [
        f"{row['method']:<14} {row['makespan_s']:>10.1f} s {row['makespan_over_bound']:>9.4f} {row['cameras_in_no_region']:>9} "
        f"{row['squared_distance_m2']:>10.4g} m² {row['iterations']:>10} {row['last_imbalance']:>9.3f}"
        for row in rows
    ]
    return "\n".join(lines)


def _picture(out: Path) -> Path:
    return out.with_suffix(".png")


def _gantt(out: Path) -> Path:
    return out.with_name(f"{out.stem}_gantt.png")


def _lists(out: Path) -> Path:
    return out.with_name(f"{out.stem}_waypoints")


def _regions(out: Path) -> Path:
    return out.with_name(f"{out.stem}_regions.geojson")


def _require_places(out: Path) -> None:
    if out.suffix != ".json":
        raise BadInput(f"{out} is no name for a plan: choose one that ends in .json; the picture goes beside it as .png.")
    for path in (out, _picture(out), _gantt(out), _lists(out), _regions(out)):
        require_file_to_be(path)


@contextmanager
def moved_when_whole(target: Path) -> Iterator[Path]:
    """A hidden folder inside `target` whose content moves there when the block ends well, and vanishes when it does not."""
    folder = Path(tempfile.mkdtemp(prefix=".plan.", dir=target))
    try:
        yield folder
        # The plan itself last: where it stands, everything else does.
        ordered = sorted(folder.iterdir(), key=lambda path: path.suffix == ".json")
        try:
            for path in ordered:
                path.rename(target / path.name)
        except BaseException:
            for path in (target / path.name for path in ordered):
                shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
            raise
    finally:
        shutil.rmtree(folder)
