"""Four machines that are network namespaces, and the commands of docs/network.md on them: the scene of the run on one machine to the
byte. `pytest -m stress -s tests/stress/test_network_namespaces.py`; root alone can make namespaces."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.network.line import MAX_WAIT_S
from radiant_core.hierarchy.codec import MODEL_NAME
from tests.app.network_namespaces import PORT, ROOT, Machines, machines_in, why_not
from tests.app.network_nodes import split_photographs
from tests.app.network_transfer import make_edge, write_model

pytestmark = pytest.mark.stress
DATA = Path(os.environ.get("RADIANT_DATA", Path(__file__).parents[3] / "shared" / "data"))
DEVICES = ("north-1", "north-2")
SMALL = ("--long-side-px", "128", "--steps", "120", "--max-splats", "3000")
LONGEST_S = 1500.0
CALL = "import socket; socket.create_connection(('{host}', {port}), timeout=2)"


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    if reason := why_not():
        pytest.skip(reason)
    with machines_in(tmp_path, DEVICES) as machines:
        yield machines


def join(machines: Machines) -> None:
    """What docs/network.md says, in its order."""
    done = [
        machines.do("cloud", "node", "init", "--url", f"https://10.77.1.1:{PORT}"),
        machines.do("cloud", "node", "invite", "north", "--out", "../north.join"),
        machines.do("edge", "node", "init", "--url", f"https://10.77.2.1:{PORT}"),
        machines.do("edge", "node", "join", "../north.join"),
    ]
    for number, device in enumerate(DEVICES, 2):
        # Every device knows the edge by another address.
        done += [
            machines.do("edge", "node", "init", "--url", f"https://10.77.{number}.1:{PORT}"),
            machines.do("edge", "node", "invite", device, "--out", f"../{device}.join"),
            machines.do(device, "node", "join", f"../{device}.join"),
        ]
    assert all(each.returncode == 0 for each in done), done


def require_one_way(machines: Machines) -> None:
    """A device reaches the edge, and nobody a device, also where somebody listens."""
    device, script = DEVICES[0], "import socket, time; one = socket.create_server(('10.77.2.2', 9)); time.sleep(30)"
    listener = subprocess.Popen(machines.words(device, sys.executable, "-c", script))
    try:
        wait_for(lambda: machines.listening(device) != [])
        assert machines.python(device, CALL.format(host="10.77.2.2", port=9)).returncode == 0, "somebody listens"
        for other in ("edge", "cloud", DEVICES[1]):
            tried = machines.python(other, CALL.format(host="10.77.2.2", port=9))
            assert "Network is unreachable" in tried.stderr or "timed out" in tried.stderr, (other, tried.stderr)
        assert machines.python(device, CALL.format(host="10.77.2.1", port=PORT)).returncode == 0
        assert machines.python(device, CALL.format(host="10.77.1.1", port=PORT)).returncode == 1, "no way to the cloud"
    finally:
        listener.kill()
        listener.wait()


def wait_for(is_so: object, seconds: float = 60.0) -> None:
    until_s = time.monotonic() + seconds
    while not is_so():  # pyright: ignore[reportCallIssue]
        assert time.monotonic() < until_s
        time.sleep(0.1)


def run_far(machines: Machines, options: tuple[str, ...], poses: tuple[str, ...]) -> None:
    """Start all machines, wait for the run's end."""
    began = time.monotonic()
    machines.start("cloud", "run", "radiant_node", "--executor", "network", "--system", "../fleet.toml", "--out", "run", *options)
    machines.start("edge", "node", "serve")
    for device in DEVICES:
        machines.start(device, "node", "work", "--photos", f"../photos/{device}", *poses, "--yes")
    wait_for(lambda: machines.listening("edge") != [])
    require_one_way(machines)
    while (code := machines.running["cloud"].poll()) is None:
        assert time.monotonic() < began + LONGEST_S, machines.logs()
        for device in DEVICES:
            assert machines.listening(device) == [], "a device listens to nobody"
        for name in ("edge", *DEVICES):
            assert machines.running[name].poll() is None, machines.logs()
        time.sleep(1)
    assert code == 0, machines.logs()


def run_here(machines: Machines, options: tuple[str, ...], poses: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "radiant_app", "run", "photos", "--system", "fleet.toml", "--out", "here", *options, *poses]
    subprocess.run(command, cwd=machines.folder, env=machines.environment(), check=True, capture_output=True)


@pytest.mark.parametrize("name", ["town", "lewis"])
def test_the_scene_of_four_machines_is_that_of_one(machines: Machines, name: str) -> None:
    town = sample_scenes_folder() / "town"
    if name == "lewis" and not (DATA / name).is_dir():
        pytest.skip(f"{name} is not in {DATA}: set RADIANT_DATA to the folder of the real sets")
    images = DATA / name / "images" if name == "lewis" else town / "images"
    folder = machines.folder
    split_photographs(images, folder / "photos", DEVICES)
    (folder / "fleet.toml").write_text('[[edge]]\nid = "north"\n' + "".join(f'[[edge.device]]\nid = "{each}"\n' for each in DEVICES))
    options = ("--frames", "gps" if name == "lewis" else "known", *SMALL)
    poses = () if name == "lewis" else ("--poses", str(town / "known"))
    join(machines)
    began = time.monotonic()
    run_far(machines, options, poses)
    far_s, began = time.monotonic() - began, time.monotonic()
    run_here(machines, options, poses)
    scene = (folder / "cloud" / "run" / "scene.ply").read_bytes()
    here_s = time.monotonic() - began
    print(f"{name}: {len(scene):,} bytes; {far_s:.0f} s over the network, {here_s:.0f} s on one machine")
    assert scene == (folder / "here" / "scene.ply").read_bytes()
    names = [path.name for path in (folder / "photos").rglob("*.*") if path.is_file()]
    for log in (machines.log("cloud"), machines.log("edge")):
        assert not any(name in log.read_text() for name in names), log
    status = machines.do(DEVICES[0], "node", "status").stdout
    (finished,) = (Path(line.split(": ")[1]) for line in status.splitlines() if "finished scene" in line)
    assert (folder / DEVICES[0] / finished).is_file()


def test_a_cable_of_20_mbit_per_s_is_used_and_one_that_is_pulled_out_costs_its_time_alone(machines: Machines) -> None:
    """Limited by the kernel (tc tbf); the second time the cable is out for 20 s on the way."""
    size, bytes_per_s, device = 50_000_000, 20e6 / 8, DEVICES[0]
    machines.limit(device, "up2", 20)
    for number, out_s in enumerate((0.0, 20.0)):
        folder = machines.folder / str(number)
        make_edge(folder, PORT, PORT, [device], "10.77.2.1")
        write_model(folder / "models" / device, size, number)
        edge = transfer(machines, "edge", "receive", folder, device)
        assert edge.stdout is not None and edge.stdout.readline() == "listening\n"
        before = machines.sent_bytes(device, "up2")
        sender = transfer(machines, device, "send", folder, device)
        if out_s:
            wait_for(lambda begin=before: machines.sent_bytes(device, "up2") > begin + size // 2)
            machines.plug(device, "up2", plugged=False)
            time.sleep(out_s)
            machines.plug(device, "up2", plugged=True)
        told = json.loads(sender.communicate(timeout=300)[0].splitlines()[-1])
        got = json.loads(edge.communicate(timeout=300)[0].splitlines()[-1])
        ratio, more = told["seconds"] * bytes_per_s / size, (machines.sent_bytes(device, "up2") - before) / size
        print(f"20 Mbit/s, out for {out_s:.0f} s: {ratio:.3f} x bytes over bandwidth, {more:.3f} x the bytes with all headers")
        assert got["hashes"][device] == hashlib.sha256((folder / "models" / device / MODEL_NAME).read_bytes()).hexdigest()
        assert ratio <= 1.15 + (out_s + MAX_WAIT_S) * bool(out_s) * bytes_per_s / size and more <= 1.15


def transfer(machines: Machines, name: str, what: str, folder: Path, device: str) -> subprocess.Popen[str]:
    command = machines.words(name, sys.executable, "-m", "tests.app.network_transfer", what, str(folder), device)
    return subprocess.Popen(command, cwd=ROOT, env=machines.environment(), stdout=subprocess.PIPE, text=True)
