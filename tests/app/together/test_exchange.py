"""A parent and its children: nobody is waited for who will not come again."""

from __future__ import annotations

import threading
from functools import partial
from pathlib import Path

from radiant_app.together import exchange
from radiant_app.together.exchange import BEGIN, START, Children, pack
from radiant_app.together.links import LinkLost, LinkRules, ParentLinks, connect
from radiant_app.together.places import mark_gone

RULES = LinkRules(limit_s=10, address="127.0.0.1")
WAIT_S = 30.0


def test_a_child_that_is_given_up_between_the_end_and_its_last_word_is_not_waited_for(tmp_path: Path) -> None:
    warned = list[str]()
    links = ParentLinks(tmp_path, ["north-1"], RULES)
    children = Children(links=links, names=["north-1"], meeting=tmp_path, warn=warned.append)
    finished = threading.Event()

    def die_after_the_end() -> None:
        link = connect(tmp_path, "north-1", WAIT_S, RULES)
        link.send(pack(START, {"north-1": b""}))
        assert link.receive().payload[:1] == BEGIN and link.receive().payload[:1] == exchange.END
        link._wire.lose("killed")
        mark_gone(tmp_path, "north-1")

    def finish() -> None:
        children.starts()
        children.begin({"north-1": pack(BEGIN, {})})
        children.finish(lambda name, parts: pack(BEGIN, {}))
        finished.set()

    for work in (die_after_the_end, finish):
        threading.Thread(target=work, daemon=True).start()
    assert finished.wait(WAIT_S), warned
    assert children.left_out == {"north-1": "it has ended"} and any("steps go on without north-1" in message for message in warned)


def test_a_child_that_is_late_every_time_is_left_out_and_a_broken_start_refuses_its_sender_alone(tmp_path: Path) -> None:
    warned = list[str]()
    rules = LinkRules(limit_s=0.5, address="127.0.0.1")
    links = ParentLinks(tmp_path, ["quick", "slow", "broken"], rules)
    children = Children(links=links, names=["quick", "slow", "broken"], meeting=tmp_path, warn=warned.append)
    steps, done = list[set[str]](), threading.Event()

    def child(name: str, *, answers: bool) -> None:
        while not done.is_set():
            try:
                link = connect(tmp_path, name, WAIT_S, RULES)
                link.send(pack(START, {name: b""}))
                while link.receive().payload[:1] != exchange.END and answers:
                    link.send(exchange.GRADIENTS + b"gradients")
                if not answers:
                    link.receive()
            except LinkLost:
                continue
            else:
                return

    def broken() -> None:
        link = connect(tmp_path, "broken", WAIT_S, RULES)
        link.send(START + b"\xff\xff\xff\xff")
        link.receive()

    def parent() -> None:
        children.starts()
        children.begin({"quick": pack(BEGIN, {}), "slow": pack(BEGIN, {})})
        for _ in range(3):
            steps.append(set(children.gradients(lambda name, parts: pack(BEGIN, {}))))
            children.send(exchange.TOTAL)
        children.send(exchange.END)
        done.set()

    workers = [partial(child, "quick", answers=True), partial(child, "slow", answers=False), broken, parent]
    for work in workers:
        threading.Thread(target=work, daemon=True).start()
    assert done.wait(WAIT_S), warned
    assert steps == [{"quick"}] * 3
    assert "a message" in children.left_out["broken"] and "late 3 times in a row" in children.left_out["slow"]
