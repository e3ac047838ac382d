"""The files of an edited plan, in the formats of `radiant plan`.

    <stem>.json                                        the plan, for `radiant run --plan`
    <stem>_system.toml                                 its machines
    <stem>_waypoints/<device>.csv, _regions.geojson    what each device captures, on the globe
    <stem>_constraints.toml, _start.json               the constraints and their reference plan

The heights of a run's cameras count from its low ground: a flight that takes off there or higher
is no lower than the first one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.export.plan import save_device_waypoints, save_regions_geojson
from radiant_core.frames import enu_from_geodetic, geodetic_from_enu
from radiant_core.io.records import load_plan, load_plan_waypoints, save_plan
from radiant_core.io.run_store import write_atomic
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_core.plan.system import System
from radiant_core.plan.waypoints import Waypoints
from radiant_viewer.editing.model.edited_plan import EditedPlan, PlanSubject
from radiant_viewer.editing.model.plan_edits import AdoptPlan
from radiant_viewer.runs.run_layers import ground_height
from radiant_viewer.runs.run_view import RunView

SAME_PLACE_M = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanSetting:
    """What editing a plan needs: machines, file of edits, writers of systems and constraints."""

    system: System | None
    """None where it is unknown: the plan cannot be changed."""
    reason: str
    """Why the system is unknown and what to do, one sentence."""
    edits_path: Path | None
    waypoints: Waypoints | None
    """The waypoints that the plan was made from, if its file has them."""
    ground_m: float | None
    """Altitude of the ground in the datum of the waypoints, if the plan's file has it."""
    system_text: Callable[[System], str]
    constraints_text: Callable[[PlanConstraints, Sequence[str], str], str]
    """Takes constraints, the names of the cameras, and the name of the reference plan's file."""


def plan_subject(run: RunView) -> PlanSubject:
    """Return the planned cameras of a run, without held-out ones; BadInput where there are none."""
    planned = np.flatnonzero(run.roles.edge_of_camera >= 0)
    frame = run.scene.frame
    return PlanSubject(
        names=tuple(run.scene.cameras.names[index] for index in planned.tolist()),
        positions=run.scene.cameras.centers[planned],
        looks=run.cloud_plan.looks,
        unit=run.unit,
        origin=frame.origin_lat_lon_alt if frame.kind == "metric" else None,
        altitude_known=frame.altitude_known,
        # Sparse points lie on surfaces; a run in the field has Gaussians instead, which may float.
        ground=ground_height(run.scene) if len(run.scene.observations) else None,
    )


def save_edited_plan(path: Path, subject: PlanSubject, plan: EditedPlan, setting: PlanSetting) -> tuple[Path, ...]:
    """Write a plan with its system, lists and constraints; return the files. Raises BadInput for a
    name without .json."""
    if path.suffix != ".json":
        raise BadInput(f"{path.name} is no name for a plan: choose one that ends in .json.")
    waypoints, shift = _geo_waypoints(subject, setting.waypoints)
    cloud, edges = shift_plan((plan.cloud, plan.edges), -shift)
    system, constraints = plan.wishes.system, plan.wishes.constraints
    system_path, constraints_path, start_path, lists, regions = (
        path.with_name(f"{path.stem}{ending}")
        for ending in ("_system.toml", "_constraints.toml", "_start.json", "_waypoints", "_regions.geojson")
    )
    written = [system_path]
    write_atomic(system_path, setting.system_text(_shift_system(system, -shift)).encode())
    if constraints:
        save_plan(start_path, shift_plan((plan.wishes.reference, ()), -shift)[0], ())
        write_atomic(constraints_path, setting.constraints_text(constraints, subject.names, start_path.name).encode())
        written += [start_path, constraints_path]
    if waypoints is not None:
        _save_lists(lists, cloud, edges, waypoints)
        save_regions_geojson(regions, cloud, edges, waypoints)
        written += [lists, regions]
    # The plan last: where it exists, all other files do.
    save_plan(path, cloud, edges, waypoints)
    return (path, *written)


def save_plan_geojson(
    path: Path, subject: PlanSubject, plan: tuple[CloudPlan, tuple[EdgePlan, ...]], setting: PlanSetting | None = None
) -> None:
    """Write regions, strips and cameras as GeoJSON; BadInput where they are not on the globe, and
    as `write_features`."""
    if path.suffix.lower() not in (".geojson", ".json"):
        raise BadInput(f"{path.name} is no name for regions: choose one that ends in .geojson.")
    waypoints, shift = _geo_waypoints(subject, None if setting is None else setting.waypoints)
    if waypoints is None:
        raise BadInput("this scene is not on the globe, its photographs hold no GPS: a map cannot show its regions.")
    cloud, edges = shift_plan(plan, -shift)
    save_regions_geojson(path, cloud, edges, waypoints)


def _save_lists(folder: Path, cloud: CloudPlan, edges: Sequence[EdgePlan], waypoints: Waypoints) -> None:
    """Write a list per device in place of an earlier plan's; BadInput where that fails."""
    try:
        folder.mkdir(exist_ok=True)
        for old in (*folder.glob("*.csv"), *folder.glob("edges/*.csv")):
            old.unlink()
    except OSError as error:
        raise BadInput(f"cannot write {folder} ({error.strerror}): choose another name or folder.") from error
    save_device_waypoints(folder, cloud, edges, waypoints)


def load_other_plan(path: Path, subject: PlanSubject) -> AdoptPlan:
    """Read a plan of the same cameras in this frame and order; BadInput for other cameras."""
    cloud, edges = load_plan(path)
    waypoints = load_plan_waypoints(path)
    count = len(cloud.edge_of_camera)
    if count != len(subject.names):
        raise BadInput(f"{path.name} is a plan of {count} cameras, this one is of {len(subject.names)}: open it by itself.")
    if waypoints is not None:
        if set(waypoints.names) != set(subject.names):
            strange = sorted(set(waypoints.names) - set(subject.names))[0]
            raise BadInput(f"{path.name} is a plan of other cameras, {strange!r} for one: open it by itself.")
        cloud, edges = _reorder((cloud, edges), waypoints.names, subject.names)
        if subject.origin is not None:
            shift = enu_from_geodetic(waypoints.origin[None], subject.origin)[0, :2]
            # A shift by zero would round, and change the plan's bits.
            cloud, edges = shift_plan((cloud, edges), shift if np.hypot(*shift) > SAME_PLACE_M else np.zeros(2))
    return AdoptPlan(name=path.name, cloud=cloud, edges=edges)


def shift_plan(plan: tuple[CloudPlan, tuple[EdgePlan, ...]], shift: FloatArray) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """Return the plan with `shift` (2,) added to its coordinates."""
    if not shift.any():
        return plan
    cloud, edges = plan
    return cloud.moved(shift), tuple(
        replace(edge, strips=tuple(strip + shift if len(strip) else strip for strip in edge.strips)) for edge in edges
    )


def _geo_waypoints(subject: PlanSubject, flown: Waypoints | None) -> tuple[Waypoints | None, FloatArray]:
    """Return the cameras as waypoints if they are on the globe, and the waypoints' origin (2,) in
    the subject's frame."""
    if flown is not None:
        return flown, np.zeros(2)
    if subject.origin is None:
        return None, np.zeros(2)
    places = geodetic_from_enu(subject.positions, subject.origin)
    ground_m = None if subject.ground is None else _altitude_m(subject.positions[:, :2].mean(axis=0), subject.ground, subject.origin)
    if subject.altitude_known:
        waypoints = Waypoints(names=subject.names, lat_lon_alt=places, counts_from="absolute", ground_m=ground_m)
    elif ground_m is None:
        waypoints = Waypoints(names=subject.names, lat_lon_alt=places, counts_from="unknown")
    else:
        # Altitudes count from nothing, and heights from the ground that was seen.
        waypoints = Waypoints(names=subject.names, lat_lon_alt=places - np.array([0.0, 0.0, ground_m]), ground_m=0.0)
    return waypoints, enu_from_geodetic(waypoints.origin[None], subject.origin)[0, :2]


def _altitude_m(place: FloatArray, height: float, origin: FloatArray) -> float:
    """Return the altitude of a height in the frame about `origin`, at `place` (2,)."""
    return float(geodetic_from_enu(np.array([[*place, height]]), origin)[0, 2])


def _shift_system(system: System, shift: FloatArray) -> System:
    if not shift.any():
        return system
    edges = [
        replace(edge, position=(edge.position[0] + float(shift[0]), edge.position[1] + float(shift[1])))
        if edge.position is not None
        else edge
        for edge in system.edges
    ]
    return replace(system, edges=tuple(edges))


def _reorder(
    plan: tuple[CloudPlan, tuple[EdgePlan, ...]], names: Sequence[str], wanted: Sequence[str]
) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """Return a plan of cameras `names` for the same cameras in the order `wanted`."""
    if tuple(names) == tuple(wanted):
        return plan
    cloud, edges = plan
    place_of = {name: index for index, name in enumerate(wanted)}
    places = np.array([place_of[name] for name in names])
    owners = np.empty_like(cloud.edge_of_camera)
    owners[places] = cloud.edge_of_camera
    looks = None if cloud.looks is None else cloud.looks[np.argsort(places)]
    dealt = []
    for edge in edges:
        moved = places[edge.camera_indices]
        order = np.argsort(moved)
        dealt.append(replace(edge, camera_indices=moved[order], device_of_camera=edge.device_of_camera[order]))
    return replace(cloud, edge_of_camera=owners, looks=looks), tuple(dealt)
