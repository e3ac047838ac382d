"""Machines that are network namespaces of their own, joined by cables with routes that lead one way. Root alone can make them.

    cloud 10.77.1.1 ── 10.77.1.2 edge 10.77.2.1 ── 10.77.2.2 first device
                                      10.77.3.1 ── 10.77.3.2 second device …

A device has a route to its edge and none beyond. The edge has none to a device but for packets that come from the address which the
device called: it answers, and can call nobody, as if each device stood behind a router that translates addresses.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from radiant_app.executors.sessions import signal_session

ROOT = Path(__file__).parents[2]
PORT = 8443
_LISTENING = "0A"
"""State of a socket in /proc/net/tcp."""
# Structure from motion with several threads differs in the last digits from run to run.
ONE_CORE = "import os\nos.cpu_count = lambda: 1\n"


@dataclass(kw_only=True)
class Machines:
    """A cloud, an edge and devices; what runs on them ends with them."""

    folder: Path
    devices: tuple[str, ...]
    running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    prefix: str = f"radiant{os.getpid()}"

    @property
    def names(self) -> tuple[str, ...]:
        return ("cloud", "edge", *self.devices)

    def namespace(self, name: str) -> str:
        return f"{self.prefix}-{name}"

    def make(self) -> None:
        """Make the namespaces, their cables and routes."""
        for name in self.names:
            _ip("netns", "add", self.namespace(name))
            self._ip(name, "link", "set", "lo", "up")
        self._cable("cloud", "edge", 1)
        for number, device in enumerate(self.devices, 2):
            self._cable("edge", device, number)
            self._ip("edge", "rule", "add", "from", f"10.77.{number}.1", "lookup", str(100 + number))
            self._ip("edge", "route", "add", f"10.77.{number}.2/32", "dev", f"to{number}", "table", str(100 + number))
            self._ip("edge", "route", "del", f"10.77.{number}.0/30", "dev", f"to{number}")
        (self.folder / "one_core").mkdir(parents=True)
        (self.folder / "one_core" / "sitecustomize.py").write_text(ONE_CORE)

    def remove(self) -> None:
        """End what runs here, and the namespaces."""
        for name in [*self.running]:
            self.end(name)
        for name in self.names:
            subprocess.run(["ip", "netns", "del", self.namespace(name)], check=False, stderr=subprocess.DEVNULL)

    def _cable(self, near: str, far: str, number: int) -> None:
        ends = (f"to{number}", f"up{number}")
        _ip("link", "add", ends[0], "netns", self.namespace(near), "type", "veth", "peer", "name", ends[1], "netns", self.namespace(far))
        for host, (name, end) in enumerate(zip((near, far), ends, strict=True), 1):
            self._ip(name, "addr", "add", f"10.77.{number}.{host}/30", "dev", end)
            self._ip(name, "link", "set", end, "up")

    def _ip(self, name: str, *words: str) -> None:
        _ip("-n", self.namespace(name), *words)

    def limit(self, name: str, end: str, mbit: int) -> None:
        """Let no more than so many Mbit/s leave by one end of a cable."""
        bucket = ("root", "tbf", "rate", f"{mbit}mbit", "burst", "32kbit", "latency", "400ms")
        subprocess.run(["ip", "netns", "exec", self.namespace(name), "tc", "qdisc", "add", "dev", end, *bucket], check=True)

    def plug(self, name: str, end: str, *, plugged: bool) -> None:
        """Pull a cable out, or put it back."""
        self._ip(name, "link", "set", end, "up" if plugged else "down")

    def sent_bytes(self, name: str, end: str) -> int:
        """Bytes that left by one end of a cable, with all headers."""
        table = subprocess.run(self.words(name, "cat", "/proc/net/dev"), capture_output=True, text=True, check=True).stdout
        return next(int(line.split(":")[1].split()[8]) for line in table.splitlines() if line.strip().startswith(f"{end}:"))

    def environment(self) -> Mapping[str, str]:
        paths = [str(self.folder / "one_core"), str(ROOT), str(ROOT / "core"), str(ROOT / "viewer")]
        return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"}

    def words(self, name: str, *words: str) -> list[str]:
        """A command as that machine starts it."""
        return ["ip", "netns", "exec", self.namespace(name), *words]

    def do(self, name: str, *words: str) -> subprocess.CompletedProcess[str]:
        """What `radiant` says on a machine, in its folder, to the end."""
        place = self.folder / name
        place.mkdir(exist_ok=True)
        command = self.words(name, sys.executable, "-m", "radiant_app", *words)
        return subprocess.run(command, cwd=place, env=self.environment(), capture_output=True, text=True, check=False)

    def start(self, name: str, *words: str) -> None:
        """Let `radiant` run on a machine, its words in a log."""
        command = self.words(name, sys.executable, "-m", "radiant_app", *words)
        with self.log(name).open("ab") as log:
            self.running[name] = subprocess.Popen(
                command, cwd=self.folder / name, env=self.environment(), stdout=log, stderr=log, start_new_session=True
            )

    def end(self, name: str) -> None:
        process = self.running.pop(name)
        if process.poll() is None:
            signal_session(process.pid, signal.SIGKILL)
        process.wait()

    def log(self, name: str) -> Path:
        return self.folder / f"{name}.log"

    def logs(self) -> str:
        return "".join(f"== {path.name}\n{path.read_text()[-3000:]}" for path in sorted(self.folder.glob("*.log")))

    def python(self, name: str, script: str) -> subprocess.CompletedProcess[str]:
        """What a line of Python says on a machine."""
        command = self.words(name, sys.executable, "-c", script)
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)

    def listening(self, name: str) -> list[str]:
        """Local addresses of sockets on a machine that can be called."""
        command = self.words(name, "cat", "/proc/net/tcp", "/proc/net/tcp6")
        rows = [line.split() for line in subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()]
        return [row[1] for row in rows if len(row) > 3 and row[3] == _LISTENING]


def why_not() -> str | None:
    """Why namespaces cannot be made here; None where they can."""
    if shutil.which("ip") is None:
        return "the command `ip` (iproute2) is not installed"
    name = f"radianttry{os.getpid()}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if made.returncode:
        return f"no network namespace can be made, which root alone can: {made.stderr.strip()}"
    cable = ["ip", "link", "add", "to", "netns", name, "type", "veth", "peer", "name", "up", "netns", name]
    tried = subprocess.run(cable, capture_output=True, text=True, check=False)
    _ip("netns", "del", name)
    return None if tried.returncode == 0 else f"no cable between namespaces can be made: {tried.stderr.strip()}"


@contextmanager
def machines_in(folder: Path, devices: Sequence[str]) -> Iterator[Machines]:
    """Machines that end with the block, and their namespaces with them."""
    machines = Machines(folder=folder, devices=tuple(devices))
    try:
        machines.make()
        yield machines
    finally:
        machines.remove()


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True)
