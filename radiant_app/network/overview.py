"""Rows that show people the nodes which join one: who, since when silent, what arrived, what was
refused. Once per look; for `radiant node status` and the inspector."""

from __future__ import annotations

import sqlite3
import time
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal

from radiant_app.network.arrivals import INCOMING, Arrivals
from radiant_app.network.store import OPEN, STORE_NAME, HubStore, KnownTask, Member
from radiant_app.plain_text import plain_text
from radiant_core.io.transport.envelope import open_envelope

SILENT_S = 60.0
"""A node that asked for nothing for so long is shown as offline."""
State = Literal["invited", "joined", "offline", "revoked"]


@dataclass(frozen=True, kw_only=True)
class NodeRow:
    """One node as it is seen from the one above it."""

    node: str
    state: State
    silent_s: float | None
    """Seconds since its last request, by this machine's clock; None before the first."""
    doing: str
    """What it last said that it does, or why its last request was refused."""
    software: str
    task: KnownTask | None = None
    """Its newest task."""
    arrived_bytes: int | None = None
    """Of the result of that task; None before it was announced."""
    num_bytes: int | None = None

    @property
    def text(self) -> str:
        """One line, for example "devices/d: joined, devices/d taken, 212 of 310 MB"."""
        parts = [self.state]
        if self.state == "offline" and self.silent_s is not None:
            parts = [f"offline since {_moment(self.silent_s)}"]
        if self.task is not None:
            parts.append(f"{self.task.stage} {_what_became(self.task)}")
        if self.num_bytes is not None and self.arrived_bytes is not None:
            parts.append(f"{_megabytes(self.arrived_bytes)} of {_megabytes(self.num_bytes)} MB")
        if self.doing.startswith("refused"):
            parts.append(self.doing)
        return plain_text(f"{self.node}: {', '.join(parts)}")


def read_rows(home: Path) -> list[NodeRow]:
    """A row per node that was invited to a home, by id; none where nobody was, or while the
    database cannot be read."""
    if not (home / STORE_NAME).is_file():
        return []
    try:
        store = HubStore(folder=home, read_only=True)
    except sqlite3.Error:
        return []
    try:
        newest: dict[str, KnownTask] = {}
        for task in store.tasks():
            newest.setdefault(task.node, task)
        return [_row_of(member, newest.get(member.id), store, Arrivals(folder=home / INCOMING)) for member in store.members()]
    except sqlite3.Error:
        return []
    finally:
        store.close()


def _row_of(member: Member, task: KnownTask | None, store: HubStore, arrivals: Arrivals) -> NodeRow:
    silent_s = None if member.seen_s is None else max(0.0, time.time() - member.seen_s)
    state: State = "offline" if (silent_s or 0.0) > SILENT_S else "joined"
    if member.key is None or member.revoked:
        state = "revoked" if member.revoked else "invited"
    arrived, total = None, None
    result = None if task is None or task.state not in OPEN else store.result(task.digest)
    if task is not None and result is not None and member.key is not None:
        envelope = open_envelope(*result, member.key)
        total = envelope.num_bytes
        arrived = total if task.state == "received" else arrivals.num_bytes(task.digest)
    return NodeRow(
        node=member.id,
        state=state,
        silent_s=silent_s,
        doing=plain_text(member.note),
        software=plain_text(member.software),
        task=task,
        arrived_bytes=arrived,
        num_bytes=total,
    )


def _what_became(task: KnownTask) -> str:
    again = f" for the {task.tries}. time" if task.tries > 1 and task.state in OPEN else ""
    return f"{task.state}{again}{f' ({task.reason})' if task.reason else ''}"


def _moment(silent_s: float) -> str:
    then = datetime.fromtimestamp(time.time() - silent_s)
    return f"{then:%H:%M}" if silent_s < 12 * 3600 else f"{then:%Y-%m-%d %H:%M}"


def _megabytes(num_bytes: int) -> str:
    return f"{num_bytes / 1e6:.0f}" if num_bytes >= 10**7 else f"{num_bytes / 1e6:.2f}"
