"""The privacy promises that a run keeps, by source of photographs and executor. Once per run.

A process of this machine reads only below its node's folder (traced in tests/app/test_field.py),
but all run under one user. In a Ray cluster any task may run on any machine, list all of them and
read what its user may read there: it is one owner's trust.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from radiant_app.config.run_config import RunConfig


@dataclass(frozen=True, kw_only=True)
class Promise:
    """One sentence about what is protected from whom, whether it holds in this run, and why."""

    promise: str
    holds: bool
    reason: str


def promises_of(config: RunConfig, *, pooled: bool) -> list[dict[str, Any]]:
    """The promises of a run with these settings; `pooled`: the photographs lay with one owner."""
    in_cluster = config.execution.executor == "ray"
    together = f"the photographs were pooled with one owner ({'--frames shared' if config.frames == 'shared' else 'one folder for all'})"
    cluster = "a Ray cluster is one owner's trust: every task there can list its machines and read their files"
    opens = Promise(
        promise="No stage of an edge or of the cloud opens a photograph of a device.",
        holds=True,
        reason="a node's process gets its own folder only; edges and the cloud get models and cameras"
        + (", and through Ray go commands, events and hashes, no file" if in_cluster else ""),
    )
    own_work = Promise(
        promise="A device's photographs are readable on that device alone.",
        holds=not pooled and not in_cluster,
        reason=cluster if in_cluster else together if pooled else "every device reads its own folder, by a process of its own",
    )
    cloud = Promise(promise="The cloud can learn no device's id, count or pose.", **_of_the_cloud(config, cluster if in_cluster else None))
    whole = Promise(
        promise="What is used is what was written: every file of a finished node has the hash in its seal.",
        holds=True,
        reason="the process that folds the tree checks all seals, wherever a node ran",
    )
    return [asdict(promise) for promise in (opens, own_work, cloud, whole)]


def _of_the_cloud(config: RunConfig, cluster: str | None) -> dict[str, Any]:
    if cluster is not None:
        return {"holds": False, "reason": cluster}
    if config.execution.executor == "network":
        return {"holds": False, "reason": "it plans: ids and counts of devices are its own; it gets no pose and no model of a device"}
    if config.frames == "shared":
        return {"holds": False, "reason": "who plans has all poses (--frames shared)"}
    if config.cell_m is None:
        return {"holds": False, "reason": "who plans has all positions (--raster-cell-m 0)"}
    reason = (
        "it is dealt models and virtual cameras of edges, with pictures, and borders; where it plans, counts in cells, a curve per edge"
    )
    return {"holds": True, "reason": reason}
