"""Results that are carried and nothing else: the product's hub and line, with files of random bytes for models."""

from __future__ import annotations

import base64
import hashlib
import json
import random
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from radiant_app.commands.network import node as commands
from radiant_app.network.home import Listening, make_home, open_home
from radiant_app.network.hub import Hub, open_hub
from radiant_app.network.kinds import RESULT_FILES
from radiant_app.network.line import Line
from radiant_core import __version__
from radiant_core.hierarchy.codec import MODEL_NAME
from radiant_core.io.transport.delivery import describe_files
from radiant_core.io.transport.envelope import open_envelope
from tests.app.network_nodes import listening

RUN = "7" * 32
TASK = ("task.json", "given/delivery.json", "given/delivery.sig")


def make_edge(folder: Path, port: int, url_port: int, devices: Sequence[str], host: str = "127.0.0.1") -> None:
    """The homes of an edge at `port` of `host` and of devices that reach it at `url_port`."""
    make_home(folder / "cloud", listening())
    commands.init(folder / "north", Listening(url=f"https://{host}:{url_port}", host=host, port=port))
    commands.invite(folder / "cloud", "north", folder / "north.join")
    commands.join(folder / "north", folder / "north.join")
    for device in devices:
        commands.invite(folder / "north", device, folder / f"{device}.join")
        commands.join(folder / device, folder / f"{device}.join")


def write_model(path: Path, num_bytes: int, seed: int) -> None:
    """Random bytes as a device's model, with the small files that come with one."""
    path.mkdir(parents=True, exist_ok=True)
    rng = random.Random(seed)
    with (path / MODEL_NAME).open("wb") as file:
        for start in range(0, num_bytes, 1 << 20):
            file.write(rng.randbytes(min(1 << 20, num_bytes - start)))
    for name in RESULT_FILES["own_field"].needed:
        (path / name).write_text("{}")


def offer(hub: Hub, folder: Path, device: str) -> str:
    """Ask a device for its model; the digest of the task."""
    place = folder / "asked" / device
    for name in TASK:
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text("{}")
    return hub.offer(RUN, f"devices/{device}", "own_field", f"devices/{device}", place).digest


def deliver(line: Line, model: Path, folder: Path) -> float:
    """What a device does with a task once its model is there; how many seconds sending took."""
    body = {"software": __version__, "task": "", "tries": 0, "doing": "idle", "ended": None, "batch": line.counter, "events": []}
    while not isinstance(offered := line.poll(body)["task"], dict):
        time.sleep(0.1)
    asked = open_envelope(base64.b64decode(offered["text"]), base64.b64decode(offered["signature"]), line.upper.key)
    line.fetch(asked, asked.digest, folder)
    paths = {path.name: path for path in model.iterdir()}
    result, began = asked.result(describe_files(paths), __version__), time.monotonic()
    line.send(result, paths)
    return time.monotonic() - began


def send(folder: Path, device: str) -> None:
    """A process that delivers a device's model; prints its memory and how long sending took."""
    line = Line(home=open_home(folder / device))
    line.join()
    idle = _rss_bytes("VmRSS")
    seconds = deliver(line, folder / "models" / device, folder / device / "task")
    print(json.dumps({"idle": idle, "peak": _rss_bytes("VmHWM"), "resumed": line.num_resumed, "seconds": seconds}))


def receive(folder: Path, devices: Sequence[str]) -> None:
    """A process that asks devices for their models and waits for all; prints its memory and the
    hashes."""
    with open_hub(open_home(folder / "north"), 0.2) as hub:
        digests = {offer(hub, folder, device): device for device in devices}
        idle, hashes = _rss_bytes("VmRSS"), {}
        print("listening", flush=True)
        while len(hashes) < len(digests):
            said = hub.messages.get()
            if said.received:
                hub.install(said.digest)
                hub.accept(said.digest)
                device = digests[said.digest]
                with (folder / "asked" / device / MODEL_NAME).open("rb") as file:
                    hashes[device] = hashlib.file_digest(file, "sha256").hexdigest()
        time.sleep(2)
        print(json.dumps({"idle": idle, "peak": _rss_bytes("VmHWM"), "hashes": hashes}))


def _rss_bytes(name: str) -> int:
    status = Path("/proc/self/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith(f"{name}:")) * 1024


if __name__ == "__main__":
    if sys.argv[1] == "send":
        send(Path(sys.argv[2]), sys.argv[3])
    else:
        receive(Path(sys.argv[2]), sys.argv[3:])
