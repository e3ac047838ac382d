"""What arrived at an edge or at the cloud: the senders' models and cameras, brought into one frame.

With frames by GPS each sender's own frame is off by a few metres, degrees and per cent: the models' overlapping geometry brings them
together, and a sender that it contradicts is left out. Once per edge and once at the cloud.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.events import Decided, Event, StageProgress, Warned
from radiant_app.workers.delivering import refusals
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.io.records import load_cameras
from radiant_core.io.run_store import read_json, write_json
from radiant_core.splats import Splats

Emit = Callable[[Event], None]

NOTHING = {"num_splats": 0, "model_bytes": 0, "num_steps": 0, "train_s": 0.0, "first_loss": 0.0, "last_loss": 0.0}
"""The summary of a node that delivers no model."""
MAX_FRAME_BYTES = 1 << 12
MAX_UNCERTAINTY = 1e6
"""In m, rad or as a share: more is no frame."""
REFUSED_NAME = "refused.json"
"""Senders that a node refused → why. It stays there."""
VIRTUAL_CAMERAS, VIRTUAL_VIEWS = "virtual_cameras.safetensors", "virtual_views.safetensors"
"""Where the cloud looks at an edge's model from, and the pictures there of the models that it was made of, none where the edge retrained.
"""
NO_CAMERAS = concatenate_cameras([])
_UNMOVED = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Inbox:
    """Models that arrived, with their cameras, in one frame; `corrections` by sender, None for one that is refused, with its reason."""

    senders: tuple[str, ...]
    models: tuple[Splats, ...]
    cameras: tuple[Cameras, ...]
    corrections: dict[str, Sim3 | None]
    uncertainty: dict[str, float] | None
    refused: dict[str, str]


def read_inbox(
    folder: Path, senders: Sequence[str], stage: str, emit: Emit, *, signed: bool = False, dealt: Mapping[str, int] | None = None
) -> Inbox:
    """The models in inbox/<sender>/ that pass `check_splats`, brought together through their geometry; with `signed` only those whose
    sender's signature is right, with `dealt` only those that send no more cameras than photographs were dealt to them."""
    places = {name: folder / "inbox" / name for name in senders}
    rejected = refusals(folder, senders, places) if signed else {}
    arrived = {}
    for name in senders:
        if name not in rejected:
            found = _arrived(places[name], None if dealt is None else dealt[name])
            if isinstance(found, str):
                rejected[name] = found
            else:
                arrived[name] = found
        if name in rejected:
            emit(Warned(stage=stage, message=f"the model of {name} is left out: {rejected[name]}"))
    inbox = _without_contradicted(_joined(folder, arrived, stage, emit), stage, emit)
    return replace(inbox, corrections={**inbox.corrections, **dict.fromkeys(rejected)}, refused={**inbox.refused, **rejected})


def _without_contradicted(inbox: Inbox, stage: str, emit: Emit) -> Inbox:
    """The inbox without models that most of their neighbours contradict."""
    from radiant_core.aggregate.agreement import MIN_AGREEMENT_DB, contradicted

    found = contradicted(inbox.models, inbox.cameras)
    if not np.isfinite(found.agreement_db).any():
        return inbox
    refused = {inbox.senders[index]: reason for index, reason in found.refused.items()}
    for name, reason in refused.items():
        emit(Warned(stage=stage, message=f"the model of {name} is left out: {reason}"))
    choice = f"{', '.join(refused)} left out" if refused else "all are joined"
    decision = Decision(
        stage=stage,
        topic="models that contradict others",
        choice=choice,
        figure=float(np.nanmin(found.agreement_db)),
        unit="dB between the two that agree least",
        reason=f"a model is left out where most that show the same places contradict it, below {MIN_AGREEMENT_DB:g} dB",
    )
    emit(Decided(decision=decision))
    kept = [index for index, name in enumerate(inbox.senders) if name not in refused]
    return replace(
        inbox,
        senders=tuple(inbox.senders[index] for index in kept),
        models=tuple(inbox.models[index] for index in kept),
        cameras=tuple(inbox.cameras[index] for index in kept),
        corrections={**inbox.corrections, **dict.fromkeys(refused)},
        refused={**inbox.refused, **refused},
    )


def dealt_to(senders: Sequence[str], task: Mapping[str, Any]) -> dict[str, int] | None:
    """How many photographs were dealt to each sender, as a node's task says; None where a task made by hand does not."""
    return dict(zip(senders, task["num_dealt"], strict=True)) if "num_dealt" in task else None


def too_many_cameras(cameras: Cameras, num_dealt: int | None) -> str | None:
    """Why a sender with these cameras is refused: joining takes time and memory per camera, so that one could spend what is there for all.
    Fewer are usual: some photographs are held out, have no pose, or add nothing."""
    if num_dealt is None or len(cameras) <= num_dealt:
        return None
    return f"it sends {len(cameras):,} cameras, where {num_dealt:,} photographs were dealt to it."


def _arrived(place: Path, num_dealt: int | None) -> tuple[Splats, Cameras] | str:
    """A sender's model and cameras, or why they are not to be used."""
    from radiant_core.aggregate.arrival import load_arrived

    try:
        # Under numbers: one that gives its cameras another's names would end the joining for both.
        own = numbered(_cameras_in(place), place.name)
        if reason := too_many_cameras(own, num_dealt):
            return reason
        if _uncertainty_in(place) is not None and not len(own):
            return "it says how unsure its frame is, but sends no cameras to refine it by."
    except BadInput as error:
        return str(error)
    model = load_arrived(place / "model.safetensors", own)
    return model if isinstance(model, str) else (model, own)


def _uncertainty_in(place: Path) -> dict[str, float] | None:
    """How sure a sender's frame is; None where it says that it is exact, or nothing. BadInput where it says anything else."""
    from radiant_core.sfm.world_frame.device_frame import FrameUncertainty

    if not (place / "frame.json").is_file():
        return None
    found = read_json(place / "frame.json", ("uncertainty",), MAX_FRAME_BYTES)["uncertainty"]
    names = {field.name for field in fields(FrameUncertainty)}
    if found is None:
        return None
    if (
        not isinstance(found, dict)
        or found.keys() != names
        or not all(type(value) in (int, float) and 0 < value <= MAX_UNCERTAINTY for value in found.values())
    ):
        raise BadInput(f"{place / 'frame.json'} says an uncertainty that is none, expected {', '.join(sorted(names))} of more than 0.")
    return {name: float(value) for name, value in found.items()}


def _joined(folder: Path, arrived: dict[str, tuple[Splats, Cameras]], stage: str, emit: Emit) -> Inbox:
    """The models that may be joined, in one frame."""
    senders = tuple(arrived)
    places = [folder / "inbox" / name for name in senders]
    models, cameras = [model for model, _ in arrived.values()], [own for _, own in arrived.values()]
    uncertainties = [_uncertainty_in(place) for place in places]
    known = [uncertainty for uncertainty in uncertainties if uncertainty is not None]
    if len(known) < len(senders) or not senders:
        return _together(senders, models, cameras, [_UNMOVED] * len(senders), None)
    from radiant_core.geometry.frame_refinement import PlacedModel, refine_frames
    from radiant_core.sfm.world_frame.device_frame import FrameUncertainty

    placed = [
        PlacedModel(splats=model, cameras=own, uncertainty=FrameUncertainty(**uncertainty), name=name)
        for name, model, own, uncertainty in zip(senders, models, cameras, known, strict=True)
    ]
    refined = refine_frames(placed, lambda done, total, note: emit(StageProgress(stage=stage, done=done, total=total, note=note)))
    for name, frame in zip(senders, refined, strict=True):
        if frame.status == "refused":
            emit(Warned(stage=stage, message=f"the model of {name} is left out: {frame.reason}"))
        else:
            emit(Decided(decision=_refinement_decision(stage, name, frame)))
    corrections = [None if frame.status == "refused" else frame.correction for frame in refined]
    refused = {name: frame.reason for name, frame in zip(senders, refined, strict=True) if frame.status == "refused"}
    # Joined, they are as sure of their place as the surest of them; beside each other, the next tier can move them as one body only.
    left = [asdict(frame.uncertainty) for frame in refined if frame.status != "refused"]
    surest = min if _are_one_group([frame.neighbours for frame in refined], [frame.status != "refused" for frame in refined]) else max
    joined = {key: surest(one[key] for one in left) for key in left[0]} if left else None
    return replace(_together(senders, models, cameras, corrections, joined), refused=refused)


def _are_one_group(neighbours: Sequence[Sequence[int]], kept: Sequence[bool]) -> bool:
    """Whether all models that are kept hang together over their neighbours."""
    members = {index for index, keep in enumerate(kept) if keep}
    reached: set[int] = set()
    waiting = sorted(members)[:1]
    while waiting:
        index = waiting.pop()
        reached.add(index)
        waiting += [other for other in neighbours[index] if other not in reached]
    return reached >= members


def _cameras_in(place: Path) -> Cameras:
    """A device's poses, an edge's virtual ones, or none where none were sent."""
    found = [place / name for name in ("cameras.safetensors", VIRTUAL_CAMERAS) if (place / name).is_file()]
    return load_cameras(found[0]) if found else NO_CAMERAS


def _together(
    senders: Sequence[str],
    models: Sequence[Splats],
    cameras: Sequence[Cameras],
    corrections: Sequence[Sim3 | None],
    joined: dict[str, float] | None,
) -> Inbox:
    kept = [index for index, correction in enumerate(corrections) if correction is not None]
    moves = [corrections[index] or _UNMOVED for index in kept]
    return Inbox(
        senders=tuple(senders[index] for index in kept),
        models=tuple(_moved(models[index], move) for index, move in zip(kept, moves, strict=True)),
        cameras=tuple(moved_cameras(cameras[index], move) for index, move in zip(kept, moves, strict=True)),
        corrections=dict(zip(senders, corrections, strict=True)),
        uncertainty=joined,
        refused={},
    )


def _moved(model: Splats, move: Sim3) -> Splats:
    if move is _UNMOVED:
        return model
    from radiant_core.geometry.similarity import move_splats

    return move_splats(model, move)


def moved_cameras(cameras: Cameras, move: Sim3) -> Cameras:
    """The same cameras seen from the frame that `move` leads to."""
    return replace(cameras, cam_from_world=move.apply_to_poses(cameras.cam_from_world))


def save_frames(folder: Path, inbox: Inbox) -> list[str]:
    """Write how each sender was moved, who is refused and why, and how sure the joined frame is; returns the names of the files.

    frame.json goes up to the next tier, which is to learn nothing of the senders: it names none of them.
    """
    moves = {name: None if move is None else sim3_record(move) for name, move in inbox.corrections.items()}
    write_json(folder / "corrections.json", moves)
    write_json(folder / REFUSED_NAME, inbox.refused)
    status = "placed" if inbox.models else "missing"
    write_json(folder / "frame.json", {"status": status, "reason": "", "uncertainty": inbox.uncertainty})
    return ["corrections.json", REFUSED_NAME, "frame.json"]


def sim3_record(move: Sim3) -> dict[str, Any]:
    """A similarity as plain numbers."""
    return {"scale": move.scale, "rotation": move.rotation.tolist(), "translation": move.translation.tolist()}


def sim3_of(record: dict[str, Any]) -> Sim3:
    """The similarity that `sim3_record` wrote."""
    return Sim3(scale=record["scale"], rotation=np.array(record["rotation"]), translation=np.array(record["translation"]))


def _refinement_decision(stage: str, name: str, frame: Any) -> Decision:
    moved_mm_per_m = 1e3 * abs(frame.correction.scale - 1)
    reason = frame.reason or f"geometry shared with {len(frame.neighbours)} neighbours; scale changed by {moved_mm_per_m:.1f} mm per m"
    choice = "stays where GPS puts it" if frame.status == "alone" else "moved onto its neighbours"
    return Decision(stage=stage, topic=f"frame of {name}", choice=choice, figure=frame.residual_m, unit="m residual", reason=reason)


def numbered(cameras: Cameras, prefix: str) -> Cameras:
    """The same cameras named prefix/0000, prefix/0001, …: names of files are their owner's business."""
    return replace(cameras, names=tuple(f"{prefix}/{index:04d}" for index in range(len(cameras))))
