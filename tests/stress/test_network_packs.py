"""A device that no cable reaches: its tasks and results go by a disk, four times each way, while its edge serves and the cloud waits;
the scene is that of the run on one machine. `pytest -m stress -s tests/stress/test_network_packs.py`."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from radiant_app.commands.network import packs as node_packs
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.errors import BadInput
from tests.app.network_processes import ROOT, Fleet, run_here

pytestmark = pytest.mark.stress
LONGEST_S = 1500.0
WORK = (
    "import sys; from pathlib import Path; from radiant_app.commands.network import node; from tests.app.network_processes import command; "
    "home, photos, poses = map(Path, sys.argv[1:]); "
    "node.Running(command=command).work(home, photos, poses, lambda text: True, offline=True)"
)


def test_a_device_takes_part_by_a_disk_alone(tmp_path: Path) -> None:
    fleet, disk = Fleet(folder=tmp_path), tmp_path / "disk"
    fleet.make()
    walks, until_s = 0, time.monotonic() + LONGEST_S
    try:
        for name in ("cloud", "e"):
            fleet.start(name)
        while (code := fleet.running["cloud"].poll()) is None:
            assert time.monotonic() < until_s, fleet.logs()
            try:
                node_packs.pack(tmp_path / "e", "d", disk)
            except BadInput:
                time.sleep(0.2)  # the edge has nothing for it yet
                continue
            walks += 1
            node_packs.unpack(tmp_path / "d", disk)
            poses = sample_scenes_folder() / "hamlet" / "known"
            arguments = [str(tmp_path / "d"), str(tmp_path / "photos" / "d"), str(poses)]
            subprocess.run([sys.executable, "-c", WORK, *arguments], cwd=ROOT, env=fleet.environment(), check=True)
            node_packs.pack(tmp_path / "d", None, disk)
            assert "received" in node_packs.unpack(tmp_path / "e", disk)[-1]
        assert code == 0, fleet.logs()
    finally:
        fleet.close()
    assert walks == 4, "count, raster, model, scores; a device alone refines nothing"
    assert (tmp_path / "far" / "scene.ply").read_bytes() == run_here(tmp_path)
    assert not (tmp_path / "d" / "joined.json").exists(), "it never reached its edge"
