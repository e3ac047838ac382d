"""`Tree`: the whole computation, cloud over edges over devices, folded from the leaves up. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan, EdgePlan

Result = TypeVar("Result")
Tier = Literal["cloud", "edge", "device"]
REFINE = "refine"
_ROUND = re.compile(rf"(cloud|[^/]+/[^/]+)/{REFINE}(\d*)")


@dataclass(frozen=True, kw_only=True)
class Tree:
    """A node and its children; `id` is its folder's path in a run, such as "devices/north-1"."""

    id: str
    tier: Tier
    children: tuple[Tree, ...] = ()
    gang: str | None = None
    """Name of the nodes that run at the same time and talk to each other, this one among them;
    None: the node runs alone, once its children are done."""

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


def with_gangs(tree: Tree, gang_of: Callable[[str], str | None]) -> Tree:
    """The same tree whose nodes have the gangs `gang_of(id)`; see `require_gangs` for what is
    refused."""

    def ganged(node: Tree) -> Tree:
        return replace(node, gang=gang_of(node.id), children=tuple(ganged(child) for child in node.children))

    marked = ganged(tree)
    require_gangs(marked)
    return marked


def require_gangs(tree: Tree) -> None:
    """Raise BadInput where members of a gang would wait for each other without end.

    The members whose parents are no members must have one parent, or be the root: then a tree is
    left where every gang is drawn together to one node. Else a member may wait for a node outside
    that waits for another member.
    """
    above: dict[str, str] = {}
    stack = [(tree, "", None)]
    while stack:
        node, parent, gang = stack.pop()
        if node.gang is not None and node.gang != gang and above.setdefault(node.gang, parent) != parent:
            raise BadInput(
                f"gang {node.gang!r} has members below {above[node.gang] or 'no node'} and below {parent or 'no node'}, which are not of "
                "it: let the members of a gang be neighbours in the tree, such as an edge and its devices."
            )
        stack += [(child, node.id, node.gang) for child in node.children]


def refined_at(node_id: str, number: int = 1) -> str:
    """The id of the node at which a device, edge or the cloud refines the joined scene, in round
    `number` from 1."""
    return f"{node_id}/{REFINE}{number if number > 1 else ''}"


def refines_for(node_id: str) -> str:
    """The id of the device, edge or cloud that refines at this node, in whichever round; any other
    id as it is."""
    match = _ROUND.fullmatch(node_id)
    return match[1] if match else node_id


def round_of(node_id: str) -> int:
    """The round in which the scene is refined at this node; 0 for any other node."""
    match = _ROUND.fullmatch(node_id)
    return int(match[2] or 1) if match else 0


def tree_of_round(devices: Mapping[str, Sequence[str]], number: int) -> Tree:
    """The nodes that refine the scene in round `number`: devices by edge, edges and the cloud."""

    def node(tier: Tier, owner: str, children: tuple[Tree, ...] = ()) -> Tree:
        return Tree(id=refined_at(owner, number), tier=tier, children=children)

    edges = [node("edge", f"edges/{edge}", tuple(node("device", f"devices/{name}") for name in names)) for edge, names in devices.items()]
    return node("cloud", "cloud", tuple(edges))


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
