"""The upload protocol: the first valid upload of a region wins, whatever the network does; each refusal says why."""

from __future__ import annotations

import json
import random
from dataclasses import replace
from itertools import combinations

import pytest

from radiant_core.errors import BadInput
from radiant_core.io.transport.acceptance import Acceptance, LastTask, Offer, Region, acceptance_of
from tests.core.io.protocol_world import REASONS, played

RUN, EDGE = "1" * 32, "edges/north"
WAITING = Acceptance(run=RUN, receiver=EDGE).planned("a", "devices/a", ["c1", "c2"]).planned("b", "devices/b", ["c3"], first_attempt=2)
FIRST = Offer(run=RUN, receiver=EDGE, region="a", sender="devices/a", attempt=1, digest="x")


def test_the_first_valid_upload_wins_and_repeating_it_is_acknowledged() -> None:
    state, verdict = WAITING.offer(FIRST)
    assert verdict.status == "accepted" and state.accepted == {"a": FIRST} and state.waiting == ("b",)
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
        ({"region": "b", "sender": "devices/b"}, "attempts count from 2 on"),
    ],
)
def test_what_is_not_asked_for_is_refused_with_the_reason_and_changes_nothing(wrong: dict[str, str], reason: str) -> None:
    state, verdict = WAITING.offer(replace(FIRST, **wrong))
    assert state is WAITING and verdict.status == "rejected" and reason in verdict.reason


def test_what_was_planned_again_is_refused_from_its_old_sender_and_taken_from_the_new_ones() -> None:
    state = WAITING.replanned("a", {"a1": ("devices/b", ["c1"]), "a2": ("devices/c", ["c2"])})
    assert state.waiting == ("a1", "a2", "b")
    assert "was planned again" in state.offer(FIRST)[1].reason
    taken, verdict = state.offer(replace(FIRST, region="a1", sender="devices/b"))
    assert verdict.status == "accepted" and set(taken.accepted) == {"a1"}
    # What has arrived is never planned again, and a region not twice.
    for region in ("a1", "a", "nowhere"):
        with pytest.raises(BadInput, match="is not open"):
            taken.replanned(region, {"z": ("devices/b", ["c1"])})


@pytest.mark.parametrize("pieces", [["c1"], ["c1", "c2", "c3"], ["c1", "c4"]])
def test_no_camera_is_lost_or_won_by_planning_again(pieces: list[str]) -> None:
    with pytest.raises(BadInput, match="do not hold each of its 2 cameras once"):
        WAITING.replanned("a", {"z": ("devices/b", pieces)})
    with pytest.raises(BadInput, match="do not hold each"):
        WAITING.replanned("a", {"y": ("devices/b", ["c1", "c2"]), "z": ("devices/c", ["c2"])})
    with pytest.raises(BadInput, match="'c3' is in two regions that count"):
        WAITING.planned("d", "devices/d", ["c3"])
    with pytest.raises(BadInput, match="was planned before"):
        WAITING.planned("a", "devices/d", ["c9"])


@pytest.mark.parametrize(("first", "second"), list(combinations(range(5), 2)))
def test_no_two_of_many_regions_share_a_camera(first: int, second: int) -> None:
    cameras = [{f"c{index}"} for index in range(5)]
    cameras[first].add("shared")
    cameras[second].add("shared")
    regions = {f"r{index}": Region(sender="devices/a", cameras=frozenset(own)) for index, own in enumerate(cameras)}
    with pytest.raises(BadInput, match="'shared' is in two regions"):
        Acceptance(run=RUN, receiver=EDGE, regions=regions)
    assert Acceptance(run=RUN, receiver=EDGE, regions=regions, closed=frozenset({f"r{first}"})).waiting


def test_a_stored_state_comes_back_and_a_damaged_one_is_refused() -> None:
    state = WAITING.replanned("a", {"a1": ("devices/b", ["c1", "c2"])}).offer(replace(FIRST, region="a1", sender="devices/b"))[0]
    record = json.loads(json.dumps(state.record()))
    assert acceptance_of(record) == state and acceptance_of(record).record() == record
    for name in record:
        with pytest.raises(BadInput):
            acceptance_of({key: value for key, value in record.items() if key != name})
    with pytest.raises(BadInput, match="never planned, or is both"):
        acceptance_of({**record, "closed": ["a", "a1"]})
    with pytest.raises(BadInput):
        acceptance_of({**record, "accepted": {"a1": {"run": RUN}}})


def test_seeded_schedules_leave_every_camera_in_one_accepted_upload() -> None:
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
