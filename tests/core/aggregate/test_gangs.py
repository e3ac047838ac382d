"""Gangs of a tree: which are refused, and that what is accepted leaves an order to start in."""

from __future__ import annotations

import random
from graphlib import CycleError, TopologicalSorter

import pytest

from radiant_core.aggregate.tree import Tree, require_gangs, with_gangs
from radiant_core.errors import BadInput

TREE = Tree(
    id="cloud",
    tier="cloud",
    children=tuple(
        Tree(id=f"edges/{edge}", tier="edge", children=tuple(Tree(id=f"devices/{edge}-{n}", tier="device") for n in "12")) for edge in "ab"
    ),
)


def test_every_node_has_the_gang_that_its_id_is_given_and_keeps_it_when_renamed() -> None:
    ganged = with_gangs(TREE, lambda node_id: "a" if node_id.startswith(("edges/a", "devices/a")) else None)
    assert {node.id: node.gang for node in ganged} == {
        "devices/a-1": "a",
        "devices/a-2": "a",
        "edges/a": "a",
        "devices/b-1": None,
        "devices/b-2": None,
        "edges/b": None,
        "cloud": None,
    }
    assert [node.gang for node in ganged.map_ids(lambda node_id: f"{node_id}/again")] == [node.gang for node in ganged]
    assert with_gangs(ganged, lambda node_id: None) == TREE


@pytest.mark.parametrize(
    ("members", "accepted"),
    [
        (["cloud", "edges/a", "edges/b", "devices/a-1", "devices/a-2", "devices/b-1", "devices/b-2"], True),
        (["edges/a", "devices/a-1"], True),
        (["devices/a-1", "devices/a-2"], True),
        (["cloud", "edges/b", "devices/b-2"], True),
        (["cloud", "devices/a-1"], False),
        (["devices/a-1", "devices/b-1"], False),
        (["edges/a", "devices/b-1"], False),
    ],
)
def test_members_are_neighbours_in_the_tree(members: list[str], accepted: bool) -> None:
    def gang_of(node_id: str) -> str | None:
        return "g" if node_id in members else None

    if accepted:
        assert [node.id for node in with_gangs(TREE, gang_of) if node.gang == "g"] == [node.id for node in TREE if node.id in members]
    else:
        with pytest.raises(BadInput, match="gang 'g' has members below"):
            with_gangs(TREE, gang_of)


def random_tree(choose: random.Random, depth: int, path: str = "n") -> Tree:
    num_children = choose.randrange(4) if depth else 0
    children = tuple(random_tree(choose, depth - 1, f"{path}{number}") for number in range(num_children))
    return Tree(id=path, tier="edge", children=children, gang=choose.choice([None, "p", "q", "r"]))


def has_order(tree: Tree) -> bool:
    """Whether there is an order in which gangs and other nodes can start, each after its children."""
    unit = {node.id: node.gang or node.id for node in tree}
    waits_for = {name: set[str]() for name in unit.values()}
    for node in tree:
        waits_for[unit[node.id]] |= {unit[child.id] for child in node.children} - {unit[node.id]}
    try:
        TopologicalSorter(waits_for).prepare()
    except CycleError:
        return False
    return True


def test_whatever_is_accepted_can_be_started_in_some_order() -> None:
    choose = random.Random(59)
    accepted = without_order = 0
    for _ in range(3000):
        tree = random_tree(choose, 3)
        without_order += not has_order(tree)
        try:
            require_gangs(tree)
        except BadInput:
            continue
        accepted += 1
        assert has_order(tree), tree
    assert accepted > 300 and without_order > 300, (accepted, without_order)
