"""What a result lacks: in sentences for whoever it is sent to, and what its run noted, for whoever
made it. Once per report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from radiant_app.report.verdict import FEW_PHOTOGRAPHS
from radiant_core.frames import Frame


def gaps_of(metrics: Mapping[str, Any], frame: Frame) -> list[str]:
    """Return a sentence for everything that somebody who is sent the result does not get, by
    metrics.json and the scene's frame; empty where every photograph was placed, all of the site
    delivered, lengths are known and no seam was found."""
    return [*_of_the_site(metrics), *_of_the_frame(metrics, frame), *_of_seams(metrics), *_of_the_figures(metrics)]


def notes_of(metrics: Mapping[str, Any], warnings: Sequence[str]) -> list[str]:
    """Return why devices gave nothing or less, and the warnings of the run."""
    notes = [f"No model came from {device}: {reason}" for device, reason in metrics.get("missing", {}).items()]
    for device, reason in metrics.get("not_refined", {}).items():
        notes.append(f"The photographs of {device} did not refine the joined scene, its model is in it: {reason}")
    for device, reason in metrics.get("partly_refined", {}).items():
        notes.append(f"The photographs of {device} refined the joined scene in some rounds alone, {reason}")
    return [*notes, *warnings]


def _of_the_site(metrics: Mapping[str, Any]) -> Iterator[str]:
    missing, unplaced = metrics.get("missing", {}), metrics.get("num_unplaced", 0)
    if missing:
        parts = f"{len(missing)} part{'s' * (len(missing) > 1)}"
        yield f"Not all of the site: {parts} of it came without a model, so what only the photographs there show is missing or coarse."
    if unplaced:
        unplaced_text = f"{unplaced} photograph{'s' * (unplaced > 1)} could not be placed"
        yield f"{unplaced_text}: what only they show is not in the model. Photographs that overlap their neighbours more would be."


def _of_the_frame(metrics: Mapping[str, Any], frame: Frame) -> Iterator[str]:
    if frame.kind == "unscaled":
        yield "Metres and a place on the map: lengths are in units of their own. GPS in the photographs or a known length gives them."
    elif frame.kind == "metric":
        if not frame.altitude_known:
            yield "Heights above the sea: they count from the middle of the scene."
        if not metrics.get("ground_control"):
            yield "A check on the ground: place and lengths rest on the GPS of the cameras, without a surveyed point."


def _of_seams(metrics: Mapping[str, Any]) -> Iterator[str]:
    borders = metrics.get("borders", ())
    if metrics.get("seam_found"):
        named = [row for row in borders if row["seam_found"]] or [{"between": ["all regions"]}]
        at = ", ".join(" and ".join(row["between"]) for row in named)
        yield f"A seamless whole: parts do not quite meet at {at}, where photographs fit {metrics['seam_excess_db']:.2f} dB worse."
    elif borders and metrics.get("seam_found") is None:
        yield f"Certainty about seams: whether parts meet was not judged, since {metrics['seam_reason']}."


def _of_the_figures(metrics: Mapping[str, Any]) -> Iterator[str]:
    count = len(metrics.get("images", ()))
    if 0 < count < FEW_PHOTOGRAPHS:
        yield f"Sure figures of quality: they come from {count} photograph{'s' * (count > 1)} that took no part in the training."
