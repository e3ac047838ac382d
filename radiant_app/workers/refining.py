"""Workers that refine a joined scene: on a device by its photographs, on an edge and at the cloud
by averaging. Once per node and round.

Each works in a folder inside its node's (`refined_at`), signs with the key of that node and takes
the uploads of the senders that are registered there.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_app.reporting import EventReporter
from radiant_app.workers.delivering import belongs_to_run, deliver, find_refusals
from radiant_app.workers.inbox import REFUSED_NAME
from radiant_app.workers.tasks import OWN_NAME, AverageTask, FinishTask, Move, RefinementsTask, RefineNodeTask
from radiant_app.workers.training import MASKS, make_machine, remove_checkpoints
from radiant_core.aggregate.averaging import Refinement, admit_refinement, join_refinements, refine_scene, start_of_next_round
from radiant_core.aggregate.tree import refined_at
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.geometry.similarity import move_cameras
from radiant_core.hierarchy.codec import CAMERAS_NAME, load_refinement, save_refinement
from radiant_core.hierarchy.decisions import refinement_decision
from radiant_core.io.array_file import header_of, load_arrays, save_arrays
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import load_cameras, load_scene
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.upload import UploadFormat
from radiant_core.numerics import check_array
from radiant_core.splats import Splats

REFINED_SCENE, NEXT_SCENE = "refined/scene.ply", "refined/next/scene.ply"
"""What the cloud writes in the folder of a round: the scene, and where the next round starts."""
KEPT_SCENE = "kept/scene.ply"
"""What the round before made, in the cloud's folder of a round from the second on."""
COUNTED, COUNTED_SCHEMA = "counted", "radiant.counted"
MIN_ADMITTED = 0.9
"""A refinement of which a smaller share counts is warned about: of honest ones 99.9 % do."""
NOT_ADMITTED = "the others changed more than refining does, or are not shown by its cameras."
NOTHING_REFINED = "it changed no Gaussian of the scene; its decisions say where memory was too small."


def run_refine(folder: Path, task: RefineNodeTask, reporter: EventReporter) -> Sequence[str]:
    """Fit the scene to the photographs that the device trained on."""
    # Averaging needs no torch.
    from radiant_core.hierarchy.refine import refine_device
    from radiant_core.train.photographs import load_training_views
    from radiant_core.train.worth import worth_training

    device_folder, scene = folder.parent, load_ply(folder / "scene.ply")
    placed = load_scene(device_folder / "scene.safetensors")
    views = load_training_views(photographs_of(device_folder), placed.cameras.scaled(task.train.long_side_px), device_folder / MASKS)
    # As in training: what repeats another one or is blurred says nothing.
    _, views, _ = worth_training(placed, views, task.train)
    views = replace(views, cameras=correct_cameras(views.cameras, task.corrections))
    machine = make_machine(folder, task, reporter, limited=task.memory_bytes is not None)
    refinement = refine_device(task, scene, views, reporter, machine)
    names = _save_and_sign(folder, refinement, scene, task.upload, reporter)
    remove_checkpoints(folder)
    return names


def run_average(folder: Path, task: AverageTask, reporter: EventReporter) -> Sequence[str]:
    """Average what an edge's devices refined, by what their photographs show."""
    scene = load_ply(folder / "scene.ply")
    moves, inbox = dict(zip(task.senders, task.corrections, strict=True)), folder.parent / "inbox"
    counted_in, refused = dict(zip(task.senders, task.counted_in, strict=True)), dict[str, str]()
    # What another try counted of devices that are not among the senders now.
    shutil.rmtree(folder / COUNTED, ignore_errors=True)

    def admitted() -> Iterator[Refinement]:
        for name, refinement in _receive(folder, task, scene, refused, reporter):
            if number := counted_in[name]:
                counts = _load_shown(Path(refined_at(str(folder.parent), number)) / counted_file(name), scene)
            else:
                cameras = correct_cameras(load_cameras(inbox / name / CAMERAS_NAME), moves[name]).scaled(task.long_side_px)
                counts = _count_shown(folder / counted_file(name), scene, cameras, task)
            admitted_part = admit_refinement(refinement, scene, counts)
            if len(admitted_part.rows) < MIN_ADMITTED * len(refinement.rows):
                reporter.warn(
                    f"of the refinement of {name} {len(admitted_part.rows):,} of {len(refinement.rows):,} Gaussians count: {NOT_ADMITTED}"
                )
            if len(refinement.rows) and not len(admitted_part.rows):
                refused[name] = f"none of its {len(refinement.rows):,} Gaussians counts: {NOT_ADMITTED}"
            yield admitted_part

    refinement = join_refinements(admitted(), scene)
    write_json(folder / REFUSED_NAME, refused)
    counted = [file for name in task.senders if (folder / (file := counted_file(name))).is_file()]
    return [REFUSED_NAME, *counted, *_save_and_sign(folder, refinement, scene, task.upload, reporter)]


def run_finish(folder: Path, task: FinishTask, reporter: EventReporter) -> Sequence[str]:
    """Put the mean of what the edges sent into the scene."""
    scene = load_ply(folder / "scene.ply")
    counts: list[int] = []
    refused: dict[str, str] = {}

    def admitted() -> Iterator[Refinement]:
        for _, refinement in _receive(folder, task, scene, refused, reporter):
            counts.append(len((admitted_part := admit_refinement(refinement, scene)).rows))
            yield admitted_part

    made_before = load_ply(folder / KEPT_SCENE) if (folder / KEPT_SCENE).is_file() else None
    refined = refine_scene(scene, admitted(), made_before)
    del made_before
    reporter.decide(refinement_decision(reporter.stage, counts, scene))
    write_json(folder / REFUSED_NAME, refused)
    files = {REFINED_SCENE: refined} | ({NEXT_SCENE: start_of_next_round(scene, refined)} if task.another_round else {})
    for name, splats in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        save_ply(folder / name, splats)
    return [*files, REFUSED_NAME]


def counted_file(device: str) -> str:
    """Where an edge keeps, in the folder of a round, what it counted of what a device's photographs
    show. It stays there: what later rounds need of it they read there."""
    return f"{COUNTED}/{device}.safetensors"


def is_counted(path: Path, joined: str) -> bool:
    """Whether a file holds a count of the scene with this hash."""
    try:
        record, _ = header_of(path)
    except (StoreDamaged, BadInput):
        return False
    return record.get("schema") == COUNTED_SCHEMA and record.get("about") == {"joined": joined}


def _load_shown(path: Path, scene: Splats) -> NDArray[np.float32]:
    arrays, _ = load_arrays(path, COUNTED_SCHEMA, {"photographs": "F32"})
    return check_array("photographs", arrays["photographs"], (len(scene),), np.float32)


def _count_shown(path: Path, scene: Splats, cameras: Cameras, task: AverageTask) -> NDArray[np.float32]:
    """What each of N Gaussians makes of a device's photographs, (N,): counted once, since they move
    little from round to round."""
    # At the cloud, and in later rounds, averaging needs no torch.
    from radiant_core.evaluate.shown_pixels import count_shown_photographs

    counts = count_shown_photographs(scene, cameras, task.backend).astype(np.float32)
    path.parent.mkdir(exist_ok=True)
    save_arrays(path, COUNTED_SCHEMA, {"photographs": counts}, {"joined": task.joined})
    return counts


def photographs_of(folder: Path) -> Path:
    """The folder of the photographs that the device in `folder` trained on."""
    return Path(read_json(folder / OWN_NAME, ("images",))["images"]) if (folder / OWN_NAME).is_file() else folder / "photos"


def correct_cameras(cameras: Cameras, corrections: Sequence[Move]) -> Cameras:
    """A machine's cameras in the frame of the scene."""
    for move in corrections:
        cameras = move_cameras(cameras, move.sim3)
    return cameras


def _receive(
    folder: Path, task: RefinementsTask, scene: Splats, refused: dict[str, str], reporter: EventReporter
) -> Iterator[tuple[str, Refinement]]:
    """The refinements that can be used, one at a time, in the order of their senders; the others'
    reasons are added to `refused`, those of senders that changed nothing too."""
    places = {name: folder / "inbox" / name for name in task.senders}
    rejected = find_refusals(folder, task.senders, places, "refinement", folder.parent) if belongs_to_run(folder) else {}
    for (name, place), num_dealt in zip(places.items(), task.num_dealt, strict=True):
        refinement = rejected.get(name) or load_refinement(place, scene, num_dealt)
        if isinstance(refinement, str):
            refused[name] = refinement
            reporter.warn(f"the refinement of {name} is left out: {refinement}")
            continue
        if not len(refinement.rows):
            refused[name] = NOTHING_REFINED
        yield name, refinement


def _save_and_sign(folder: Path, refinement: Refinement, scene: Splats, upload: UploadFormat, reporter: EventReporter) -> list[str]:
    names = save_refinement(folder, refinement, scene, upload, reporter.warn)
    if not belongs_to_run(folder):
        return names
    return [*names, *deliver(folder, {name: folder / name for name in names}, "refinement", folder.parent)]
