"""When a scene would be done on machines of given speeds behind given links, from measured work.

    device   done when its work and its model's bytes are:  cpu / speed + bytes / uplink
    edge     begins when its last device's model is there, done as a device
    cloud    begins when the last edge's model is there:    cpu / CLOUD_SPEED
    refine   the same once more per round, from the scene on; sending the scene down is not counted,
             since a system knows uplinks alone
    compare  then every device says how good the versions of the scene are in what it holds out
    server   takes clients in order, each when its model is there and the one before is taken in

cpu are the CPU seconds of a node's process on this machine, never wall time: other work beside it
does not lengthen them by its turns on a core, though it may by the caches that they share. Speeds
are shares of a core, as `radiant run --emulate` plays them in wall time. Once per model.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count

from radiant_core.aggregate.tree import refined_at, refines_for, scored_at
from radiant_core.errors import BadInput
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.plan.system import Device, Edge, System

CLOUD_SPEED = 1.0
"""As of an edge: the paper names its cloud without its speed."""


@dataclass(frozen=True, kw_only=True)
class NodeWork:
    """CPU seconds of a node on this machine, and the bytes it sent up."""

    stage: str
    """devices/NAME, edges/NAME, cloud, or cloud/NAME for what a server does about one client."""
    cpu_s: float
    sent_bytes: int = 0


@dataclass(frozen=True, kw_only=True)
class EmulatedLatency:
    """Seconds since the devices began."""

    edge_s: tuple[float, ...]
    """When each edge's model is at the cloud, in the order of the system; 0 for one without
    photographs. Empty for a server, which has no edges."""
    devices_s: float
    """When the last device of the edge that is last had sent; of a server, when the second client
    had, so that merging began."""
    joined_s: float
    """When the scene was joined."""
    scene_s: float
    """When the scene was done: refined and compared, where it is."""


@dataclass(frozen=True, kw_only=True)
class NodeClock:
    """CPU seconds of nodes that run one after another in this process: each from its reporter's
    making to the next one's, with the writing and reading of what it sends."""

    begun: list[tuple[str, float]] = field(default_factory=list)

    def reporter_of(self, stage: str) -> Recorder:
        """A node begins."""
        self.begun.append((stage, time.process_time()))
        return Recorder(stage=stage)

    def seconds(self) -> dict[str, float]:
        """By stage; the last one ends now."""
        ends_s = [*(begun_s for _, begun_s in self.begun[1:]), time.process_time()]
        return {stage: end_s - begun_s for (stage, begun_s), end_s in zip(self.begun, ends_s, strict=True)}


def emulate_tree(system: System, works: Sequence[NodeWork]) -> EmulatedLatency:
    """Devices, edges and the cloud, of which those without work had nothing to do."""
    work_of = {work.stage: work for work in works}
    edge_s, ready_s = [], []
    for edge in system.edges:
        sent_s = [_spent_s(device, work_of[stage]) for device in edge.devices if (stage := f"devices/{device.id}") in work_of]
        ready_s.append(max(sent_s, default=0.0))
        work = work_of.get(f"edges/{edge.id}")
        edge_s.append(0.0 if work is None else ready_s[-1] + _spent_s(edge, work))
    last = max(range(len(edge_s)), key=lambda index: edge_s[index])
    joined_s = edge_s[last] + work_of["cloud"].cpu_s / CLOUD_SPEED
    scene_s = joined_s + _compared_s(system, work_of)
    for number in count(1):
        if refined_at("cloud", number) not in work_of:
            break
        scene_s += _round_s(system, work_of, number)
    return EmulatedLatency(edge_s=tuple(edge_s), devices_s=ready_s[last], joined_s=joined_s, scene_s=scene_s)


def _round_s(system: System, work_of: Mapping[str, NodeWork], number: int) -> float:
    """How long a round of refining the scene takes, from its sending on."""

    def part_s(machine: Device | Edge, node: str) -> float:
        work = work_of.get(refined_at(node, number))
        return 0.0 if work is None else _spent_s(machine, work)

    edges_s = [
        max((part_s(device, f"devices/{device.id}") for device in edge.devices), default=0.0) + part_s(edge, f"edges/{edge.id}")
        for edge in system.edges
    ]
    return max(edges_s, default=0.0) + work_of[refined_at("cloud", number)].cpu_s / CLOUD_SPEED


def _compared_s(system: System, work_of: Mapping[str, NodeWork]) -> float:
    """How long devices take to compare versions of the scene; 0 where there is one."""
    works = ((device, work_of.get(scored_at(f"devices/{device.id}"))) for device in system.devices)
    return max((_spent_s(device, work) for device, work in works if work is not None), default=0.0)


def joining_s(works: Sequence[NodeWork]) -> float:
    """Processor seconds from the devices' models to the done scene, if every node had a core of its
    own and links took no time: of each tier and round its slowest node, one after another."""
    slowest: dict[tuple[str, str], float] = {}
    for work in works:
        node = refines_for(work.stage).removesuffix(scored_at(""))
        step = (node.split("/", 1)[0], work.stage.removeprefix(node))
        if step != ("devices", ""):
            slowest[step] = max(slowest.get(step, 0.0), work.cpu_s)
    return sum(slowest.values())


def emulate_server(system: System, works: Sequence[NodeWork]) -> EmulatedLatency:
    """Devices that send to one server, which takes them in as their `cloud/NAME` are ordered."""
    machines = {f"devices/{device.id}": device for device in system.devices}
    sent_s = {work.stage.removeprefix("devices/"): _spent_s(machines[work.stage], work) for work in works if work.stage in machines}
    merges = [(work.stage.removeprefix("cloud/"), work.cpu_s) for work in works if work.stage.startswith("cloud/")]
    now_s = 0.0
    for name, cpu_s in merges:
        now_s = max(now_s, sent_s[name]) + cpu_s / CLOUD_SPEED
    return EmulatedLatency(edge_s=(), devices_s=max((sent_s[name] for name, _ in merges[:2]), default=0.0), joined_s=now_s, scene_s=now_s)


def _spent_s(machine: Device | Edge, work: NodeWork) -> float:
    if machine.speed is None:
        raise BadInput(f"{machine.id!r} has no speed to emulate: add speed = 0.5, its share of a core, to the system file.")
    return work.cpu_s / machine.speed + work.sent_bytes / machine.uplink_bytes_per_s
