"""Watermarks in every photograph and pose, looked for in all files and sent bytes of the other
tiers: 0 found, under both executors.

The kinds, how they may be packed and the search stand in tests/app/canary.py;
tests/app/test_canary.py leaks each on purpose. Here whole runs are searched, and each kind is
planted once more in a file of the cloud, so that finding nothing means something. Figures:
docs/experiments/privacy.md.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.hierarchy.codec import FRAME_NAME, MODEL_NAME, VIRTUAL_CAMERAS
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.text import write_model
from radiant_core.io.records import load_cameras, load_scene
from tests.app.canary import PHOTOGRAPH_KINDS, POSE_KINDS, Canaries, Search, add_broken, canaries_of, files_with, watermark
from tests.app.test_field import assert_models_and_little_else_were_sent
from tests.contract.ray_machines import ray_cluster

pytestmark = pytest.mark.stress

DEVICES = ("north-1", "north-2", "south-1", "south-2")
SYSTEM = "".join(
    f'[[edge]]\nid = "{edge}"\n' + "".join(f'[[edge.device]]\nid = "{edge}-{number}"\n' for number in (1, 2)) for edge in ("north", "south")
)
SIZE_PX, TIMEOUT_S = 160, 3000.0


@pytest.mark.parametrize(("executor", "frames", "scene", "most"), [
    ("local", "known", "town", 48), ("local", "gps", "town", 24), ("ray", "known", "town", 16),
])  # fmt: skip
def test_no_canary_leaves_its_device(
    executor: str,
    frames: str,
    scene: str,
    most: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    captured, poses = marked_photographs(sample_scenes_folder() / scene, most, tmp_path)
    (tmp_path / "system.toml").write_text(SYSTEM)
    sent = kept_socket_bytes(tmp_path, monkeypatch)
    options = ["--poses", poses] if frames == "known" else []
    sizes = ["--steps", 100, "--long-side-px", SIZE_PX, "--max-splats", 4000]
    with machines(executor) as (address, ray_files):
        command = ["run", captured, "--out", tmp_path / "run", "--frames", frames, "--system", tmp_path / "system.toml", *options, *sizes]
        command += ["--executor", "ray", "--address", address] if executor == "ray" else []
        done = subprocess.run(
            [sys.executable, "-m", "radiant_app", *map(str, command)], capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
        assert done.returncode == 0, done.stderr
        searched = search_all(tmp_path / "run", captured, [*sent.iterdir(), *ray_files()])
    assert_models_and_little_else_were_sent(tmp_path / "run")
    num_bytes = sum(path.stat().st_size for path in sent.iterdir())
    # The capture sees what Ray sends; the local executor sends nothing to anybody.
    assert (b"devices/north-1" in b"".join(path.read_bytes() for path in sent.iterdir())) == (executor == "ray")
    with capsys.disabled():
        print(f"{executor}, {frames}: {searched}; {num_bytes:,} bytes through sockets; 0 found")
        if frames == "known":
            print(where_virtual_cameras_stand(tmp_path / "run"))


def marked_photographs(scene: Path, most: int, folder: Path) -> tuple[Path, Path]:
    """Photographs with watermarks and broken ones, a folder of each device, and the COLMAP model of their poses."""
    model = read_model(scene / "known")
    names = sorted(image.name for image in model.images)[:most]
    for index, name in enumerate(names):
        own = folder / "captured" / DEVICES[index * len(DEVICES) // len(names)]
        own.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(scene / "images" / name, own / name)
        watermark(own / name)
    for device in DEVICES:
        add_broken(folder / "captured" / device)
    (folder / "poses").mkdir()
    write_model(folder / "poses", model.without({image.name for image in model.images} - set(names)))
    return folder / "captured", folder / "poses"


def kept_socket_bytes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which all processes started from here on keep what they send through sockets."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("needs Linux and a C compiler to keep sent bytes")
    library, sent = folder / "sent_bytes.so", folder / "sent"
    source = Path(__file__).parent.parent / "app" / "sent_bytes.c"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", str(library), str(source), "-ldl"], check=True)
    sent.mkdir()
    script = (
        "import os, socket; a, b = socket.socketpair(); a.send(b'one'); a.sendall(b'two'); a.sendmsg([b'thr', b'ee']); "
        "os.write(a.fileno(), b'four'); os.writev(a.fileno(), [b'fi', b've']); print('six')"
    )
    monkeypatch.setenv("LD_PRELOAD", str(library))
    monkeypatch.setenv("SENT_BYTES", str(sent))
    subprocess.run([sys.executable, "-c", script], check=True)
    (tried,) = sent.iterdir()
    assert tried.read_bytes() == b"onetwothreefourfive", "what is sent is kept"
    tried.unlink()
    return sent


@contextmanager
def machines(executor: str) -> Iterator[tuple[str, Callable[[], list[Path]]]]:
    """The address of a cluster of two machines and what lists Ray's own files, where Ray is to run the nodes."""
    if executor != "ray":
        yield "", list
        return
    with ray_cluster() as cluster:
        cluster.start("head", num_cpus=1, offers=["edge:north", "cloud"])
        cluster.start("one", num_cpus=1, offers=["device:north-1", "edge:south"])

        def files() -> list[Path]:
            return [path for path in cluster.temporary.rglob("*") if path.is_file()]

        yield cluster.address, files


def search_all(run: Path, captured: Path, carried: list[Path]) -> str:
    """Look for every device's canaries where they must not be; what was searched, in words."""
    nodes = [path for kind in ("devices", "positions", "edges") for path in (run / kind).glob("*")]
    nodes += [path for path in (run / "cloud", run / "planning") if path.is_dir()]
    of_owner = [path for path in run.iterdir() if path.is_file() or path.name in ("evaluation", "delivered", "pictures")]
    num_patterns, places = 0, set[Path]()
    for name in DEVICES:
        poses = load_cameras(run / "devices" / name / "cameras.safetensors")
        canaries = canaries_of(captured / name, poses, SIZE_PX, [path.name for path in (captured / name).glob("zz secret*")])
        own_edge = run / "edges" / name.split("-")[0]
        elsewhere = [node for node in nodes if node.name != name and node != own_edge]
        # What other devices must not hold of this one's poses its edge may, and the owner too.
        assert files_with(canaries, [*elsewhere, *carried]) == []
        assert files_with(canaries.of(PHOTOGRAPH_KINDS), [own_edge]) == []
        assert files_with(canaries.of(PHOTOGRAPH_KINDS), of_owner) == []
        assert files_with(canaries.of(POSE_KINDS), [own_edge]), "the search finds what is there"
        assert_each_kind_is_found_when_planted(canaries, run / "cloud" / "scene.ply")
        num_patterns += sum(map(len, canaries.patterns.values()))
        held = {path for place in [*elsewhere, own_edge, *of_owner] for path in [place, *place.rglob("*")] if path.is_file()}
        places |= {*held, *carried}
    num_bytes = sum(path.stat().st_size for path in places)
    num_photographs = sum(1 for _ in captured.rglob("*.jpg"))
    return f"{num_photographs} photographs, {num_patterns:,} patterns, {len(places):,} files and {num_bytes / 1e6:,.1f} MB searched"


def assert_each_kind_is_found_when_planted(canaries: Canaries, stranger: Path) -> None:
    """A pattern of each kind in the middle of a file that holds none."""
    content = stranger.read_bytes()
    search = Search(canaries)
    for kind, patterns in canaries.patterns.items():
        planted = content[: len(content) // 2] + patterns[len(patterns) // 2] + content[len(content) // 2 :]
        assert kind in search.kinds_in(planted), kind


def where_virtual_cameras_stand(run: Path) -> str:
    """That edges send no pictures and cameras of nobody's photograph, and how far those are off the nearest one."""
    told = []
    for edge in ("north", "south"):
        inbox = run / "cloud" / "inbox" / edge
        assert {path.name for path in inbox.iterdir()} <= {MODEL_NAME, VIRTUAL_CAMERAS, FRAME_NAME}
        virtual = load_cameras(inbox / VIRTUAL_CAMERAS)
        assert len(np.unique(virtual.Ks, axis=0)) == len(np.unique(virtual.sizes_wh, axis=0)) == 1, "of one optics"
        own = [load_scene(run / "devices" / name / "scene.safetensors").cameras for name in DEVICES if name.startswith(edge)]
        offs_m, turns_deg = [], []
        for cameras in own:
            distances_m = np.linalg.norm(cameras.centers[:, None] - virtual.centers, axis=2)
            for row, near in enumerate(distances_m.argmin(axis=1)):
                turn = cameras.cam_from_world[row, :3, :3] @ virtual.cam_from_world[near, :3, :3].T
                offs_m.append(distances_m[row, near])
                turns_deg.append(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(turn - np.eye(3)) / np.sqrt(8)))))
        assert min(offs_m) > 1e-3 and min(turns_deg) > 1e-3, "no virtual camera is a photograph's"
        told.append(f"{edge}: virtual cameras {min(offs_m):.3f} m, {min(turns_deg):.3f}° off at least")
    return "; ".join(told)
