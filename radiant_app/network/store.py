"""What a node remembers of those that join it: keys, counters, tasks and results, in SQLite.

    node     invited ─→ joined ─→ revoked      by key; a one-time word is kept as its hash
    task     offered ─→ taken ─→ received ─→ accepted | refused
                └────────┼───────────┴─────→ withdrawn
                         └─→ failed

Everything is a transaction, so that a process may end at any moment. Several processes may read
and invite; one conducts. Once per request.
"""

from __future__ import annotations

import hashlib
import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from radiant_core.errors import CannotWrite

STORE_NAME = "hub.sqlite"
OPEN = ("offered", "taken", "received")
_CLOSED = ("accepted", "refused", "failed", "withdrawn")
_TABLES = """
create table if not exists nodes(
    id text primary key, key blob, token text, joined_s real, revoked integer not null default 0, counter integer not null default 0,
    seen_s real, software text not null default '', batch integer not null default 0, note text not null default '');
create table if not exists tasks(
    digest text primary key, run text not null, node text not null, stage text not null, attempt integer not null, text blob not null,
    signature blob not null, folder text not null, tries integer not null, state text not null, reason text not null default '',
    changed_s real not null);
create index if not exists tasks_of on tasks(node, state);
create table if not exists carried(task text primary key);
create table if not exists results(task text primary key, text blob not null, signature blob not null);
"""


@dataclass(frozen=True, kw_only=True)
class Member:
    """A node that was invited; without a key while it has not joined."""

    id: str
    key: Ed25519PublicKey | None
    revoked: bool
    counter: int
    seen_s: float | None
    """When its last request came, seconds since 1970 by this machine's clock."""
    software: str
    note: str
    """What it last did, or why it was refused."""


@dataclass(frozen=True, kw_only=True)
class KnownTask:
    """A task of a node, and what became of it."""

    digest: str
    run: str
    node: str
    stage: str
    attempt: int
    text: bytes
    signature: bytes
    folder: Path
    """Where its files lie."""
    tries: int
    """How often it was asked for; more than once after its process was lost."""
    state: str
    reason: str
    changed_s: float


@dataclass(kw_only=True)
class HubStore:
    """The database of a node's hub."""

    folder: Path
    read_only: bool = False
    """For a look at a database that another process writes."""
    _lock: threading.RLock = field(default_factory=threading.RLock)

    def __post_init__(self) -> None:
        if self.read_only:
            place = f"{(self.folder / STORE_NAME).resolve().as_uri()}?mode=ro"
            self._database = sqlite3.connect(place, uri=True, check_same_thread=False, isolation_level=None, timeout=5.0)
            return
        self._database = sqlite3.connect(self.folder / STORE_NAME, check_same_thread=False, isolation_level=None, timeout=30.0)
        self._database.executescript(f"pragma journal_mode=wal; pragma synchronous=full; {_TABLES}")

    def close(self) -> None:
        """Close the database."""
        with self._lock:
            self._database.close()

    @contextmanager
    def _changing(self, *, forced: bool = True) -> Iterator[sqlite3.Connection]:
        """`forced`: to the disk before it returns, so that a power cut does not undo it."""
        with self._lock:
            self._database.execute(f"pragma synchronous={'full' if forced else 'normal'}")
            self._database.execute("begin immediate")
            try:
                yield self._database
            except BaseException:
                self._database.execute("rollback")
                raise
            self._database.execute("commit")

    def _rows(self, query: str, *values: Any) -> list[Any]:
        with self._lock:
            return self._database.execute(query, values).fetchall()

    # Nodes

    def invite(self, node: str, token: str) -> None:
        """Let `node` join once by this word; one that has joined keeps its key until then, one that
        was revoked has lost it."""
        with self._changing() as database:
            database.execute(
                "insert into nodes(id, token) values(?, ?) on conflict(id) do update set token = excluded.token, "
                "key = case when revoked then null else key end, revoked = 0",
                (node, _hash(token)),
            )

    def join(self, node: str, token: str, key: bytes, software: str, counter: int) -> bool:
        """Register the key (32 bytes) of a node whose word is right, which then counts no more.
        The same key may join again by the same word: its first answer may have been lost."""
        with self._changing() as database:
            row = database.execute("select token, key, counter, revoked from nodes where id = ?", (node,)).fetchone()
            if row is None or row[3]:
                return False
            if row[0] != _hash(token):
                return row[0] == _spent(token) and row[1] == key
            database.execute(
                "update nodes set token = ?, key = ?, joined_s = ?, counter = ?, software = ?, batch = 0 where id = ?",
                (_spent(token), key, time.time(), counter, software, node),
            )
            return True

    def revoke(self, node: str) -> bool:
        """Refuse a node from now on; False where it is unknown."""
        with self._changing() as database:
            return database.execute("update nodes set revoked = 1, token = null where id = ?", (node,)).rowcount > 0

    def member(self, node: str) -> Member | None:
        """The node with this id, if it was invited."""
        return next(iter(self._members("where id = ?", node)), None)

    def members(self) -> list[Member]:
        """All nodes that were invited, by id."""
        return self._members("order by id")

    def _members(self, where: str, *values: Any) -> list[Member]:
        rows = self._rows(f"select id, key, revoked, counter, seen_s, software, note from nodes {where}", *values)
        return [
            Member(
                id=row[0],
                key=None if row[1] is None else Ed25519PublicKey.from_public_bytes(row[1]),
                revoked=bool(row[2]),
                counter=row[3],
                seen_s=row[4],
                software=row[5],
                note=row[6],
            )
            for row in rows
        ]

    def count(self, node: str, counter: int) -> bool:
        """Take a request's counter; False for one that is not larger than all before."""
        with self._changing(forced=False) as database:
            query = "update nodes set counter = ?, seen_s = ? where id = ? and counter < ? and revoked = 0"
            return database.execute(query, (counter, time.time(), node, counter)).rowcount > 0

    def last_counter(self, node: str) -> int:
        """The largest counter that was taken of a node."""
        return next((row[0] for row in self._rows("select counter from nodes where id = ?", node)), 0)

    def take_batch(self, node: str, batch: int) -> bool:
        """Take a numbered batch of events; False for one that was taken before."""
        with self._changing(forced=False) as database:
            query = "update nodes set batch = ? where id = ? and batch < ?"
            return database.execute(query, (batch, node, batch)).rowcount > 0

    def note(self, node: str, note: str, software: str = "") -> None:
        """Remember what a node does."""
        with self._changing(forced=False) as database:
            database.execute("update nodes set note = ?, software = ifnull(nullif(?, ''), software) where id = ?", (note, software, node))

    # Tasks

    def put_task(self, task: KnownTask) -> KnownTask:
        """Offer a task; the same one again is offered anew only where it was not received, with the
        reason where its result was refused. Older tasks of its stage are withdrawn."""
        with self._changing() as database:
            database.execute(
                f"update tasks set state = 'withdrawn', changed_s = ? where node = ? and stage = ? and digest != ? and state in {OPEN}",
                (time.time(), task.node, task.stage, task.digest),
            )
            database.execute(
                "insert into tasks values(?, ?, ?, ?, ?, ?, ?, ?, 1, 'offered', '', ?) on conflict(digest) do update set "
                f"tries = tries + (state in {_CLOSED}), folder = excluded.folder, changed_s = excluded.changed_s, "
                "reason = case when state = 'refused' then reason else '' end, "
                f"state = case when state in {_CLOSED} then 'offered' else state end",
                (*self._key(task), task.text, task.signature, str(task.folder), time.time()),
            )
        stored = self.task(task.digest)
        assert stored is not None
        return stored

    def _key(self, task: KnownTask) -> tuple[Any, ...]:
        return task.digest, task.run, task.node, task.stage, task.attempt

    def task(self, digest: str) -> KnownTask | None:
        """The task with this digest."""
        return next(iter(self._tasks("where digest = ?", digest)), None)

    def open_task(self, node: str) -> KnownTask | None:
        """The oldest task that a node has to do, else one whose result is not accepted yet: that
        waits for who conducts, and may do so while the next is offered."""
        order = "order by state = 'received', changed_s limit 1"
        return next(iter(self._tasks(f"where node = ? and state in {OPEN} {order}", node)), None)

    def open_digests(self) -> set[str]:
        """Digests of the tasks whose results are still waited for."""
        return {row[0] for row in self._rows(f"select digest from tasks where state in {OPEN}")}

    def settle_stage(self, run: str, stage: str) -> None:
        """Count what was received for a stage as accepted: the stage is sealed."""
        with self._changing() as database:
            query = "update tasks set state = 'accepted', changed_s = ? where run = ? and stage = ? and state = 'received'"
            database.execute(query, (time.time(), run, stage))

    def reject_stage(self, run: str, stage: str, reason: str) -> None:
        """Refuse what was accepted for a stage: who joined it found that it cannot be used."""
        with self._changing() as database:
            query = "update tasks set state = 'refused', reason = ?, changed_s = ? where run = ? and stage = ? and state = 'accepted'"
            database.execute(query, (reason, time.time(), run, stage))

    def newest_attempt(self, run: str, node: str, stage: str) -> KnownTask | None:
        """The newest task of a stage, whatever became of it."""
        return next(iter(self._tasks("where run = ? and node = ? and stage = ? order by attempt desc limit 1", run, node, stage)), None)

    def tasks(self) -> list[KnownTask]:
        """All tasks, the latest change first."""
        return self._tasks("order by changed_s desc")

    def _tasks(self, where: str, *values: Any) -> list[KnownTask]:
        columns = "digest, run, node, stage, attempt, text, signature, folder, tries, state, reason, changed_s"
        names = columns.split(", ")
        rows = self._rows(f"select {columns} from tasks {where}", *values)
        return [KnownTask(**{**dict(zip(names, row, strict=True)), "folder": Path(row[7])}) for row in rows]

    def move_task(self, digest: str, state: str, since: tuple[str, ...], reason: str = "") -> bool:
        """Change what became of a task; False where it is in none of the states `since`."""
        marks = ", ".join("?" * len(since))
        with self._changing() as database:
            query = f"update tasks set state = ?, reason = ?, changed_s = ? where digest = ? and state in ({marks})"
            return database.execute(query, (state, reason, time.time(), digest, *since)).rowcount > 0

    def carry(self, digest: str) -> None:
        """Remember that a task goes by another carrier than this network, so that silence means
        nothing."""
        with self._changing() as database:
            database.execute("insert or ignore into carried values(?)", (digest,))

    def is_carried(self, digest: str) -> bool:
        """Whether a task was taken along by another carrier."""
        return bool(self._rows("select 1 from carried where task = ?", digest))

    def withdraw_all(self, but_of_run: str = "") -> None:
        """Withdraw what is open, except of one run."""
        with self._changing() as database:
            query = f"update tasks set state = 'withdrawn', changed_s = ? where run != ? and state in {OPEN}"
            database.execute(query, (time.time(), but_of_run))

    # Results

    def put_result(self, task: str, text: bytes, signature: bytes) -> None:
        """Keep the announcement of a task's result in place of an earlier one."""
        with self._changing() as database:
            database.execute("insert or replace into results values(?, ?, ?)", (task, text, signature))

    def open_results(self) -> list[tuple[str, bytes]]:
        """Digest of the task and announcement of each result that is still arriving."""
        return self._rows("select task, results.text from results join tasks on task = digest where state in ('offered', 'taken')")

    def result(self, task: str) -> tuple[bytes, bytes] | None:
        """The announcement of a task's result and its signature."""
        return next(iter(self._rows("select text, signature from results where task = ?", task)), None)


@contextmanager
def open_store(folder: Path) -> Iterator[HubStore]:
    """The database of a node's folder, until the end of the block; CannotWrite where its disk is
    full, or refuses otherwise, at any moment of it."""
    try:
        store = HubStore(folder=folder)
        try:
            yield store
        finally:
            store.close()
    except sqlite3.Error as error:
        way = "free space on its disk" if "is full" in str(error) else "check the rights and the disk of its folder"
        raise CannotWrite(f"{folder / STORE_NAME} cannot be used ({error}): {way}, then do it again.") from error


def _hash(token: str) -> str:
    return hashlib.sha256(f"radiant.token\0{token}".encode()).hexdigest()


def _spent(token: str) -> str:
    return f"spent {_hash(token)}"
