"""A link between two machines that can be cut, go down and be slow: a TCP proxy on loopback."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

PIECE = 1 << 16
_RESET = struct.pack("ii", 1, 0)


@dataclass
class Link:
    """Forwards connections to a port of loopback."""

    target: int
    cuts: Sequence[int] = ()
    """Each time that so many bytes in all went up, the connection that carries them is reset."""
    bytes_per_s: float | None = None
    port: int = 0
    num_up: int = 0
    num_cut: int = 0
    _up: threading.Event = field(default_factory=threading.Event)
    _counting: threading.Lock = field(default_factory=threading.Lock)
    _open: set[socket.socket] = field(default_factory=set)
    _threads: list[threading.Thread] = field(default_factory=list)
    _free_s: float = 0.0
    """When the link is free for the next piece."""

    def __post_init__(self) -> None:
        self._up.set()
        self._bound = socket.create_server(("127.0.0.1", 0), backlog=128)
        self.port = self._bound.getsockname()[1]
        self._start(self._accept)

    @contextmanager
    def down(self) -> Iterator[None]:
        """Nothing passes, and nobody is told; what was on its way arrives late."""
        self._up.clear()
        try:
            yield
        finally:
            self._up.set()

    def close(self) -> None:
        """Reset what is open; returns when nothing is."""
        self._up.set()
        with suppress(OSError):
            self._bound.shutdown(socket.SHUT_RDWR)
        self._bound.close()
        for one in [*self._open]:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        for thread in [*self._threads]:
            thread.join(5)

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._bound.accept()
                self._open.add(near)
                self._start(self._connect, near)

    def _connect(self, near: socket.socket) -> None:
        try:
            far = socket.create_connection(("127.0.0.1", self.target))
        except OSError:
            self._open.discard(near)
            near.close()
            return
        self._open.add(far)
        down = self._start(self._pump, far, near, False)
        self._pump(near, far, True)
        down.join()
        for one in (near, far):
            self._open.discard(one)
            one.close()

    def _start(self, work: Callable[..., None], *given: object) -> threading.Thread:
        thread = threading.Thread(target=work, args=given, daemon=True)
        self._threads.append(thread)
        thread.start()
        return thread

    def _pump(self, source: socket.socket, target: socket.socket, upwards: bool) -> None:
        try:
            while data := source.recv(PIECE):
                self._up.wait()
                self._wait_for_room(len(data))
                if upwards and self._count(len(data)):
                    break
                target.sendall(data)
            else:
                target.shutdown(socket.SHUT_WR)
                return
        except OSError:
            pass
        _reset(source)
        _reset(target)

    def _wait_for_room(self, num_bytes: int) -> None:
        if self.bytes_per_s is not None:
            with self._counting:
                self._free_s = max(self._free_s, time.monotonic()) + num_bytes / self.bytes_per_s
                wait_s = self._free_s - time.monotonic()
            time.sleep(max(0.0, wait_s))

    def _count(self, num_bytes: int) -> bool:
        """Whether the connection that carries these is cut."""
        with self._counting:
            self.num_up += num_bytes
            is_cut = self.num_cut < len(self.cuts) and self.num_up >= self.cuts[self.num_cut]
            self.num_cut += is_cut
            return is_cut


def _reset(one: socket.socket) -> None:
    """Its other pump sees the end, and both close it: with a reset where bytes are on their way."""
    with suppress(OSError):
        one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
        one.shutdown(socket.SHUT_RDWR)
