"""A parent and its children: nobody is waited for who will not come again."""

from __future__ import annotations

import threading
from pathlib import Path

from radiant_app.together import exchange
from radiant_app.together.exchange import BEGIN, START, Children, pack
from radiant_app.together.links import LinkRules, ParentLinks, connect
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
