"""`Tree`: the whole computation, cloud over edges over devices, folded from the leaves up. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

from radiant_core.plan.plans import CloudPlan, EdgePlan

Result = TypeVar("Result")
Tier = Literal["cloud", "edge", "device"]
REFINE = "refine"
_ROUND = re.compile(rf"(cloud|[^/]+/[^/]+)/{REFINE}\d*")


@dataclass(frozen=True, kw_only=True)
class Tree:
    """A node and its children; `id` is its folder's path in a run, such as "devices/north-1"."""

    id: str
    tier: Tier
    children: tuple[Tree, ...] = ()

    def __iter__(self) -> Iterator[Tree]:
        """All nodes, every child before its parent."""
        for child in self.children:
            yield from child
        yield self

    @property
    def name(self) -> str:
        """The last part of the id: that of the device or edge."""
        return self.id.rsplit("/", 1)[-1]

    def fold(self, combine: Callable[[Tree, Sequence[Result]], Result]) -> Result:
        """`combine(node, results of its children)` from the leaves up; the result of the root."""
        return combine(self, [child.fold(combine) for child in self.children])

    def map_ids(self, rename: Callable[[str], str]) -> Tree:
        """The same tree with renamed nodes."""
        return replace(self, id=rename(self.id), children=tuple(child.map_ids(rename) for child in self.children))


def refined_at(node_id: str, number: int = 1) -> str:
    """The id of the node at which a device, edge or the cloud refines the joined scene, in round
    `number` from 1."""
    return f"{node_id}/{REFINE}{number if number > 1 else ''}"


def refines_for(node_id: str) -> str:
    """The id of the device, edge or cloud that refines at this node, in whichever round; any other
    id as it is."""
    found = _ROUND.fullmatch(node_id)
    return found[1] if found else node_id


def scored_at(node_id: str) -> str:
    """The id of the node at which a device scores versions of the scene."""
    return f"{node_id}/score"


def tree_of_plan(cloud_plan: CloudPlan, edge_plans: Sequence[EdgePlan]) -> Tree:
    """Cloud over edges and devices with cameras."""
    edges = []
    for index, plan in enumerate(edge_plans):
        devices = tuple(Tree(id=f"devices/{device_id}", tier="device") for device_id in plan.device_ids if len(plan.cameras_of(device_id)))
        if devices:
            edges.append(Tree(id=f"edges/{cloud_plan.edge_ids[index]}", tier="edge", children=devices))
    return Tree(id="cloud", tier="cloud", children=tuple(edges))
