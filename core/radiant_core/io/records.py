"""What flows between stages, as files: arrays as safetensors, plans as JSON. Once per stage.

Every file says in its metadata which schema and version it is. No pickle, nothing lost; reading
takes no more memory than the file is long. In plan.json stand, of waypoints, what their heights
count from and how high they may be flown, and the groups of machines that train together:

    "heights_from": "takeoff"            # or a list, one a waypoint, where they differ
    "height_limits_m": [null, 150.0]     # left out: the usual ones
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter, ValidationError

from radiant_core.cameras import Cameras
from radiant_core.choices import HeightFrom
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.io.array_file import VERSION, load_arrays, name_file_in_errors, require_schema, save_arrays
from radiant_core.io.colmap.records import is_image_name
from radiant_core.io.plan_content import GROUND_KEY
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.strict import Strict, problem_sentence
from radiant_core.numerics import check_array
from radiant_core.plan.counts.slack_curve import SlackPoint
from radiant_core.plan.heights import HEIGHT_KINDS, USUAL_LIMIT_M, HeightLimits, height_codes
from radiant_core.plan.plans import CloudPlan, EdgePlan, require_plan_of
from radiant_core.plan.system import require_id
from radiant_core.plan.together.groups import GroupLevel, GroupPlan
from radiant_core.plan.waypoints import Waypoints
from radiant_core.scene import SfmScene
from radiant_core.splats import TENSORS, Splats

HEIGHTS_FROM, LIMITS = "heights_from", "height_limits_m"


def heights_record(waypoints: Waypoints) -> dict[str, Any]:
    """The entries above, for the record of the waypoints."""
    kinds = waypoints.counts_from
    named = [HEIGHT_KINDS[code] for code in kinds.tolist()] if isinstance(kinds, np.ndarray) else kinds
    limits = waypoints.limits
    return {HEIGHTS_FROM: named, **({} if limits == HeightLimits() else {LIMITS: [limits.lowest_m, limits.highest_m]})}


def with_recorded_heights(waypoints: Waypoints, record: Mapping[str, Any]) -> Waypoints:
    """The waypoints with what their record says of heights; BadInput where it says something
    else."""
    limits = record.get(LIMITS)
    if limits is not None:
        if not (isinstance(limits, list) and len(limits) == 2 and all(bound is None or _is_number(bound) for bound in limits)):
            raise BadInput(f"{LIMITS} is {str(limits)[:40]}, expected the lowest height, or null, and the highest.")
        lowest_m, highest_m = limits
        waypoints = replace(waypoints, limits=HeightLimits(lowest_m=lowest_m, highest_m=USUAL_LIMIT_M if highest_m is None else highest_m))
    if HEIGHTS_FROM not in record:
        raise BadInput(f"it has no {HEIGHTS_FROM}, so nothing says what its heights count from: plan again.")
    named = record[HEIGHTS_FROM]
    if isinstance(named, str):
        return replace(waypoints, counts_from=_kind(named))
    if not isinstance(named, list):
        raise BadInput(f"{HEIGHTS_FROM} is {str(named)[:40]}, expected one of {', '.join(HEIGHT_KINDS)}, or one a waypoint.")
    return replace(waypoints, counts_from=height_codes([_kind(name) for name in named]))


def _kind(name: Any) -> HeightFrom:
    for kind in HEIGHT_KINDS:
        if name == kind:
            return kind
    raise BadInput(f"{HEIGHTS_FROM} has {str(name)[:40]!r}, expected one of {', '.join(HEIGHT_KINDS)}.")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


GROUPS_KEY = "together"
_MAX_GROUPS = 100_000
_Seconds = Annotated[float, Field(ge=0, le=1e12)]
_Count = Annotated[int, Field(ge=1, le=10**9)]


class _Group(Strict):
    level: GroupLevel
    edges: Annotated[list[str], Field(min_length=1)]
    views: dict[str, _Count]
    num_photographs: _Count
    num_steps: _Count
    step_s: _Seconds
    start_s: _Seconds
    end_s: _Seconds
    overlaps: bool

    def build(self) -> GroupPlan:
        return GroupPlan(**{**self.model_dump(), "edges": tuple(self.edges)})


def groups_record(groups: Sequence[GroupPlan]) -> list[dict[str, Any]]:
    """The groups as JSON's values."""
    return [{**vars(group), "edges": list(group.edges), "views": dict(group.views)} for group in groups]


def groups_of_record(record: Any) -> tuple[GroupPlan, ...]:
    """What `groups_record` was made of; BadInput for anything else, and for a device in two
    groups."""
    try:
        groups = TypeAdapter(Annotated[list[_Group], Field(max_length=_MAX_GROUPS)]).validate_python(record)
    except ValidationError as error:
        raise BadInput(problem_sentence(error, "plan", GROUPS_KEY)) from error
    built = tuple(group.build() for group in groups)
    names = [device for group in built for device in group.views]
    twice = next((name for name in names if names.count(name) > 1), None) if len(set(names)) < len(names) else None
    if twice is not None:
        raise BadInput(f"device {twice!r} trains in two groups: plan again.")
    return built


MAX_PLAN_BYTES = 512 * 2**20
"""A plan of a million waypoints takes some 150 MB."""
MAX_PIXELS = 1 << 28
"""Of one camera, as of a photograph: what renders a picture makes room for all of them."""
SPLATS_DTYPES: dict[str, str] = dict.fromkeys(TENSORS, "F32")
CAMERAS_DTYPES = {"Ks": "F64", "cam_from_world": "F64", "sizes_wh": "I64"}
SCENE_DTYPES = {**CAMERAS_DTYPES, "points": "F64", "colors": "U8", "observations": "I64", "origin_lat_lon_alt": "F64"}


def save_splats(path: Path, splats: Splats) -> None:
    """Write a model (N Gaussians) to `path`, atomically; raises as `write_atomic`."""
    save_arrays(path, "radiant.splats", splats.arrays(), {"antialiased": splats.antialiased})


def load_splats(path: Path) -> Splats:
    """The model that `save_splats` wrote; StoreDamaged when broken, BadInput when it is no
    model."""
    arrays, about = load_arrays(path, "radiant.splats", SPLATS_DTYPES)
    with name_file_in_errors(path):
        return Splats(**arrays, antialiased=about.get("antialiased") is True)


def save_cameras(path: Path, cameras: Cameras) -> None:
    """Write C cameras to `path`, atomically; raises as `write_atomic`."""
    save_arrays(path, "radiant.cameras", _camera_arrays(cameras), {"names": list(cameras.names)})


def load_cameras(path: Path) -> Cameras:
    """The cameras that `save_cameras` wrote; StoreDamaged when broken, BadInput for something else,
    a name that leads out of a folder, or a camera larger than any photograph."""
    arrays, about = load_arrays(path, "radiant.cameras", CAMERAS_DTYPES)
    with name_file_in_errors(path):
        return cameras_of_arrays(about["names"], arrays)


def save_scene(path: Path, scene: SfmScene) -> None:
    """Write cameras, points, colours, observations and frame, atomically; raises as
    `write_atomic`."""
    arrays = {
        **_camera_arrays(scene.cameras),
        "points": scene.points,
        "colors": scene.colors,
        "observations": scene.observations,
        "origin_lat_lon_alt": scene.frame.origin_lat_lon_alt,
    }
    about = {"names": list(scene.cameras.names), "frame_kind": scene.frame.kind, "frame_residual_m": scene.frame.residual_m}
    if not scene.frame.altitude_known:
        about["frame_altitude_known"] = False
    save_arrays(path, "radiant.scene", arrays, about)


def load_scene(path: Path) -> SfmScene:
    """Read the scene that `save_scene` wrote.

    Args:
        path: the scene.safetensors of `radiant sfm` or of a run.

    Returns:
        Cameras, points, observations and frame.

    Raises:
        BadInput: something else than a scene, a name that leads out of a folder, or a camera larger
            than any photograph.
        StoreDamaged: the file is missing or broken.
    """
    arrays, about = load_arrays(path, "radiant.scene", SCENE_DTYPES)
    with name_file_in_errors(path):
        residual_m = about["frame_residual_m"]
        return SfmScene(
            cameras=cameras_of_arrays(about["names"], arrays),
            points=arrays["points"],
            colors=arrays["colors"],
            observations=arrays["observations"],
            frame=Frame(
                kind=about["frame_kind"],
                origin_lat_lon_alt=arrays["origin_lat_lon_alt"],
                residual_m=None if residual_m is None else float(residual_m),
                altitude_known=about.get("frame_altitude_known") is not False,
            ),
        )


def save_plan(  # noqa: PLR0913
    path: Path,
    cloud: CloudPlan,
    edges: tuple[EdgePlan, ...],
    waypoints: Waypoints | None = None,
    *,
    slack_curve: Sequence[SlackPoint] = (),
    warnings: Sequence[str] = (),
    content: Mapping[str, Any] | None = None,
    groups: Sequence[GroupPlan] = (),
) -> None:
    """Write both levels of a plan as JSON, atomically, with the waypoints that its indices point
    into, what slacks would buy, its warnings, what `content_record` says of footprints, and the
    groups of machines that train together;
    BadInput when the waypoints' number is another, else raises as `write_atomic`."""
    record = plan_record(cloud, edges)
    if slack_curve:
        record["slack_curve"] = [asdict(point) for point in slack_curve]
    if waypoints is not None:
        require_plan_of(len(waypoints), cloud, edges)
        record["waypoints"] = {"names": list(waypoints.names), "lat_lon_alt": waypoints.lat_lon_alt.tolist()}
        if waypoints.heading_pitch_deg is not None:
            angles = waypoints.heading_pitch_deg.tolist()
            record["waypoints"]["heading_pitch_deg"] = [[None if np.isnan(angle) else angle for angle in pair] for pair in angles]
        record["waypoints"] |= heights_record(waypoints)
        if waypoints.ground_m is not None:
            record[GROUND_KEY] = waypoints.ground_m
    if warnings:
        record["warnings"] = list(warnings)
    record |= content or {}
    if groups:
        record[GROUPS_KEY] = groups_record(groups)
    write_json(path, {"schema": "radiant.plan", "version": VERSION, **record})


def plan_record(cloud: CloudPlan, edges: Sequence[EdgePlan]) -> dict[str, Any]:
    """Both levels of a plan as JSON's values, for a file that holds more than a plan."""
    return {"cloud": _plan_values(cloud), "edges": [_plan_values(edge) for edge in edges]}


def plan_of_record(record: Mapping[str, Any]) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """What `plan_record` was made of, bit for bit; BadInput, KeyError or TypeError otherwise."""
    cloud = CloudPlan(**_plan_fields(CloudPlan, record["cloud"]))
    return cloud, tuple(EdgePlan(**_plan_fields(EdgePlan, edge)) for edge in record["edges"])


@dataclass(frozen=True, kw_only=True, eq=False)
class PlanFile:
    """What a plan's file holds: both levels, the waypoints it was made from, and the altitude of
    the ground (m) that their altitudes count with, where it was given; and which machines train
    together."""

    cloud: CloudPlan
    edges: tuple[EdgePlan, ...]
    waypoints: Waypoints | None = None
    ground_m: float | None = None
    groups: tuple[GroupPlan, ...] = ()


def load_plan(path: Path) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """The plan that `save_plan` wrote; StoreDamaged when broken, BadInput when it is no plan."""
    plan_file = load_plan_file(path)
    return plan_file.cloud, plan_file.edges


def load_plan_groups(path: Path) -> tuple[GroupPlan, ...]:
    """The groups of machines that train together in a plan; none where all models are joined.
    Raises as `load_plan`."""
    return load_plan_file(path).groups


def load_plan_waypoints(path: Path) -> Waypoints | None:
    """The waypoints that a plan was made from, one per camera; None where it was made from a scene.
    Raises as `load_plan`."""
    return load_plan_file(path).waypoints


def load_plan_file(path: Path) -> PlanFile:
    """A plan with what it was made from; raises as `load_plan`."""
    record = read_json(path, max_bytes=MAX_PLAN_BYTES)
    with name_file_in_errors(path):
        if not isinstance(record, dict):
            raise BadInput("it holds no plan: pass the plan.json of a run.")
        require_schema(record, "radiant.plan")
        cloud, edges = plan_of_record(record)
        groups = groups_of_record(record.get(GROUPS_KEY, []))
        stored = record.get("waypoints")
        ground = record.get(GROUND_KEY)
        ground_m = None if ground is None else float(check_array("the ground's altitude", [ground], (1,))[0])
        if stored is None:
            return PlanFile(cloud=cloud, edges=edges, ground_m=ground_m, groups=groups)
        looks = stored.get("heading_pitch_deg") if isinstance(stored, dict) else None
        angles = None if looks is None else np.array(looks, dtype=np.float64)
        waypoints = with_recorded_heights(
            Waypoints(names=_texts(stored["names"]), lat_lon_alt=stored["lat_lon_alt"], heading_pitch_deg=angles, ground_m=ground_m), stored
        )
        require_plan_of(len(waypoints), cloud, edges)
    return PlanFile(cloud=cloud, edges=edges, waypoints=waypoints, ground_m=waypoints.ground_m, groups=groups)


def _camera_arrays(cameras: Cameras) -> dict[str, NDArray]:
    return {name: getattr(cameras, name) for name in CAMERAS_DTYPES}


def _texts(values: Any) -> tuple[str, ...]:
    if not (isinstance(values, list) and all(isinstance(value, str) for value in values)):
        raise BadInput("a list of names holds something else: write the file anew.")
    return tuple(values)


def cameras_of_arrays(names: Any, arrays: Mapping[str, NDArray]) -> Cameras:
    """The cameras of a file: names are paths inside a folder, sizes those of photographs."""
    cameras = Cameras(names=_texts(names), **{name: arrays[name] for name in CAMERAS_DTYPES})
    outside = next((name for name in cameras.names if not is_image_name(name)), None)
    if outside is not None:
        raise BadInput(f"it names an image {outside!r}, expected relative paths inside a folder: do not use what this file came with.")
    # As real numbers: a product of two large integers wraps around.
    large = np.flatnonzero(cameras.sizes_wh.astype(np.float64).prod(axis=1) > MAX_PIXELS)
    if len(large):
        width, height = cameras.sizes_wh[large[0]].tolist()
        raise BadInput(f"camera {cameras.names[large[0]]!r} has {width} × {height} px, expected at most {MAX_PIXELS:,} in all.")
    return cameras


def _ids(values: Any) -> tuple[str, ...]:
    """Ids of edges or devices, which name folders and files."""
    ids = _texts(values)
    for name in ids:
        require_id("its edge or device", name)
    return ids


def _plan_values(plan: CloudPlan | EdgePlan) -> dict[str, Any]:
    values = {field.name: _plain_value(getattr(plan, field.name)) for field in fields(plan)}
    # Files of plans that are cut where cameras stand are as ever, for earlier versions too.
    return {name: value for name, value in values.items() if name != "looks" or value is not None}


def _plain_value(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain_value(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def _plan_fields(plan_type: type[CloudPlan | EdgePlan], record: Any) -> dict[str, Any]:
    names = {field.name for field in fields(plan_type)}
    needed = {field.name for field in fields(plan_type) if field.default is MISSING}
    if not isinstance(record, dict) or not needed <= set(record) <= names:
        raise BadInput(f"a part of it is no {plan_type.__name__}, which has exactly {sorted(names)}: plan again.")
    return {name: _parse_field(name, value) for name, value in record.items()}


def _parse_field(name: str, value: Any) -> Any:
    """A field of a plan from JSON; arrays stay lists for its checks, empty polygons are (0,2)."""
    if name in ("edge_ids", "device_ids"):
        return _ids(value)
    if name == "constrained":
        return _texts(value)
    if name == "edge_id":
        return _ids([value])[0]
    if name in ("borders", "strips"):
        return tuple(np.zeros((0, 2)) if polygon == [] else polygon for polygon in value)
    if name in ("method", "status", "certified", "dealt"):
        wanted = bool if name in ("certified", "dealt") else str
        if not isinstance(value, wanted):
            raise BadInput(f"its {name} is {value!r}, expected {wanted.__name__}: plan again.")
        return value
    if name == "history":
        return tuple(float(makespan_s) for makespan_s in value)
    if name == "looks":
        return None if value is None else check_array("looks", value, (None, 2))
    if name == "lower_bound_s":
        return float(value)
    if name in ("slack", "num_outside"):
        return None if value is None else float(value) if name == "slack" else int(value)
    return value
