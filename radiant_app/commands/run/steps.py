"""The single steps of the main job as commands: each returns what the command line prints."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.events import Listener, StageProgress, StageStarted, Warned
from radiant_app.files.out_folder import require_folder_for
from radiant_app.files.run_folder import sfm_folder
from radiant_app.report.progress import ProgressDisplay
from radiant_app.reporting import EventReporter
from radiant_app.workers.folder_kinds import named_folder
from radiant_app.workers.sources import POSITIONS, SURVEY, reconstruct_source, save_given_frames, sfm_record, sfm_task
from radiant_app.workers.tasks import SfmTask
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.hierarchy.codec import message_record
from radiant_core.io.records import save_scene
from radiant_core.io.run_store import write_json
from radiant_core.scene import SfmScene
from radiant_core.sfm.config import SfmConfig, SfmResult
from radiant_core.sfm.intake import AS_FOUND, Intake
from radiant_core.sfm.world_frame.placement import Placement


def sfm(  # noqa: PLR0913
    source: Path,
    out: Path,
    config: SfmConfig,
    display: ProgressDisplay,
    masks: Path | None = None,
    placement: dict[str, Any] | None = None,
    poses: Path | None = None,
    *,
    refine_poses: bool = False,
    intake: Intake = AS_FOUND,
    resume: bool = False,
) -> dict[str, Any]:
    """Structure from motion of `source` into the new folder `out`, where `resume` goes on;
    `placement` has fields of `radiant_core.sfm.world_frame.placement.Placement`."""
    task = sfm_task(source, config, masks, Placement(**(placement or {})), poses, refine_poses=refine_poses, intake=intake)
    with display:
        result = reconstruct_into(out, task, display, resume=resume)
        warn_of("sfm", result.warnings, display)
    return {
        "cameras": len(result.scene.cameras),
        "points": len(result.scene.points),
        "frame": result.scene.frame.kind,
        "gps_residual_m": result.scene.frame.residual_m,
        "unregistered": list(result.unregistered),
        **({} if result.survey is None else {SURVEY: result.survey}),
        **({} if result.positions is None else {POSITIONS: result.positions}),
        "warnings": "; ".join(result.warnings) or "none",
        "folder": str(out),
    }


def warn_of(stage: str, messages: Iterable[str], listen: Listener) -> str:
    """Show each warning by itself, and return all of them for `--json`."""
    told = list(messages)
    for message in told:
        listen(Warned(stage=stage, message=message))
    return " ".join(told) or "none"


def reconstruct_into(out: Path, task: SfmTask, listen: Listener, *, resume: bool = False) -> SfmResult:
    """Structure from motion of a task into the new folder `out`, where `resume` goes on."""
    with sfm_folder(out, message_record(task), resume=resume), libraries_log_to(out / "log.txt"):
        listen(StageStarted(stage="sfm"))
        result = reconstruct_source(task, out, EventReporter(stage="sfm", emit=listen).sfm_progress)
    save_scene(out / "scene.safetensors", result.scene)
    write_json(out / "result.json", sfm_record(result, out))
    save_given_frames(out, result)
    return result


def screenshot(run: Path, view: Any, path: Path, size_wh: tuple[int, int] = (1280, 900), camera: str | None = None) -> str:
    """Write one view of a run, a training or a scene as PNG."""
    from radiant_viewer.pictures.images import save_png
    from radiant_viewer.runs.run_pictures import screenshot as make_screenshot

    save_png(path, make_screenshot(run, view, size_wh, camera))
    return f"written: {path}"


def training_part(scene: SfmScene) -> SfmScene:
    """Return the scene without its held-out cameras."""
    return scene.restricted_to(np.flatnonzero(~held_out_mask(scene.cameras.names)))


def require_run(folder: Path, name: str = "plan.json") -> None:
    """Raise BadInput unless `folder` holds the file `name` of a run."""
    if not (folder / name).is_file():
        raise BadInput(f"{named_folder(folder)} holds no {name}: give the folder of a run that went that far, made by 'radiant run --out'.")


def require_model(model: Path) -> None:
    """Raise BadInput where a folder holds no model, saying what makes one; readers check files."""
    from radiant_viewer.runs.run_view import no_model_text

    if not model.exists():
        raise BadInput(f"there is no {model}: name the folder of a run or a training, or a model file.")
    if model.is_dir() and not (model / "scene.ply").is_file():
        raise BadInput(no_model_text(model))


def require_file_to_be(out: Path) -> None:
    """Raise BadInput when `out` exists already or its folder can be none."""
    if out.exists():
        raise BadInput(f"{out} exists: choose another name.")
    require_folder_for(out)


@contextmanager
def libraries_log_to(path: Path) -> Iterator[None]:
    """Redirect standard error of C++ libraries to a file, as in a run; Python's stays visible.
    Without effect if Python's standard error is not that of the process, as in tests."""
    stderr = sys.stderr
    try:
        is_process_stderr = stderr.fileno() == 2
    except (AttributeError, OSError, ValueError):
        is_process_stderr = False
    if not is_process_stderr:
        yield
        return
    with os.fdopen(os.dup(2), "w", buffering=1, encoding=stderr.encoding, errors=stderr.errors) as terminal, path.open("a") as log:
        stderr.flush()
        os.dup2(log.fileno(), 2)
        sys.stderr = terminal
        try:
            yield
        finally:
            sys.stderr = stderr
            os.dup2(terminal.fileno(), 2)


@contextmanager
def stage_bar(display: ProgressDisplay, stage: str) -> Iterator[Any]:
    """A progress bar of its own for one step; yields `report(done, total, note)`."""
    with display:
        display(StageStarted(stage=stage))
        yield lambda num_done, total, note: display(StageProgress(stage=stage, done=num_done, total=total, note=note))
