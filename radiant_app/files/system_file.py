"""The system file: edges, their devices and their costs, written by a user in TOML.

    [[edge]]
    id = "north"
    position_m = [0.0, 40.0]             # or lat_lon_deg = [47.37, 8.54]; else among the cameras
    uplink_mbit_per_s = 100.0
    aggregate_s = { constant = 5.0, linear = 0.5 }
    memory_gb = 4.0                      # what joining may hold; beyond it by tiles, or cut;
                                         # left out: 4/5 of what is free, divided among edges
    latency_ms = 1.0                     # one way between it and a device, half of what ping says;
                                         # left out: as measured on one machine, by its profile
    add_ms_per_mb = 2.0                  # of adding up what devices send in a step

    [[edge.device]]
    id = "north-1"
    init_s = { linear = 0.1 }
    train_s = { constant = 20.0, linear = 1.0 }
    model_mb = { linear = 0.5 }
    uplink_mbit_per_s = 50.0
    max_cameras = 400                    # left out: no limit
    memory_gb = 8.0                      # of training: limits Gaussians and, else, cameras
    relative_speed = 2.0                 # divides init_s and train_s: its own, its profile's, or
                                         # those of the machines beside it where it names neither
    speed = 0.5                          # of an edge too: share of a core under --emulate

`count = 3` in a device stands for three equal ones, north-1-1 to north-1-3.

A device with a relative_speed that names neither costs nor a profile costs what the devices beside
it do, those of its edge that name one, else those of all edges with a profile, divided by its
relative_speed; one that names nothing at all too, where these have one profile; otherwise the
values above. The planner believes the costs, an emulation plays `speed`: a device that is to be
half as fast in both has relative_speed and speed 0.5.

    [cloud]                              # limits of fitting there; beyond them models are cut
    memory_gb = 16.0                     # beyond it by tiles first; left out: 4/5 of what is free
    time_s = 3600.0                      # left out, as max_cameras: no limit
    max_cameras = 2000
    merge_s = { linear = 0.5 }           # of joining there; left out: not predicted
    latency_ms = 10.0                    # one way between it and an edge; left out: as an edge's
    add_ms_per_mb = 2.0

    [training]                           # which the costs hold for, where they were a profile's:
    preset = "default"                   # written by runs and plans, so that what joins by
    num_steps = 1500                     # `radiant plan --join` is taken for the same
    long_side_px = 576
    max_num_splats = 200000

In place of costs, a device, an edge or the cloud may have profile = "rtx-3090" of the library
(`radiant machine profile --list`) or profile = "mine.toml", a curve file of `radiant machine
profile` relative to this one: its costs and, where the file says none, its memory come from there.
A profile's training is taken at the steps that a run gives so many photographs; `train_s` that
stands here is believed as it is. An edge may also have aggregate_alone_s: what it costs where one
device has all its cameras, so that nothing is retrained. Where a run or plan writes its system, the
costs stand there as numbers, and costs_from names their profile: "measured mine.toml", "estimate
rtx-3090"; what profiles know beside (structure from motion, frames by GPS) stands there as far as
it was in them.

For `radiant plan` alone, an edge may have `time_s` (a cost, from its first photograph to its model
sent) and `max_cameras` in place of devices, uplink and aggregate_s: the cloud plans its region, and
it deals its cameras itself, later, with a system file of its own.

A cost is constant + linear · c + power_coefficient · c ** exponent for c cameras, 0 for none. Only
ids are required; what is left out has the value above, except position, memory limits,
aggregate_alone_s and speed (none) and relative_speed (1). latency_ms and add_ms_per_mb decide
whether machines train together: of an edge whose profile does not have them the first profile of
its devices counts, else 1 ms and 2 ms.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from radiant_app.files.profile_file import find_profile
from radiant_app.files.toml_file import load_toml
from radiant_core.errors import BadInput
from radiant_core.io.strict import Strict, problem_sentence
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.profile import Profile, ProfileKey
from radiant_core.plan.system import Cloud, Device, Edge, System

_BYTES_PER_S_PER_MBIT = 1e6 / 8
_BYTES_PER_MB, _BYTES_PER_GB = 1e6, 1e9
_MS_PER_S = 1e3
_MS_PER_MB = 1e9  # for a second a byte

_NonNegative = Annotated[float, Field(ge=0, le=1e12)]
_Positive = Annotated[float, Field(gt=0, le=1e12)]
_Share = Annotated[float, Field(gt=0, le=1)]
_Speed = Annotated[float, Field(ge=1e-3, le=1e3)]
_Count = Annotated[int, Field(ge=1, le=10**9)]
_Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


class _Curve(Strict):
    constant: _NonNegative = 0.0
    linear: _NonNegative = 0.0
    power_coefficient: _NonNegative = 0.0
    exponent: Annotated[float, Field(ge=0, le=4)] = 1.0

    def scaled(self, factor: float) -> CostCurve:
        return CostCurve(
            constant=self.constant * factor,
            linear=self.linear * factor,
            power_coefficient=self.power_coefficient * factor,
            exponent=self.exponent,
        )


_Origin = Annotated[str, Field(pattern=r"^(measured|estimate) \S.*$")]


_DEVICE_COSTS = ("init_s", "train_s", "model_mb")


class _Device(Strict):
    id: str
    profile: str | None = None
    costs_from: _Origin | None = None
    init_s: _Curve = _Curve(linear=0.1)
    train_s: _Curve = _Curve(constant=20.0, linear=1.0)
    model_mb: _Curve = _Curve(linear=0.5)
    uplink_mbit_per_s: _Positive = 50.0
    max_cameras: Annotated[int, Field(ge=0)] | None = None
    memory_gb: _Positive | None = None
    relative_speed: _Speed = 1.0
    speed: _Share | None = None
    count: Annotated[int, Field(ge=1, le=10_000)] | None = None

    @property
    def names_costs(self) -> bool:
        """Whether it says what its work costs."""
        return bool(self.model_fields_set & {"profile", *_DEVICE_COSTS})

    def build(self, folder: Path, reference: _Device | None) -> tuple[Device, ...]:
        """The device, or `count` equal ones with numbered ids, at the costs of the one beside it
        where it names none."""
        one = self._build_one(folder) if reference is None or self.names_costs else self._like(reference, folder)
        return (one,) if self.count is None else tuple(replace(one, id=f"{self.id}-{number + 1}") for number in range(self.count))

    def _like(self, reference: _Device, folder: Path) -> Device:
        costs = {name: getattr(reference, name) for name in ("profile", *_DEVICE_COSTS) if name in reference.model_fields_set}
        alike = self.model_copy(update={**costs, "relative_speed": self.relative_speed * reference.relative_speed})
        return alike._build_one(folder)

    def _build_one(self, folder: Path) -> Device:
        profile = _profile_of(self, f"device {self.id!r}", _DEVICE_COSTS, folder)
        memory_bytes = None if self.memory_gb is None else self.memory_gb * _BYTES_PER_GB
        if profile is None:
            curves = self.init_s.scaled(1.0), self.train_s.scaled(1.0), self.model_mb.scaled(_BYTES_PER_MB)
        else:
            curves = profile.init_s.curve, profile.train_s.curve, profile.model_bytes.curve
            memory_bytes = memory_bytes or profile.memory_bytes
        return Device(
            id=self.id,
            init_s=curves[0].scaled(1 / self.relative_speed),
            train_s=curves[1].scaled(1 / self.relative_speed),
            model_bytes=curves[2],
            uplink_bytes_per_s=self.uplink_mbit_per_s * _BYTES_PER_S_PER_MBIT,
            max_cameras=self.max_cameras,
            memory_bytes=memory_bytes,
            speed=self.speed,
            profile=profile,
            costs_from=self.costs_from,
        )


class _Edge(Strict):
    id: str
    position_m: _Pair | None = None
    lat_lon_deg: _Pair | None = None
    uplink_mbit_per_s: _Positive = 100.0
    profile: str | None = None
    costs_from: _Origin | None = None
    aggregate_s: _Curve = _Curve(constant=5.0, linear=0.5)
    aggregate_alone_s: _Curve | None = None
    speed: _Share | None = None
    memory_gb: _Positive | None = None
    device: list[_Device] = Field(default_factory=list[_Device])
    latency_ms: _NonNegative | None = None
    add_ms_per_mb: _NonNegative | None = None
    time_s: _Curve | None = None
    max_cameras: Annotated[int, Field(ge=0)] | None = None

    def build(self, folder: Path, costed_devices: list[_Device]) -> Edge:
        """The edge; `costed_devices`: the devices of all edges that name costs."""
        if self.position_m is not None and self.lat_lon_deg is not None:
            raise BadInput(f"edge {self.id!r} has both position_m and lat_lon_deg: give one of them or neither.")
        if self.lat_lon_deg is not None and (abs(self.lat_lon_deg[0]) > 90 or abs(self.lat_lon_deg[1]) > 180):
            raise BadInput(
                f"edge {self.id!r} has lat_lon_deg {self.lat_lon_deg}, expected a latitude within ±90 and a longitude within ±180."
            )
        replaced_by_time = {"profile", "costs_from", "aggregate_s", "aggregate_alone_s", "uplink_mbit_per_s", "speed", "memory_gb"}
        replaced_by_time |= {"latency_ms", "add_ms_per_mb"}
        surplus = self.model_fields_set & replaced_by_time
        if self.time_s is not None and surplus:
            raise BadInput(f"edge {self.id!r} has time_s, its whole time, and {min(surplus)} too: remove one of them.")
        profile = _profile_of(self, f"edge {self.id!r}", ("aggregate_s", "aggregate_alone_s"), folder)
        joined = self.aggregate_s.scaled(1.0) if self.time_s is None else CostCurve()
        alone = None if self.aggregate_alone_s is None else self.aggregate_alone_s.scaled(1.0)
        if profile is not None:
            if profile.aggregate_s is None:
                raise BadInput(f"edge {self.id!r}: profile {self.profile!r} has no aggregate_s: measure it, or give aggregate_s here.")
            joined, alone = profile.aggregate_s.curve, None if profile.aggregate_alone_s is None else profile.aggregate_alone_s.curve
        devices = tuple(device for table in self.device for device in table.build(folder, self._reference_of(table, costed_devices)))
        latency_s, add_s_per_byte = _exchange_of(self, [profile, *(device.profile for device in devices)])
        return Edge(
            id=self.id,
            position=None if self.position_m is None else (self.position_m[0], self.position_m[1]),
            lat_lon_deg=None if self.lat_lon_deg is None else (self.lat_lon_deg[0], self.lat_lon_deg[1]),
            aggregate_s=joined,
            uplink_bytes_per_s=self.uplink_mbit_per_s * _BYTES_PER_S_PER_MBIT,
            devices=devices,
            speed=self.speed,
            aggregate_alone_s=alone,
            profile=profile,
            costs_from=self.costs_from,
            time_s=None if self.time_s is None else self.time_s.scaled(1.0),
            max_cameras=self.max_cameras,
            memory_bytes=None if self.memory_gb is None else self.memory_gb * _BYTES_PER_GB,
            latency_s=latency_s,
            add_s_per_byte=add_s_per_byte,
        )

    def _reference_of(self, device: _Device, everywhere: list[_Device]) -> _Device | None:
        """The device whose costs one that names none has; BadInput where those beside it differ."""
        if device.names_costs:
            return None
        scales_speed = "relative_speed" in device.model_fields_set
        # Costs that are spelt out are somebody's; a profile is a machine that others can be like.
        near = [candidate for candidate in self.device if candidate.names_costs and (scales_speed or candidate.profile is not None)]
        near = near or [candidate for candidate in everywhere if candidate.profile is not None]
        kinds = {_costs_text(candidate): candidate for candidate in near}
        if len(kinds) > 1 and not scales_speed:
            return None
        if len(kinds) > 1:
            raise BadInput(
                f"device {device.id!r} names neither a profile nor costs, so that its relative_speed is of the machines beside it, "
                f"and these differ ({', '.join(sorted(kinds))}): give it the profile that its speed is of."
            )
        return next(iter(kinds.values()), None)


def _costs_text(device: _Device) -> str:
    """What a device's costs are, the same text for the same costs."""
    speed = "" if device.relative_speed == 1 else f" at {device.relative_speed:g}"
    if device.profile is not None:
        return f"{device.profile}{speed}"
    curves = ", ".join(f"{name} {_inline(getattr(device, name).scaled(1.0), 1.0)}" for name in _DEVICE_COSTS)
    return f"{curves}{speed}"


def _profile_of(table: _Device | _Edge | _Cloud, owner: str, costs: tuple[str, ...], folder: Path) -> Profile | None:
    if table.profile is None:
        return None
    other_costs = [name for name in (*costs, "costs_from") if name in table.model_fields_set]
    if other_costs:
        raise BadInput(f"{owner} has both profile and {other_costs[0]}: keep one of them.")
    try:
        return find_profile(table.profile, folder)
    except BadInput as error:
        raise BadInput(f"{owner}: {error}") from error


def _exchange_of(table: _Edge | _Cloud, profiles: Sequence[Profile | None]) -> tuple[float | None, float | None]:
    """Latency in seconds and seconds per byte added up: the table's, else the first profile's."""
    latencies = [profile.latency_s for profile in profiles if profile is not None and profile.latency_s is not None]
    adding = [profile.add_s_per_byte for profile in profiles if profile is not None and profile.add_s_per_byte is not None]
    latency_s = next(iter(latencies), None) if table.latency_ms is None else table.latency_ms / _MS_PER_S
    add_s = next(iter(adding), None) if table.add_ms_per_mb is None else table.add_ms_per_mb / _MS_PER_MB
    return latency_s, add_s


class _Cloud(Strict):
    memory_gb: _NonNegative | None = None
    time_s: _NonNegative | None = None
    max_cameras: Annotated[int, Field(ge=0)] | None = None
    profile: str | None = None
    merge_s: _Curve | None = None
    latency_ms: _NonNegative | None = None
    add_ms_per_mb: _NonNegative | None = None

    def build(self, folder: Path) -> Cloud:
        memory_bytes = None if self.memory_gb is None else self.memory_gb * _BYTES_PER_GB
        merge_s = None if self.merge_s is None else self.merge_s.scaled(1.0)
        profile = _profile_of(self, "cloud", ("merge_s",), folder)
        if profile is not None:
            if profile.merge_s is None:
                raise BadInput(f"cloud: profile {self.profile!r} has no merge_s: measure it, or give merge_s here.")
            merge_s = profile.merge_s.curve
        latency_s, add_s_per_byte = _exchange_of(self, [profile])
        return Cloud(
            memory_bytes=memory_bytes,
            time_s=self.time_s,
            max_cameras=self.max_cameras,
            merge_s=merge_s,
            profile=profile,
            latency_s=latency_s,
            add_s_per_byte=add_s_per_byte,
        )


class _Training(Strict):
    preset: Annotated[str, Field(min_length=1, max_length=500)]
    num_steps: _Count
    long_side_px: _Count
    max_num_splats: _Count | None = None
    aggregate_preset: Annotated[str, Field(min_length=1, max_length=500)] = "default"

    def build(self) -> ProfileKey:
        return ProfileKey(**self.model_dump())


class _File(Strict):
    edge: Annotated[list[_Edge], Field(min_length=1)]
    cloud: _Cloud = _Cloud()
    training: _Training | None = None


def load_system(path: Path, *, curves: bool = False) -> System:
    """The system in a TOML file; BadInput names the file, the key, what came and what is expected.
    Edges described by their curve alone, without a device, are refused unless `curves`. Use it for
    machines that differ in speed, memory or links (docs/system_files.md).

    Args:
        path: the TOML file.
        curves: whether an edge may be a curve of its time.

    Example:
        >>> system = radiant.load_system(Path("system.toml"))
        >>> plan = radiant.plan_regions(radiant.load_scene("SCENE"), system)
        >>> sum(len(plan.cameras_of(device)) for device in plan.devices)
        10
    """
    tables = load_toml(path, "system file")
    try:
        file = _File.model_validate(tables)
        costed_devices = [device for edge in file.edge for device in edge.device if device.names_costs]
        edges = tuple(edge.build(path.parent, costed_devices) for edge in file.edge)
        system = System(edges=edges, cloud=file.cloud.build(path.parent), training=None if file.training is None else file.training.build())
        unknown = [edge.id for edge in system.edges if not edge.devices]
        if unknown and not curves:
            raise BadInput(f"edge {unknown[0]!r} has time_s and no devices: `radiant plan` plans it, everything else needs its devices.")
        return system
    except ValidationError as error:
        raise BadInput(f"{path}: {problem_sentence(error, 'system file', model=_File)}") from error
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error


def dump_system(system: System) -> str:
    """The system as TOML text that `load_system` reads back, with curves in place of profiles."""
    edges = [line for edge in system.edges for line in _edge_lines(edge)]
    return "\n".join([*edges, *_cloud_lines(system.cloud), *_training_lines(system.training)]) + "\n"


def even_system(num_edges: int, devices_per_edge: int) -> System:
    """Equal edges with equal devices at the file's defaults, placed among the cameras later;
    BadInput below one of either. Use it where machines are alike; `load_system` reads unequal ones.

    Args:
        num_edges: servers that join, each with a region.
        devices_per_edge: machines that train below each.

    Example:
        >>> system = radiant.even_system(2, 2)
        >>> [device.id for device in system.devices]
        ['edge-1-1', 'edge-1-2', 'edge-2-1', 'edge-2-2']
    """
    if num_edges < 1 or devices_per_edge < 1:
        raise BadInput(f"{num_edges} edges with {devices_per_edge} devices each were asked for: give at least one of either.")
    names = [f"edge-{index + 1}" for index in range(num_edges)]
    edges = [_Edge(id=name, device=[_Device(id=f"{name}-{n + 1}") for n in range(devices_per_edge)]) for name in names]
    return System(edges=tuple(edge.build(Path(), []) for edge in edges))


def _edge_lines(edge: Edge) -> list[str]:
    lines = ["[[edge]]", f"id = {json.dumps(edge.id)}"]
    if edge.position is not None:
        lines.append(f"position_m = {list(map(float, edge.position))}")
    elif edge.lat_lon_deg is not None:
        lines.append(f"lat_lon_deg = {list(map(float, edge.lat_lon_deg))}")
    if edge.time_s is not None:
        limit = [] if edge.max_cameras is None else [f"max_cameras = {edge.max_cameras}"]
        return [*lines, f"time_s = {_inline(edge.time_s, 1.0)}", *limit]
    lines += [_bandwidth_line(edge.uplink_bytes_per_s), f"aggregate_s = {_inline(edge.aggregate_s, 1.0)}", *_speed_lines(edge)]
    if edge.aggregate_alone_s is not None:
        lines.append(f"aggregate_alone_s = {_inline(edge.aggregate_alone_s, 1.0)}")
    if edge.memory_bytes is not None:
        lines.append(f"memory_gb = {edge.memory_bytes / _BYTES_PER_GB}")
    lines += [*_exchange_lines(edge), *_origin_lines(edge)]
    return [*lines, *(line for device in edge.devices for line in _device_lines(device))]


def _device_lines(device: Device) -> list[str]:
    return [
        "[[edge.device]]",
        f"id = {json.dumps(device.id)}",
        f"init_s = {_inline(device.init_s, 1.0)}",
        f"train_s = {_inline(device.train_s, 1.0)}",
        f"model_mb = {_inline(device.model_bytes, _BYTES_PER_MB)}",
        _bandwidth_line(device.uplink_bytes_per_s),
        *([] if device.max_cameras is None else [f"max_cameras = {device.max_cameras}"]),
        *([] if device.memory_bytes is None else [f"memory_gb = {device.memory_bytes / _BYTES_PER_GB}"]),
        *_speed_lines(device),
        *_origin_lines(device),
    ]


def _cloud_lines(cloud: Cloud) -> list[str]:
    limits = {
        "memory_gb": None if cloud.memory_bytes is None else cloud.memory_bytes / _BYTES_PER_GB,
        "time_s": cloud.time_s,
        "max_cameras": cloud.max_cameras,
    }
    lines = [f"{name} = {limit}" for name, limit in limits.items() if limit is not None]
    lines += [] if cloud.merge_s is None else [f"merge_s = {_inline(cloud.merge_s, 1.0)}"]
    lines += _exchange_lines(cloud)
    return ["[cloud]", *lines] if lines else []


def _training_lines(training: ProfileKey | None) -> list[str]:
    if training is None:
        return []
    return ["[training]", *(f"{name} = {json.dumps(value)}" for name, value in vars(training).items() if value is not None)]


def _speed_lines(machine: Device | Edge) -> list[str]:
    return [] if machine.speed is None else [f"speed = {float(machine.speed)}"]


def _exchange_lines(machine: Edge | Cloud) -> list[str]:
    latency = [] if machine.latency_s is None else [f"latency_ms = {float(machine.latency_s * _MS_PER_S)}"]
    adding = machine.add_s_per_byte
    return latency if adding is None else [*latency, f"add_ms_per_mb = {float(adding * _MS_PER_MB)}"]


def _origin_lines(machine: Device | Edge) -> list[str]:
    return [] if machine.origin is None else [f"costs_from = {json.dumps(machine.origin, ensure_ascii=False)}"]


def _bandwidth_line(bytes_per_s: float) -> str:
    return f"uplink_mbit_per_s = {float(bytes_per_s / _BYTES_PER_S_PER_MBIT)}"


def _inline(curve: CostCurve, unit: float) -> str:
    terms = {name: getattr(curve, name) / unit for name in ("constant", "linear", "power_coefficient")}
    return "{ " + ", ".join(f"{name} = {float(value)}" for name, value in {**terms, "exponent": curve.exponent}.items()) + " }"
