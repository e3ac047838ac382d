"""The upload protocol: the first valid upload of a region wins on any network; refusals say why."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from radiant_core.io.transport.acceptance import Acceptance, LastTask, Offer
from tests.core.io.protocol_world import REASONS, played

RUN, EDGE = "1" * 32, "edges/north"
WAITING = Acceptance(run=RUN, receiver=EDGE, senders={"a": "devices/a", "b": "devices/b"})
FIRST = Offer(run=RUN, receiver=EDGE, region="a", sender="devices/a", attempt=1, digest="x")


def test_the_first_valid_upload_wins_and_repeating_it_is_acknowledged() -> None:
    state, verdict = WAITING.offer(FIRST)
    assert verdict.status == "accepted" and state.accepted == {"a": FIRST}
    again, verdict = state.offer(FIRST)
    assert again is state and verdict.status == "duplicate"
    # The same files of a later attempt are the same upload; other files are not.
    assert state.offer(replace(FIRST, attempt=2))[1].status == "duplicate"
    later, verdict = state.offer(replace(FIRST, attempt=2, digest="y"))
    assert later is state and verdict.status == "rejected" and verdict.reason == "attempt 1 was accepted first, this is attempt 2."


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"run": "2" * 32}, "belongs to run"),
        ({"receiver": "edges/south"}, "is addressed to 'edges/south'"),
        ({"region": "c"}, "is none of this run's"),
        ({"sender": "devices/b"}, "which 'devices/a' is to deliver"),
    ],
)
def test_what_is_not_asked_for_is_refused_with_the_reason_and_changes_nothing(wrong: dict[str, str], reason: str) -> None:
    state, verdict = WAITING.offer(replace(FIRST, **wrong))
    assert state is WAITING and verdict.status == "rejected" and reason in verdict.reason


def test_seeded_schedules_leave_one_accepted_upload_of_every_region() -> None:
    # `make stress` plays a thousand.
    counts = played(range(200))
    assert min(counts[status] for status in ("accepted", "duplicate", "rejected")) > 100
    assert min(counts[reason] for reason in REASONS) > 10


def test_of_tasks_the_newest_counts_in_every_order() -> None:
    first = Offer(run=RUN, receiver="devices/a", region="", sender="edges/e", attempt=1, digest="1")
    sent = [replace(first, attempt=attempt, digest=f"{attempt}") for attempt in range(1, 7)]
    strays = [{"run": "2" * 32}, {"receiver": "devices/b"}, {"sender": "edges/f"}]
    for seed in range(100):
        rng = random.Random(seed)
        state, newest = LastTask(run=RUN, receiver="devices/a", sender="edges/e"), 0
        for offer in rng.choices(sent, k=20):
            for stray in strays:
                assert state.offer(replace(offer, **stray))[1].status == "rejected"
            after, verdict = state.offer(offer)
            expected = "accepted" if offer.attempt > newest else "duplicate" if offer.attempt == newest else "rejected"
            assert verdict.status == expected and (after is state) == (expected != "accepted")
            state, newest = after, max(newest, offer.attempt)
            assert (state.attempt, state.digest) == (newest, f"{newest}")
            assert state.offer(replace(offer, attempt=newest, digest="other"))[1].reason == f"other files were taken as attempt {newest}."
