"""Which files a task of each kind has, and which a result. Once per task and result.

Of a device's photographs nothing is in any of these lists: what a node may send is decided here, by
name, on both sides.

    count, raster                 how many photographs a device has; how many stand in each cell
    own_field, refine, score      a device's model; what it changed in the scene; its figures
    edge_count, edge_raster, region, edge_refine, edge_score     the same of all devices of an edge
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from radiant_core.hierarchy.codec import (
    CAMERAS_NAME,
    FRAME_NAME,
    MODEL_NAME,
    REFINED_NAME,
    ROWS_NAME,
    SUMMARY_NAME,
    TASK_NAME,
    VIRTUAL_CAMERAS,
)
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME

NOTES_NAME, REPORT_NAME = "notes.json", "report.json"
MAX_SMALL_BYTES = 64 << 20
"""Most bytes of a file that is no model and no scene."""
_SIGNATURE_FROM_ABOVE = (f"given/{RECORD_NAME}", f"given/{SIGNATURE_NAME}")
_SIGNED = (RECORD_NAME, SIGNATURE_NAME)
_LARGE = {MODEL_NAME, CAMERAS_NAME, VIRTUAL_CAMERAS, REFINED_NAME, ROWS_NAME, "scene.ply"}


@dataclass(frozen=True, kw_only=True)
class Files:
    """Names of files that have to be there, and of those that may."""

    needed: tuple[str, ...]
    possible: tuple[str, ...] = ()

    def problem(self, names: Collection[str]) -> str | None:
        """Why these are not the files, one sentence."""
        if missing := sorted({*self.needed} - {*names}):
            return f"it lacks {missing[0]}: use the same version of the software on both sides."
        if strange := sorted({*names} - {*self.needed, *self.possible}):
            return f"it has {strange[0][:80]!r}, which is no file of its kind: use the same version of the software on both sides."
        return None


TASK_FILES: Mapping[str, Files] = {
    "count": Files(needed=(TASK_NAME,)),
    "raster": Files(needed=(TASK_NAME,)),
    "own_field": Files(needed=(TASK_NAME, *_SIGNATURE_FROM_ABOVE)),
    "refine": Files(needed=(TASK_NAME, "scene.ply", *_SIGNATURE_FROM_ABOVE)),
    "score": Files(
        needed=(TASK_NAME, "inbox/scene.ply", "inbox/plan.json", *_SIGNATURE_FROM_ABOVE),
        possible=("inbox/joined.ply", "inbox/cut.ply", "inbox/lpips.safetensors"),
    ),
    "edge_count": Files(needed=(TASK_NAME,)),
    "edge_raster": Files(needed=(TASK_NAME,)),
    "region": Files(needed=(TASK_NAME, "plan.json", "system.toml")),
    "edge_refine": Files(needed=(TASK_NAME, "scene.ply")),
    "edge_score": Files(needed=(TASK_NAME, "scene.ply", "plan.json"), possible=("joined.ply", "cut.ply", "lpips.safetensors")),
}
RESULT_FILES: Mapping[str, Files] = {
    "count": Files(needed=("count.json", NOTES_NAME)),
    "raster": Files(needed=("raster.json", NOTES_NAME)),
    "own_field": Files(needed=(FRAME_NAME, SUMMARY_NAME, NOTES_NAME), possible=(MODEL_NAME, CAMERAS_NAME, *_SIGNED)),
    "refine": Files(needed=(REFINED_NAME, ROWS_NAME, NOTES_NAME, *_SIGNED)),
    "score": Files(needed=("scores.json", NOTES_NAME, *_SIGNED)),
    "edge_count": Files(needed=(REPORT_NAME,)),
    "edge_raster": Files(needed=(REPORT_NAME,)),
    "region": Files(
        needed=(REPORT_NAME,),
        possible=(MODEL_NAME, VIRTUAL_CAMERAS, FRAME_NAME, SUMMARY_NAME, NOTES_NAME, "corrections.json", "refused.json", *_SIGNED),
    ),
    "edge_refine": Files(needed=(REPORT_NAME,), possible=(REFINED_NAME, ROWS_NAME, NOTES_NAME, "refused.json", *_SIGNED)),
    "edge_score": Files(needed=(REPORT_NAME,)),
}


def result_problem(kind: str, files: Mapping[str, Any]) -> str | None:
    """Why a result of this kind cannot have these files (with `bytes`), one sentence."""
    if kind not in RESULT_FILES:
        return f"there is no work of kind {kind[:40]!r}: use the same version of the software on both sides."
    large = sorted(name for name, file in files.items() if name not in _LARGE and file.bytes > MAX_SMALL_BYTES)
    if large:
        return f"{large[0]} has {files[large[0]].bytes:,} bytes, expected at most {MAX_SMALL_BYTES:,}."
    problem = RESULT_FILES[kind].problem(files)
    return problem and f"a result of kind {kind}: {problem}"


def task_problem(kind: str, files: Mapping[str, Any]) -> str | None:
    """As `result_problem`, of a task."""
    if kind not in TASK_FILES:
        return f"there is no work of kind {kind[:40]!r}: use the same version of the software on both sides."
    problem = TASK_FILES[kind].problem(files)
    return problem and f"a task of kind {kind}: {problem}"


def remove_earlier(kind: str, folder: Path, names: Collection[str]) -> None:
    """Remove from the folder of a task what an earlier one of its stage had beside it: these are
    the names of all files that this one has."""
    for name in {*TASK_FILES[kind].possible} - {*names}:
        (folder / name).unlink(missing_ok=True)


def task_files(kind: str, folder: Path) -> dict[str, Path]:
    """Name → file of the task in a folder."""
    files = TASK_FILES[kind]
    names = [*files.needed, *(name for name in files.possible if (folder / name).is_file())]
    return {name: folder / name for name in names}
