"""The emulating executor: devices and edges at their system's speeds and uplinks, in wall time.

Every node of a device or edge runs inside `emulated_node`: one thread at `speed` of a core, and the
node only ends when its model's last byte would have passed its uplink, so that its parent starts no
sooner. All nodes that may run at once do. Nodes that train together keep to their speeds and links
in every step instead (`radiant_app/together/playing.py`), and the cloud, if it is one of them, to
its links and a core. A cloud that joins, structure from motion and evaluation run and are measured
as usual. Events of emulated nodes are marked.
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

from radiant_app.events import Event, Listener, StageDone, StageSkipped, StageStarted, Warned
from radiant_app.executors.emulated_node import product_bytes
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask, NodeTime, Prepare
from radiant_app.files.run_folder import Manifest
from radiant_app.together.playing import Pace, links_variable
from radiant_app.workers.training import CHECKPOINTS
from radiant_core.aggregate.tree import Tree, refines_for
from radiant_core.errors import BadInput
from radiant_core.hierarchy.codec import SUMMARY_NAME
from radiant_core.io.run_store import read_json
from radiant_core.plan.system import Device, Edge, System
from radiant_core.plan.together.costs import latency_of

RESUMED = "it goes on from a checkpoint of an earlier attempt: its emulated time is that of the rest alone."


@dataclass
class EmulatedExecutor:
    """Runs a tree as `local` does, but each node at its machine's speed and behind its uplink."""

    system: System
    local: LocalExecutor

    def fold(self, tree: Tree, prepare: Prepare, listen: Listener) -> Mapping[str, NodeTime]:
        """See `Executor.fold`; BadInput if this machine cannot emulate the system."""
        require_emulable(self.system)
        machines, links, resumed = _machines(self.system), _links_of(self.system, tree), set[str]()
        if (crowded := crowding_of(self.system, tree)) is not None:
            listen(Warned(stage="cloud", message=crowded))
        keeps_model = {node.id for node in tree if node.tier == "device" and node.gang is not None}

        def command(task: NodeTask) -> list[str]:
            if any((task.folder / CHECKPOINTS).glob("*")):
                resumed.add(task.stage)
            inner = self.local.command(task)
            machine = machines.get(refines_for(task.stage))
            if machine is None:
                return inner
            return _node_command(machine, task, inner, math.inf if task.stage in keeps_model else machine.uplink_bytes_per_s)

        def label_and_listen(event: Event) -> None:
            label = isinstance(event, StageStarted | StageDone | StageSkipped) and refines_for(event.stage) in machines
            listen(replace(event, emulated=True) if label else event)
            if isinstance(event, StageStarted) and event.stage in resumed:
                listen(Warned(stage=event.stage, message=RESUMED))

        executor = replace(self.local, num_workers=sum(1 for _ in tree), command=command, variables=lambda task: links.get(task.stage, {}))
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


def crowding_of(system: System, tree: Tree) -> str | None:
    """What to say where machines that train together, edges beside their devices and the cloud,
    need more cores than there are while all of them work; None where cores suffice."""
    machines, together = _machines(system), [node.id for node in tree if node.gang is not None]
    demand, cores = sum(machines[node].speed or 0 if node in machines else 1.0 for node in together), len(os.sched_getaffinity(0))
    if demand <= cores * (1 + 1e-9):
        return None
    return (
        f"machines that train together need {demand:g} cores while all of them work at once, as when they load libraries, and this machine "
        f"has {cores}: their emulated times may be too long; lower speeds for all avoid that."
    )


def emulated_figures(run: Path, tree: Tree, refining: Sequence[Tree], manifest: Manifest) -> dict[str, Any]:
    """The figures of an emulated run in the folder `run`.

    Seconds and bytes sent per stage; the makespan, when the last edge's model is at the cloud,
    which is what a plan predicts; and the end of the scene, which adds the cloud's join and the
    rounds in which the trees `refining` refine it. All of the nodes' own times, without copying,
    those of machines that train together side by side; None with a reason if one is unknown.
    """

    def node_s(node: Tree) -> float:
        # A resumed run skips a node whose transfer was interrupted, so that its time is unknown.
        times = manifest.stages if node.tier == "cloud" else manifest.emulated
        span = times.get(node.id, {"started_s": 0.0, "ended_s": 0.0})
        return math.inf if f"{node.id}: {RESUMED}" in manifest.warnings else (span["ended_s"] - span["started_s"]) or math.inf

    def arrival_s(node: Tree) -> float:
        gang = [child for child in node.children if child.gang is not None and child.gang == node.gang]
        before_s = max((arrival_s(child) for child in node.children if child not in gang), default=0.0)
        return max(before_s + node_s(node), *map(arrival_s, gang), 0.0)

    def edges_s(part: Tree) -> float:
        return max(map(arrival_s, part.children), default=math.inf)

    seconds = {stage: times["ended_s"] - times["started_s"] for stage, times in manifest.emulated.items()}
    makespan_s = edges_s(tree)
    scene_s = sum(arrival_s(part) if part.children else math.inf for part in (tree, *refining))
    sent = {node.id: _sent_bytes(run / node.id, node) for part in (tree, *refining) for node in part}
    figures: dict[str, Any] = {
        "emulated_seconds": seconds,
        "emulated_bytes": {stage: count for stage, count in sent.items() if stage in seconds},
        "emulated_makespan_s": makespan_s if makespan_s < math.inf else None,
        "emulated_scene_s": scene_s if scene_s < math.inf else None,
    }
    if not scene_s < math.inf:
        figures["emulated_reason"] = (
            "a node had nothing to send, was stopped while its model was on its way, or went on from a checkpoint of an earlier attempt."
        )
    return figures


def _machines(system: System) -> dict[str, Device | Edge]:
    """Node id → machine, in the order of the system."""
    edges = ((f"edges/{edge.id}", edge) for edge in system.edges)
    return dict(chain(((f"devices/{device.id}", device) for device in system.devices), edges))


def _links_of(system: System, tree: Tree) -> dict[str, dict[str, str]]:
    """Node that trains together with others → the variable that says how fast its links are: as
    `plan/together/costs.py` assumes, the same both ways."""
    of_edges = {edge.id: Pace(edge.uplink_bytes_per_s, latency_of(system.cloud)) for edge in system.edges}
    links = {"cloud": links_variable(Pace(), of_edges)}
    for edge in system.edges:
        of_devices = {device.id: Pace(device.uplink_bytes_per_s, latency_of(edge)) for device in edge.devices}
        links[f"edges/{edge.id}"] = links_variable(of_edges[edge.id], of_devices)
        links |= {f"devices/{device}": links_variable(pace, {}) for device, pace in of_devices.items()}
    return {node.id: links[node.id] for node in tree if node.gang is not None}


def _sent_bytes(folder: Path, node: Tree) -> int:
    """Of a node that trains together with others what it sent in all steps, and its model, which
    devices keep."""
    if node.gang is None:
        return product_bytes(folder)
    summary = folder / SUMMARY_NAME
    sent = int(read_json(summary).get("sent_bytes", 0)) if summary.is_file() else 0
    return sent if node.tier == "device" else sent + product_bytes(folder)


def _node_command(machine: Device | Edge, task: NodeTask, command: Sequence[str], bytes_per_s: float) -> list[str]:
    module = "radiant_app.executors.emulated_node"
    numbers = map(str, (time.monotonic(), machine.speed, bytes_per_s))
    return [sys.executable, "-m", module, *numbers, task.stage, str(task.folder), *command]
