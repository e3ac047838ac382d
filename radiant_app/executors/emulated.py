"""The emulating executor: devices and edges at their system's speeds and uplinks, in wall time.

Every node of a device or edge runs inside `emulated_node`: one thread at `speed` of a core, and the
node only ends when its model's last byte would have passed its uplink, so that its parent starts no
sooner. All nodes that may run at once do. The cloud, structure from motion and evaluation run and
are measured as usual. Events of emulated nodes are marked.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

from radiant_app.events import Event, Listener, StageDone, StageSkipped, StageStarted
from radiant_app.executors.emulated_node import product_bytes
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask, NodeTime, Prepare
from radiant_app.files.run_folder import Manifest
from radiant_core.aggregate.tree import Tree, refines_for
from radiant_core.errors import BadInput
from radiant_core.plan.system import Device, Edge, System


@dataclass
class EmulatedExecutor:
    """Runs a tree as `local` does, but each node at its machine's speed and behind its uplink."""

    system: System
    local: LocalExecutor

    def fold(self, tree: Tree, prepare: Prepare, listen: Listener) -> Mapping[str, NodeTime]:
        """See `Executor.fold`; BadInput if this machine cannot emulate the system."""
        require_emulable(self.system)
        machines = _machines(self.system)

        def command(task: NodeTask) -> list[str]:
            inner = self.local.command(task)
            machine = machines.get(refines_for(task.stage))
            return inner if machine is None else _node_command(machine, task, inner)

        def label_and_listen(event: Event) -> None:
            label = isinstance(event, StageStarted | StageDone | StageSkipped) and refines_for(event.stage) in machines
            listen(replace(event, emulated=True) if label else event)

        executor = replace(self.local, num_workers=sum(1 for _ in tree), command=command)
        return executor.fold(tree, prepare, label_and_listen)


def require_emulable(system: System) -> None:
    """Raise BadInput unless every machine has a speed and cores suffice for all at once."""
    for machine in _machines(system).values():
        if machine.speed is None:
            kind = "device" if isinstance(machine, Device) else "edge"
            raise BadInput(f"{kind} {machine.id!r} has no speed to emulate: add speed = 0.5, its share of one core of this machine.")
    cores = len(os.sched_getaffinity(0))
    demand = sum(max(edge.speed or 0, sum(device.speed or 0 for device in edge.devices)) for edge in system.edges)
    if demand > cores * (1 + 1e-9):
        raise BadInput(
            f"the devices and edges that may run at once need {demand:g} cores, this machine has {cores}: multiply every speed by "
            f"{cores / demand:.2g}, which slows all of them alike."
        )


def emulated_figures(run: Path, tree: Tree, refining: Sequence[Tree], manifest: Manifest) -> dict[str, Any]:
    """The figures of an emulated run in the folder `run`.

    Seconds and bytes sent per stage; the makespan, when the last edge's model is at the cloud,
    which is what a plan predicts; and the end of the scene, which adds the cloud's join and the
    rounds in which the trees `refining` refine it. All of the nodes' own times, without copying;
    None with a reason if one is unknown.
    """

    def arrival_s(node: Tree, arrivals_s: Sequence[float]) -> float:
        # A resumed run skips a node whose transfer was interrupted, so that its time is unknown.
        return max(arrivals_s, default=0.0) + (seconds.get(node.id, 0.0) or math.inf)

    def edges_s(part: Tree) -> float:
        return max((edge.fold(arrival_s) for edge in part.children), default=math.inf)

    def cloud_s(part: Tree) -> float:
        times = manifest.stages.get(part.id, {"started_s": 0.0, "ended_s": 0.0})
        return (times["ended_s"] - times["started_s"]) or math.inf

    seconds = {stage: times["ended_s"] - times["started_s"] for stage, times in manifest.emulated.items()}
    makespan_s = edges_s(tree)
    scene_s = makespan_s + cloud_s(tree) + sum(edges_s(part) + cloud_s(part) for part in refining)
    sent = {node.id: product_bytes(run / node.id) for part in (tree, *refining) for node in part}
    figures: dict[str, Any] = {
        "emulated_seconds": seconds,
        "emulated_bytes": {stage: count for stage, count in sent.items() if stage in seconds},
        "emulated_makespan_s": makespan_s if makespan_s < math.inf else None,
        "emulated_scene_s": scene_s if scene_s < math.inf else None,
    }
    if not scene_s < math.inf:
        figures["emulated_reason"] = "a node had nothing to send, or was stopped while its model was on its way."
    return figures


def _machines(system: System) -> dict[str, Device | Edge]:
    """Node id → machine, in the order of the system."""
    edges = ((f"edges/{edge.id}", edge) for edge in system.edges)
    return dict(chain(((f"devices/{device.id}", device) for device in system.devices), edges))


def _node_command(machine: Device | Edge, task: NodeTask, command: Sequence[str]) -> list[str]:
    module = "radiant_app.executors.emulated_node"
    numbers = map(str, (time.monotonic(), machine.speed, machine.uplink_bytes_per_s))
    return [sys.executable, "-m", module, *numbers, task.stage, str(task.folder), *command]
