"""When a scene would be done over links of given bandwidth: of trees, and of groups step by step.

A step of a group, k its devices, e its edges (without any the root sums for the devices):

    at e        max_k (sent_k + bytes_k / B + L)
    at root     max_e (at e + sum_e / v_e + bytes_e / B + L), then sum_root
    at k        at root + (bytes / B + L) for each level, then take / v_k, then contribute / v_k

v are speeds, B the bandwidth of every link, L its latency. A device contributes to a step when it
has taken the one before or, where it renders meanwhile (`overlaps`) and that one moves no rows, the
one before that. Before the first step stands the slowest device's preparation, what it sends, the
root's start and that on its way down. What a tree sends has no latency: it sends a few times. Once
per row of a benchmark.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.methods.emulated_latency import CLOUD_SPEED, NodeWork, emulate_server, emulate_tree
from radiant_core.hierarchy.group_in_process import GroupRun
from radiant_core.numerics import FloatArray
from radiant_core.plan.system import System
from radiant_core.train.densify.policies import NoDensification


@dataclass(frozen=True, kw_only=True)
class Link:
    """Between devices and edges, and between edges and the cloud."""

    bits_per_s: float
    latency_s: float = 1e-3

    def spent_s(self, num_bytes: ArrayLike) -> FloatArray:
        """Seconds until so many bytes are there."""
        return 8 * np.asarray(num_bytes, float) / self.bits_per_s + self.latency_s

    def __str__(self) -> str:
        return f"{self.bits_per_s / 1e9:g} Gbit/s" if self.bits_per_s >= 1e9 else f"{self.bits_per_s / 1e6:g} Mbit/s"


LINKS = (Link(bits_per_s=20e6), Link(bits_per_s=100e6), Link(bits_per_s=1e9))


@dataclass(frozen=True, kw_only=True)
class LinkTime:
    """Seconds until the scene is done with links of that bandwidth, all nodes at once."""

    link: str
    scene_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class GroupWork:
    """CPU seconds and bytes of a group: arrays have an entry per step (S,)."""

    edges: Mapping[str, Sequence[str]]
    """Edge → devices."""
    has_relays: bool
    """Whether edges sum for the cloud."""
    overlaps: bool
    prepare_s: Mapping[str, float]
    """Of devices before the first step, most of it before they send their start."""
    begin_s: float
    """Of the root."""
    start_bytes: Mapping[str, int]
    """Sent by each device before the first step."""
    initial_bytes: int
    """What the root answers."""
    contribute_s: Mapping[str, FloatArray]
    sum_s: Mapping[str, FloatArray]
    """Of edges, and of "root"."""
    take_s: FloatArray
    bytes_up: Mapping[str, FloatArray]
    bytes_down: FloatArray
    edits_every: int = 0
    """Every so many steps Gaussians are added or removed; 0: never."""


def work_of(run: GroupRun) -> GroupWork:
    """What a group that was trained in this process took."""
    cost, devices = run.cost, run.plan.of_devices
    steps = min(len(cost.take_s), len(cost.bytes_down))
    array = {
        name: {k: np.array(v[:steps], float) for k, v in getattr(cost, name).items()} for name in ("contribute_s", "sum_s", "bytes_up")
    }
    starts = {device: _start_bytes(run, device) for device in devices if device in run.starts}
    density = run.start.group.stepping.density
    return GroupWork(
        edits_every=0 if isinstance(density, NoDensification) else density.every,
        edges={edge: tuple(views) for edge, views in run.plan.views.items()},
        has_relays=run.plan.has_relays,
        overlaps=run.plan.overlaps,
        prepare_s={device: run.before_s[device] for device in devices},
        begin_s=run.before_s[run.plan.root],
        start_bytes=starts,
        initial_bytes=run.start.initial.num_bytes,
        take_s=np.array(cost.take_s[:steps]),
        bytes_down=np.array(cost.bytes_down[:steps], float),
        **array,
    )


def _start_bytes(run: GroupRun, device: str) -> int:
    start = run.starts[device]
    cameras = start.cameras
    arrays = (start.points, start.colors, start.logs.points, start.logs.logs, cameras.Ks, cameras.cam_from_world)
    return sum(array.nbytes for array in arrays)


def group_s(work: GroupWork, speeds: Mapping[str, float], link: Link) -> float:
    """Seconds until the group's root has its model; `speeds` of devices and edges by their id, 1
    where there is none."""
    root_speed = CLOUD_SPEED if work.has_relays else speeds.get(next(iter(work.edges)), 1.0)
    speed = {name: speeds.get(name, 1.0) for devices in work.edges.values() for name in devices}
    levels = 1 + work.has_relays
    free_s, num_taken = dict.fromkeys(speed, 0.0), 0
    down_s: list[float] = []
    root_s = 0.0
    for step in range(len(work.bytes_down)):
        while num_taken < step - (work.overlaps and not _edits(work, step - 1)):
            take_s, there_s = work.take_s[num_taken], down_s[num_taken]
            free_s = {name: max(at_s, there_s) + take_s / speed[name] for name, at_s in free_s.items()}
            num_taken += 1
        free_s = {name: at_s + work.contribute_s[name][step] / speed[name] for name, at_s in free_s.items()}
        root_s = max(root_s, _at_root_s(work, step, free_s, speeds, link)) + work.sum_s["root"][step] / root_speed
        down_s.append(root_s + levels * float(link.spent_s(work.bytes_down[step])))
    last_s = root_s + work.take_s[-1] / root_speed if len(work.take_s) else 0.0
    return _before_s(work, speed, link, root_speed) + last_s


def _edits(work: GroupWork, step: int) -> bool:
    """Whether taking a step (from 0) adds or removes Gaussians."""
    return work.edits_every > 0 and (step + 1) % work.edits_every == 0


def _at_root_s(work: GroupWork, step: int, sent_s: Mapping[str, float], speeds: Mapping[str, float], link: Link) -> float:
    """When all messages of a step are at the root, from when each device sends its own."""
    at_root = []
    for edge, devices in work.edges.items():
        there = max(sent_s[name] + float(link.spent_s(work.bytes_up[name][step])) for name in devices)
        if work.has_relays:
            there += work.sum_s[edge][step] / speeds.get(edge, 1.0) + float(link.spent_s(work.bytes_up[edge][step]))
        at_root.append(there)
    return max(at_root)


def _before_s(work: GroupWork, speed: Mapping[str, float], link: Link, root_speed: float) -> float:
    """Seconds until all devices have the first Gaussians."""
    at_root = []
    for devices in work.edges.values():
        there = max(work.prepare_s[name] / speed[name] + float(link.spent_s(work.start_bytes.get(name, 0))) for name in devices)
        if work.has_relays:
            there += float(link.spent_s(sum(work.start_bytes.get(name, 0) for name in devices)))
        at_root.append(there)
    return max(at_root) + work.begin_s / root_speed + (1 + work.has_relays) * float(link.spent_s(work.initial_bytes))


def scene_times(
    system: System, nodes: Sequence[NodeWork], groups: Mapping[str, GroupWork], links: Sequence[Link] = LINKS
) -> tuple[LinkTime, ...]:
    """When the scene is done at each of the links; empty where no node made it.

    Args:
        system: speeds, 1 where there is none; its own links do not count.
        nodes: what is done beside groups; of an edge that is the root of one, what it sends.
        groups: by root.
    """
    return tuple(LinkTime(link=str(link), scene_s=_scene_s(system, nodes, groups, link)) for link in links if nodes or groups)


def _scene_s(system: System, nodes: Sequence[NodeWork], groups: Mapping[str, GroupWork], link: Link) -> float:
    speeds = {node.id: node.speed or 1.0 for node in (*system.edges, *system.devices)}
    if (whole := groups.get("cloud")) is not None:
        return group_s(whole, speeds, link)
    linked = _linked(system, link)
    trained_s = {root: group_s(work, speeds, link) for root, work in groups.items()}
    works = [
        replace(node, cpu_s=trained_s[node.stage] * speeds[node.stage.removeprefix("edges/")]) if node.stage in trained_s else node
        for node in nodes
    ]
    has_tiers = any(node.stage == "cloud" for node in works)
    return (emulate_tree if has_tiers else emulate_server)(linked, works).scene_s


def _linked(system: System, link: Link) -> System:
    """The system with that link everywhere."""
    uplink = {"uplink_bytes_per_s": link.bits_per_s / 8}
    edges = []
    for edge in system.edges:
        devices = tuple(replace(device, speed=device.speed or 1.0, **uplink) for device in edge.devices)
        edges.append(replace(edge, speed=edge.speed or 1.0, devices=devices, **uplink))
    return replace(system, edges=tuple(edges))
