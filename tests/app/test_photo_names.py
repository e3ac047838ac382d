"""One listing for every command: folders of a camera below are read by all, under the same names."""

from __future__ import annotations

from pathlib import Path

import pytest

from radiant_app.files.system_file import load_system
from radiant_app.run.captured import device_folders
from radiant_app.run.source_key import used_files
from radiant_app.workers.field_nodes import run_positions
from radiant_app.workers.own_photographs import find_own, save_own_source
from radiant_app.workers.tasks import PositionsTask
from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import list_photographs
from radiant_core.io.run_store import read_json
from radiant_core.plan.system import System
from radiant_core.waypoints.reader import exif_waypoints

ROOT = Path(__file__).parents[2]
HAMLET = sorted((ROOT / "sample_scenes" / "hamlet" / "images").iterdir())


class Messages:
    """What a worker says."""

    def __init__(self) -> None:
        self.warned: list[str] = []

    def warn(self, message: str) -> None:
        self.warned.append(message)


@pytest.fixture
def cards(tmp_path: Path) -> Path:
    for number, photo in enumerate(HAMLET):
        below = tmp_path / "photos" / ("100MEDIA" if number < 6 else "101MEDIA")
        below.mkdir(parents=True, exist_ok=True)
        (below / f"DJI_{number % 6:04d}.JPG").write_bytes(photo.read_bytes())
    return tmp_path / "photos"


NAMES = tuple(f"{folder}/DJI_{number:04d}.JPG" for folder in ("100MEDIA", "101MEDIA") for number in range(6))


@pytest.fixture
def system() -> System:
    return load_system(ROOT / "sample_scenes" / "town" / "system.toml")


def test_every_reader_of_photographs_has_the_same_names(cards: Path, tmp_path: Path, system: System) -> None:
    assert tuple(photo.name for photo in list_photographs(cards).photographs) == NAMES
    assert tuple(used_files(cards, None)) == NAMES
    assert exif_waypoints(cards).waypoints.names == NAMES
    save_own_source(tmp_path, cards, None)
    assert find_own(tmp_path, "gps").names == NAMES
    assert device_folders(cards, system) is None
    said = Messages()
    run_positions(tmp_path, PositionsTask(source=str(cards), cell_m=None, held_out=(), owned=False), said)  # pyright: ignore
    assert tuple(read_json(tmp_path / "positions.json")["photographs"]) == NAMES
    assert said.warned == ["12 photographs are read from 2 folders: 100MEDIA 6, 101MEDIA 6."]


def test_an_owner_counts_what_lies_below_without_names(cards: Path, tmp_path: Path) -> None:
    (cards / "transforms.json").write_text("{}")
    said = Messages()
    run_positions(tmp_path, PositionsTask(source=str(cards), cell_m=25.0, held_out=(NAMES[0],), owned=True), said)  # pyright: ignore
    record = read_json(tmp_path / "raster.json")
    assert record["num_photographs"] == 12 and sum(cell[2] for cell in record["cells"]) == 11
    assert said.warned == [
        "12 photographs are read from 2 folders.",
        "beside the photographs there are poses of nerfstudio or instant-ngp: they are not used.",
    ]


@pytest.mark.parametrize("inner", ["flight2", "flight2/100MEDIA"])
def test_folders_that_are_no_camera_s_may_be_owners_and_are_refused(inner: str, tmp_path: Path, system: System) -> None:
    (tmp_path / inner).mkdir(parents=True)
    (tmp_path / inner / "a.jpg").write_bytes(HAMLET[0].read_bytes())
    with pytest.raises(BadInput, match="has photographs in the folder 'flight2', which is no device of the system"):
        device_folders(tmp_path, system)
