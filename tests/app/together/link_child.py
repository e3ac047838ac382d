"""A child of the link tests, as a process of its own: `python link_child.py WORK MEETING NAME [LIMIT_S]`."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from radiant_app.together.links import ChildLink, LinkLost, LinkRules, connect

ECHO_BYTES = 1000
BIG_BYTES = 40 << 20


def echo(link: ChildLink) -> None:
    """Give back every message, until an empty one."""
    while (message := link.receive()).payload:
        link.send(message.payload, message.step)
    link.close()


def echo_and_reconnect(meeting: Path, name: str, rules: LinkRules) -> None:
    """Echo; whenever the link is lost, say so and connect again."""
    while True:
        try:
            return echo(connect(meeting, name, 20, rules))
        except LinkLost as error:
            print(f"{time.monotonic()} {error}", flush=True)


def parent(meeting: Path, name: str, rules: LinkRules) -> None:
    """A parent that talks to one child until it is killed."""
    from radiant_app.together.links import ParentLinks

    links = ParentLinks(meeting, [name], rules)
    assert links.wait_for([name], 20) == []
    for step in range(10**9):
        links.send_all({name: bytes(ECHO_BYTES)}, step)
        links.receive_all([name], step)
        print(step, flush=True)
        time.sleep(0.01)


def main() -> None:
    """Do one kind of work."""
    work, meeting, name = sys.argv[1], Path(sys.argv[2]), sys.argv[3]
    rules = LinkRules(limit_s=float(sys.argv[4]) if len(sys.argv) > 4 else 20, address="127.0.0.1")
    if work == "parent":
        return parent(meeting, name, rules)
    if work == "reconnect":
        return echo_and_reconnect(meeting, name, rules)
    link = connect(meeting, name, 20, rules)
    if work == "echo":
        echo(link)
    elif work == "send big":  # until it is killed
        time.sleep(0.5)
        while True:
            link.send(b"x" * BIG_BYTES)
    elif work == "send and end":
        link.send(b"the last word", 7)
        link.close()
    elif work == "idle":
        before = time.process_time()
        link.receive()
        link.send(str(time.process_time() - before).encode())
        link.receive()
    return None


if __name__ == "__main__":
    main()
