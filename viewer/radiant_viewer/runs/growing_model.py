"""The model of a run that is still at work, for the eye: what its nodes have made so far, together.

    per edge    its joined model, else of each of its devices
    per device  its finished model, else the newest checkpoint of its training

Nothing is cut or fitted: where devices overlap, both are seen. Once per reading of a run without a
scene.ply; files that vanish or are being written are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.io.array_file import load_arrays
from radiant_core.io.records import load_splats
from radiant_core.plan.plans import EdgePlan
from radiant_core.splats import TENSORS, Splats, concatenate_splats

GROWING_S = 20.0
"""A window reads a model that is growing again after so many seconds at the soonest."""
MODEL_NAME, CHECKPOINTS = "model.safetensors", "checkpoints/step-*.safetensors"


def growing_model(folder: Path, edges: Sequence[EdgePlan]) -> Splats | None:
    """What there is of a run's model; None before any node has a model or a checkpoint."""
    parts = [part for edge in edges for part in _edge_parts(folder, edge) if len(part)]
    if not parts:
        return None
    # All are trained alike, but a checkpoint does not say whether they fade below a pixel.
    return concatenate_splats([Splats(antialiased=False, **part.arrays()) for part in parts])


def growing_files(folder: Path) -> list[Path]:
    """The files that `growing_model` may read."""
    files = [*folder.glob(f"edges/*/{MODEL_NAME}"), *folder.glob(f"devices/*/{MODEL_NAME}"), *folder.glob(f"devices/*/{CHECKPOINTS}")]
    return sorted(files)


def _edge_parts(folder: Path, edge: EdgePlan) -> list[Splats]:
    joined = _finished(folder / "edges" / edge.edge_id)
    if joined is not None:
        return [joined]
    devices = [_finished(node) or _checkpoint(node) for node in (folder / "devices" / device for device in edge.device_ids)]
    return [model for model in devices if model is not None]


def _finished(node: Path) -> Splats | None:
    if (node / MODEL_NAME).is_file():
        with suppress(BadInput):
            return load_splats(node / MODEL_NAME)
    return None


def _checkpoint(node: Path) -> Splats | None:
    """The newest checkpoint that is whole."""
    for path in sorted(node.glob(CHECKPOINTS), reverse=True):
        with suppress(BadInput):
            arrays, _ = load_arrays(path, "radiant.checkpoint", None)
            if {f"splats.{name}" for name in TENSORS} <= set(arrays):
                return Splats(antialiased=False, **{name: arrays[f"splats.{name}"] for name in TENSORS})
    return None
