"""The search for canaries finds every kind when it is leaked on purpose, however it is packed, and nothing where nothing leaked."""

from __future__ import annotations

import base64
import gzip
import json
import shutil
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.aggregate.virtual_cameras import virtual_cameras
from radiant_core.cameras import Cameras
from radiant_core.io.array_file import save_arrays
from radiant_core.io.colmap.model import read_model
from radiant_core.io.photos.listing import photograph_positions
from radiant_core.io.records import save_cameras
from radiant_core.sfm.world_frame.world import cameras_of
from tests.app.canary import PHOTOGRAPH_KINDS, POSE_KINDS, Canaries, Search, canaries_of, files_with, watermark

SIZE_PX = 96
PACKINGS: dict[str, Callable[[bytes], bytes]] = {
    "as it is": lambda data: data,
    "base64": base64.b64encode,
    "base64 for addresses, shifted": lambda data: base64.urlsafe_b64encode(b"a" + data),
    "hexadecimal": lambda data: data.hex().encode(),
    "zlib": zlib.compress,
    "gzip in base64": lambda data: base64.b64encode(gzip.compress(data)),
}


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Cameras, Canaries]:
    """Three watermarked photographs, their poses and what is looked for of them."""
    folder, scene = tmp_path_factory.mktemp("photographs"), sample_scenes_folder() / "hamlet"
    for path in sorted((scene / "images").iterdir())[:3]:
        shutil.copyfile(path, folder / path.name)
        watermark(folder / path.name)
    poses = cameras_of(read_model(scene / "known")).named(sorted(path.name for path in folder.iterdir()))
    return folder, poses, canaries_of(folder, poses, SIZE_PX)


@pytest.mark.parametrize("packing", PACKINGS)
def test_every_kind_is_found_in_every_packing(packing: str, device: tuple[Path, Cameras, Canaries]) -> None:
    _, _, canaries = device
    noise = np.random.default_rng(0).bytes(301)
    search = Search(canaries.of((*PHOTOGRAPH_KINDS, *POSE_KINDS)))
    for kind in (*PHOTOGRAPH_KINDS, *POSE_KINDS):
        patterns = canaries.patterns[kind]
        for pattern in patterns[:: -(-len(patterns) // 12)]:
            kinds = search.kinds_in(noise + PACKINGS[packing](b"{" + pattern + b"}") + noise)
            assert kind in kinds, f"{kind}: {pattern!r}"


def test_nothing_is_found_where_nothing_leaked(device: tuple[Path, Cameras, Canaries]) -> None:
    _, poses, canaries = device
    others = virtual_cameras(poses, poses.centers - [0, 0, 40.0], np.random.default_rng(1))
    stranger = np.random.default_rng(2).bytes(300_000) + others.cam_from_world.tobytes() + json.dumps(others.centers.tolist()).encode()
    assert Search(canaries).kinds_in(stranger) == set()


def test_what_our_own_writers_and_readers_would_leak_is_found(device: tuple[Path, Cameras, Canaries], tmp_path: Path) -> None:
    folder, poses, canaries = device
    name = poses.names[0]
    photograph = np.asarray(cv2.imread(str(folder / name), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION))
    lat, lon, _ = next(place for place in photograph_positions(folder).values() if place is not None)
    save_cameras(tmp_path / "virtual_cameras.safetensors", replace(poses, names=("a", "b", "c")))
    save_cameras(tmp_path / "names.safetensors", virtual_cameras(poses, poses.centers - [0, 0, 40.0], np.random.default_rng(1)))
    save_arrays(tmp_path / "view.safetensors", "radiant.test", {"png": cv2.imencode(".png", photograph)[1].ravel()}, {})
    (tmp_path / "centers.json").write_text(json.dumps([[f"{value:.4f}" for value in center] for center in poses.centers]).replace('"', ""))
    (tmp_path / "centers.bin").write_bytes((poses.centers + 2e-4).astype("<f4").tobytes())
    (tmp_path / "place.json").write_text(json.dumps({"at": [round(lat, 6), round(lon, 6)]}))
    (tmp_path / "wide.txt").write_bytes(f"seen by {Path(name).stem}".encode("utf-16-le"))
    (tmp_path / "all.bin").write_bytes((folder / name).read_bytes())
    hits = {path.name: {hit.split(" in /")[0] for hit in files_with(canaries, [path])} for path in tmp_path.iterdir()}
    assert hits["virtual_cameras.safetensors"] >= {"pose float64"}
    assert hits["names.safetensors"] == set(), "cameras drawn for the cloud are nobody's"
    assert hits["view.safetensors"] == {"pixels"}
    assert "pose nearby" in hits["centers.bin"] and hits["centers.json"] >= {"pose text"}
    assert hits["place.json"] == {"GPS"} and hits["wide.txt"] == {"name"}
    assert hits["all.bin"] >= {"EXIF", "EXIF text", "XMP", "IPTC", "comment", "JPEG", "pixels"}
