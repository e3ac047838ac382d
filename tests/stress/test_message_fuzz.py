"""20,000 mutated messages of each kind of the network: refused with an error of ours, or used by all that use such a message."""

from __future__ import annotations

import pytest

from tests.stress.message_fuzz import SEED, fuzz_kind
from tests.stress.message_kinds import KINDS

MAX_S = 0.5
"""CPU seconds of one message: what is read and used of one is small."""
SAMPLE = 150
EVENTS = ("StageStarted", "StageProgress", "StageDone", "MemoryPeaked", "Warned", "Decided", "Outlined", "TimeLeft", "Failed", "Heartbeat")
AWAITED = frozenset({"answer to an announcement", *(f"event {name}" for name in EVENTS), "raster", "scores", "summary", "edge summary"}) | {
    *("report of rasters", "report of a region", "report of scores"),
}
"""Kinds whose parser is being mended; a test that passes there says that its name can go."""


@pytest.mark.stress
@pytest.mark.parametrize("name", list(KINDS))
def test_mutated_messages_are_refused_or_used(name: str) -> None:
    report = fuzz_kind(KINDS[name], 20_000, SEED)
    assert report.surprises == [] and report.longest_s < MAX_S, report


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.xfail(strict=True)] if name in AWAITED else []) for name in KINDS])
def test_a_sample_of_mutated_messages_is_refused_or_used(name: str) -> None:
    report = fuzz_kind(KINDS[name], SAMPLE, 1)
    assert report.surprises == [] and report.longest_s < MAX_S, report
    # A parser that refuses, or takes, everything would pass the rest; the reason of a refusal is read from whatever comes.
    assert (report.num_refused > 0 or name == "refusal") and report.num_refused < report.count, report
