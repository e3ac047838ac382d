"""Edges and the cloud of devices that train together: as `nodes.py`, without an inbox. Once per
node.

Their devices' gradients come over links (`radiant_app/together`); what they write is what an edge
or the cloud writes that has joined models.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from radiant_app.reporting import EventReporter
from radiant_app.together.leading import lead
from radiant_app.together.relaying import relay
from radiant_app.workers.delivering import sign_upload
from radiant_app.workers.inbox import save_joining
from radiant_app.workers.training import make_machine
from radiant_core.hierarchy.codec import NOTHING, SUMMARY_NAME, save_edge_model
from radiant_core.hierarchy.group_models import NOT_BEGUN, edge_of_group, scene_of_group
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.hierarchy.joining import UNMOVED
from radiant_core.hierarchy.messages import CloudTask, EdgeTask
from radiant_core.io.ply import save_ply
from radiant_core.io.run_store import read_json, write_json


def run_group_edge(folder: Path, task: EdgeTask, group: GroupTraining, reporter: EventReporter) -> Sequence[str]:
    """Sum the gradients of an edge's devices for the cloud, or train its model with them."""
    if group.has_relays:
        relayed = relay(folder, group, reporter)
        write_json(folder / SUMMARY_NAME, {**NOTHING, "num_models": 0, **relayed.summary})
        moves = {device: UNMOVED if device in relayed.begun else None for device in task.devices}
        refused = {device: relayed.refused.get(device, NOT_BEGUN) for device, move in moves.items() if move is None}
        return [SUMMARY_NAME, *save_joining(folder, moves, refused, None)]
    num_dealt = dict(zip(task.devices, task.num_dealt, strict=True))
    led = lead(folder, group, task, num_dealt, reporter, make_machine(folder, task, reporter))
    model = edge_of_group(task, led.starts, led.result)
    names = save_edge_model(folder, model, task.upload, reporter.warn)
    _add_figures(folder, led.summary)
    return [*names, *save_joining(folder, model.corrections, {**model.refused, **led.refused}, None), *sign_upload(folder)]


def run_group_cloud(folder: Path, task: CloudTask, group: GroupTraining, reporter: EventReporter) -> Sequence[str]:
    """Train the scene with all devices."""
    num_dealt = dict(zip(group.of_devices, task.of_devices or (), strict=True))
    led = lead(folder, group, task, num_dealt, reporter, make_machine(folder, task, reporter))
    scene = scene_of_group(group, led.starts, led.result)
    assert scene.splats is not None
    save_ply(folder / "scene.ply", scene.splats)
    write_json(folder / SUMMARY_NAME, dict(scene.summary))
    _add_figures(folder, led.summary)
    return ["scene.ply", SUMMARY_NAME, *save_joining(folder, scene.corrections, {**scene.refused, **led.refused}, None)]


def _add_figures(folder: Path, figures: Mapping[str, float | int]) -> None:
    write_json(folder / SUMMARY_NAME, {**read_json(folder / SUMMARY_NAME), **figures})
