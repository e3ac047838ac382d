"""Committed figures of the quick benchmarks that no machine changes, to compare new ones with.

Errors, ratios and counts; neither times nor memory, and nothing that only informs. A figure may be
worse than its baseline by the tolerance that its benchmark states. One file for all benchmarks;
each compares and replaces the figures whose key begins with its name.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from benchmarks.metric import Metric, metrics_from_json, metrics_to_json, regressions
from radiant_core.errors import StageFailed
from radiant_core.io.run_store import read_json, write_json

_OF_THE_MACHINE = ("_s", "_ms", ".seconds", "_bytes", "_scaling", "_fraction")
"""How keys end whose figures depend on the machine."""


def machine_independent(metrics: Sequence[Metric]) -> list[Metric]:
    """Those that any machine reproduces within their tolerance and that can be better or worse."""
    return [metric for metric in metrics if metric.direction != "info" and not metric.key.endswith(_OF_THE_MACHINE)]


def check_against_baseline(file: Path, name: str, metrics: Sequence[Metric]) -> int:
    """Compare the figures of the benchmark `name` with its part of `file`; returns how many there
    are. Raises StageFailed naming each that is worse or missing, BadInput for a changed unit or
    direction."""
    blessed = [metric for metric in _load(file) if metric.key.startswith(f"{name}.")]
    if worse := regressions(machine_independent(metrics), blessed):
        raise StageFailed("worse than the baseline:\n  " + "\n  ".join(worse) + f"\nmend that, or add --bless where {file} is to change.")
    return len(blessed)


def bless(file: Path, name: str, metrics: Sequence[Metric]) -> None:
    """Replace the figures of the benchmark `name` in `file`, which need not exist."""
    others = [metric for metric in _load(file) if not metric.key.startswith(f"{name}.")] if file.is_file() else []
    write_json(file, metrics_to_json(sorted([*others, *machine_independent(metrics)], key=lambda metric: metric.key)))


def _load(file: Path) -> tuple[Metric, ...]:
    return metrics_from_json(read_json(file))
