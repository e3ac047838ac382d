"""What a node answers: nothing to who is not known, sealed, whole and new; and no byte of theirs is kept."""

from __future__ import annotations

import base64
import json
import random
from dataclasses import replace
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from radiant_app.network.arrivals import SPARE_BYTES, Arrivals
from radiant_app.network.home import make_home
from radiant_app.network.hub import Hub
from radiant_app.network.reception import COUNTER, NODE, SEAL, Asked, Reception, Said
from radiant_app.network.store import HubStore, KnownTask
from radiant_core import __version__
from radiant_core.io.transport.delivery import describe_files
from radiant_core.io.transport.envelope import Envelope, Request, open_envelope, sign_envelope
from tests.app.network_nodes import listening

RUN = "0" * 32


class World:
    """A cloud with one edge that joined and one task for it."""

    def __init__(self, folder: Path) -> None:
        self.home = make_home(folder / "cloud", listening(8443))
        (folder / "incoming").mkdir()
        self.arrivals = Arrivals(folder=folder / "incoming")
        self.store = HubStore(folder=folder)
        self.heard: list[Said] = []
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

    def sealed(self, method: str, target: str, body: bytes = b"", node: str = "edges/north", **headers: str) -> Asked:
        self.counter += 1
        request = Request(node=node, counter=self.counter, method=method, target=target)
        seal = base64.b64encode(self.key.sign(request.message(body))).decode()
        return Asked(method=method, target=target, headers={NODE: node, COUNTER: str(self.counter), SEAL: seal, **headers}, body=body)

    def ask(self, method: str, target: str, body: bytes = b"", **headers: str) -> tuple[int, dict]:
        reply = self.reception.answer(self.sealed(method, target, body, **headers))
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

    def part(self, offset: int, data: bytes) -> Asked:
        headers = {"upload-offset": str(offset), "content-type": "application/offset+octet-stream"}
        return self.sealed("PATCH", f"/results/{self.task.digest}/0?offset={offset}", data, **headers)

    def kept(self) -> int:
        return sum(path.stat().st_size for path in self.arrivals.folder.rglob("*") if path.is_file())


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(tmp_path)


def spoiled(asked: Asked, rng: random.Random) -> Asked:
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
        taken += world.reception.answer(spoiled(whole, rng)).status < 400 or world.kept() != before
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
    assert world.reception.answer(asked).status == 200
    assert world.reception.answer(asked).status == 409
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
    assert world.reception.answer(world.part(0, b"x")).status == 409 and world.kept() == 0


def test_parts_in_any_order_with_duplicates_end_in_the_same_bytes(world: World) -> None:
    data, rng = world.report.read_bytes(), random.Random(2)
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[1] == {"offsets": [0]}
    while not any(said.received for said in world.heard):
        offset = rng.choice([rng.randrange(len(data)), world.kept()])
        world.reception.answer(world.part(offset, data[offset : offset + rng.randrange(1, 9000)]))
        if rng.random() < 0.1:
            assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[0] == 200
    assert world.hub.install(world.task.digest) == ["report.json"]
    assert (world.place / "report.json").read_bytes() == data


def test_other_bytes_than_announced_are_dropped_and_come_again(world: World) -> None:
    data = world.report.read_bytes()
    world.ask("POST", f"/results/{world.task.digest}", world.announcement())
    assert world.reception.answer(world.part(0, bytes(len(data)))).status == 200
    assert world.kept() == 0 and not any(said.received for said in world.heard)
    world.reception.answer(world.part(0, data))
    assert any(said.received for said in world.heard)


def test_a_full_disk_refuses_before_a_byte(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda folder: type("Usage", (), {"free": SPARE_BYTES}))
    assert world.ask("POST", f"/results/{world.task.digest}", world.announcement())[0] == 507 and world.kept() == 0


def test_a_task_is_anothers_secret_and_comes_signed_in_parts(world: World) -> None:
    status, answer = world.ask("POST", "/poll", _poll())
    text, signature = (base64.b64decode(answer["task"][name]) for name in ("text", "signature"))
    assert status == 200 and open_envelope(text, signature, world.home.key.public_key()).digest == world.task.digest
    reply = world.reception.answer(world.sealed("GET", f"/tasks/{world.task.digest}/0", range="bytes=1-"))
    assert (reply.status, reply.body) == (206, b"}")
    stranger = Ed25519PrivateKey.generate()
    world.store.invite("edges/south", "other")
    assert world.store.join("edges/south", "other", stranger.public_key().public_bytes_raw(), __version__, 1)
    world.key, world.counter = stranger, 10
    assert world.reception.answer(world.sealed("GET", f"/tasks/{world.task.digest}/0", node="edges/south")).status == 404


def test_another_version_is_refused_with_a_sentence(world: World) -> None:
    status, answer = world.ask("POST", "/poll", _poll("0.0.1"))
    assert status == 409 and "install the same version" in answer["reason"]


def _poll(software: str = __version__) -> bytes:
    body = {"software": software, "task": "", "tries": 0, "doing": "idle", "ended": None, "batch": 0, "events": []}
    return json.dumps(body).encode()
