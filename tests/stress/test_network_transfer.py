"""Large results over bad links, between processes: bytes, memory, time. `pytest -m stress -s tests/stress/test_network_transfer.py`."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from radiant_core.hierarchy.codec import MODEL_NAME
from tests.app.network_nodes import free_port
from tests.app.network_proxy import Link
from tests.app.network_transfer import make_edge, write_model

pytestmark = pytest.mark.stress
ROOT = Path(__file__).parents[2]
MB = 10**6


class Machines:
    """An edge and devices that are processes, with a link between them."""

    def __init__(self, folder: Path, num_bytes: int, devices: Sequence[str]) -> None:
        self.folder, self.devices = folder, devices
        port = free_port()
        self.link = Link(target=port)
        make_edge(folder, port, self.link.port, devices)
        for number, device in enumerate(devices):
            write_model(folder / "models" / device, num_bytes, number)
        self.edge = start("receive", str(folder), *devices)
        assert self.edge.stdout is not None and self.edge.stdout.readline() == "listening\n"

    def send(self) -> list[subprocess.Popen[str]]:
        return [start("send", str(self.folder), device) for device in self.devices]

    def hashes(self) -> dict[str, str]:
        return {device: sha256(self.folder / "models" / device / MODEL_NAME) for device in self.devices}


def start(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, "-m", "tests.app.network_transfer", *arguments], cwd=ROOT, stdout=subprocess.PIPE, text=True)


def told(process: subprocess.Popen[str]) -> dict[str, Any]:
    out, _ = process.communicate(timeout=900)
    assert process.returncode == 0, out
    return json.loads(out.splitlines()[-1])


def sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def test_500_mb_with_50_cuts_and_an_outage_of_a_minute(tmp_path: Path) -> None:
    size = 500 * MB
    machines = Machines(tmp_path, size, ["d"])
    machines.link.cuts = range(10 * MB, size + MB, 10 * MB)
    (device,) = machines.send()
    while machines.link.num_up < size // 2:
        assert device.poll() is None
        time.sleep(0.05)
    with machines.link.down():
        time.sleep(60)
    sent, got = told(device), told(machines.edge)
    machines.link.close()
    rose = [(one["peak"] - one["idle"]) / MB for one in (sent, got)]
    ratio = machines.link.num_up / size
    print(f"{machines.link.num_cut} cuts, {ratio:.3f} x the bytes, {rose[0]:.0f} and {rose[1]:.0f} MB above idle")
    assert got["hashes"] == machines.hashes() and machines.link.num_cut == 50
    assert ratio <= 1.10 and max(rose) <= 100


def test_30_devices_at_once_on_one_edge(tmp_path: Path) -> None:
    machines = Machines(tmp_path, 2 * MB, [f"d{number}" for number in range(30)])
    began = time.monotonic()
    sent = [told(device) for device in machines.send()]
    got = told(machines.edge)
    machines.link.close()
    again, rose = sum(one["resumed"] for one in sent), (got["peak"] - got["idle"]) / MB
    print(f"{time.monotonic() - began:.0f} s, {rose:.0f} MB above idle, {again} requests again")
    assert got["hashes"] == machines.hashes() and rose <= 200


def test_20_mbit_per_s_are_used(tmp_path: Path) -> None:
    size, bytes_per_s = 50 * MB, 20e6 / 8
    machines = Machines(tmp_path, size, ["d"])
    machines.link.bytes_per_s = bytes_per_s
    began = time.monotonic()
    (device,) = machines.send()
    while machines.link.num_up < MB:
        time.sleep(0.005)
        began = time.monotonic() if machines.link.num_up < 20_000 else began
    sent = told(device)
    ratio, got = (time.monotonic() - began) * bytes_per_s / size, told(machines.edge)
    machines.link.close()
    print(f"{ratio:.3f} x bytes over bandwidth, {sent['resumed']} requests again")
    assert got["hashes"] == machines.hashes() and ratio <= 1.15


@pytest.fixture(autouse=True)
def room(tmp_path: Path) -> None:
    if shutil.disk_usage(tmp_path).free < 2 * 10**9:
        pytest.skip("there are less than 2 GB free")
