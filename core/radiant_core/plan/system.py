"""`System`: the edges, their devices, how fast each is and how fast it sends (paper Sec. III-B)."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.profile import Profile, ProfileKey

_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


@dataclass(frozen=True, kw_only=True)
class Device:
    """A machine that holds photographs and trains (paper: device n; G, F_n, H, B^n, |C^n_max|)."""

    id: str
    """Letters, digits, - and _; names the device's folder."""
    init_s: CostCurve
    """G: seconds to initialise against cameras."""
    train_s: CostCurve
    """F_n: seconds to train against cameras."""
    model_bytes: CostCurve
    """H: bytes of the trained model against cameras."""
    uplink_bytes_per_s: float
    """B^n: bandwidth to the edge."""
    max_cameras: int | None = None
    """|C^n_max|: how many cameras its memory can hold, None without a limit."""
    memory_bytes: float | None = None
    """What its training may hold, which limits its Gaussians; None without a limit."""
    speed: float | None = None
    """Share of one core, at most 1, when the system is emulated; what that means for the curves
    above is for their author to say."""
    profile: Profile | None = None
    """What the three curves come from; None where they were spelt out."""
    costs_from: str | None = None
    """"measured NAME" or "estimate NAME" where the curves were copied from that profile."""

    @property
    def origin(self) -> str | None:
        """Kind and name of the profile that the curves are from, None where they were spelt out."""
        return _origin(self.profile, self.costs_from)

    def __post_init__(self) -> None:
        require_id("device", self.id)
        _require_bandwidth(f"device {self.id!r}", self.uplink_bytes_per_s)
        if self.max_cameras is not None and self.max_cameras < 0:
            raise BadInput(f"device {self.id!r}: max_cameras is {self.max_cameras}, expected at least 0.")
        _require_memory(f"device {self.id!r}", self.memory_bytes)
        _require_speed(f"device {self.id!r}", self.speed)


@dataclass(frozen=True, kw_only=True)
class Edge:
    """A machine that owns a region and joins its devices' models (paper: edge m at P^m with F_m and
    B^m).

    To the cloud it may be known by `time_s` and `max_cameras` alone: then it has no devices here
    and deals its cameras itself, later.
    """

    id: str
    """Letters, digits, - and _; names the edge's folder."""
    position: tuple[float, float] | None
    """x east, y north in the scene's frame, metres; None: placed by `seeded_positions` when the
    scene is known."""
    lat_lon_deg: tuple[float, float] | None = None
    """Latitude and longitude instead of `position`, turned into metres about the scene's origin."""
    aggregate_s: CostCurve
    """F_m: seconds to aggregate against cameras. An edge whose cameras several devices share takes
    a + b · views whatever the cut, as it retrains on every view; if only views at borders were
    shown, it would depend on where these run, and makespan over bound could only be reported for
    this model."""
    uplink_bytes_per_s: float
    """B^m: bandwidth to the cloud."""
    devices: tuple[Device, ...]
    """At least one, or none where `time_s` is given."""
    speed: float | None = None
    """As a device's."""
    aggregate_alone_s: CostCurve | None = None
    """F_m where one device has all the edge's cameras and nothing is joined; None:
    `aggregate_s`."""
    profile: Profile | None = None
    """What the curves of aggregation come from; None where they were spelt out."""
    costs_from: str | None = None
    """As a device's."""
    time_s: CostCurve | None = None
    """T^m, seconds against cameras from the first photograph to the model sent, given instead of
    devices."""
    max_cameras: int | None = None
    """How many cameras its devices can hold together; only with `time_s`."""
    memory_bytes: float | None = None
    """What joining may hold; beyond it models are joined in tiles, and cut at their borders where
    no tile fits. None: a share of what its machine has free."""
    latency_s: float | None = None
    """Seconds that a message takes one way between it and a device; None: not known."""
    add_s_per_byte: float | None = None
    """Seconds for each byte that it adds up of what devices send in a step of a training together;
    None: not known."""

    def __post_init__(self) -> None:
        require_id("edge", self.id)
        _require_memory(f"edge {self.id!r}", self.memory_bytes)
        _require_times(f"edge {self.id!r}", self)
        _require_bandwidth(f"edge {self.id!r}", self.uplink_bytes_per_s)
        _require_speed(f"edge {self.id!r}", self.speed)
        for pair in (self.position, self.lat_lon_deg):
            if pair is not None and not np.isfinite(pair).all():
                raise BadInput(f"edge {self.id!r}: position {pair} is not finite: give two numbers.")
        if not self.devices and self.time_s is None:
            raise BadInput(f"edge {self.id!r} has no devices: give it at least one, or its time_s alone.")
        if self.time_s is None:
            if self.max_cameras is not None:
                raise BadInput(f"edge {self.id!r} has max_cameras and no time_s: limit its devices instead.")
        elif self.devices or self.aggregate_s != CostCurve() or self.aggregate_alone_s is not None:
            raise BadInput(f"edge {self.id!r} has time_s, its whole time, and devices or aggregate_s too: give one or the other.")
        elif self.max_cameras is not None and self.max_cameras < 0:
            raise BadInput(f"edge {self.id!r}: max_cameras is {self.max_cameras}, expected at least 0.")

    @property
    def origin(self) -> str | None:
        """As a device's."""
        return _origin(self.profile, self.costs_from)

    def aggregation_s(self, num_cameras: int, num_devices: int) -> float:
        """F_m for cameras that so many devices have."""
        joined_s = float(self.aggregate_s(num_cameras))
        return joined_s if num_devices > 1 or self.aggregate_alone_s is None else min(joined_s, float(self.aggregate_alone_s(num_cameras)))

    def with_aggregation_scaled(self, factor: float) -> Edge:
        """The same edge that aggregates `factor` times as long."""
        alone = None if self.aggregate_alone_s is None else self.aggregate_alone_s.scaled(factor)
        return replace(self, aggregate_s=self.aggregate_s.scaled(factor), aggregate_alone_s=alone)

    @property
    def workers(self) -> tuple[Device, ...]:
        """What the cost model reckons with: the devices, or one in place of unknown ones."""
        if self.time_s is None:
            return self.devices
        nothing = CostCurve()
        return (
            Device(
                id=self.id,
                init_s=nothing,
                train_s=self.time_s,
                model_bytes=nothing,
                uplink_bytes_per_s=self.uplink_bytes_per_s,
                max_cameras=self.max_cameras,
            ),
        )


@dataclass(frozen=True, kw_only=True)
class Cloud:
    """What the cloud can spend on joining the scene; None: no limit but the machine's memory.
    Beyond its memory models are joined in tiles, and cut where no tile fits or another limit is
    exceeded."""

    memory_bytes: float | None = None
    """Memory of the cloud's process."""
    time_s: float | None = None
    """Seconds of retraining."""
    max_cameras: int | None = None
    """|C_max| at the cloud: how many views it can retrain on."""
    merge_s: CostCurve | None = None
    """Seconds of joining the edges' models against the scene's cameras; None: not known. The same
    for every plan of a scene, so that no plan depends on it."""
    profile: Profile | None = None
    """What `merge_s` comes from; None where it was spelt out."""
    latency_s: float | None = None
    """Seconds that a message takes one way between it and an edge; None: not known."""
    add_s_per_byte: float | None = None
    """As an edge's."""

    def __post_init__(self) -> None:
        for name in ("memory_bytes", "time_s", "max_cameras", "latency_s", "add_s_per_byte"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value >= 0):
                raise BadInput(f"cloud: {name} is {value}, expected a finite number of at least 0, or nothing where it is not given.")


@dataclass(frozen=True, kw_only=True)
class System:
    """All edges and the cloud. BadInput without edges, or when an edge or device id comes twice."""

    edges: tuple[Edge, ...]
    cloud: Cloud = Cloud()
    training: ProfileKey | None = None
    """Which its costs hold for, where they were made of profiles; None: not said."""

    def __post_init__(self) -> None:
        if not self.edges:
            raise BadInput("the system has no edges: give it at least one.")
        for kind, ids in (("edge", [edge.id for edge in self.edges]), ("device", [d.id for d in self.devices])):
            twice = sorted(name for name, count in Counter(ids).items() if count > 1)
            if twice:
                raise BadInput(f"{kind} id {twice[0]!r} comes twice: ids name folders and must differ.")

    def __repr__(self) -> str:
        return f"System({len(self.edges)} edges: {', '.join(f'{edge.id} with {len(edge.devices)} devices' for edge in self.edges)})"

    @property
    def devices(self) -> tuple[Device, ...]:
        """Devices of all edges in order."""
        return tuple(device for edge in self.edges for device in edge.devices)

    @property
    def workers(self) -> tuple[Device, ...]:
        """Workers of all edges in order."""
        return tuple(worker for edge in self.edges for worker in edge.workers)

    def with_uploads_of(self, factor: float) -> System:
        """The same system with models that are uploaded in `factor` times their bytes."""

        def resized(edge: Edge) -> Edge:
            return replace(edge, devices=tuple(replace(d, model_bytes=d.model_bytes.scaled(factor)) for d in edge.devices))

        return replace(self, edges=tuple(resized(edge) for edge in self.edges))


def _origin(profile: Profile | None, costs_from: str | None) -> str | None:
    return costs_from if profile is None else f"{profile.kind} {profile.name}"


def require_id(kind: str, name: str) -> None:
    """Raise BadInput where the id of a machine of this kind is no name for a folder."""
    if not _ID.fullmatch(name):
        raise BadInput(f"{kind} id {name!r} cannot name a folder: use up to 64 letters, digits, '-' and '_'.")


def _require_bandwidth(owner: str, value: float) -> None:
    if not np.isfinite(value) or value <= 0:
        raise BadInput(f"{owner}: uplink_bytes_per_s is {value}, expected a positive number of bytes per second.")


def _require_memory(owner: str, value: float | None) -> None:
    if value is not None and not 0 < value < np.inf:
        raise BadInput(f"{owner}: memory_bytes is {value}, expected a positive number.")


def _require_times(owner: str, edge: Edge) -> None:
    for name in ("latency_s", "add_s_per_byte"):
        value = getattr(edge, name)
        if value is not None and not 0 <= value < np.inf:
            raise BadInput(f"{owner}: {name} is {value}, expected a finite number of seconds, at least 0.")


def _require_speed(owner: str, value: float | None) -> None:
    if value is not None and not 0 < value <= 1:
        raise BadInput(f"{owner}: speed is {value}, expected more than 0 and at most 1, a share of one core.")
