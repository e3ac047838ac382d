"""Links between processes: messages arrive whole, and who dies or stops breaks its own link alone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from radiant_app.together import meeting as meeting_place
from radiant_app.together import wire
from radiant_app.together.links import ChildLink, LinkLost, LinkRules, Message, Pace, ParentLinks, connect

ROOT = Path(__file__).parents[3]
RULES = LinkRules(limit_s=10, address="127.0.0.1")
NUM_TIMED = 3
"""The quickest of so many counts: on a machine with other work one may wait for a core."""
Start = Callable[..., subprocess.Popen]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts `link_child.py WORK tmp_path NAME …`; whatever is left of them is killed at the end."""
    processes: list[subprocess.Popen] = []
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(str(ROOT / part) for part in (".", "core", "viewer"))}

    def run(work: str, name: str, *more: str) -> subprocess.Popen:
        command = [sys.executable, str(Path(__file__).with_name("link_child.py")), work, str(tmp_path), name, *more]
        processes.append(subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True))
        return processes[-1]

    yield run
    for process in processes:
        process.kill()
        process.wait()
        if process.stdout:
            process.stdout.close()


@pytest.fixture
def linked(tmp_path: Path) -> Iterator[Callable[..., ParentLinks]]:
    """Makes a parent and waits until all its children are linked."""
    parents: list[ParentLinks] = []

    def link(names: list[str], rules: LinkRules = RULES) -> ParentLinks:
        parents.append(ParentLinks(tmp_path, names, rules))
        assert parents[-1].wait_for(names, 20) == []
        return parents[-1]

    yield link
    for parent in parents:
        parent.close()


def in_thread(work: Callable[[], object]) -> threading.Thread:
    thread = threading.Thread(target=work)
    thread.start()
    return thread


def say(link: ChildLink, payload: bytes, step: int = 0) -> None:
    link.send(payload, step)
    link.close()


def echo_once(links: ParentLinks, names: list[str], payload: bytes, step: int = 0) -> dict[str, Message | LinkLost]:
    links.send_all(dict.fromkeys(names, payload), step)
    return links.receive_all(names, step)


def open_descriptors() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def threads_of_this_process() -> int:
    return sum(1 for _ in Path("/proc/self/task").iterdir())


def test_messages_of_every_length_arrive_whole_and_are_counted(start: Start, linked: Callable[..., ParentLinks]) -> None:
    names = ["device 1", "edge/2"]
    for name in names:
        start("echo", name)
    links = linked(names)
    lengths = [1, 23, 1000, wire.FIRST_BYTES - 24, wire.FIRST_BYTES - 23, wire.FIRST_BYTES + 12345]
    for step, length in enumerate(lengths):
        payload = os.urandom(length)
        answers = echo_once(links, names, payload, step)
        assert answers == dict.fromkeys(names, Message(step, payload)), f"{length} bytes"
    traffic = links.traffic["edge/2"]
    assert traffic.sent_bytes == traffic.received_bytes == sum(lengths) + 24 * len(lengths)
    assert traffic.sent_messages == traffic.received_messages == len(lengths)


def test_first_parts_that_are_filled_up_carry_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, linked: Callable[..., ParentLinks]
) -> None:
    """As over libuv, whose receives take only messages of the posted length."""
    monkeypatch.setattr(wire, "FIRST_BYTES", 4096)
    monkeypatch.setattr(wire, "PADDED", True)
    payloads = [b"", b"a", os.urandom(4072), os.urandom(4073), os.urandom(100_000)]
    received: list[Message] = []

    def child() -> None:
        link = connect(tmp_path, "device", 20, RULES)
        for payload in payloads:
            received.append(link.receive())
            link.send(payload, 3)
        link.close()

    thread = in_thread(child)
    links = linked(["device"])
    for payload in payloads:
        assert echo_once(links, ["device"], payload, 3) == {"device": Message(3, payload)}
    thread.join()
    assert received == [Message(3, payload) for payload in payloads]


def test_half_a_message_of_a_killed_child_is_given_up_at_once(start: Start, linked: Callable[..., ParentLinks]) -> None:
    names = [f"victim {number}" for number in range(20)]
    for name in names:
        victim = start("send big", name)
        links = linked([name])
        inbox = links._wires[name]._inbox
        while not inbox[1000]:
            time.sleep(1e-4)
        victim.send_signal(signal.SIGSTOP)
        time.sleep(0.1)
        if inbox[-1] == 0:
            break
        # The first part was there before its sender could be stopped: another one is tried.
        victim.kill()
    else:
        pytest.fail(f"none of {len(names)} senders could be stopped in the middle of a message")
    victim.kill()
    began = time.monotonic()
    answer = links.receive_all([name])[name]
    assert str(answer) == f"The link to {name} is lost: the other process ended or closed it."
    assert time.monotonic() - began < RULES.limit_s / 2


@pytest.mark.parametrize("work", ["send big", "echo"])
def test_a_child_killed_in_the_middle_breaks_its_own_link_alone(work: str, start: Start, linked: Callable[..., ParentLinks]) -> None:
    """Killed while it sends 40 MB again and again, or while the parent waits for it."""
    victim = start(work, "victim")
    start("echo", "other")
    links = linked(["victim", "other"])
    time.sleep(0.2)
    threading.Timer(0.2, victim.kill).start()
    began = time.monotonic()
    links.send_all({"other": b"x"}, 1)
    answers = links.receive_all(["victim", "other"])
    while isinstance(answers["victim"], Message):
        answers |= links.receive_all(["victim"])
    assert answers["victim"].reason == "the other process ended or closed it"
    assert answers["victim"].peer == "victim"
    assert answers["other"] == Message(1, b"x")
    assert time.monotonic() - began < RULES.limit_s / 2
    assert links.linked == ["other"]
    again = echo_once(links, ["victim", "other"], b"y", 2)
    assert str(again["victim"]) == "The link to victim is lost: it has not been made, or not again."
    assert again["other"] == Message(2, b"y")
    start("echo", "victim")
    assert links.wait_for(["victim"], 20) == []
    assert echo_once(links, ["victim", "other"], b"z", 3) == dict.fromkeys(["victim", "other"], Message(3, b"z"))


def test_a_child_that_stops_is_left_out_after_the_limit_and_comes_back(start: Start, linked: Callable[..., ParentLinks]) -> None:
    slow = start("reconnect", "slow")
    start("echo", "quick")
    links = linked(["slow", "quick"], LinkRules(limit_s=1, address="127.0.0.1"))
    slow.send_signal(signal.SIGSTOP)
    began = time.monotonic()
    answers = echo_once(links, ["slow", "quick"], b"x", 5)
    assert 0.9 < time.monotonic() - began < RULES.limit_s / 2
    assert str(answers["slow"]) == "The link to slow is lost: no answer within 1 s."
    assert answers["quick"] == Message(5, b"x")
    slow.send_signal(signal.SIGCONT)
    assert links.wait_for(["slow"], 20) == []
    assert echo_once(links, ["slow", "quick"], b"y", 6) == dict.fromkeys(["slow", "quick"], Message(6, b"y"))


def test_children_see_that_their_parent_died_and_go_on_with_the_next(start: Start, linked: Callable[..., ParentLinks]) -> None:
    child = start("reconnect", "device")
    parent = start("parent", "device")
    assert parent.stdout is not None and child.stdout is not None
    for _ in range(5):
        parent.stdout.readline()
    killed = time.monotonic()
    parent.kill()
    when, _, sentence = child.stdout.readline().partition(" ")
    assert float(when) - killed < RULES.limit_s / 2
    assert sentence == "The link to the parent is lost: the other process ended or closed it.\n"
    links = linked(["device"])
    assert echo_once(links, ["device"], b"after", 9) == {"device": Message(9, b"after")}


def test_a_parent_leaves_alone_what_its_dead_predecessor_took(tmp_path: Path, linked: Callable[..., ParentLinks]) -> None:
    """The child gives such an attempt up after `ANSWER_S` and asks again."""
    device = meeting_place.device_at("127.0.0.1")
    dead = meeting_place.ask(tmp_path, "device")
    assert dead.take() and not dead.take()
    parent = ParentLinks(tmp_path, ["device"], RULES)
    assert parent.poll() == [] and parent.wait_for(["device"], 0.3) == ["device"]
    with pytest.raises(TimeoutError, match="did not come"):
        meeting_place.join(dead, meeting_place.CHILD, device, 0.2)
    thread = in_thread(lambda: say(connect(tmp_path, "device", 20, RULES), b"here", 1))
    assert parent.wait_for(["device"], 20) == []
    assert parent.receive_all(["device"]) == {"device": Message(1, b"here")}
    thread.join()
    parent.close()


def test_a_child_that_died_before_it_was_taken_holds_up_nobody(
    tmp_path: Path, start: Start, linked: Callable[..., ParentLinks], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("radiant_app.together.links.ANSWER_S", 1.0)
    start("echo", "alive")
    dead = start("echo", "dead")
    while not meeting_place.attempts(tmp_path, "dead"):
        time.sleep(0.01)
    dead.kill()
    dead.wait()
    links = ParentLinks(tmp_path, ["dead", "alive"], RULES)
    began = time.monotonic()
    links.poll()
    assert time.monotonic() - began < 0.9, "it waits for no answer"
    assert links.wait_for(["alive"], 20) == []
    assert links.linked == ["alive"]
    start("echo", "dead")
    assert links.wait_for(["dead"], 20) == []
    links.close()


def test_steps_are_held_apart_and_lengths_are_bounded(tmp_path: Path, linked: Callable[..., ParentLinks]) -> None:
    thread_says: list[str] = []
    small = LinkRules(limit_s=10, most_bytes=100, address="127.0.0.1")

    def child() -> None:
        link = connect(tmp_path, "device", 20, RULES)
        for step in (1, 2, 3, 9):
            link.send(b"%d" % step, step)
        for attempt in range(2):
            try:
                link.receive()
            except LinkLost as error:
                thread_says.append(error.reason)
                link = connect(tmp_path, "device", 20, RULES)
                link.send(bytes(101), attempt)

    thread = in_thread(child)
    links = linked(["device"], small)
    assert links.receive_all(["device"], 3) == {"device": Message(3, b"3")}
    assert links.traffic["device"].stale_messages == 2
    ahead = links.receive_all(["device"], 4)["device"]
    assert str(ahead) == "The link to device is lost: it speaks of step 9 where step 4 is due."
    assert links.wait_for(["device"], 20) == []
    long = links.receive_all(["device"])["device"]
    assert str(long) == "The link to device is lost: it announced a message of 101 bytes; at most 100 are taken."
    assert links.wait_for(["device"], 20) == []
    with pytest.raises(ValueError, match=r"A message of 101 bytes to device is too long: most_bytes is 100\."):
        links.send_all({"device": bytes(101)})
    with pytest.raises(ValueError, match=r"There is no child nobody; the children are device\."):
        links.receive_all(["nobody"])
    thread.join()
    assert thread_says == ["the other process ended or closed it"] * 2


def test_the_last_word_of_a_child_that_ends_is_heard(start: Start, linked: Callable[..., ParentLinks]) -> None:
    start("send and end", "device")
    links = linked(["device"])
    time.sleep(0.3)
    assert links.receive_all(["device"]) == {"device": Message(7, b"the last word")}
    assert isinstance(links.receive_all(["device"])["device"], LinkLost)


def test_nobody_waits_for_ever_for_a_parent(tmp_path: Path) -> None:
    began = time.monotonic()
    with pytest.raises(LinkLost, match=r"no parent took the link that device asked for in .* within 0\.5 s"):
        connect(tmp_path, "device", 0.5, RULES)
    assert time.monotonic() - began < RULES.limit_s / 2
    assert meeting_place.attempts(tmp_path, "device") == []


def test_who_waits_burns_no_processor_time(start: Start, linked: Callable[..., ParentLinks]) -> None:
    start("idle", "device")
    links = linked(["device"])
    before = time.process_time()
    threading.Timer(2.0, lambda: links.send_all({"device": b"x"})).start()
    answer = links.receive_all(["device"])["device"]
    assert isinstance(answer, Message)
    assert float(answer.payload) < 0.5, "seconds of the child's processor time in 2 s"
    assert time.process_time() - before < 0.5, "seconds of the parent's"
    links.send_all({"device": b"x"})


@pytest.mark.parametrize(("bytes_per_s", "latency_s"), [(2.5e6, 0.02), (None, 0.05)])
def test_a_paced_link_takes_the_time_of_the_link_it_plays(
    tmp_path: Path, linked: Callable[..., ParentLinks], bytes_per_s: float | None, latency_s: float
) -> None:
    """250 kB each way, two messages up: the second follows the first without another latency."""
    rules = LinkRules(limit_s=10, address="127.0.0.1", pace=Pace(bytes_per_s, latency_s))
    carry_s = 0.0 if bytes_per_s is None else 250_024 / bytes_per_s

    def child() -> None:
        link = connect(tmp_path, "device", 20, rules)
        for _ in range(NUM_TIMED):
            link.receive()
            link.send(bytes(250_000), 1)
            link.send(bytes(250_000), 2)
        link.receive()

    thread = in_thread(child)
    links = linked(["device"], rules)
    times_s: list[tuple[float, float, float]] = []
    for _ in range(NUM_TIMED):
        began = time.monotonic()
        links.send_all({"device": bytes(250_000)})
        sent_s = time.monotonic() - began
        assert isinstance(links.receive_all(["device"], 1)["device"], Message)
        first_s = time.monotonic() - began
        assert isinstance(links.receive_all(["device"], 2)["device"], Message)
        times_s.append((sent_s, first_s, time.monotonic() - began))
    links.send_all({"device": b""})
    thread.join()
    quickest_s, slack_s = np.min(times_s, axis=0), 0.2  # a machine of two busy cores
    assert quickest_s[0] < carry_s + latency_s, "the sender goes on at once"
    assert 0 <= quickest_s[1] - 2 * (carry_s + latency_s) < slack_s
    assert -1e-3 <= quickest_s[2] - 3 * carry_s - 2 * latency_s < slack_s


def test_a_hundred_new_links_leave_no_thread_and_no_descriptor(tmp_path: Path, linked: Callable[..., ParentLinks]) -> None:
    def child() -> None:
        for _ in range(101):
            link = connect(tmp_path, "device", 20, RULES)
            link.send(b"here")
            with pytest.raises(LinkLost):
                link.receive()

    thread = in_thread(child)
    links = linked(["device"])
    counts = []
    for _ in range(101):
        assert links.wait_for(["device"], 20) == []
        assert links.receive_all(["device"]) == {"device": Message(0, b"here")}
        counts.append((open_descriptors(), threads_of_this_process()))
        links.drop("device")
    thread.join()
    links.close()
    assert max(counts[50:]) <= max(counts[:10]), "descriptors and threads, both ends being here"
    assert len(meeting_place.attempts(tmp_path, "device")) == 1, "earlier attempts are withdrawn"


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (lambda: Pace(bytes_per_s=0), "bytes_per_s is 0; it must be above 0 and finite, or None for no bound."),
        (lambda: Pace(latency_s=-1), "latency_s is -1; it must be 0 or more and finite."),
        (lambda: LinkRules(limit_s=0), "limit_s is 0; it must be above 0 and below a million seconds."),
        (lambda: LinkRules(most_bytes=-1), "most_bytes is -1; it must be 0 or more."),
    ],
)
def test_rules_that_make_no_sense_are_refused(wrong: Callable[[], object], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence.replace("(", r"\(")):
        wrong()


def test_the_interface_is_that_of_the_environment_where_no_address_is_given(
    tmp_path: Path, linked: Callable[..., ParentLinks], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GLOO_SOCKET_IFNAME", "lo")
    thread = in_thread(lambda: say(connect(tmp_path, "device", 20), b"over lo"))
    assert linked(["device"], LinkRules(limit_s=10)).receive_all(["device"]) == {"device": Message(0, b"over lo")}
    thread.join()
    monkeypatch.setenv("GLOO_SOCKET_IFNAME", "no such one")
    with pytest.raises(RuntimeError, match="Unable to find address for: no such one"):
        connect(tmp_path, "device", 20)


@pytest.mark.parametrize("work", ["send big", "echo"])
def test_a_parent_that_sends_to_a_killed_child_hears_of_it(work: str, start: Start, linked: Callable[..., ParentLinks]) -> None:
    """40 MB to a child that reads none of them, or to one that gives back what it reads."""
    victim = start(work, "victim")
    start("echo", "other")
    links = linked(["victim", "other"])
    threading.Timer(0.3, victim.kill).start()
    began = time.monotonic()
    lost: dict[str, LinkLost] = {}
    while not lost:
        lost = links.send_all({"victim": bytes(40 << 20), "other": b"x"}, 1)
        answers = links.receive_all(["other"], 1)
        assert answers == {"other": Message(1, b"x")}
        if work == "echo" and not lost:
            lost = {name: loss for name, loss in links.receive_all(["victim"]).items() if isinstance(loss, LinkLost)}
    assert lost["victim"].reason == "the other process ended or closed it"
    assert time.monotonic() - began < RULES.limit_s / 2
