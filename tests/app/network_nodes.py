"""Nodes of a network on loopback: each in a thread of this process, with folders and keys of its own."""

from __future__ import annotations

import shutil
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from radiant_app.commands.network import node as commands
from radiant_app.executors.protocol import NodeTask
from radiant_app.network.home import Listening, make_home
from radiant_core.errors import RadiantError

POLL_S = 0.5
"""Between requests of a node: at 0.1 s, requests took most of the CPU time of a tiny run."""


def free_port() -> int:
    """A port that nobody listens at now."""
    with socket.create_server(("127.0.0.1", 0)) as bound:
        return bound.getsockname()[1]


def listening(port: int | None = None) -> Listening:
    """Loopback at a free port."""
    port = port or free_port()
    return Listening(url=f"https://127.0.0.1:{port}", host="127.0.0.1", port=port)


@dataclass
class Nodes:
    """The homes below a folder, and the threads of those that work."""

    folder: Path
    command: Callable[[NodeTask], list[str]] | None = None
    threads: dict[str, tuple[threading.Thread, threading.Event]] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)
    errors: list[BaseException] = field(default_factory=list)

    def home(self, name: str) -> Path:
        return self.folder / name

    def make(self, edges: dict[str, Sequence[str]]) -> None:
        """A cloud, its edges, their devices: made, invited and joined by the commands themselves."""
        make_home(self.home("cloud"), listening())
        for edge, devices in edges.items():
            commands.init(self.home(edge), listening())
            commands.invite(self.home("cloud"), edge, self.folder / f"{edge}.join")
            commands.join(self.home(edge), self.folder / f"{edge}.join")
            for device in devices:
                commands.invite(self.home(edge), device, self.folder / f"{device}.join")
                commands.join(self.home(device), self.folder / f"{device}.join")

    def start_edge(self, name: str) -> None:
        ended = threading.Event()
        running = commands.Running(say=self.said.append, ended=ended, command=self.command, poll_s=POLL_S)
        self._start(name, ended, lambda: running.serve(self.home(name)))

    def start_device(self, name: str, photographs: Path, poses: Path | None) -> None:
        ended = threading.Event()
        running = commands.Running(say=self.said.append, ended=ended, command=self.command)
        self._start(name, ended, lambda: running.work(self.home(name), photographs, poses, lambda text: True))

    def _start(self, name: str, ended: threading.Event, work: Callable[[], None]) -> None:
        def run() -> None:
            try:
                work()
            except (RadiantError, OSError) as error:
                self.errors.append(error)

        thread = threading.Thread(target=run, daemon=True)
        self.threads[name] = (thread, ended)
        thread.start()

    def stop(self, name: str) -> None:
        thread, ended = self.threads.pop(name)
        ended.set()
        thread.join(30)
        assert not thread.is_alive()

    def stop_all(self) -> None:
        for name in list(self.threads):
            self.stop(name)


@contextmanager
def nodes_in(folder: Path, command: Callable[[NodeTask], list[str]] | None = None) -> Iterator[Nodes]:
    """Nodes whose threads end with the block."""
    nodes = Nodes(folder=folder, command=command)
    try:
        yield nodes
    finally:
        nodes.stop_all()


def split_photographs(images: Path, target: Path, devices: Sequence[str]) -> Path:
    """A folder of photographs per device, dealt in turn."""
    for index, path in enumerate(sorted(images.iterdir())):
        folder = target / devices[index % len(devices)]
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, folder / path.name)
    return target
