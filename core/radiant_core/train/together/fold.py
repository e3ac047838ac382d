"""A group in one process: the oracle of every way to run one on several machines.

The messages are those that travel, in the order in which they do. All replicas have the same bits,
so that holders share the model of one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_core.train.results import TrainResult
from radiant_core.train.together.replica import Group, Replica
from radiant_core.train.together.roles import Holder, Relay, Root
from radiant_core.train.trainer import FitOptions


@dataclass(kw_only=True)
class GroupCost:
    """What the steps of a group took: seconds and bytes of each step by machine."""

    contribute_s: dict[str, list[float]] = field(default_factory=dict)
    """A holder renders and encodes."""
    sum_s: dict[str, list[float]] = field(default_factory=dict)
    """An edge, or the root, decodes, sums and encodes."""
    take_s: list[float] = field(default_factory=list)
    """A replica decodes the total and takes the step."""
    bytes_up: dict[str, list[int]] = field(default_factory=dict)
    """Of holders and edges."""
    bytes_down: list[int] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    """What machines that sum noticed of their senders."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GroupMembers:
    """The machines of a group."""

    holders: Mapping[str, Holder]
    edges: Mapping[str, Mapping[str, int]]
    """Edge → holder → its views of a step."""
    has_relays: bool
    """Whether edges sum for a root above them."""


def fit_in_process(
    initial: Splats,
    group: Group,
    members: GroupMembers,
    camera_centers: FloatArray,
    options: FitOptions,
    clock: Callable[[], float] = lambda: 0.0,
) -> tuple[TrainResult, GroupCost]:
    """Train a model of all shares.

    Args:
        initial: the first Gaussians.
        group: settings of the training.
        members: its machines; holders end as they are after the last step but one.
        camera_centers: (C,3) of all photographs.
        options: renderer and progress.
        clock: seconds, by which steps are timed.

    Returns:
        The result, and what its steps took.
    """
    holders, top = members.holders, Replica(initial, group, options)
    relays = {edge: Relay(views, top.layout, group) for edge, views in members.edges.items()}
    for relay in relays.values():
        relay.begin(0, len(initial))
    of_edges = {edge: sum(views.values()) for edge, views in members.edges.items()}
    of_root = of_edges if members.has_relays else {name: views for shares in members.edges.values() for name, views in shares.items()}
    root = Root(top, of_root, camera_centers, group, sums_edges=members.has_relays)
    cost, waiting = GroupCost(), list[bytes]()

    def timed(where: list[float], work: Callable[[], bytes]) -> bytes:
        begun_s = clock()
        message = work()
        where.append(clock() - begun_s)
        return message

    def take_waiting() -> None:
        begun_s = clock()
        first, *others = holders.values()
        first.take(waiting[0])
        for holder in others:
            holder.follow(first)
        cost.take_s.append(clock() - begun_s)
        waiting.clear()

    while not top.is_done:
        if waiting and next(iter(holders.values())).waits_for_total:
            take_waiting()
        sent = {name: timed(cost.contribute_s.setdefault(name, []), holder.message) for name, holder in holders.items()}
        if waiting:
            take_waiting()
        for name, message in sent.items():
            cost.bytes_up.setdefault(name, []).append(len(message))
        if members.has_relays:
            parts = {edge: {name: sent[name] for name in names} for edge, names in members.edges.items()}
            sent = {edge: timed(cost.sum_s.setdefault(edge, []), partial(relays[edge].message, parts[edge])) for edge in parts}
            for edge, message in sent.items():
                cost.bytes_up.setdefault(edge, []).append(len(message) + len(relays[edge].state()))
                cost.warnings += relays[edge].inbox.take_warnings()
        begun_s = clock()
        message, total = root.total(sent)
        cost.sum_s.setdefault("root", []).append(clock() - begun_s)
        cost.bytes_down.append(len(message))
        cost.warnings += root.inbox.take_warnings()
        for relay in relays.values():
            relay.follow(message)
        root.take(total)
        waiting.append(message)
    return root.result(), cost


def step_s(cost: GroupCost, *, overlaps: bool) -> float:
    """Mean seconds of a step with all machines at once, without links."""

    def slowest(names: Sequence[str], seconds: Mapping[str, list[float]]) -> np.ndarray:
        return np.max([seconds[name] for name in names], axis=0) if names else np.zeros(len(cost.take_s))

    count = len(cost.take_s)
    holders = slowest(list(cost.contribute_s), cost.contribute_s)[:count] + np.array(cost.take_s)
    sums = slowest([name for name in cost.sum_s if name != "root"], {k: v[:count] for k, v in cost.sum_s.items()})
    sums = sums + np.array(cost.sum_s["root"][:count])
    return float(np.mean(np.maximum(holders, sums) if overlaps else holders + sums))
