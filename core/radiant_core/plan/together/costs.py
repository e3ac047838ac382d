"""What training together costs: the bytes and seconds of a step, and of all of them.

    rows(k)  = N · (1 − (1 − v)^k),   v = min(1, 16 / C)     Gaussians that k of C photographs show
    up_d     = row_bytes · rows(views_d)         device d → edge, in every step; under masks
               4 (floats + 2) · N
    down     = row_bytes · rows(V)               edge → device: what all have sent, added up
    at edge  = max_d (views_d · view_s_d + up_d / B_d) + latency + add · Σ_d up_d
    whole    = at edge + latency + max_d down / B_d                          a group of one edge
    whole    = max_e (at edge_e + up_e / B_e + latency_c) + add · Σ_e up_e
               + max_e (latency_c + down / B_e + latency_e + max_d down / B_d)     of all edges
    views    = max_d views_d · view_s_d,   exchange = whole − views
    step_s   = whole, and max(views, exchange) where exchange > views / 2: they overlap

    seconds  = start + views / V · step_s + end
    start    = max_d (G_d + H / B_d) + 2 latencies     sparse points up, the first model down
    end      = F alone + H / B_e                       of one edge, whose model the cloud joins

N Gaussians and H bytes of a model of all C photographs of the group, V views a step. A device
renders views of the whole group's model: view_s_d is F_d(C) over the steps that F holds for. What
a step costs once, the optimiser's part, is counted for every view, which is on the safe side. A
link is as fast down as up, and the edge's own takes all devices at once. Rows were counted by the
sparse points in each frustum: a photograph of 53 to 75 shows those of 15 to 17, of 12 or 18 those
of 6, and k at random show what is stated within a tenth (town, caliterra, lewis, brighton, hamlet).
Once per edge and plan, O(D).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.plan.system import Cloud, Device, Edge

SHOWN_LIKE = 16.0
"""Photographs that show as many Gaussians as there are, in views without overlap: what v is."""
LATENCY_S = 0.001
"""One way over a link whose latency nobody measured: a wired local network."""
ADD_S_PER_BYTE = 2e-9
"""Of adding what one child sent, where nobody measured it: 1.4 to 2.2 ms a megabyte by
`radiant machine profile` on two cores."""
BESIDE_BYTES = 10
"""Bytes of a row beside its gradients: exponents of their blocks, its statistics of density, and
its share of the bits that say which rows are sent."""
OVERLAPPED_FROM = 0.5
"""An exchange that lasts longer than so many times its views is overlapped with the next ones,
whose gradients are then of the model one step before: 0.1 to 0.2 dB less
(docs/experiments/together.md)."""


@dataclass(frozen=True, kw_only=True)
class TogetherLaw:
    """What is known of the training. Raises BadInput for a number that is not positive."""

    views_per_photograph: float
    """Views of one machine's training, for each photograph."""
    steps_of: Callable[[float], float]
    """Steps for which the devices' curves F hold, against photographs."""
    num_floats: int
    """Floats of a Gaussian: 23 with harmonics of degree 1."""
    splat_bytes: float
    """Bytes of a Gaussian in the devices' curves H."""
    max_num_splats: int | None = None
    """Limit of a model's Gaussians; None: there is none."""
    masked: bool = False
    """Whether devices add masks to what they send: all Gaussians then, 32 bits a number."""
    view_s: float | None = None
    """Estimated seconds of a view, where the devices' curves are nobody's; None: by their curves.
    Links alone decide then."""

    def __post_init__(self) -> None:
        for name in ("views_per_photograph", "num_floats", "splat_bytes", "max_num_splats", "view_s"):
            value = getattr(self, name)
            if value is not None and not 0 < value < inf:
                raise BadInput(f"the law of training together has {name} {value}, expected a positive number.")

    @property
    def row_bytes(self) -> float:
        """Bytes of a Gaussian in what is sent in a step: 8 bits a float."""
        return float(self.num_floats + BESIDE_BYTES)

    def sent_bytes(self, num_splats: float, num_views: int, num_photographs: int) -> float:
        """Of a device for so many views of a step."""
        if self.masked:
            return 4.0 * (self.num_floats + 2) * num_splats
        return self.row_bytes * num_splats * shown_share(num_views, num_photographs)

    def num_splats(self, devices: Sequence[Device], num_photographs: int) -> float:
        """N: Gaussians of a model of so many photographs, the most that a curve has."""
        most = max((float(device.model_bytes(num_photographs)) for device in devices), default=0.0) / self.splat_bytes
        return most if self.max_num_splats is None else min(most, float(self.max_num_splats))

    def device_view_s(self, device: Device, num_photographs: int) -> float:
        """Seconds of a view of the whole group's model on a device."""
        if self.view_s is not None:
            return self.view_s
        return float(device.train_s(num_photographs)) / self.steps_of(num_photographs)


@dataclass(frozen=True, kw_only=True)
class StepCost:
    """A step, and what it is made of."""

    seconds: float
    views_s: float
    """Of rendering, on the device that takes longest."""
    up_bytes: float
    """Of the device that sends most."""
    down_bytes: float
    """To each device."""

    @property
    def exchange_s(self) -> float:
        """All but the views."""
        return self.seconds - self.views_s

    @property
    def overlaps(self) -> bool:
        """Whether views are rendered while the sum of the step before is on its way."""
        return self.exchange_s > OVERLAPPED_FROM * self.views_s

    @property
    def step_s(self) -> float:
        """From one step to the next."""
        return max(self.views_s, self.exchange_s) if self.overlaps else self.seconds


@dataclass(frozen=True, kw_only=True)
class _AtEdge:
    """What an edge and its devices add to a step."""

    up_s: float
    """From the start of a step until what they sent is added up."""
    device_down_s: float
    """From the edge's answer until the last device has it."""
    rows: float


def shown_share(num_views: int, num_photographs: int) -> float:
    """Share of a scene's Gaussians that so many of its photographs show, drawn at random."""
    return 1.0 - (1.0 - min(1.0, SHOWN_LIKE / num_photographs)) ** num_views


def step_cost(edges: Sequence[Edge], cloud: Cloud | None, views: Mapping[str, int], num_photographs: int, law: TogetherLaw) -> StepCost:
    """The cost of a step with these views of each device, of a group of one edge, or of edges whose
    sums `cloud` adds up; edges without a device in `views` take no part.

    Raises BadInput where no device has views, and for several edges without a cloud.
    """
    working = [edge for edge in edges if any(device.id in views for device in edge.devices)]
    if not working or num_photographs < 1:
        raise BadInput(f"a step of {sum(views.values())} views of {num_photographs} photographs has nobody to train: name its devices.")
    if cloud is None and len(working) > 1:
        raise BadInput(f"a step of {len(working)} edges has nobody to add up what they send: give the cloud.")
    devices = [device for edge in working for device in edge.devices if device.id in views]
    num_splats = law.num_splats(devices, num_photographs)
    down_bytes = law.row_bytes * num_splats * shown_share(sum(views.values()), num_photographs)
    parts = [_at_edge(edge, views, num_photographs, law, (num_splats, down_bytes)) for edge in working]
    if cloud is None:
        seconds = parts[0].up_s + parts[0].device_down_s
    else:
        latency_s = latency_of(cloud)
        up_s = max(part.up_s + part.rows / edge.uplink_bytes_per_s for edge, part in zip(working, parts, strict=True))
        down_s = max(part.device_down_s + down_bytes / edge.uplink_bytes_per_s for edge, part in zip(working, parts, strict=True))
        seconds = up_s + adding_of(cloud) * sum(part.rows for part in parts) + down_s + 2 * latency_s
    return StepCost(
        seconds=seconds,
        views_s=max(views[device.id] * law.device_view_s(device, num_photographs) for device in devices),
        up_bytes=law.sent_bytes(num_splats, max(views.values()), num_photographs),
        down_bytes=down_bytes,
    )


def _at_edge(edge: Edge, views: Mapping[str, int], num_photographs: int, law: TogetherLaw, splats_and_down: tuple[float, float]) -> _AtEdge:
    num_splats, down_bytes = splats_and_down
    latency_s, sent, ready_s, down_s = latency_of(edge), 0.0, 0.0, 0.0
    devices = [device for device in edge.devices if device.id in views]
    for device in devices:
        up_bytes = law.sent_bytes(num_splats, views[device.id], num_photographs)
        sent += up_bytes
        rendered_s = views[device.id] * law.device_view_s(device, num_photographs)
        ready_s = max(ready_s, rendered_s + up_bytes / device.uplink_bytes_per_s)
        down_s = max(down_s, down_bytes / device.uplink_bytes_per_s)
    of_edge = law.row_bytes * num_splats * shown_share(sum(views[device.id] for device in devices), num_photographs)
    return _AtEdge(up_s=ready_s + latency_s + adding_of(edge) * sent, device_down_s=latency_s + down_s, rows=of_edge)


def start_cost(edges: Sequence[Edge], cloud: Cloud | None, shares: Mapping[str, float], num_photographs: int) -> float:
    """Seconds before the first step, of devices that have `shares` of the photographs: each is
    ready, its sparse points are up and the first model is down, no larger than the last."""
    started_s = 0.0
    for edge in edges:
        for device in edge.devices:
            if device.id in shares:
                count = max(1.0, shares[device.id] * num_photographs)
                link_s = float(device.model_bytes(num_photographs)) / device.uplink_bytes_per_s
                started_s = max(started_s, float(device.init_s(count)) + link_s + 2 * latency_of(edge))
    if cloud is None:
        return started_s
    return started_s + 2 * latency_of(cloud) + max(_model_bytes(edges, num_photographs) / edge.uplink_bytes_per_s for edge in edges)


def end_cost(edge: Edge, num_photographs: int) -> float:
    """Seconds from a group's last step until the model of its edge is at the cloud."""
    return edge.aggregation_s(num_photographs, 1) + _model_bytes([edge], num_photographs) / edge.uplink_bytes_per_s


def latency_of(machine: Edge | Cloud) -> float:
    """Seconds one way between a machine and those below it, by default `LATENCY_S`."""
    return LATENCY_S if machine.latency_s is None else machine.latency_s


def adding_of(machine: Edge | Cloud) -> float:
    """Seconds for each byte that it adds up, by default `ADD_S_PER_BYTE`."""
    return ADD_S_PER_BYTE if machine.add_s_per_byte is None else machine.add_s_per_byte


def _model_bytes(edges: Sequence[Edge], num_photographs: int) -> float:
    return float(np.max([device.model_bytes(num_photographs) for edge in edges for device in edge.devices]))
