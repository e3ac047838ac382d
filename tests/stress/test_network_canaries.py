"""A run over a network whose devices map their own photographs: the scene of the run on one machine to the byte; and of what is marked
in photographs and poses nothing in a file, a request, an answer or a log beyond the device, but its poses at its edge."""

from __future__ import annotations

from pathlib import Path

import pytest

from radiant_core.io.records import load_cameras
from tests.app.canary import PHOTOGRAPH_KINDS, POSE_KINDS, add_broken, canaries_of, files_with, watermark
from tests.app.network_processes import WIRE, Fleet, run_here

pytestmark = pytest.mark.stress
DEVICES = ("north-1", "north-2")
SIZE_PX = 64


@pytest.mark.parametrize("frames", ["gps", "known"])
def test_the_same_scene_and_no_canary_beyond_its_device(tmp_path: Path, frames: str, capsys: pytest.CaptureFixture[str]) -> None:
    fleet = Fleet(folder=tmp_path, devices=DEVICES, frames="gps" if frames == "gps" else "known")
    fleet.make()
    broken = {}
    for device in DEVICES:
        for photograph in (tmp_path / "photos" / device).glob("*.jpg"):
            watermark(photograph)
        broken[device] = add_broken(tmp_path / "photos" / device)
    try:
        fleet.run_with([])
    finally:
        fleet.close()
    assert (tmp_path / "far" / "scene.ply").read_bytes() == run_here(tmp_path)
    # The page of a device prints names of its own folder; everything else is looked through.
    at_cloud = [tmp_path / "far", tmp_path / "cloud", tmp_path / "cloud.log", tmp_path / "cloud.events", tmp_path / "e.log"]
    at_edge = [tmp_path / "e"]
    wire = sorted((tmp_path / WIRE).iterdir())
    assert len(wire) == 1 + len(DEVICES) and sum(path.stat().st_size for path in wire) > 100_000
    num_patterns = 0
    for device in DEVICES:
        poses = load_cameras(next((tmp_path / device / "runs").glob(f"*/devices/{device}/cameras.safetensors")))
        canaries = canaries_of(tmp_path / "photos" / device, poses, SIZE_PX, [path.name for path in broken[device]])
        num_patterns += sum(map(len, canaries.patterns.values()))
        others = [tmp_path / other for other in DEVICES if other != device]
        of_others = [path for path in wire if not path.name.startswith(f"{device}.")]
        assert files_with(canaries, [*at_cloud, *others, *of_others]) == []
        assert files_with(canaries.of(PHOTOGRAPH_KINDS), [*at_edge, *wire, tmp_path / f"{device}.log"]) == []
        assert files_with(canaries.of(POSE_KINDS), at_edge), "the search finds what is there"
        assert files_with(canaries, [tmp_path / "photos" / device]), "and in photographs"
    num_bytes = sum(path.stat().st_size for path in wire)
    with capsys.disabled():
        print(f"{frames}: {num_patterns:,} patterns, {num_bytes:,} bytes in requests and answers, 0 found")
