"""Reads the models that arrived at an edge or the cloud. Once per join.

Signatures, lengths and hashes are checked here, before a model is read; its content is checked by
`radiant_core.hierarchy.joining`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from radiant_app.workers.delivering import belongs_to_run, find_refusals
from radiant_core.aggregate.synthetic_views import Rendered
from radiant_core.cameras import Cameras
from radiant_core.frames import FrameUncertainty, Sim3
from radiant_core.hierarchy.messages import DeviceModel, EdgeModel, EdgeTask
from radiant_core.io.messages import load_device_model, load_edge_model, save_frame, sim3_of, sim3_record
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.view_file import load_view

REFUSED_NAME, CORRECTIONS_NAME = "refused.json", "corrections.json"
"""Files of a node, never sent: refused sender → reason; sender → how its model was moved."""


def receive_device_models(folder: Path, task: EdgeTask) -> dict[str, DeviceModel | str]:
    """Device → its model, with its teacher's views, or the reason why the edge refuses it."""
    found: dict[str, DeviceModel | str] = {}
    rejected = _find_unsigned(folder, task.devices)
    for name in task.devices:
        model = rejected.get(name) or load_device_model(folder / "inbox" / name)
        if isinstance(model, DeviceModel) and name in task.teachers:
            ready = load_teacher_views(folder / "teachers" / name, model.cameras.scaled(task.train.long_side_px))
            model = replace(model, rendered=ready)
        found[name] = model
    return found


def receive_edge_models(folder: Path, edges: Sequence[str]) -> dict[str, EdgeModel | str]:
    """Edge → its model, or the reason why the cloud refuses it."""
    rejected = _find_unsigned(folder, edges)
    return {name: rejected.get(name) or load_edge_model(folder / "inbox" / name) for name in edges}


def _find_unsigned(folder: Path, senders: Sequence[str]) -> dict[str, str]:
    return find_refusals(folder, senders, {name: folder / "inbox" / name for name in senders}) if belongs_to_run(folder) else {}


def teacher_view_name(index: int) -> str:
    """The file in a teacher's folder with the view of camera `index`."""
    return f"views/{index:05d}.safetensors"


def load_teacher_views(teacher: Path, cameras: Cameras) -> Rendered:
    """The views that a teacher has written for `cameras`, maybe not all; raises as `load_view`."""
    sizes = {index: (int(width), int(height)) for index, (width, height) in enumerate(cameras.sizes_wh)}
    written = {index: size for index, size in sizes.items() if (teacher / teacher_view_name(index)).exists()}
    return {index: load_view(teacher / teacher_view_name(index), *size) for index, size in written.items()}


def save_joining(
    folder: Path, corrections: Mapping[str, Sim3 | None], refused: Mapping[str, str], frame: FrameUncertainty | None
) -> list[str]:
    """Write moves, refusals and the joined frame's uncertainty; the names of the files, of which
    only the last is sent to the next tier: it names no sender."""
    write_json(folder / CORRECTIONS_NAME, {name: None if move is None else sim3_record(move) for name, move in corrections.items()})
    write_json(folder / REFUSED_NAME, dict(refused))
    missing = None if any(move is not None for move in corrections.values()) else ""
    return [CORRECTIONS_NAME, REFUSED_NAME, save_frame(folder, frame, missing)]


def load_corrections(folder: Path) -> dict[str, Sim3 | None]:
    """Sender → how its model was moved; None if it was refused."""
    return {name: None if move is None else sim3_of(move) for name, move in read_json(folder / CORRECTIONS_NAME).items()}
