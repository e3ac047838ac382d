"""What a node answers: nothing to who is not known, sealed, whole and new; and no byte of theirs is kept."""

from __future__ import annotations

import base64
import hashlib
import json
import random
import sqlite3
import stat
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from radiant_app.commands.network import node as commands
from radiant_app.network.arrivals import SPARE_BYTES, Arrivals
from radiant_app.network.executor import admit_event
from radiant_app.network.home import make_home
from radiant_app.network.hub import MAX_MESSAGES, Hub
from radiant_app.network.reception import BODY, COUNTER, NODE, REPLY, SEAL, HttpRequest, NodeMessage, Reception, Reply
from radiant_app.network.store import HubStore, KnownTask
from radiant_core import __version__
from radiant_core.io.transport.delivery import SentFile, describe_files
from radiant_core.io.transport.envelope import Envelope, Request, open_envelope, sign_envelope
from radiant_core.io.transport.signing import is_signed_by
from tests.app.network_nodes import listening
from tests.memory_folder import SHARED_MEMORY

RUN = "0" * 32


class World:
    """A cloud with one edge that joined and one task for it."""

    def __init__(self, folder: Path) -> None:
        self.home = make_home(folder / "cloud", listening(8443))
        (self.home.folder / "incoming").mkdir()
        self.arrivals = Arrivals(folder=self.home.folder / "incoming")
        self.store = HubStore(folder=self.home.folder)
        self.heard: list[NodeMessage] = []
        self.reception = Reception(node="cloud", key=self.home.key, store=self.store, arrivals=self.arrivals, heard=self.heard.append)
        self.hub = Hub(home=self.home, store=self.store, arrivals=self.arrivals)
        self.key, self.counter = Ed25519PrivateKey.generate(), 0
        raw = self.key.public_key().public_bytes_raw()
        self.store.invite("edges/north", "word")
        body = json.dumps({"token": "word", "key": base64.b64encode(raw).decode(), "software": __version__}).encode()
        assert self.ask("POST", "/join", body)[0] == 200
        self.place = folder / "task"
        self.place.mkdir()
        (self.place / "task.json").write_text("{}")
        self.task: KnownTask = self.hub.offer(RUN, "edges/north", "edge_count", "edges/north/count", self.place)
        self.report = folder / "report.json"
        self.report.write_bytes(bytes(random.Random(0).randbytes(50_000)))

    def sealed(self, method: str, target: str, body: bytes = b"", node: str = "edges/north", **headers: str) -> HttpRequest:
        self.counter += 1
        digest = hashlib.sha256(body).hexdigest()
        request = Request(node=node, counter=self.counter, method=method, target=target, body_sha256=digest)
        sealed = {NODE: node, COUNTER: str(self.counter), SEAL: base64.b64encode(self.key.sign(request.message())).decode(), BODY: digest}
        return HttpRequest(method=method, target=target, headers={**sealed, "content-length": str(len(body)), **headers}, body=body)

    def answer(self, asked: HttpRequest) -> Reply:
        """As the socket does: without its body first."""
        return self.reception.admit(replace(asked, body=b"")) or self.reception.answer(asked)

    def ask(self, method: str, target: str, body: bytes = b"", **headers: str) -> tuple[int, dict]:
        reply = self.answer(self.sealed(method, target, body, **headers))
        return reply.status, json.loads(reply.body or b"{}")

    def announcement(self, **changed: object) -> bytes:
        task = self.task
        envelope = Envelope(
            run=RUN,
            sender="edges/north",
            receiver="cloud",
            kind="edge_count",
            stage="edges/north/count",
            attempt=task.attempt,
            answers=task.digest,
            software=__version__,
            files=describe_files({"report.json": self.report}),
        )
        text, signature = sign_envelope(replace(envelope, **changed), self.key)
        return signature + text

    def part(self, offset: int, data: bytes) -> HttpRequest:
        headers = {"upload-offset": str(offset), "content-type": "application/offset+octet-stream"}
        return self.sealed("PATCH", f"/results/{self.task.digest}/0?offset={offset}", data, **headers)

    def kept(self) -> int:
        return sum(path.stat().st_size for path in self.arrivals.folder.rglob("*") if path.is_file())


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(tmp_path)


def spoiled(asked: HttpRequest, rng: random.Random) -> HttpRequest:
    """A request with something else than was sealed."""
    kind = rng.randrange(7)
    headers = dict(asked.headers)
    if kind == 0:
        at = rng.randrange(len(asked.body) + 1)
        return replace(asked, body=asked.body[:at] + bytes([rng.randrange(256)]) + asked.body[at:])
    if kind == 1:
        headers[SEAL] = base64.b64encode(rng.randbytes(64)).decode()
    elif kind == 2:
        headers[COUNTER] = str(int(headers[COUNTER]) + rng.randrange(1, 99))
    elif kind == 3:
        headers[NODE] = rng.choice(["edges/south", "devices/north", "cloud", "edges/../north", ""])
    elif kind == 4:
        return replace(asked, target=asked.target + rng.choice(["0", "?offset=1", "/../0", "%00"]))
    elif kind == 5:
        return replace(asked, method=rng.choice(["GET", "DELETE", "PUT", "OPTIONS"]))
    else:
        headers.pop(rng.choice([NODE, COUNTER, SEAL]))
    return replace(asked, headers=headers)


def forge(world: World, count: int) -> int:
    """How many of so many forged requests were taken, or left a byte."""
    rng, taken = random.Random(1), 0
    data = world.report.read_bytes()
    for _ in range(count):
        whole = rng.choice([world.part(0, data[:1000]), world.sealed("POST", f"/results/{world.task.digest}", world.announcement())])
        before = world.kept()
        taken += world.answer(spoiled(whole, rng)).status < 400 or world.kept() != before
    return taken


def test_forged_and_altered_requests_are_refused_and_leave_nothing(world: World) -> None:
    assert forge(world, 500) == 0 and world.kept() == 0
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[0] == 200
    assert forge(world, 500) == 0 and world.kept() == 0


@pytest.mark.stress
def test_ten_thousand_forged_requests_are_refused(world: World) -> None:
    assert forge(world, 10_000) == 0 and world.kept() == 0


def test_a_replayed_request_and_a_revoked_node_are_refused(world: World) -> None:
    asked = world.sealed("POST", f"/results/{world.task.digest}", world.announcement())
    assert world.answer(asked).status == 200
    assert world.answer(asked).status == 409
    assert world.store.revoke("edges/north")
    status, record = world.ask("POST", f"/results/{world.task.digest}", world.announcement())
    assert status == 403 and "not known here, or no longer" in record["reason"]


def test_a_word_counts_once_and_another_key_cannot_use_it_again(world: World) -> None:
    other = Ed25519PrivateKey.generate()
    body = json.dumps({"token": "word", "key": base64.b64encode(other.public_key().public_bytes_raw()).decode(), "software": "1"}).encode()
    world.key = other
    assert world.ask("POST", "/join", body)[0] == 403


@pytest.mark.parametrize(
    "changed",
    [{"run": "1" * 32}, {"receiver": "edges/south"}, {"kind": "region"}, {"attempt": 2}, {"answers": "2" * 64}, {"software": "0.0.1"}],
)
def test_a_result_of_something_else_is_refused_before_a_byte(world: World, changed: dict[str, object]) -> None:
    status, _ = world.ask("POST", f"/results/{world.task.digest}", world.announcement(**changed))
    assert status >= 400 and world.kept() == 0
    assert world.answer(world.part(0, b"x")).status == 409 and world.kept() == 0


def test_parts_in_any_order_with_duplicates_end_in_the_same_bytes(world: World) -> None:
    data, rng = world.report.read_bytes(), random.Random(2)
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[1] == {"offsets": [0]}
    while not any(said.received for said in world.heard):
        offset = rng.choice([rng.randrange(len(data)), world.kept()])
        world.answer(world.part(offset, data[offset : offset + rng.randrange(1, 9000)]))
        if rng.random() < 0.1:
            assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[0] == 200
    assert world.hub.install(world.task.digest) == ["report.json"]
    assert (world.place / "report.json").read_bytes() == data


def test_other_bytes_than_announced_are_dropped_and_come_again(world: World) -> None:
    data = world.report.read_bytes()
    world.ask("POST", f"/results/{world.task.digest}", world.announcement())
    assert world.answer(world.part(0, bytes(len(data)))).status == 200
    assert world.kept() == 0 and not any(said.received for said in world.heard)
    world.answer(world.part(0, data))
    assert any(said.received for said in world.heard)


def test_a_full_disk_refuses_before_a_byte(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda folder: type("Usage", (), {"free": SPARE_BYTES}))
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[0] == 507 and world.kept() == 0


def test_a_task_is_anothers_secret_and_comes_signed_in_parts(world: World) -> None:
    status, answer = world.ask("POST", "/poll", poll_body())
    text, signature = (base64.b64decode(answer["task"][name]) for name in ("text", "signature"))
    assert status == 200 and open_envelope(text, signature, world.home.key.public_key()).digest == world.task.digest
    reply = world.answer(world.sealed("GET", f"/tasks/{world.task.digest}/0?bytes=1-9", range="bytes=1-9"))
    assert (reply.status, reply.body) == (206, b"}")
    stranger = Ed25519PrivateKey.generate()
    world.store.invite("edges/south", "other")
    assert world.store.join("edges/south", "other", stranger.public_key().public_bytes_raw(), __version__, 1)
    world.key, world.counter = stranger, 10
    assert world.answer(world.sealed("GET", f"/tasks/{world.task.digest}/0", node="edges/south")).status == 404


def test_another_version_is_refused_with_a_sentence(world: World) -> None:
    status, answer = world.ask("POST", "/poll", poll_body("0.0.1"))
    assert status == 409 and "install the same version" in answer["reason"]


def test_nothing_of_a_stranger_is_read_beyond_the_head_of_its_request(world: World) -> None:
    data = world.report.read_bytes()
    for asked in (world.sealed("POST", "/poll", data), world.part(0, data)):
        for name, value in (
            (SEAL, base64.b64encode(bytes(64)).decode()),
            (NODE, "edges/south"),
            (COUNTER, "1"),
            ("content-length", "9" * 9),
        ):
            spoilt = replace(asked, headers={**asked.headers, name: value}, body=b"")
            reply = world.reception.admit(spoilt)
            assert reply is not None and reply.status >= 400, name
        chunked = replace(asked, headers={**asked.headers, "transfer-encoding": "chunked"}, body=b"")
        reply = world.reception.admit(chunked)
        assert reply is not None and reply.status == 413


def test_another_body_than_the_sealed_one_is_refused_and_an_older_request_after_a_newer(world: World) -> None:
    first, second = world.sealed("POST", "/poll", poll_body()), world.sealed("POST", "/poll", poll_body())
    assert world.reception.admit(first) is None
    assert world.reception.answer(replace(first, body=b"{}")).status == 502
    assert world.reception.admit(second) is None
    assert world.reception.answer(first).status == 409, "its connection was given up, its bytes come late"
    assert world.reception.answer(second).status == 200


def test_an_answer_belongs_to_the_request_as_it_came(world: World) -> None:
    """Who reads what passes could else spoil a request and pass on the signed refusal, or another offset."""
    world.ask("POST", f"/results/{world.task.digest}", world.announcement())
    whole = world.part(0, world.report.read_bytes()[:100])
    spoilt = replace(whole, headers={**whole.headers, SEAL: base64.b64encode(bytes(64)).decode()})
    key, refusal = world.home.key.public_key(), world.answer(spoilt)
    request = Request(node="edges/north", counter=world.counter, method="PATCH", target=whole.target, body_sha256=whole.headers[BODY])

    def fits(reply: Reply, offset: str) -> bool:
        message = request.reply_message(whole.headers[SEAL], reply.status, offset, reply.body)
        return is_signed_by(key, base64.b64decode(reply.headers[REPLY]), message)

    assert refusal.status == 403 and not fits(refusal, "")
    reply = world.answer(whole)
    assert fits(reply, "100") and not fits(reply, "50000")


def test_who_was_revoked_and_invited_again_needs_the_new_word(world: World) -> None:
    assert world.store.revoke("edges/north")
    world.store.invite("edges/north", "new word")
    assert world.ask("POST", "/poll", poll_body())[0] == 403
    body = json.dumps(
        {"token": "word", "key": base64.b64encode(world.key.public_key().public_bytes_raw()).decode(), "software": "1"}
    ).encode()
    assert world.ask("POST", "/join", body)[0] == 403, "the old word counts no more"
    assert world.ask("POST", "/join", body.replace(b'"word"', b'"new word"'))[0] == 200
    assert world.ask("POST", "/poll", poll_body())[0] == 200


def test_what_waits_for_the_conductor_keeps_nobody_from_the_next_task(world: World) -> None:
    """A process that ended between sealing a result and saying so would else wait for ever."""
    world.ask("POST", f"/results/{world.task.digest}", world.announcement())
    assert world.answer(world.part(0, world.report.read_bytes())).status == 200
    following = world.hub.offer(RUN, "edges/north", "edge_raster", "edges/north/raster", world.place)
    answer = world.ask("POST", "/poll", poll_body())[1]
    assert open_envelope(
        base64.b64decode(answer["task"]["text"]), base64.b64decode(answer["task"]["signature"]), world.home.key.public_key()
    ) == (open_envelope(following.text, following.signature, world.home.key.public_key()))
    world.hub.settle_stage(RUN, "edges/north/count")
    found = world.store.task(world.task.digest)
    assert found is not None and found.state == "accepted"


def test_who_did_not_hear_that_a_result_arrived_is_told_so_after_it_was_taken(world: World) -> None:
    announced, data = world.announcement(), world.report.read_bytes()
    world.ask("POST", f"/results/{world.task.digest}", announced)
    world.answer(world.part(0, data))
    world.hub.install(world.task.digest)
    world.hub.accept(world.task.digest)
    assert world.ask("POST", f"/results/{world.task.digest}", announced) == (200, {"offsets": [len(data)]})
    reply = world.answer(world.part(0, data))
    assert (reply.status, reply.headers["Upload-Offset"]) == (200, str(len(data))) and world.kept() == 0
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement(files={}))[0] == 409


def test_numbers_that_no_database_holds_are_refused(world: World) -> None:
    assert world.ask("POST", "/poll", poll_body().replace(b'"batch": 0', b'"batch": 99999999999999999999'))[0] == 400


def test_what_a_node_says_moves_no_cursor(world: World) -> None:
    ended = {"message": "gone\x1b[2J\nroot:", "exit_code": 2, "crashed": False, "cannot_write": False}
    body = {**json.loads(poll_body()), "task": world.task.digest, "tries": 1, "doing": "\x1b]0;x", "ended": ended, "batch": 1}
    assert world.ask("POST", "/poll", json.dumps(body).encode())[0] == 200
    (said,) = world.heard
    member = world.store.member("edges/north")
    assert said.ended is not None and member is not None
    assert said.ended.message == "gone [2J root:" and member.note == " ]0;x"
    event = json.dumps({"event": "Warned", "stage": "edges/north", "message": "a\x1bb"})
    assert [vars(each) for each in admit_event(event, "edges/north", set())] == [{"stage": "edges/north", "message": "a b"}]


def test_events_that_nobody_reads_are_bounded_and_ends_are_kept(world: World) -> None:
    for number in range(3 * MAX_MESSAGES):
        world.hub.hear(NodeMessage(digest="1", events=(f"event {number}",)))
    world.hub.hear(NodeMessage(digest="1", events=("last",), received=True))
    assert world.hub.messages.qsize() == MAX_MESSAGES + 1


def test_a_disk_with_room_for_one_promises_it_to_one(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda folder: type("Usage", (), {"free": SPARE_BYTES + 70_000}))
    place = world.place.parent / "other"
    place.mkdir()
    (place / "task.json").write_text("{}")
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[0] == 200
    other = world.hub.offer(RUN, "edges/north", "edge_raster", "edges/north/raster", place)
    text = world.announcement(kind="edge_raster", stage="edges/north/raster", attempt=other.attempt, answers=other.digest)
    assert world.ask("POST", f"/results/{other.digest}", text)[0] == 507
    world.answer(world.part(0, world.report.read_bytes()))
    assert world.ask("POST", f"/results/{other.digest}", text)[0] == 200


def test_an_announcement_without_a_byte_keeps_no_other_member_out(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nearly all of the room is announced by one, and nothing sent."""
    monkeypatch.setattr("shutil.disk_usage", lambda folder: type("Usage", (), {"free": SPARE_BYTES + 336 * 10**6}))
    large = SentFile(bytes=336 * 10**6 - 60_000, sha256="0" * 64)
    region = world.hub.offer(RUN, "edges/north", "edge_refine", "edges/north/refine", refining_task(world))
    announced = {"report.json": describe_files({"report.json": world.report})["report.json"], "refined.safetensors": large}
    text = world.announcement(kind="edge_refine", stage="edges/north/refine", answers=region.digest, files=announced)
    assert world.ask("POST", f"/results/{region.digest}", text)[0] == 200
    south = second_member(world)
    task = world.hub.offer(RUN, "edges/south", "edge_count", "edges/south/count", world.place)
    text = world.announcement(sender="edges/south", stage="edges/south/count", answers=task.digest)
    reply = world.answer(world.sealed("POST", f"/results/{task.digest}", text, node="edges/south"))
    assert reply.status == 200, reply.body
    headers = {"upload-offset": "0", "content-type": "application/offset+octet-stream"}
    part = world.sealed("PATCH", f"/results/{task.digest}/0?offset=0", world.report.read_bytes(), node="edges/south", **headers)
    assert world.answer(part).status == 200
    found = world.store.task(task.digest)
    assert south == "edges/south" and found is not None and found.state == "received"


def test_a_part_says_whether_the_disk_is_full_or_kept_for_others(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[0] == 200
    monkeypatch.setattr("shutil.disk_usage", lambda folder: type("Usage", (), {"free": SPARE_BYTES // 2 + 10_000}))
    reply = world.answer(world.part(0, world.report.read_bytes()[:5000]))
    assert reply.status == 507 and json.loads(reply.body)["reason"] == "the disk there is full: it is tried again, free space meanwhile."
    monkeypatch.setattr(world.reception.promises, "may_grow", lambda *asked: False)
    monkeypatch.setattr("shutil.disk_usage", lambda folder: type("Usage", (), {"free": 2 * SPARE_BYTES}))
    reply = world.answer(world.part(0, world.report.read_bytes()[:5000]))
    assert reply.status == 507 and "no room beside results of others" in json.loads(reply.body)["reason"]


def refining_task(world: World) -> Path:
    place = world.place.parent / "refining"
    place.mkdir()
    for name in ("task.json", "scene.ply"):
        (place / name).write_text("{}")
    return place


def second_member(world: World) -> str:
    """Another edge, whose key is the same here, so that `world` seals for it too."""
    world.store.invite("edges/south", "other")
    assert world.store.join("edges/south", "other", world.key.public_key().public_bytes_raw(), __version__, 1)
    return "edges/south"


MOVES = {
    "colour and title": "\x1b[31m\x1b]0;owned\x07",
    "lines": "a\nedges/x: joined\r",
    "direction": "\u202egnp\u2066",
    "C1": "\x9b2J\x85",
}


@pytest.mark.parametrize("word", MOVES.values(), ids=MOVES.keys())
@pytest.mark.parametrize("where", ["software", "doing", "join", "field", "result", "stored"])
def test_no_word_of_a_member_moves_the_cursor_of_who_looks_at_the_status(world: World, where: str, word: str) -> None:
    body = json.loads(poll_body())
    if where == "join":
        key, world.key = world.key, Ed25519PrivateKey.generate()
        world.store.invite("edges/north", "again")
        joining = {"token": "again", "key": base64.b64encode(world.key.public_key().public_bytes_raw()).decode(), "software": word}
        assert world.ask("POST", "/join", json.dumps(joining).encode())[0] == 200 and key is not world.key
    elif where == "result":
        text = world.announcement(software=word)
        assert world.ask("POST", f"/results/{world.task.digest}", text)[0] == 409
    elif where == "stored":
        world.store.note("edges/north", f"refused: {word}", word)
        world.store.move_task(world.task.digest, "withdrawn", ("offered",), word)
    else:
        changed = {"software": {"software": word}, "doing": {"doing": f"refused {word}"}, "field": {word: 1}}[where]
        world.ask("POST", "/poll", json.dumps({**body, **changed}).encode())
    record = commands.status(world.home.folder)
    lines = commands.status_lines(record)
    assert len(lines) == 2 and all(line.isprintable() for line in lines), lines
    assert all(row["doing"].isprintable() and row["software"].isprintable() for row in record["nodes"])


@pytest.mark.parametrize("method", ["POST", "GET", "PATCH"])
@pytest.mark.parametrize("word", ["wrong", ""])
def test_a_stranger_who_joins_in_vain_writes_nothing_into_a_members_status(world: World, method: str, word: str) -> None:
    world.ask("POST", "/poll", poll_body())
    before = commands.status_lines(commands.status(world.home.folder))
    member, world.key = world.key, Ed25519PrivateKey.generate()
    body = {"token": word, "key": base64.b64encode(world.key.public_key().public_bytes_raw()).decode(), "software": "1"}
    assert world.ask(method, "/join", json.dumps(body).encode())[0] in (403, 404)
    assert commands.status_lines(commands.status(world.home.folder)) == before
    world.key = member
    world.ask("POST", "/join", json.dumps({**body, "key": base64.b64encode(member.public_key().public_bytes_raw()).decode()}).encode())
    assert "refused: the join file of edges/north is used up" in commands.status_lines(commands.status(world.home.folder))[1], "its own key"


@pytest.mark.parametrize("content", [None, b"{"], ids=["missing", "cut"])
def test_a_file_of_a_task_that_is_gone_is_refused_with_a_sentence(world: World, content: bytes | None) -> None:
    (world.place / "task.json").unlink()
    if content is not None:
        (world.place / "task.json").write_bytes(content)
    reply = world.answer(world.sealed("GET", f"/tasks/{world.task.digest}/0?bytes=0-1", range="bytes=0-1"))
    said = "task.json of the task edges/north/count is not there any more, or not whole: run it again there with --resume."
    assert (reply.status, json.loads(reply.body)) == (404, {"reason": said})


@pytest.mark.parametrize("target", ["//[::1/x", "//[/results", "http://[::1/", "/tasks/\u0662", "/%zz?bytes=%", "?", "", "//"])
def test_a_target_that_is_no_address_is_refused(world: World, target: str) -> None:
    assert world.answer(world.sealed("GET", target)).status == 404


def test_a_folder_that_cannot_be_used_is_said_and_tried_again(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(error: Exception) -> None:
        raise error

    for error in (PermissionError(13, "Permission denied", "x"), sqlite3.OperationalError("database or disk is full")):
        monkeypatch.setattr(world.reception.store, "open_task", lambda node, error=error: fail(error))
        reply = world.answer(world.sealed("POST", "/poll", poll_body()))
        assert reply.status == 503 and str(error.args[-1] if len(error.args) == 1 else error.args[1]) in json.loads(reply.body)["reason"]


def test_a_result_moves_to_a_run_on_another_disk(world: World) -> None:
    here = world.place.stat().st_dev
    away = next((path for path in (SHARED_MEMORY, Path(tempfile.gettempdir())) if path.is_dir() and path.stat().st_dev != here), None)
    if away is None:
        pytest.skip("there is one disk")
    with tempfile.TemporaryDirectory(dir=away) as folder:
        (Path(folder) / "task.json").write_text("{}")
        task = world.hub.offer(RUN, "edges/north", "edge_count", "edges/north/count", Path(folder))
        assert task.digest == world.task.digest
        world.ask("POST", f"/results/{task.digest}", world.announcement())
        world.answer(world.part(0, world.report.read_bytes()))
        assert world.hub.install(task.digest) == ["report.json"]
        assert (Path(folder) / "report.json").read_bytes() == world.report.read_bytes() and world.kept() == 0


def test_what_arrived_for_tasks_that_are_over_is_removed_when_a_node_starts(world: World) -> None:
    world.ask("POST", f"/results/{world.task.digest}", world.announcement())
    world.answer(world.part(0, b"x" * 100))
    world.arrivals.remove_all_but(world.store.open_digests())
    assert world.kept() == 100
    world.store.withdraw_all()
    world.arrivals.remove_all_but(world.store.open_digests())
    assert world.kept() == 0


def test_others_on_the_machine_see_neither_keys_nor_words_nor_poses(world: World) -> None:
    def mode(path: Path) -> int:
        return stat.S_IMODE(path.stat().st_mode)

    file = world.home.folder.parent / "north.join"
    commands.invite(world.home.folder, "north", file)
    assert mode(file) == 0o600 and mode(world.home.folder) == 0o700 and mode(world.home.identity / "signing_key.pem") == 0o600


def poll_body(software: str = __version__) -> bytes:
    body = {"software": software, "task": "", "tries": 0, "doing": "idle", "ended": None, "batch": 0, "events": []}
    return json.dumps(body).encode()
