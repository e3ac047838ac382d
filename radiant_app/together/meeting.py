"""Where the two ends of a link find each other: a folder that both see, and gloo's handshake over
it.

A child asks for a link by an *attempt*, a folder of its own in `MEETING/to-NAME`:

    asked      written by the child when it is ready; its parent renames it to `taken`, once for all
    store/     what gloo says to the other end: one file per key, written at once or not at all

An attempt is taken by one parent and never again, so a restarted parent leaves alone what its dead
predecessor took; whoever waits in vain for the other end makes a new attempt. Runs once per link.

The keys lie in small files and not in torch's `FileStore`, which was seen to wait without end
(torch 2.13). A file here is whole or absent.
"""

import contextlib
import os
import secrets
import shutil
import time
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any
from urllib.parse import quote

import torch.distributed as dist
from torch.distributed.distributed_c10d import Store

CHILD, PARENT = 0, 1
"""Ranks of the two ends in the process group of a link."""

ANSWER_S = 5.0
"""Seconds that an end whose attempt was taken waits for the other before it gives that attempt
up."""

_Gloo: Any = dist.ProcessGroupGloo  # its options and devices are not in torch's stubs
_GLOO_CONNECTS = 5  # times its timeout that gloo waits for a connection which the other end opens


class Attempt:
    """One attempt of a child at a link; `path` is its folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def take(self) -> bool:
        """Mark it as taken; `False` where it was taken before, is withdrawn or is not complete."""
        try:
            (self.path / "asked").rename(self.path / "taken")
        except OSError:
            return False
        return True

    def is_taken(self) -> bool:
        """Whether a parent has taken it."""
        return (self.path / "taken").exists()


class _Store(Store):
    """torch's interface to a store over the files of one attempt, until `deadline` (monotonic,
    s)."""

    def __init__(self, attempt: Attempt, deadline: float) -> None:
        super().__init__()
        self._attempt = attempt
        self._deadline = deadline

    def _file(self, key: str) -> Path:
        return self._attempt.path / "store" / quote(key, safe="")

    def set(self, key: str, value: Any) -> None:
        file = self._file(key)
        draft = file.with_name(f"{file.name}.{secrets.token_hex(4)}")
        draft.write_bytes(value.encode() if isinstance(value, str) else value)
        draft.replace(file)

    def get(self, key: str) -> bytes:
        self.wait([key])
        return self._file(key).read_bytes()

    def check(self, keys: Sequence[str]) -> bool:
        return all(self._file(key).exists() for key in keys)

    def wait(self, keys: Sequence[str], timeout: timedelta | None = None) -> None:
        """Wait for `keys`; `TimeoutError` at the deadline, and `ANSWER_S` after the attempt was
        taken.

        gloo's own `timeout` is not heeded: a child may wait for its parent longer than for a
        connection.
        """
        deadline, was_taken, pause_s = self._deadline, False, 0.001
        while not self.check(keys):
            if not was_taken and self._attempt.is_taken():
                was_taken, deadline = True, min(deadline, time.monotonic() + ANSWER_S)
            if time.monotonic() >= deadline:
                raise TimeoutError(f"The other end of {self._attempt.path} did not come.")
            time.sleep(pause_s)
            pause_s = min(1.5 * pause_s, 0.05)


def ask(meeting: Path, name: str) -> Attempt:
    """Make a new attempt of the child `name` and withdraw its earlier ones."""
    place = _place(meeting, name)
    withdraw(meeting, name)
    attempt = Attempt(place / secrets.token_hex(8))
    (attempt.path / "store").mkdir(parents=True)
    (attempt.path / "asked").touch()
    return attempt


def withdraw(meeting: Path, name: str) -> None:
    """Remove every attempt of the child `name`."""
    shutil.rmtree(_place(meeting, name), ignore_errors=True)


def attempts(meeting: Path, name: str) -> list[Attempt]:
    """The attempts of the child `name`, in no order; most often none or one."""
    place = _place(meeting, name)
    with contextlib.suppress(OSError):
        return [Attempt(path) for path in place.iterdir()]
    return []


def join(attempt: Attempt, rank: int, device: Any, wait_s: float) -> Any:
    """The `ProcessGroupGloo` of two that an attempt leads to.

    Raises `OSError` or `RuntimeError` where the other end does not come: within `wait_s`, or within
    `ANSWER_S` after the attempt was taken.
    """
    options = _Gloo._Options()
    options._devices = [device]
    options._threads = 1  # of collectives, of which a link has none
    options._timeout = timedelta(seconds=ANSWER_S / _GLOO_CONNECTS)
    store = _Store(attempt, time.monotonic() + wait_s)
    return _Gloo(store, rank, 2, options)


def device_at(address: str) -> Any:
    """gloo's device: an address to listen at and the thread that carries the bytes of all its
    links.

    `address` is an IP address or name of this machine. Where it is empty it is that of the
    interface which `GLOO_SOCKET_IFNAME` names, else that to which the name of this machine
    resolves, else loopback.
    """
    interface = os.environ.get("GLOO_SOCKET_IFNAME", "").split(",")[0]
    if address:
        return _Gloo.create_device(hostname=address)
    if interface:
        return _Gloo.create_device(interface=interface)
    return _Gloo.create_default_device()


def _place(meeting: Path, name: str) -> Path:
    return meeting / f"to-{quote(name, safe='')}"
