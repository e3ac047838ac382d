"""What people really have: photographs without EXIF, and two sites in one folder. A result or a
clear refusal, on every real set. Minutes; `python -m pytest -m stress
tests/stress/test_messy_sets.py -s` prints what became of each (docs/experiments/frames.md)."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import pytest

from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import RunConfig, TrainOptions
from radiant_app.events import Event, Warned
from radiant_core.errors import BadInput
from radiant_core.io.records import load_scene

DATA = Path(os.environ.get("RADIANT_DATA", Path(__file__).parents[3] / "shared" / "data"))
SETS = ("brighton", "lewis", "caliterra")
SMALL = TrainOptions(preset="draft", long_side_px=240, num_steps=200, max_num_splats=8_000)


def photographs(name: str) -> list[Path]:
    if not (DATA / name).is_dir():
        pytest.skip(f"{name} is not in {DATA}: set RADIANT_DATA to the folder of the real sets")
    return sorted((DATA / name / "images").iterdir())


def without_exif(data: bytes) -> bytes:
    """A JPEG without its application segments, EXIF among them; pixels keep their bytes."""
    kept, at = [data[:2]], 2
    while data[at] == 0xFF and data[at + 1] != 0xDA:
        end = at + 2 + struct.unpack(">H", data[at + 2 : at + 4])[0]
        if not 0xE1 <= data[at + 1] <= 0xEF:
            kept.append(data[at:end])
        at = end
    return b"".join([*kept, data[at:]])


def stripped(name: str, target: Path) -> Path:
    target.mkdir()
    for path in photographs(name):
        (target / path.name).write_bytes(without_exif(path.read_bytes()))
    return target


def two_edges(target: Path) -> Path:
    target.write_text("".join(f'[[edge]]\nid = "{edge}"\n[[edge.device]]\nid = "{edge}-1"\n' for edge in ("one", "two")))
    return target


def config_of(source: Path, folder: Path, **changes: object) -> RunConfig:
    settings = {"source": source, "out": folder / "run", "system": two_edges(folder / "system.toml")}
    return RunConfig(**{**settings, "train": SMALL, **changes})  # type: ignore[arg-type]


@pytest.mark.stress
@pytest.mark.parametrize("name", SETS)
def test_without_exif_a_set_becomes_an_unscaled_scene(name: str, tmp_path: Path) -> None:
    source = stripped(name, tmp_path / "photos")
    events: list[Event] = []
    result = run(config_of(source, tmp_path), events.append)
    scene = load_scene(result.folder / "sfm" / "scene.safetensors")
    print(f"\n{name} without EXIF: {len(scene.cameras)} of {len(photographs(name))} placed, {result.metrics['psnr_db']:.2f} dB")
    assert scene.frame.kind == "unscaled" and len(scene.cameras) >= 0.8 * len(photographs(name))
    assert result.metrics["psnr_db"] > 12
    assert any("no usable GPS" in event.message for event in events if isinstance(event, Warned))


@pytest.mark.stress
@pytest.mark.parametrize("name", SETS)
def test_without_exif_frames_by_gps_are_refused_at_once(name: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"no photograph has a GPS position.*--frames known"):
        run(config_of(stripped(name, tmp_path / "photos"), tmp_path, frames="gps"))
    assert not (tmp_path / "run").exists()


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """All of brighton and the first 36 photographs of caliterra, 1,800 km away."""
    folder = tmp_path / "mixed"
    folder.mkdir()
    for path in [*photographs("brighton"), *photographs("caliterra")[:36]]:
        (folder / path.name).symlink_to(path)
    return folder


@pytest.mark.stress
def test_of_two_sites_in_one_folder_the_larger_is_reconstructed(mixed: Path, tmp_path: Path) -> None:
    events: list[Event] = []
    result = run(config_of(mixed, tmp_path), events.append)
    scene = load_scene(result.folder / "sfm" / "scene.safetensors")
    told = [event.message for event in events if isinstance(event, Warned)]
    print(f"\nbrighton and caliterra: {len(scene.cameras)} of 54 placed, {result.metrics['psnr_db']:.2f} dB; {told}")
    assert all(name.startswith("IMG_") for name in scene.cameras.names) and len(scene.cameras) >= 30
    assert any("have no pose and are left out" in message for message in told)


@pytest.mark.stress
def test_of_two_sites_in_one_folder_frames_by_gps_leave_the_smaller_out(mixed: Path, tmp_path: Path) -> None:
    for path in photographs("caliterra")[9:36]:
        (mixed / path.name).unlink()
    events: list[Event] = []
    result = run(config_of(mixed, tmp_path, frames="gps"), events.append)
    told = [event.message for event in events if isinstance(event, Warned)]
    print(f"\nbrighton and 9 of caliterra by GPS: missing {result.metrics['missing']}, {result.metrics['psnr_db']:.2f} dB; {told}")
    assert any("9 of 27 photographs lie more than 300 km" in message for message in told)
    assert not list(result.folder.glob("devices/*/photos/IMG_*"))
