"""What stands in the small files of a result, checked before it counts as one. Once per result.

Models, cameras, scenes and refinements have readers of their own, which the process that joins
them calls; here is what the conductor itself reads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from pydantic import FiniteFloat, TypeAdapter, ValidationError

from radiant_app.network.kinds import MAX_SMALL_BYTES, NOTES_NAME, REPORT_NAME
from radiant_app.network.messages import DevicesReport
from radiant_app.workers.inbox import CORRECTIONS_NAME, REFUSED_NAME, load_corrections
from radiant_app.workers.reporting import read_notes
from radiant_core.choices import Version
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import FIGURES
from radiant_core.evaluate.seam_excess import BorderError
from radiant_core.io.messages import CAMERAS_NAME, FRAME_NAME, MODEL_NAME, SUMMARY_NAME, load_uncertainty, message_of
from radiant_core.io.run_store import read_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME

MAX_REASON_CHARS = 4000
MAX_COUNT = 10**8
MODEL_FIGURES = ("num_splats", "num_steps", "train_s")
_WRONG = "use the same version of the software on both sides, or look at the disk of that machine"


def check_result(kind: str, folder: Path, names: Collection[str]) -> None:
    """Raise BadInput unless the small files of a result say what its kind says."""
    if NOTES_NAME in names:
        _checked(f"{NOTES_NAME} is none", lambda: read_notes(folder, ""))
    checks: dict[str, Callable[[Path, Collection[str]], None]] = {
        "count": _check_count,
        "raster": lambda place, _: check_raster(read_json(place / "raster.json", max_bytes=MAX_SMALL_BYTES)),
        "own_field": _check_model,
        "region": _check_region,
        "score": lambda place, _: check_scores(read_json(place / "scores.json", max_bytes=MAX_SMALL_BYTES)),
    }
    if kind in checks:
        _checked(f"a file of {kind} is none", lambda: checks[kind](folder, names))
    if REPORT_NAME in names:
        _checked(f"{REPORT_NAME} is none", lambda: _check_report(kind, folder))
    if REFUSED_NAME in names:
        _texts(read_json(folder / REFUSED_NAME), REFUSED_NAME)


def load_report(folder: Path) -> DevicesReport:
    """The report of an edge; BadInput where it is none."""
    record = read_json(folder / REPORT_NAME, max_bytes=MAX_SMALL_BYTES)
    if not isinstance(record, dict):
        raise BadInput(f"{REPORT_NAME} is no object: {_WRONG}.")
    return message_of(DevicesReport, record, REPORT_NAME)


def check_count(record: Any) -> int:
    """The number of photographs that a device says it has."""
    number = record.get("num_photographs") if isinstance(record, dict) and record.keys() == {"num_photographs"} else None
    if type(number) is not int or not 0 <= number <= MAX_COUNT:
        raise BadInput(f"a device counts {str(record)[:80]} photographs: {_WRONG}.")
    return number


def check_raster(record: Any) -> None:
    """Raise BadInput unless this is a device's raster: finite cells with counts."""
    if not isinstance(record, dict) or record.keys() != {"cells", "altitude_m", "num_photographs", "num_unplaced"}:
        raise BadInput(f"a raster has other fields than ours: {_WRONG}.")
    rows, altitude_m = record["cells"], record["altitude_m"]
    if not isinstance(rows, list) or not all(isinstance(row, list) and len(row) == 3 for row in rows):
        raise BadInput(f"a raster has cells that are none: {_WRONG}.")
    for first, second, count in rows:
        if not (_is_finite(first) and _is_finite(second) and type(count) is int and 1 <= count <= MAX_COUNT):
            raise BadInput(f"a raster has the cell {str([first, second, count])[:80]}: {_WRONG}.")
    counts = [record["num_photographs"], record["num_unplaced"]]
    if not all(type(count) is int and 0 <= count <= MAX_COUNT for count in counts) or not (altitude_m is None or _is_finite(altitude_m)):
        raise BadInput(f"a raster counts {str(counts)[:80]} photographs: {_WRONG}.")
    if sum(count for _, _, count in rows) > counts[0]:
        raise BadInput(f"a raster's cells hold more than its {counts[0]} photographs: {_WRONG}.")


def check_scores(record: Any) -> None:
    """Raise BadInput unless these are a device's figures."""
    if (
        not isinstance(record, dict)
        or record.keys() != {"images", "borders", "leakage", "versions"}
        or not isinstance(record["images"], list)
    ):
        raise BadInput(f"scores have other fields than ours: {_WRONG}.")
    for row in record["images"]:
        figures = dict(row) if isinstance(row, dict) else {}
        if not isinstance(figures.pop("name", None), str) or not {*FIGURES} <= figures.keys():
            raise BadInput(f"a score has the row {str(row)[:80]}: {_WRONG}.")
        if not all(value is None or _is_finite(value) for value in figures.values()):
            raise BadInput(f"a score has the row {str(row)[:80]}: {_WRONG}.")
    TypeAdapter(dict[Version, list[FiniteFloat]]).validate_python(record["versions"], strict=True)
    if any(len(figures) != len(record["images"]) for figures in record["versions"].values()):
        raise BadInput(f"scores compare versions in other photographs than they score: {_WRONG}.")
    TypeAdapter(list[BorderError]).validate_python(record["borders"])
    leakage = record["leakage"]
    if leakage is not None and not (isinstance(leakage, dict) and all(_is_finite(value) for value in leakage.values())):
        raise BadInput(f"scores have a leakage that is none: {_WRONG}.")


def _check_count(folder: Path, names: Collection[str]) -> None:
    del names
    check_count(read_json(folder / "count.json"))


def _check_model(folder: Path, names: Collection[str]) -> None:
    """A device's frame and figures; with a place in the common frame the model that is said."""
    check_frame(read_json(folder / FRAME_NAME))
    load_uncertainty(folder)
    check_summary(read_json(folder / SUMMARY_NAME))
    placed = read_json(folder / FRAME_NAME)["status"] == "placed"
    if placed and not {MODEL_NAME, CAMERAS_NAME, RECORD_NAME, SIGNATURE_NAME} <= {*names}:
        raise BadInput(f"a device says that it has a model and sends none: {_WRONG}.")


def check_frame(frame: Any) -> None:
    """Raise BadInput unless this says how a device's frame is known, or why there is no model."""
    if not isinstance(frame, dict) or frame.keys() != {"status", "reason", "uncertainty"} or frame["status"] not in ("placed", "missing"):
        raise BadInput(f"{FRAME_NAME} has other fields than ours: {_WRONG}.")
    if not isinstance(frame["reason"], str) or len(frame["reason"]) > MAX_REASON_CHARS:
        raise BadInput(f"{FRAME_NAME} gives no reason: {_WRONG}.")


def check_summary(record: Any) -> None:
    """Raise BadInput unless these are a training's figures."""
    if not isinstance(record, dict) or not all(_is_finite(value) for value in record.values()):
        raise BadInput(f"{SUMMARY_NAME} holds something else than numbers: {_WRONG}.")
    if record.get("num_splats", 0) and not {*MODEL_FIGURES} <= record.keys():
        raise BadInput(f"{SUMMARY_NAME} lacks one of {', '.join(MODEL_FIGURES)}: {_WRONG}.")


def _check_region(folder: Path, names: Collection[str]) -> None:
    """What an edge says of its join."""
    if FRAME_NAME not in names:
        return
    _check = {FRAME_NAME, SUMMARY_NAME, CORRECTIONS_NAME, REFUSED_NAME, NOTES_NAME}
    if not _check <= {*names}:
        raise BadInput(f"an edge joined and sends no {sorted(_check - {*names})[0]}: {_WRONG}.")
    check_frame(read_json(folder / FRAME_NAME))
    load_uncertainty(folder)
    check_summary(read_json(folder / SUMMARY_NAME))
    load_corrections(folder)
    if read_json(folder / FRAME_NAME)["status"] == "placed" and not {MODEL_NAME, RECORD_NAME, SIGNATURE_NAME} <= {*names}:
        raise BadInput(f"an edge says that it has a model and sends none: {_WRONG}.")


def _check_report(kind: str, folder: Path) -> None:
    report = load_report(folder)
    checks: dict[str, Callable[[Any], object]] = {"edge_count": check_count, "edge_raster": check_raster, "edge_score": check_scores}
    for record in report.found.values():
        checks.get(kind, lambda found: None)(record)
        if kind == "region":
            check_frame(record["frame"])
            check_summary(record["summary"])
    _texts(report.missing, REPORT_NAME)


def _texts(record: Any, name: str) -> None:
    if not isinstance(record, dict) or not all(isinstance(text, str) and len(text) <= MAX_REASON_CHARS for text in record.values()):
        raise BadInput(f"{name} gives reasons that are no texts: {_WRONG}.")


def _is_finite(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def _checked(what: str, check: Callable[[], object]) -> None:
    """Call a check; what a stranger's file makes our readers raise is bad input."""
    try:
        check()
    except BadInput:
        raise
    except (ValidationError, KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise BadInput(f"{what} ({type(error).__name__}): {_WRONG}.") from error
