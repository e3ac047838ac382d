"""Ray machines for tests: heads and raylets as `ray start` makes them, several on one computer, always ended with their test."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

STORE_BYTES = 80 * 2**20
START_S = 300.0
# Ray gives its own agents half a minute to start, which a busy machine of two cores does not keep.
PATIENCE = {"RAY_agent_register_timeout_ms": "300000", "RAY_raylet_start_wait_time_s": "300"}
ENVIRONMENT = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0", "OMP_NUM_THREADS": "1", **PATIENCE}


@dataclass
class Cluster:
    """A head and further machines, all on this computer."""

    address: str
    temporary: Path
    """Of Ray's sockets and logs; its path must be short."""
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def start(self, name: str, num_cpus: int, offers: Sequence[str] = ()) -> None:
        """Start a machine and wait until it has joined; the first one is the head."""
        host, port = self.address.split(":")
        is_head = not self.processes
        role = (
            ["--head", "--node-ip-address", host, "--port", port, "--include-dashboard=false"] if is_head else ["--address", self.address]
        )
        resources = ["--resources", json.dumps(dict.fromkeys(offers, 1))] if offers else []
        sizes = ["--num-cpus", str(num_cpus), "--object-store-memory", str(STORE_BYTES), *resources]
        folder = ["--temp-dir", str(self.temporary)] if is_head else []
        with (self.temporary / f"{name}.log").open("wb") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, "-c", RAY, "start", *role, *sizes, *folder, "--block"],
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
                env={**os.environ, **ENVIRONMENT},
                start_new_session=True,
            )
        deadline_s = time.monotonic() + START_S
        while b"Ray runtime started" not in (text := (self.temporary / f"{name}.log").read_bytes()):
            assert self.processes[name].poll() is None and time.monotonic() < deadline_s, text.decode()
            time.sleep(0.2)

    def kill(self, name: str) -> None:
        """SIGKILL all processes of a machine at once, as when its power goes; what Ray's workers started dies by itself."""
        for pid in self.pids(name):
            os.kill(pid, signal.SIGKILL)
        self.processes.pop(name).wait()

    def pids(self, name: str) -> list[int]:
        """The processes of a machine's own session: those that `ray start` made, and what they made in it."""
        return pids_of(self.processes[name].pid)


def pids_of(session: int) -> list[int]:
    """The processes of a session."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[3]) == session:
            found.append(int(path.parent.name))
    return found


RAY = "import sys; from ray.scripts.scripts import main; sys.argv[0] = 'ray'; sys.exit(main())"


@contextmanager
def ray_cluster() -> Iterator[Cluster]:
    """A cluster without machines yet; all that are started are ended with the block."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{listener.getsockname()[1]}"
    cluster = Cluster(address=address, temporary=Path(tempfile.mkdtemp(prefix="ray-")))
    try:
        yield cluster
    finally:
        for name in list(cluster.processes):
            cluster.kill(name)
        shutil.rmtree(cluster.temporary, ignore_errors=True)
