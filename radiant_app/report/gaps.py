"""What a run's result lacks, in sentences for whoever gets it. Once per report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from radiant_core.frames import Frame


def gaps_of(metrics: Mapping[str, Any], warnings: Sequence[str], frame: Frame) -> list[str]:
    """Return a sentence for everything that is missing by metrics.json, the warnings of the run and
    the scene's frame; empty where every photograph was placed, every device delivered and no seam
    was found."""
    return [*_of_devices(metrics), *warnings, *_of_the_frame(frame), *_of_seams(metrics)]


def _of_devices(metrics: Mapping[str, Any]) -> Iterator[str]:
    for device, reason in metrics.get("missing", {}).items():
        yield f"No model came from {device}: {reason}"
    for device, reason in metrics.get("not_refined", {}).items():
        yield f"The photographs of {device} did not refine the joined scene, its model is in it: {reason}"
    for device, reason in metrics.get("partly_refined", {}).items():
        yield f"The photographs of {device} refined the joined scene in some rounds alone, {reason}"


def _of_the_frame(frame: Frame) -> Iterator[str]:
    if frame.kind == "unscaled":
        yield "No scale and no place: nothing can be measured in metres. GPS in EXIF gives both, --distance or --height the scale."
    elif frame.kind == "metric" and not frame.altitude_known:
        yield "No altitude: heights count from the middle of the scene's points."


def _of_seams(metrics: Mapping[str, Any]) -> Iterator[str]:
    borders = metrics.get("borders", ())
    if metrics.get("seam_found"):
        named = [row for row in borders if row["seam_found"]] or [{"between": ["all regions"]}]
        at = ", ".join(" | ".join(row["between"]) for row in named)
        yield f"A seam is found at {at}: photographs fit the ground beyond it {metrics['seam_excess_db']:.2f} dB worse than before it."
    elif borders and metrics.get("seam_found") is None:
        yield f"Whether a seam is to be seen was not judged: {metrics['seam_reason']}."
