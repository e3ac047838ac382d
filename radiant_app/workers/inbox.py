"""Reads the models that arrived at an edge or the cloud. Once per join.

Signatures, lengths and hashes are checked here, before a model is read; its content is checked by
`radiant_core.hierarchy.joining`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from radiant_app.strangers import UntrustedRecord, parse_record
from radiant_app.workers.delivering import belongs_to_run, find_refusals
from radiant_app.workers.tasks import Move
from radiant_core.frames import FrameUncertainty, Sim3
from radiant_core.hierarchy.codec import load_device_model, load_edge_model, save_frame, sim3_record
from radiant_core.hierarchy.messages import DeviceModel, EdgeModel
from radiant_core.io.run_store import read_json, write_json

REFUSED_NAME, CORRECTIONS_NAME = "refused.json", "corrections.json"
"""Files of a node, never sent: refused sender → reason; sender → how its model was moved."""


def receive_device_models(folder: Path, devices: Sequence[str]) -> dict[str, DeviceModel | str]:
    """Device → its model, or the reason why the edge refuses it."""
    rejected = _find_unsigned(folder, devices)
    return {name: rejected.get(name) or load_device_model(folder / "inbox" / name) for name in devices}


def receive_edge_models(folder: Path, edges: Sequence[str]) -> dict[str, EdgeModel | str]:
    """Edge → its model, or the reason why the cloud refuses it."""
    rejected = _find_unsigned(folder, edges)
    return {name: rejected.get(name) or load_edge_model(folder / "inbox" / name) for name in edges}


def _find_unsigned(folder: Path, senders: Sequence[str]) -> dict[str, str]:
    return find_refusals(folder, senders, {name: folder / "inbox" / name for name in senders}) if belongs_to_run(folder) else {}


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
    """Sender → how its model was moved; None if it was refused. BadInput where a file says else."""
    record = read_json(folder / CORRECTIONS_NAME)
    moves = parse_record(_Corrections, {"moves": record}, CORRECTIONS_NAME).moves
    return {name: None if move is None else move.sim3 for name, move in moves.items()}


class _Corrections(UntrustedRecord):
    moves: dict[str, Move | None]
