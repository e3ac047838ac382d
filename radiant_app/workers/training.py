"""Training, checkpoints and memory limits of nodes that train or join. Once per node."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from radiant_app.reporting import EventReporter
from radiant_app.workers.delivering import sign_upload
from radiant_app.workers.memory import EDGES_AT_ONCE, available_bytes, base_bytes_in, resident_bytes

if TYPE_CHECKING:
    from radiant_core.hierarchy.messages import DeviceModel, DeviceTask, Training
    from radiant_core.hierarchy.reporter import Machine

CHECKPOINTS = "checkpoints"
"""Folder of checkpoints in a node's folder; removed when the node is done."""
MASKS = "masks"
"""Folder of masks beside a node's photographs, if any."""


def train_from_folder(folder: Path, task: DeviceTask, images: Path, reporter: EventReporter) -> DeviceModel:
    """Train a device from its photographs in `images`, together with others where its task has a
    seat; its checkpoints lie in `folder`."""
    from radiant_core.hierarchy.device import train_device
    from radiant_core.train.photographs import load_training_views

    machine = make_machine(folder, task, reporter, limited=task.memory_bytes is not None)
    views = load_training_views(images, task.scene.cameras.scaled(task.train.long_side_px), folder / MASKS)
    if task.seat is not None:
        from radiant_app.together.holding import hold

        return hold(folder, task, views, reporter, machine)
    return train_device(task, views, reporter, machine)


def save_signed_model(folder: Path, task: DeviceTask, model: DeviceModel, reporter: EventReporter) -> list[str]:
    """Write and sign a device's model; returns the names of the files. One that was trained
    together with others stays here, unsigned: the root has it."""
    from radiant_core.hierarchy.codec import save_device_model

    if task.seat is not None:
        return save_device_model(folder, model, "float32", reporter.warn)
    names = save_device_model(folder, model, task.upload, reporter.warn)
    remove_checkpoints(folder)
    return [*names, *sign_upload(folder)]


def make_machine(folder: Path, task: Training, reporter: EventReporter, *, limited: bool = False) -> Machine:
    """This machine's resources for a node; if `limited`, with the bytes that the process holds."""
    from radiant_core.hierarchy.reporter import Machine
    from radiant_core.train.checkpoint import CheckpointFolder

    def checkpoints(key: Callable[[], str]) -> CheckpointFolder:
        checkpoint_folder = CheckpointFolder(folder / CHECKPOINTS, key(), every_s=task.checkpoint_every_s, warn=reporter.warn)
        # Checkpoints of an older plan or other settings.
        checkpoint_folder.remove_foreign()
        return checkpoint_folder

    base_bytes = base_bytes_in(folder, resident_bytes()) if limited else 0
    num_edges = int(os.environ.get(EDGES_AT_ONCE, "1"))
    return Machine(
        base_bytes=base_bytes,
        free_bytes=available_bytes,
        held_bytes=resident_bytes,
        num_edges=num_edges,
        checkpoints=checkpoints,
        scratch=folder,
    )


def remove_checkpoints(folder: Path) -> None:
    """Remove the checkpoints of a node that is done."""
    from radiant_core.train.checkpoint import CheckpointFolder

    CheckpointFolder(folder / CHECKPOINTS, "").remove()
