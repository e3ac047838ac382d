"""What both joining tiers do with the models that arrive: refuse, bring into one frame, leave out
what contradicts. Once per join.

With frames by GPS each sender's frame is off by a few metres, degrees and per cent: the overlapping
geometry of the models brings them together, and a sender whose geometry contradicts its neighbours'
is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from radiant_core import __version__
from radiant_core.aggregate.agreement import MIN_AGREEMENT_DB, MIN_MODELS, find_contradictions
from radiant_core.aggregate.arrival import check_splats
from radiant_core.cameras import Cameras, number_cameras
from radiant_core.decisions import Decision
from radiant_core.frames import FrameUncertainty, Sim3
from radiant_core.geometry.frame_refinement import PlacedModel, RefinedFrame, refine_frames
from radiant_core.geometry.similarity import move_cameras, move_splats
from radiant_core.hierarchy.codec import task_key
from radiant_core.hierarchy.messages import CloudTask, DeviceModel, EdgeModel, EdgeTask
from radiant_core.hierarchy.reporter import Reporter
from radiant_core.io.run_store import content_key
from radiant_core.render.contract import Backend
from radiant_core.splats import Splats

UNMOVED = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))
"""The correction of a model that is where it belongs."""

Arrival = DeviceModel | EdgeModel | str
"""A model that arrived, or why the transport does not hand it over."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Arrivals:
    """The models that are joined, with their cameras, in one frame."""

    senders: tuple[str, ...]
    models: tuple[Splats, ...]
    cameras: tuple[Cameras, ...]
    corrections: dict[str, Sim3 | None]
    """How each sender's model was moved; None for one that is refused."""
    uncertainty: FrameUncertainty | None
    """How well the common frame is known; None where it is exact."""
    refused: dict[str, str]


def admit(arrived: Mapping[str, Arrival], num_dealt: Sequence[int], reporter: Reporter, backend: Backend = "auto") -> Arrivals:
    """The models that can be joined, in one frame; refused ones are reported with the reason.

    Args:
        arrived: by sender, in the order of the task.
        num_dealt: photographs dealt to each; more cameras than that are refused.
        reporter: hears who is left out and why.
        backend: renders models that are compared.
    """
    rejected: dict[str, str] = {}
    usable: dict[str, tuple[Splats, Cameras, FrameUncertainty | None]] = {}
    for (name, model), most in zip(arrived.items(), num_dealt, strict=True):
        outcome = model if isinstance(model, str) else _check_model(name, model, most)
        if isinstance(outcome, str):
            rejected[name] = outcome
            reporter.warn(f"the model of {name} is left out: {outcome}")
        else:
            usable[name] = outcome
    arrivals = _leave_out_contradicted(_bring_into_one_frame(usable, reporter), reporter, backend)
    corrections = {**arrivals.corrections, **dict.fromkeys(rejected)}
    return replace(arrivals, corrections=corrections, refused={**arrivals.refused, **rejected})


def join_key(task: EdgeTask | CloudTask, arrived: Mapping[str, Arrival]) -> str:
    """Hash of all that decides the bits of a join."""
    return content_key(__version__, task_key(task), received_files(arrived))


def received_files(arrived: Mapping[str, Arrival]) -> dict[str, str]:
    """SHA-256 of everything that arrived, by sender and name of the file."""
    models = {name: model for name, model in arrived.items() if not isinstance(model, str)}
    return {f"{name}/{file}": sha256 for name, model in models.items() for file, sha256 in model.received.items()}


def _check_model(name: str, model: DeviceModel | EdgeModel, num_dealt: int) -> tuple[Splats, Cameras, FrameUncertainty | None] | str:
    # Under numbers: one that gives its cameras another's names would end the joining for both.
    cameras = number_cameras(model.cameras, name)
    return model_problem(model, num_dealt) or (_require_splats(model.splats), cameras, model.uncertainty)


def _require_splats(splats: Splats | None) -> Splats:
    assert splats is not None
    return splats


def model_problem(model: DeviceModel | EdgeModel, num_dealt: int) -> str | None:
    """Why a model is refused by itself, one sentence, or None.

    More cameras than photographs were dealt are refused: joining takes time and memory per camera,
    so that one sender could spend what is there for all. Fewer are usual: some photographs are held
    out, have no pose, or add nothing.
    """
    if len(model.cameras) > num_dealt:
        return f"it sends {len(model.cameras):,} cameras, where {num_dealt:,} photographs were dealt to it."
    if model.uncertainty is not None and not len(model.cameras):
        return "it says how unsure its frame is, but sends no cameras to refine it by."
    return "it sends no model." if model.splats is None else check_splats(model.splats, model.cameras)


def _bring_into_one_frame(usable: Mapping[str, tuple[Splats, Cameras, FrameUncertainty | None]], reporter: Reporter) -> Arrivals:
    senders = tuple(usable)
    uncertainties = [uncertainty for _, _, uncertainty in usable.values() if uncertainty is not None]
    if len(uncertainties) < len(senders) or not senders:
        return _move_models(usable, [UNMOVED] * len(senders), None)
    placed = [
        PlacedModel(splats=model, cameras=cameras, uncertainty=uncertainty, name=name)
        for (name, (model, cameras, _)), uncertainty in zip(usable.items(), uncertainties, strict=True)
    ]
    refined = refine_frames(placed, reporter.progress)
    for name, frame in zip(senders, refined, strict=True):
        if frame.status == "refused":
            reporter.warn(f"the model of {name} is left out: {frame.reason}")
        else:
            reporter.decide(_refinement_decision(reporter.stage, name, frame))
    corrections = [None if frame.status == "refused" else frame.correction for frame in refined]
    refused = {name: frame.reason for name, frame in zip(senders, refined, strict=True) if frame.status == "refused"}
    # Joined, they are as sure of their place as the surest of them; beside each other, the next
    # tier can move them as one body only.
    accepted = [asdict(frame.uncertainty) for frame in refined if frame.status != "refused"]
    surest = min if are_one_group([frame.neighbours for frame in refined], [frame.status != "refused" for frame in refined]) else max
    common = FrameUncertainty(**{key: surest(one[key] for one in accepted) for key in accepted[0]}) if accepted else None
    return replace(_move_models(usable, corrections, common), refused=refused)


def are_one_group(neighbours: Sequence[Sequence[int]], keep_mask: Sequence[bool]) -> bool:
    """Whether all models that are kept are connected over their neighbours."""
    members = {index for index, keep in enumerate(keep_mask) if keep}
    reached: set[int] = set()
    waiting = sorted(members)[:1]
    while waiting:
        index = waiting.pop()
        reached.add(index)
        waiting += [neighbour for neighbour in neighbours[index] if neighbour not in reached]
    return reached >= members


def _move_models(
    usable: Mapping[str, tuple[Splats, Cameras, FrameUncertainty | None]],
    corrections: Sequence[Sim3 | None],
    common: FrameUncertainty | None,
) -> Arrivals:
    moves = dict(zip(usable, corrections, strict=True))
    placed = {name: move for name, move in moves.items() if move is not None}
    return Arrivals(
        senders=tuple(placed),
        models=tuple(usable[name][0] if move is UNMOVED else move_splats(usable[name][0], move) for name, move in placed.items()),
        cameras=tuple(move_cameras(usable[name][1], move) for name, move in placed.items()),
        corrections=moves,
        uncertainty=common,
        refused={},
    )


def _leave_out_contradicted(arrivals: Arrivals, reporter: Reporter, backend: Backend) -> Arrivals:
    """The arrivals without models that most of their neighbours contradict; a warning names two
    that contradict each other and stay."""
    agreement = find_contradictions(arrivals.models, arrivals.cameras, backend)
    for (first, second), agreement_db in agreement.ties.items():
        reporter.warn(
            f"the models of {arrivals.senders[first]} and {arrivals.senders[second]} contradict each other: {agreement_db:.1f} dB where "
            f"both show the same places, {MIN_AGREEMENT_DB:g} expected. Neither can be shown to be wrong, so both are joined: look at the "
            "photographs of both, or add a third that shows these places."
        )
    if len(arrivals.models) < MIN_MODELS or not np.isfinite(agreement.agreement_db).any():
        return arrivals
    refused = {arrivals.senders[index]: reason for index, reason in agreement.refused.items()}
    for name, reason in refused.items():
        reporter.warn(f"the model of {name} is left out: {reason}")
    reporter.decide(
        Decision(
            stage=reporter.stage,
            topic="models that contradict others",
            choice=f"{', '.join(refused)} left out" if refused else "all are joined",
            figure=float(np.nanmin(agreement.agreement_db)),
            unit="dB between the two that agree least",
            reason=f"a model is left out where most that show the same places contradict it, below {MIN_AGREEMENT_DB:g} dB",
        )
    )
    rows = [index for index, name in enumerate(arrivals.senders) if name not in refused]
    return replace(
        arrivals,
        senders=tuple(arrivals.senders[index] for index in rows),
        models=tuple(arrivals.models[index] for index in rows),
        cameras=tuple(arrivals.cameras[index] for index in rows),
        corrections={**arrivals.corrections, **dict.fromkeys(refused)},
        refused={**arrivals.refused, **refused},
    )


def _refinement_decision(stage: str, name: str, frame: RefinedFrame) -> Decision:
    moved_mm_per_m = 1e3 * abs(frame.correction.scale - 1)
    reason = frame.reason or f"geometry shared with {len(frame.neighbours)} neighbours; scale changed by {moved_mm_per_m:.1f} mm per m"
    choice = "stays where GPS puts it" if frame.status == "alone" else "moved onto its neighbours"
    return Decision(stage=stage, topic=f"frame of {name}", choice=choice, figure=frame.residual_m, unit="m residual", reason=reason)
