"""Where Ray runs a node: machines that can, its threads there, and the placement group of a gang.

Members of a gang run at the same time, so all their places are reserved at once, as a placement
group: a bundle for each, spread over the machines.

    devices   the threads that a device has anyhow; where its machines have fewer CPUs than devices
              of the gang, an even part of a CPU, so that the gang fits in
    others    mostly wait for the devices, so they reserve no CPU: only their machine, where one is
              named as their place, else they join their first device
    again     a member that is started again takes its bundle. Where the machine of that is gone
              and Ray has no other for it, it reserves nothing and starts anywhere: its gang waits
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import ray
from ray.util.placement_group import PlacementGroup, placement_group, placement_group_table, remove_placement_group
from ray.util.scheduling_strategies import PlacementGroupSchedulingStrategy

PLACE_SHARE = 0.001
"""Amount of its machine's resource that a task takes: it only places the task, CPUs limit it."""
AMOUNTS = {"CPU", "GPU"}
PRECISION = 10_000
"""Ray counts in parts of so many of a CPU or GPU."""


def living_machines() -> list[dict[str, Any]]:
    """What Ray says of each machine that is alive."""
    return [machine for machine in ray.nodes() if machine["Alive"]]


def find_machines(place: str, gpu: bool) -> list[dict[str, Any]]:
    """Living machines that can run a node: those named as its place, or all where none is. With
    `gpu` those with one; a machine named for the node runs it without, too."""
    able = [machine for machine in living_machines() if offers(machine, {"CPU": 1})]
    named = [machine for machine in able if offers(machine, {place: PLACE_SHARE})]
    if not gpu:
        return named or able
    return have_gpus(named) or named or have_gpus(able)


def have_gpus(machines: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Those machines that have a GPU."""
    return [machine for machine in machines if offers(machine, {"GPU": 1})]


def offers(machine: dict[str, Any], wanted: Mapping[str, float]) -> bool:
    """Whether a machine has as much in all, free or not."""
    return all(machine["Resources"].get(name, 0) >= amount for name, amount in wanted.items())


def num_threads(fit: Sequence[dict[str, Any]], leaves: Sequence[str]) -> int:
    """Threads of a node on any of these machines: its CPUs over the leaves that may run there."""
    return max(1, int(min((machine["Resources"]["CPU"] // num_at([machine], leaves) for machine in fit), default=1)))


def num_at(fit: Sequence[dict[str, Any]], places: Sequence[str]) -> int:
    """The most nodes of these places that may run on one of the machines: those of its own place,
    and an even part of those whose place no machine has; at least 1."""
    machines = living_machines()
    named = {name for machine in machines for name in machine["Resources"]}
    anywhere = sum(place not in named for place in places) / max(1, len(machines))
    counts = [math.ceil(anywhere + sum(place in machine["Resources"] for place in places)) for machine in fit]
    return max([1, *counts])


@dataclass(kw_only=True)
class Gang:
    """The placement group of nodes that run at the same time."""

    bundles: Mapping[str, Mapping[str, float]]
    """Node → what is reserved for it; empty for one that joins another's place."""
    indices: Mapping[str, int]
    """Node → its bundle, or that which it joins."""
    group: PlacementGroup | None
    """None: no more, or no machine could run any member."""
    began: bool = False
    """Whether a member has begun, so that the group was placed."""

    @classmethod
    def open(cls, members: Sequence[Mapping[str, Any]], leaves: Sequence[str]) -> Gang:
        """Reserve the places of members: node, place, gpu, whether it computes, and else near which
        member it belongs. `leaves` are the places of all leaves of the tree. Tasks of a group wait
        until it is placed."""
        places = [member["place"] for member in members if member["computes"]]
        bundles = {member["node"]: _bundle_of(member, places, leaves) for member in members}
        # Those that only one machine can take come first.
        reserved = sorted((node for node, bundle in bundles.items() if bundle), key=lambda node: bundles[node].keys() <= AMOUNTS)
        index = {node: number for number, node in enumerate(reserved)}
        indices = {member["node"]: index.get(member["node"], index.get(member["near"], 0)) for member in members}
        group = placement_group([dict(bundles[node]) for node in reserved], strategy="SPREAD") if reserved else None
        return cls(bundles=bundles, indices=indices, group=group)

    def place(self, node: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """Amounts that a member's task takes, and the options that place it into its bundle; none
        where that is gone."""
        bundle = self.bundles[node]
        if self.group is None or self.is_gone(node):
            return {"cpus": 0, "gpus": bundle.get("GPU", 0)}, {}
        resources = {name: amount for name, amount in bundle.items() if name not in AMOUNTS}
        strategy = PlacementGroupSchedulingStrategy(self.group, placement_group_bundle_index=self.indices[node])
        return {"cpus": bundle.get("CPU", 0), "gpus": bundle.get("GPU", 0), "resources": resources}, {"scheduling_strategy": strategy}

    def is_gone(self, node: str) -> bool:
        """Whether the bundle of a member was placed on a machine that is lost, and has no other."""
        if self.group is None or not self.began:
            return False
        table: Any = placement_group_table(self.group)
        machine = table["bundles_to_node_id"].get(self.indices[node])
        return all(living["NodeID"] != machine for living in living_machines())

    def close(self) -> None:
        """Free the places; nothing where that is done."""
        if self.group is not None:
            remove_placement_group(self.group)
            self.group = None


def _bundle_of(member: Mapping[str, Any], places: Sequence[str], leaves: Sequence[str]) -> dict[str, float]:
    """What a member reserves; `places` are those of the members that compute."""
    fit = find_machines(member["place"], member["gpu"] and member["computes"])
    bundle: dict[str, float] = {}
    if fit and member["place"] in fit[0]["Resources"]:
        bundle[member["place"]] = PLACE_SHARE
    if fit and member["computes"]:
        bundle["CPU"] = min(num_threads(fit, leaves), _even_part("CPU", fit, places))
        if member["gpu"] and have_gpus(fit):
            bundle["GPU"] = min(1.0, _even_part("GPU", fit, places))
    return bundle


def _even_part(name: str, fit: Sequence[dict[str, Any]], places: Sequence[str]) -> float:
    """The even part of a resource for one of those at `places`: a whole number, or less than 1."""
    part = min(machine["Resources"][name] / num_at([machine], places) for machine in fit)
    return float(math.floor(part)) if part >= 1 else max(1, math.floor(part * PRECISION)) / PRECISION
