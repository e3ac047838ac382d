"""Groups of a run, machines that train as one model: their place in its tree, and what is around
their processes. Once per run."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

from radiant_app.together.places import mark_gone, meeting_of
from radiant_app.workers.training import remove_checkpoints
from radiant_core.aggregate.tree import Tree, with_gangs
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.hierarchy.recipe import Recipe

MEETINGS = "together"
"""Folder of a run in which processes that train together meet."""

GivenUp = Callable[[Tree, Collection[str]], None]


def with_groups(tree: Tree, groups: Mapping[str, GroupTraining]) -> Tree:
    """The tree whose machines that train together run at the same time."""
    gang_of = {member: root for root, group in groups.items() for member in _members(group)}
    return with_gangs(tree, gang_of.get)


def _members(group: GroupTraining) -> list[str]:
    devices = [f"devices/{device}" for device in group.of_devices]
    return [group.root, *devices, *(f"edges/{edge}" for edge in group.views if group.has_relays)]


def prepare_meetings(run: Path, recipe: Recipe) -> None:
    """Forget who met in an earlier try of this run."""
    shutil.rmtree(run / MEETINGS, ignore_errors=True)
    if recipe.groups:
        (run / MEETINGS).mkdir(mode=0o700)


def end_groups(run: Path, recipe: Recipe) -> None:
    """Remove what roots keep until all their machines are done."""
    shutil.rmtree(run / MEETINGS, ignore_errors=True)
    for root in recipe.groups:
        remove_checkpoints(run / root)


def tell_parents(run: Path, recipe: Recipe, on_given_up: GivenUp) -> GivenUp:
    """`on_given_up`, after the parent of a machine was told that it will not come again."""

    def tell(node: Tree, begun: Collection[str]) -> None:
        parent = None
        if node.tier == "device" and (group := recipe.group_of(node.name)) is not None:
            parent = group.seat_of(node.name).parent
        elif node.tier == "edge" and "cloud" in recipe.groups:
            parent = "cloud"
        if parent is not None:
            mark_gone(meeting_of(run / node.id, parent), node.name)
        on_given_up(node, begun)

    return tell
