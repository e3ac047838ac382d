"""What an older round, attempt, stage or run said counts once, whoever sends it again: the member itself, or a stranger who recorded it."""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_app.commands.network import packs as node_packs
from radiant_app.network.contents import MAX_REASON_CHARS, check_frame
from radiant_app.network.home import Listening, open_home
from radiant_app.network.packs import LIST_NAME, SIGNATURE_NAME
from radiant_app.network.receiving import open_desk
from radiant_app.network.reception import HttpRequest, Refused
from radiant_app.network.store import HubStore
from radiant_core import __version__
from radiant_core.aggregate.averaging import Refinement
from radiant_core.errors import BadInput
from radiant_core.hierarchy.codec import FRAME_NAME, MODEL_NAME, load_refinement, load_uncertainty, save_refinement
from radiant_core.io.transport.delivery import SentFile, describe_files
from radiant_core.io.transport.envelope import open_envelope, sign_envelope
from tests.app.test_network_packs import Road
from tests.app.test_network_reception import World
from tests.core.scenes import ground_splats

OTHER_RUN = "8" * 32
STARTED = json.dumps({"event": "StageStarted", "stage": "edges/north/count"})


@pytest.fixture
def world(tmp_path: Path):
    world = World(tmp_path)
    yield world
    world.store.close()


@pytest.fixture
def road(tmp_path: Path):
    road = Road(tmp_path)
    yield road
    road.store.close()


def said(world: World, batch: int, tries: int = 1, events: list[str] | None = None) -> bytes:
    body = {"software": __version__, "task": world.task.digest, "tries": tries, "doing": "count", "ended": None}
    return json.dumps({**body, "batch": batch, "events": [STARTED] if events is None else events}).encode()


def everything(world: World) -> list[HttpRequest]:
    """A member's whole task, each request once: poll, the file of the task, announcement, the parts, what arrived, poll."""
    target = f"/results/{world.task.digest}"
    data = world.report.read_bytes()
    range_ = {"range": "bytes=0-1"}
    asked = [
        world.sealed("POST", "/poll", said(world, 1)),
        world.sealed("GET", f"/tasks/{world.task.digest}/0?bytes=0-1", **range_),
        world.sealed("POST", target, world.announcement()),
        world.part(0, data[:20_000]),
        world.sealed("HEAD", f"{target}/0"),
        world.part(20_000, data[20_000:]),
        world.sealed("POST", "/poll", said(world, 2)),
    ]
    assert [world.answer(each).status // 100 for each in asked] == [2] * len(asked)
    return asked


@pytest.mark.parametrize("when", ["at once", "accepted", "restarted", "planned anew"])
def test_nothing_that_was_recorded_counts_again(world: World, when: str) -> None:
    recorded = everything(world)
    if when != "at once":
        world.hub.install(world.task.digest)
        world.hub.accept(world.task.digest)
    if when == "restarted":
        world.store.close()
        world.reception.store = world.store = world.hub.store = HubStore(folder=world.home.folder)
    if when == "planned anew":
        (world.place / "task.json").write_text('{"other": 1}')
        world.hub.offer(world.task.run, "edges/north", "edge_count", "edges/north/count", world.place)
    heard, tasks, kept = len(world.heard), [(each.digest, each.state) for each in world.store.tasks()], world.kept()
    for asked in [*recorded, *reversed(recorded)]:
        assert world.answer(asked).status == 409
    assert (len(world.heard), [(each.digest, each.state) for each in world.store.tasks()], world.kept()) == (heard, tasks, kept)


def test_a_recorded_request_to_join_brings_no_older_counter_and_no_older_word_back(world: World) -> None:
    raw = base64.b64encode(world.key.public_key().public_bytes_raw()).decode()
    world.store.invite("edges/north", "again")
    joined = world.sealed("POST", "/join", json.dumps({"token": "again", "key": raw, "software": __version__}).encode())
    assert world.answer(joined).status == 200
    assert world.ask("POST", "/poll", said(world, 1))[0] == 200
    counter = world.store.last_counter("edges/north")
    assert world.answer(joined).status == 200, "its answer may have been lost"
    assert world.store.last_counter("edges/north") == counter
    world.store.invite("edges/north", "newest")
    assert world.answer(joined).status == 403
    assert world.store.revoke("edges/north")
    assert world.answer(joined).status == 403
    member = world.store.member("edges/north")
    assert member is not None and member.revoked


def test_events_of_an_older_batch_or_an_older_try_are_not_heard_again(world: World) -> None:
    assert world.ask("POST", "/poll", said(world, 5))[0] == 200
    assert sum(len(each.events) for each in world.heard) == 1
    for batch in (5, 4, 0):
        assert world.ask("POST", "/poll", said(world, batch))[0] == 200
    assert sum(len(each.events) for each in world.heard) == 1, "sealed anew by the member itself"
    # The same task is asked for once more after its process was lost: what the first try says is of no more interest.
    world.hub.withdraw(world.task.digest)
    assert world.hub.offer(world.task.run, "edges/north", "edge_count", "edges/north/count", world.place).tries == 2
    assert world.ask("POST", "/poll", said(world, 9, tries=1))[0] == 200
    assert sum(len(each.events) for each in world.heard) == 1
    assert world.ask("POST", "/poll", said(world, 9, tries=2))[0] == 200
    assert sum(len(each.events) for each in world.heard) == 2


@pytest.mark.parametrize("older", ["run", "stage", "attempt", "round"])
def test_the_result_of_an_older_task_answers_no_newer_one(world: World, older: str) -> None:
    """The list of what a member made before, signed as it was then, and signed anew for the task that is open."""
    kind, stage = ("edge_refine", "edges/north/refine") if older == "round" else ("edge_count", "edges/north/count")
    for name in ("task.json", "scene.ply"):
        (world.place / name).write_text("{}")
    first = world.task = world.hub.offer(world.task.run, "edges/north", kind, stage, world.place)
    before = world.announcement(kind=kind, stage=stage)
    assert world.ask("POST", f"/results/{first.digest}", before)[0] == 200
    (world.place / "task.json").write_text('{"newer": 1}')
    run = OTHER_RUN if older == "run" else first.run
    stage = {"stage": "edges/north/raster", "round": "edges/north/refine2"}.get(older, stage)
    kind = "edge_raster" if older == "stage" else kind
    newer = world.hub.offer(run, "edges/north", kind, stage, world.place)
    assert newer.digest != first.digest and newer.attempt == (2 if older == "attempt" else 1)
    kept = world.kept()
    for text in (before, world.announcement(kind=kind, stage=stage, run=run, answers=first.digest)):
        status, record = world.ask("POST", f"/results/{newer.digest}", text)
        assert (status, record["reason"]) == (409, "a result answers another task than the one that it was sent for.")
    found = world.store.task(newer.digest)
    assert found is not None and found.state == "offered" and world.store.result(newer.digest) is None and world.kept() == kept


def test_a_reason_as_long_as_may_be_is_read_in_any_letters(tmp_path: Path) -> None:
    """Of 4,000 letters outside ASCII, which another writer of JSON writes in six bytes each."""
    frame = {"status": "missing", "reason": "é" * MAX_REASON_CHARS, "uncertainty": None}
    (tmp_path / FRAME_NAME).write_text(json.dumps(frame))
    check_frame(frame)
    assert load_uncertainty(tmp_path) is None


def test_the_refinement_of_an_older_round_refines_no_newer_scene(tmp_path: Path) -> None:
    """Its sender may sign it again for the newer task: it names the scene that it was made from."""
    first = ground_splats(20)
    second = replace(first, sh0=first.sh0 + np.float32(0.01))
    rows = np.arange(3)
    refined = Refinement(rows=rows, splats=first.select(rows), weights=np.ones(3, np.float32))
    save_refinement(tmp_path, refined, first, "float16", lambda message: None)
    assert not isinstance(load_refinement(tmp_path, first), str)
    assert load_refinement(tmp_path, second) == "it refines another scene than the one that was sent: run that node again."


def test_an_empty_file_with_another_hash_is_asked_for_again_and_ends_nothing(world: World) -> None:
    """It was removed as damaged, and then missed as a file: every later part was answered by 503, as of a broken disk."""
    wrong = {"report.json": SentFile(bytes=0, sha256="b" * 64)}
    for _ in range(2):
        assert world.ask("POST", f"/results/{world.task.digest}", world.announcement(files=wrong)) == (200, {"offsets": [0]})
        assert world.answer(world.part(0, b"x")).status == 409
        assert world.answer(world.part(0, b"")).status == 200
    found = world.store.task(world.task.digest)
    assert found is not None and found.state == "offered"
    right = {"report.json": SentFile(bytes=0, sha256=hashlib.sha256(b"").hexdigest())}
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement(files=right))[0] == 200
    found = world.store.task(world.task.digest)
    assert found is not None and found.state == "received"


@pytest.mark.parametrize("url", ["https://[::1/", "https://[x]:1", "https://host:99999", "https://host:x", "http://host", "https://", "a"])
def test_an_address_that_is_none_is_said_in_a_join_file_and_an_option(url: str) -> None:
    with pytest.raises(BadInput, match="expected https://HOST:PORT, as the machines that join will reach this one"):
        Listening(url=url)
    assert Listening(url="https://[::1]:8443").url and Listening(url="https://host").url


# By a disk


def test_the_result_of_an_older_run_is_refused_and_leaves_nothing(road: Road) -> None:
    road.result()
    shutil.copytree(road.disk, road.folder / "older")
    road.store.withdraw_all(OTHER_RUN)
    newer = road.hub.offer(OTHER_RUN, "devices/d", "own_field", "devices/d", road.folder / "asked" / "d")
    before = road.kept()
    with pytest.raises(BadInput, match="the result of devices/d is refused: the task is withdrawn, nobody waits for it any more"):
        node_packs.unpack(road.folder / "north", road.folder / "older")
    found = road.store.task(newer.digest)
    assert road.kept() == before and found is not None and found.state == "offered"


def test_an_older_task_takes_no_newer_ones_place(road: Road) -> None:
    """Also before the newer one was begun."""
    road.task()
    shutil.copytree(road.disk, road.folder / "older")
    road.ask(text='{"newer": 1}')
    road.task()
    node_packs.unpack(road.folder / "d", road.disk)
    before = road.kept()
    with pytest.raises(BadInput, match="attempt 1, and attempt 2 was taken before"):
        node_packs.unpack(road.folder / "d", road.folder / "older")
    assert road.kept() == before
    assert "devices/d is here; next:" in node_packs.unpack(road.folder / "d", road.disk)[0], "the same pack again"


def test_a_task_of_another_run_in_place_of_one_that_is_not_done_is_said(road: Road) -> None:
    road.task()
    shutil.copytree(road.disk, road.folder / "older")
    road.hub.offer(OTHER_RUN, "devices/d", "own_field", "devices/d", road.folder / "asked" / "d")
    road.hub.withdraw(road.digests["d"])
    road.task()
    assert node_packs.unpack(road.folder / "d", road.disk)[0].startswith("the task of devices/d is here; next:")
    (said,) = node_packs.unpack(road.folder / "d", road.folder / "older")
    assert said.startswith("the task of devices/d is here, in place of that of devices/d of another run, which is not done; next:")
    road.work()
    node_packs.pack(road.folder / "d", None, road.folder / "result")
    with pytest.raises(BadInput, match="nobody waits for it any more"):
        node_packs.unpack(road.folder / "north", road.folder / "result")
    (said,) = node_packs.unpack(road.folder / "d", road.disk)
    assert "in place of" not in said, "what lay there is done"


def test_a_result_that_was_refused_is_not_taken_before_it_is_asked_for_again(road: Road) -> None:
    road.result()
    node_packs.unpack(road.folder / "north", road.disk)
    road.hub.refuse(road.digests["d"], "it has no Gaussian.")
    with pytest.raises(BadInput, match=r"the task is refused: it has no Gaussian\."):
        node_packs.unpack(road.folder / "north", road.disk)


def test_what_was_announced_over_the_network_comes_by_a_disk_as_the_same_result(road: Road) -> None:
    road.result()
    text, signature = (road.disk / LIST_NAME).read_bytes(), (road.disk / SIGNATURE_NAME).read_bytes()
    task = road.store.task(road.digests["d"])
    assert task is not None
    with open_desk(open_home(road.folder / "north")) as desk:
        desk.reception.announce(task, signature + text)
    assert "is received" in node_packs.unpack(road.folder / "north", road.disk)[-1]
    key = open_home(road.folder / "d").key
    (road.folder / "model" / MODEL_NAME).write_bytes(b"another")
    files = describe_files({path.name: path for path in (road.folder / "model").iterdir()})
    other, signed = sign_envelope(replace(open_envelope(text, signature, key.public_key()), files=files), key)
    with open_desk(open_home(road.folder / "north")) as desk, pytest.raises(Refused, match="another result of this task was received"):
        desk.reception.announce(task, signed + other)
