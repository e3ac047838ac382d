"""The interface of executors: fold a tree, one process and folder per node, children first.

Nodes of one gang (`Tree.gang`) run at the same time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from radiant_app.events import Listener
from radiant_core.aggregate.tree import Tree


@dataclass(frozen=True, kw_only=True)
class NodeTask:
    """A node ready to run; its folder holds all it may read, `key` is of its inputs and
    settings."""

    kind: str
    """Which worker runs it: a key of `workers.tasks.TASKS`, such as device or score."""
    stage: str
    """Name in events, the folder's path inside the run."""
    folder: Path
    key: str
    module: str = "radiant_app.workers.worker"
    """Module that its process runs."""


@dataclass(frozen=True, kw_only=True)
class NodeTime:
    """When a node ran, seconds of the executor's clock since the fold began; equal if skipped."""

    started_s: float
    ended_s: float


Prepare = Callable[[Tree], NodeTask | None]
"""Called when all children of a node outside its gang are done, and for every member of a gang
before any of them starts: fills its folder. None: the node has no work."""


class Executor(Protocol):
    """Runs the nodes of a tree."""

    def fold(self, tree: Tree, prepare: Prepare, listen: Listener) -> Mapping[str, NodeTime]:
        """Run every node once its children are done and return the times by node id.

        Members of a gang start together once their children outside it are done; a node whose
        child is in a gang waits for all of that gang.

        A node whose folder is sealed with the task's key is skipped. Raises StageFailed (or
        BadInput, as the worker said) with the node's reason after the other running nodes were
        stopped; what is sealed stays and is skipped the next time.
        """
        ...
