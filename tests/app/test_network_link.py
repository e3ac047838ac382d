"""Results over links that break: the same bytes arrive, whatever is cut, and who dawdles is cut off."""

from __future__ import annotations

import logging
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from radiant_app.events import Event, StageDone, decode
from radiant_app.network import line as lines
from radiant_app.network import serving
from radiant_app.network.errands import Errands, Outcome
from radiant_app.network.home import open_home
from radiant_app.network.hub import Hub, open_hub
from radiant_app.network.line import Line
from radiant_app.network.reception import MAX_EVENTS
from radiant_core.errors import StageFailed
from radiant_core.hierarchy.codec import MODEL_NAME
from radiant_core.io.run_store import SEAL_NAME
from radiant_core.io.transport.envelope import Envelope
from tests.app.network_nodes import free_port
from tests.app.network_proxy import Link
from tests.app.network_transfer import RUN, deliver, make_edge, offer, write_model

NUM_BYTES = 20 << 20


class Road:
    """A device and an edge with a link between them."""

    def __init__(self, folder: Path, hub: Hub, link: Link) -> None:
        self.folder, self.hub, self.link = folder, hub, link
        self.said: list[str] = []
        self.lines: list[Line] = []
        self.digest = offer(hub, folder, "d")
        write_model(folder / "model", NUM_BYTES, 1)

    def line(self) -> Line:
        self.lines.append(Line(home=open_home(self.folder / "d"), say=self.said.append))
        return self.lines[-1]

    def received(self) -> bytes:
        assert _state(self) == "received"
        self.hub.install(self.digest)
        return (self.folder / "asked" / "d" / MODEL_NAME).read_bytes()

    def arrived(self) -> int:
        return self.hub.arrivals.num_bytes(self.digest)


@pytest.fixture
def road(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Road]:
    monkeypatch.setattr(lines, "TIMEOUT_S", 1.0)
    port = free_port()
    link = Link(target=port)
    make_edge(tmp_path, port, link.port, ["d"])
    with open_hub(open_home(tmp_path / "north"), 0.1) as hub:
        road = Road(tmp_path, hub, link)
        try:
            yield road
        finally:
            for line in road.lines:
                line.close()
            link.close()


def test_a_model_arrives_whole_over_a_link_that_is_cut_and_goes_down(road: Road) -> None:
    road.link.cuts = [*range(2 << 20, NUM_BYTES, 2 << 20)]
    line = road.line()
    line.join()
    sending = threading.Thread(target=deliver, args=(line, road.folder / "model", road.folder / "task"), daemon=True)
    sending.start()
    while road.arrived() < NUM_BYTES // 2:
        time.sleep(0.005)
    with road.link.down():
        time.sleep(2.5)
        stood = road.arrived()
    sending.join(60)
    assert not sending.is_alive() and stood < NUM_BYTES
    assert road.received() == (road.folder / "model" / MODEL_NAME).read_bytes()
    assert road.link.num_cut >= 8, "the link was cut"
    assert road.link.num_up < 1.25 * NUM_BYTES, "10 cuts and an outage in 20 MB; for 500 MB see tests/stress"


def test_a_slow_link_gets_short_parts_and_loses_nothing_for_ever(road: Road, monkeypatch: pytest.MonkeyPatch) -> None:
    """At 0.3 MB/s a part of 4 MB takes longer than its timeout: sent again and again it would never arrive."""
    write_model(road.folder / "model", 600_000, 2)
    road.link.bytes_per_s = 300_000
    monkeypatch.setattr(lines, "TIMEOUT_S", 1.0)
    line = road.line()
    line.part_bytes = 4 << 20
    line.join()
    deliver(line, road.folder / "model", road.folder / "task")
    assert road.received() == (road.folder / "model" / MODEL_NAME).read_bytes()
    assert line.part_bytes < 1 << 20 and road.link.num_up < 4 << 20


def test_a_sender_that_begins_again_sends_what_is_missing(road: Road) -> None:
    line = road.line()
    line.join()
    sending = threading.Thread(target=_until_withdrawn, args=(line, road), daemon=True)
    sending.start()
    while road.arrived() < NUM_BYTES // 2:
        time.sleep(0.005)
    line.ended.set()
    sending.join(20)
    before = road.link.num_up
    line = road.line()
    deliver(line, road.folder / "model", road.folder / "task")
    assert road.link.num_up - before < 0.6 * NUM_BYTES
    assert road.received() == (road.folder / "model" / MODEL_NAME).read_bytes()


def _until_withdrawn(line: Line, road: Road) -> None:
    with pytest.raises((lines.Withdrawn, lines.BadInput)):
        deliver(line, road.folder / "model", road.folder / "task")


class _Planner:
    """A performer whose task is withdrawn while its files come."""

    def __init__(self, road: Road) -> None:
        self.road, self.begun = road, 0

    def place(self, envelope: Envelope) -> Path:
        self.road.hub.withdraw(envelope.digest, "it was planned anew")
        return self.road.folder / "place"

    def begin(self, envelope: Envelope, folder: Path, digest: str) -> None:
        self.begun += 1


def test_a_node_whose_task_is_withdrawn_while_it_fetches_goes_on_asking(road: Road) -> None:
    line, performer = road.line(), _Planner(road)
    errands = Errands(home=line.home, line=line, performer=performer)  # pyright: ignore[reportArgumentType]
    working = threading.Thread(target=errands.run, daemon=True)
    working.start()
    _wait_for(lambda: _state(road) == "withdrawn")
    heard = road.hub.heard_of["devices/d"]
    _wait_for(lambda: road.hub.heard_of["devices/d"] > heard + 5)
    assert working.is_alive() and performer.begun == 0
    errands.ended.set()
    working.join(10)
    assert not working.is_alive()


class _Done:
    """A performer whose work is done at once."""

    def __init__(self, road: Road) -> None:
        self.road = road

    def place(self, envelope: Envelope) -> Path:
        return self.road.folder / "place"

    def begin(self, envelope: Envelope, folder: Path, digest: str) -> _Done:
        return self

    def heard(self) -> list[Event]:
        return []

    def outcome(self) -> Outcome:
        return Outcome()

    def stop(self) -> None:
        pass

    def result(self) -> dict[str, Path]:
        return {path.name: path for path in (self.road.folder / "model").iterdir()}


def test_a_hub_that_lost_what_it_had_gets_it_again(road: Road) -> None:
    """By a power cut, or as its folder was restored from a copy: the device is asked, and sends, once more."""
    write_model(road.folder / "model", 3 << 20, 4)
    line, store = road.line(), road.hub.store
    errands = Errands(home=line.home, line=line, performer=_Done(road))
    working = threading.Thread(target=errands.run, daemon=True)
    working.start()
    _wait_for(lambda: _state(road) == "received")
    road.hub.arrivals.remove(road.digest)
    assert store.move_task(road.digest, "taken", ("received",))
    _wait_for(lambda: _state(road) == "received")
    assert road.received() == (road.folder / "model" / MODEL_NAME).read_bytes()
    road.hub.accept(road.digest)
    _wait_for(lambda: errands.current is None)
    errands.ended.set()
    working.join(10)
    assert not working.is_alive()


def _state(road: Road) -> str:
    task = road.hub.store.task(road.digest)
    return "" if task is None else task.state


def test_a_node_says_why_it_gets_no_answer_and_notices_soon_when_it_does(road: Road, monkeypatch: pytest.MonkeyPatch) -> None:
    line = road.line()
    line.upper = type(line.upper)(**{**vars(line.upper), "url": f"https://127.0.0.1:{free_port()}"})
    joining = threading.Thread(target=_until_ended, args=(line,), daemon=True)
    joining.start()
    _wait_for(lambda: bool(road.said))
    assert "does not answer (ConnectError: [Errno 111] Connection refused)" in road.said[0]
    assert line.max_wait_s <= 10.0
    line.ended.set()
    joining.join(10)


def _until_ended(line: Line) -> None:
    with pytest.raises(lines.Withdrawn):
        line.join()


@pytest.mark.parametrize("sent", [b"", b"POST /poll HTTP/1.1\r\nHost: x\r\n", b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"])
def test_who_dawdles_is_cut_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sent: bytes) -> None:
    monkeypatch.setattr(serving, "IDLE_S", 0.3)
    port = free_port()
    make_edge(tmp_path, port, port, [])
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with open_hub(open_home(tmp_path / "north")), context.wrap_socket(socket.create_connection(("127.0.0.1", port))) as one:
        one.settimeout(5)
        one.sendall(sent)
        began, cut = time.monotonic(), False
        while not cut and time.monotonic() < began + 4:
            try:
                one.sendall(b"X-More: 1\r\n" if sent and not sent.endswith(b"\r\n\r\n") else b"")
                one.settimeout(0.1)
                cut = one.recv(1 << 16) == b""
            except TimeoutError:
                continue
            except OSError:
                cut = True
        assert cut, "it holds a connection that others need"


def test_a_refused_request_leaves_its_body_unread(road: Road) -> None:
    """Of 4 MB that nobody sealed no more than a buffer is taken from the socket."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with context.wrap_socket(socket.create_connection(("127.0.0.1", road.link.port))) as one:
        one.sendall(b"POST /poll HTTP/1.1\r\nHost: x\r\nContent-Length: 4000000\r\n\r\n")
        one.settimeout(5)
        assert one.recv(1 << 16).startswith(b"HTTP/1.1 400")


@pytest.mark.parametrize("sent", [b"", b"POST /poll HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\n"], ids=["idle", "in a body"])
def test_a_server_that_ends_while_others_are_connected_prints_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, sent: bytes
) -> None:
    port = free_port()
    make_edge(tmp_path, port, port, [])
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with open_hub(open_home(tmp_path / "north")):
        one = context.wrap_socket(socket.create_connection(("127.0.0.1", port)))
        one.sendall(sent)
        time.sleep(0.3)
    one.close()
    assert [record.getMessage() for record in caplog.records] == []


def test_a_fault_of_the_server_is_still_printed(capfd: pytest.CaptureFixture[str]) -> None:
    log = logging.Logger("uvicorn.error")
    log.addFilter(serving.is_fault)
    log.addHandler(logging.StreamHandler())
    log.error("Exception in ASGI application", exc_info=ValueError("played"))
    log.error("Cancel %s running task(s), timeout graceful shutdown exceeded", 0)
    assert "ValueError: played" in (said := capfd.readouterr().err) and "Cancel" not in said


def _wait_for(said: object, seconds: float = 10.0) -> None:
    until_s = time.monotonic() + seconds
    while not said():  # pyright: ignore[reportCallIssue]
        assert time.monotonic() < until_s
        time.sleep(0.01)


def test_a_device_whose_model_was_refused_makes_it_anew_when_it_is_asked_again(road: Road) -> None:
    """Nobody removes a seal by hand; one that was accepted, and is asked for as it was lost, is sent as it is."""
    write_model(road.folder / "model", 1000, 4)
    (road.folder / "place").mkdir()
    seal = road.folder / "place" / SEAL_NAME
    seal.write_text("{}")
    line = road.line()
    errands = Errands(home=line.home, line=line, performer=_Done(road))
    working = threading.Thread(target=errands.run, daemon=True)
    working.start()
    for again in (False, True):
        _wait_for(lambda: _state(road) == "received")
        road.hub.accept(road.digest)
        _wait_for(lambda: errands.current is None)
        assert seal.is_file()
        if again:
            road.hub.reject_stage(RUN, "devices/d", "it contradicts its neighbours")
        assert offer(road.hub, road.folder, "d") == road.digest
    _wait_for(lambda: not seal.exists())
    _wait_for(lambda: _state(road) == "received")
    task = road.hub.store.task(road.digest)
    assert task is not None and task.tries == 3
    errands.ended.set()
    working.join(10)
    assert not working.is_alive()


class _Talking(_Done):
    """Its work has said more than one request carries by the time that it ends."""

    def __init__(self, road: Road, error: StageFailed | None) -> None:
        super().__init__(road)
        self.error = error
        self.events: list[Event] = [StageDone(stage=f"devices/d/{number}", seconds=0.0) for number in range(MAX_EVENTS + 100)]

    def heard(self) -> list[Event]:
        events, self.events = self.events, []
        return events

    def outcome(self) -> Outcome:
        return Outcome(error=self.error)


@pytest.mark.parametrize("error", [None, StageFailed("devices/d: the disk is full.")])
def test_what_a_node_said_arrives_before_how_it_ended(road: Road, error: StageFailed | None) -> None:
    """The node above hears nothing more of a task that has ended."""
    write_model(road.folder / "model", 1000, 4)
    line = road.line()
    errands = Errands(home=line.home, line=line, performer=_Talking(road, error))
    working = threading.Thread(target=errands.run, daemon=True)
    working.start()
    _wait_for(lambda: _state(road) == ("received" if error is None else "failed"))
    said: list[str] = []
    while not road.hub.messages.empty():
        message = road.hub.messages.get()
        said += [getattr(decode(event), "stage", "") for event in message.events]
    assert said == [f"devices/d/{number}" for number in range(MAX_EVENTS + 100)]
    errands.ended.set()
    working.join(10)
    assert not working.is_alive()
