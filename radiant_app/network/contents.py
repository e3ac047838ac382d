"""What stands in the small files of a result, parsed before it counts as one. Once per result.

    check_result   the files of a result say what its kind says, or it is refused by its node's name
    open_report    what an edge says of each of its devices: one that is wrong is left out alone

Models, cameras, scenes and refinements have readers of their own, which the process that joins
them calls; here is what the conductor itself reads. Texts are kept without control characters.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, ValidationError, model_validator

from radiant_app.events import Decided, Warned
from radiant_app.network.kinds import MAX_SMALL_BYTES, NOTES_NAME, REPORT_NAME
from radiant_app.network.messages import DevicesReport
from radiant_app.network.reception import plain_text
from radiant_app.reporting import read_notes
from radiant_app.strangers import WRONG, UntrustedRecord, parse_record
from radiant_app.workers.inbox import CORRECTIONS_NAME, REFUSED_NAME, load_corrections
from radiant_app.workers.rasters import Raster, count_of, raster_of
from radiant_app.workers.scores import Scores, scores_of
from radiant_core.aggregate.arrival import MAX_SPLATS
from radiant_core.errors import BadInput
from radiant_core.hierarchy.codec import (
    CAMERAS_NAME,
    FRAME_NAME,
    MAX_UNCERTAINTY,
    MODEL_NAME,
    SUMMARY_NAME,
    load_uncertainty,
    message_of,
    task_setting,
)
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME

MAX_REASON_CHARS = 4000
MAX_NOTES = 1000
"""Decisions and warnings of one result: a run keeps them all in its manifest."""
MOST = 1e15
Reason = Annotated[str, Field(max_length=MAX_REASON_CHARS), AfterValidator(plain_text)]
Figure = Annotated[int, Field(ge=-MOST, le=MOST)] | Annotated[float, Field(ge=-MOST, le=MOST)]
Deviation = Annotated[float, Field(gt=0, le=MAX_UNCERTAINTY)]


class Uncertainty(UntrustedRecord):
    """See `FrameUncertainty`."""

    position_m: Deviation
    scale: Deviation
    rotation_rad: Deviation


class FrameRecord(UntrustedRecord):
    """How a node's frame is known, or why it has no model."""

    status: Literal["placed", "missing"]
    reason: Reason
    uncertainty: Uncertainty | None


class Summary(UntrustedRecord):
    """A training's figures; those that everybody reads are always there."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Figure] = Field(init=False)  # pyright: ignore

    num_splats: int = Field(ge=0, le=MAX_SPLATS)
    model_bytes: int = Field(ge=0, le=MOST)
    num_steps: int = Field(ge=0, le=MOST)
    train_s: float = Field(ge=0, le=MOST)
    first_loss: float = Field(ge=-MOST, le=MOST)
    last_loss: float = Field(ge=-MOST, le=MOST)

    @model_validator(mode="after")
    def _check_sizes(self) -> Summary:
        if len(extra := self.model_extra or {}) > 64 or max(map(len, extra), default=0) > 64:
            raise ValueError("it has more figures than a training")
        return self


class DeviceRecord(UntrustedRecord):
    """What an edge says of a device in its region."""

    frame: FrameRecord
    summary: Summary


class _Nothing(UntrustedRecord):
    pass


@dataclass(frozen=True, kw_only=True)
class OpenedReport:
    """See `DevicesReport`."""

    records: dict[str, Any]
    """Device → what it sent, as its type: a number, a `Raster`, a `DeviceRecord` or `Scores`."""
    missing: dict[str, str]


def check_result(kind: str, folder: Path, names: Collection[str]) -> None:
    """Raise BadInput unless the small files of a result say what its kind says."""
    checks: dict[str, Callable[[Path, Collection[str]], object]] = {
        "count": lambda place, _: check_count(_read_bounded(place / "count.json")),
        "raster": lambda place, _: raster_of(_read_bounded(place / "raster.json"), task_setting(place, "frames")),
        "own_field": _check_model,
        "region": _check_region,
        "score": lambda place, _: check_scores(_read_bounded(place / "scores.json")),
    }
    if kind in checks:
        _checked(f"a file of {kind} is none", lambda: checks[kind](folder, names))
    if REPORT_NAME in names:
        _checked(f"{REPORT_NAME} is none", lambda: load_report(folder))
    if REFUSED_NAME in names:
        _checked(f"{REFUSED_NAME} is none", lambda: _settle_refused(folder))


def settle_notes(folder: Path, stage: str) -> None:
    """Keep of a stranger's notes what may be heard: bounded, as those of its own stage, in texts
    without control characters. BadInput where they are none."""
    notes = read_notes(folder, stage)
    if len(notes) > MAX_NOTES:
        raise BadInput(f"it notes {len(notes):,} decisions and warnings, expected at most {MAX_NOTES:,}: {WRONG}.")
    decisions, warnings = list[dict[str, Any]](), list[str]()
    for event in notes:
        if isinstance(event, Decided):
            decision = asdict(replace(event.decision, stage=stage))
            decisions.append({name: plain_text(value) if isinstance(value, str) else value for name, value in decision.items()})
        elif isinstance(event, Warned):
            warnings.append(plain_text(event.message))
    write_json(folder / NOTES_NAME, {"decisions": decisions, "warnings": warnings})


def load_report(folder: Path) -> DevicesReport:
    """The report of an edge, in which nothing of a device was parsed; BadInput where it is none."""
    record = _read_bounded(folder / REPORT_NAME)
    if not isinstance(record, dict):
        raise BadInput(f"{REPORT_NAME} is no object: {WRONG}.")
    report = message_of(DevicesReport, record, REPORT_NAME)
    return replace(report, missing=_reasons(report.missing, REPORT_NAME))


def open_report(kind: str, folder: Path, frames: str | None = None) -> OpenedReport:
    """The report of an edge. A device of which it says something else than its kind is missing,
    with the reason; BadInput where it is no report."""
    parse: dict[str, Callable[[Any], Any]] = {
        "edge_count": count_of,
        "edge_raster": lambda record: raster_of(record, frames),
        "region": lambda record: parse_record(DeviceRecord, record, "a device's model"),
        "edge_refine": lambda record: parse_record(_Nothing, record, "a refinement"),
        "edge_score": scores_of,
    }
    report = load_report(folder)
    records, missing = dict[str, Any](), dict(report.missing)
    for device, record in report.found.items():
        try:
            records[device] = parse[kind](record)
        except BadInput as error:
            missing[device] = str(error)
    return OpenedReport(records=records, missing=missing)


def check_count(record: Any) -> int:
    """The number of photographs that a device says it has."""
    return count_of(record)


def check_raster(record: Any) -> Raster:
    """A device's raster; BadInput where it is none."""
    return raster_of(record)


def check_scores(record: Any) -> Scores:
    """A device's figures; BadInput where these are none."""
    return scores_of(record)


def check_frame(frame: Any) -> FrameRecord:
    """How a device's frame is known, or why there is no model; BadInput where this says neither."""
    return parse_record(FrameRecord, frame, FRAME_NAME)


def check_summary(record: Any) -> Summary:
    """A training's figures; BadInput where these are none."""
    return parse_record(Summary, record, SUMMARY_NAME)


def _read_bounded(path: Path) -> Any:
    return read_json(path, max_bytes=MAX_SMALL_BYTES)


def _check_model(folder: Path, names: Collection[str]) -> None:
    """A device's frame and figures; with a place in the common frame the model that is said."""
    frame = check_frame(_read_bounded(folder / FRAME_NAME))
    load_uncertainty(folder)
    check_summary(_read_bounded(folder / SUMMARY_NAME))
    if frame.status == "placed" and not {MODEL_NAME, CAMERAS_NAME, RECORD_NAME, SIGNATURE_NAME} <= {*names}:
        raise BadInput(f"a device says that it has a model and sends none: {WRONG}.")


def _check_region(folder: Path, names: Collection[str]) -> None:
    """What an edge says of its join."""
    if FRAME_NAME not in names:
        if MODEL_NAME in names:
            raise BadInput(f"an edge sends a model and no {FRAME_NAME}: {WRONG}.")
        return
    needed = {FRAME_NAME, SUMMARY_NAME, CORRECTIONS_NAME, REFUSED_NAME, NOTES_NAME}
    if not needed <= {*names}:
        raise BadInput(f"an edge joined and sends no {sorted(needed - {*names})[0]}: {WRONG}.")
    frame = check_frame(_read_bounded(folder / FRAME_NAME))
    load_uncertainty(folder)
    check_summary(_read_bounded(folder / SUMMARY_NAME))
    moves = load_corrections(folder)
    _require_devices(folder, moves, CORRECTIONS_NAME)
    if frame.status == "placed" and not {MODEL_NAME, RECORD_NAME, SIGNATURE_NAME} <= {*names}:
        raise BadInput(f"an edge says that it has a model and sends none: {WRONG}.")
    if frame.status == "placed" and not any(move is not None for move in moves.values()):
        raise BadInput(f"an edge says that it has a model, and moved that of no device: {WRONG}.")


def _settle_refused(folder: Path) -> None:
    """Keep the reasons without control characters."""
    reasons = _reasons(_read_bounded(folder / REFUSED_NAME), REFUSED_NAME)
    _require_devices(folder, reasons, REFUSED_NAME)
    write_json(folder / REFUSED_NAME, reasons)


def _require_devices(folder: Path, named: Collection[str], name: str) -> None:
    """Raise BadInput where an edge speaks of a device that the task beside it does not name."""
    requested = task_setting(folder, "devices")
    if isinstance(requested, list) and (strange := sorted({*named} - {*requested})):
        raise BadInput(f"{name} speaks of the device {strange[0][:80]!r}, which is none of this edge: {WRONG}.")


class _Reasons(UntrustedRecord):
    reasons: dict[str, Reason]


def _reasons(record: Mapping[str, Any] | Any, name: str) -> dict[str, str]:
    return dict(parse_record(_Reasons, {"reasons": record}, name).reasons)


def _checked(subject: str, check: Callable[[], object]) -> None:
    """Call a check; what a stranger's file makes our readers raise is bad input."""
    try:
        check()
    except BadInput:
        raise
    except (ValidationError, KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise BadInput(f"{subject} ({type(error).__name__}): {WRONG}.") from error
