"""A Ray cluster of one machine alone: heard by nobody else, joined by nobody without its secret, gone without a trace."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from radiant_app.executors.ray_cluster import _Cluster
from radiant_core.aggregate.tree import Tree
from tests.contract.ray_machines import pids_of

pytestmark = pytest.mark.stress
LOOPBACKS = {"0100007F", "0000000000000000FFFF00000100007F", "00000000000000000000000001000000"}
"""127.0.0.1 as the kernel lists it among addresses of IPv4 and of IPv6, and ::1."""
JOIN = "import sys, ray; ray.init(address=sys.argv[1], logging_level='ERROR')"


def listeners(pids: list[int]) -> list[tuple[str, int]]:
    """Addresses, as the kernel writes them, and ports at which these processes listen."""
    sockets = set()
    for pid in pids:
        for link in Path(f"/proc/{pid}/fd").iterdir():
            try:
                sockets.add(str(link.readlink()))
            except OSError:
                continue
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    places = [row[1].split(":") for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in sockets]
    return [(address, int(port, 16)) for address, port in places]


def test_a_cluster_of_this_machine_alone_listens_at_home_keeps_its_secret_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed: the extra `cluster` brings it")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    before = set(Path("/tmp").glob("ray*"))
    cluster = _Cluster(address="local", log=tmp_path / "ray.log", command=lambda task: [], tree=Tree(id="cloud", tier="cloud"))
    with cluster:
        assert cluster.process is not None
        time.sleep(3)
        pids = pids_of(cluster.process.pid)
        places = listeners(pids)
        assert len(places) >= 3 and {address for address, _ in places} <= LOOPBACKS, places
        secret = dict(line.split("=", 1) for line in Path(f"/proc/{cluster.process.pid}/environ").read_text().split("\0") if "=" in line)
        assert not [pid for pid in pids if secret["RAY_AUTH_TOKEN"] in Path(f"/proc/{pid}/cmdline").read_text()]
        (head,) = (pid for pid in pids if Path(f"/proc/{pid}/comm").read_text().strip() == "gcs_server")
        ((_, port),) = listeners([head])
        stranger = {**os.environ, "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": "0" * 64}
        command = [sys.executable, "-c", JOIN, f"127.0.0.1:{port}"]
        joined = subprocess.run(command, env=stranger, capture_output=True, text=True, timeout=120, check=False)
        assert joined.returncode != 0 and "auth" in joined.stderr.lower(), joined.stderr
    assert set(Path("/tmp").glob("ray*")) <= before and not list((tmp_path / "home").rglob("*"))
