"""Copies among files: the same bytes under two names, and which of the two stays."""

from __future__ import annotations

from pathlib import Path

import pytest

from radiant_core.errors import BadInput
from radiant_core.io.photos.copies import copies_warning, file_copies
from radiant_core.io.photos.listing import list_photographs
from radiant_core.waypoints.reader import exif_waypoints

HAMLET = Path(__file__).parents[3] / "sample_scenes" / "hamlet" / "images"


def paths_of(folder: Path, contents: dict[str, bytes]) -> dict[str, Path]:
    for name, content in contents.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return {name: folder / name for name in contents}


def test_only_files_with_the_same_bytes_are_copies_and_the_first_stays(tmp_path: Path) -> None:
    paths = paths_of(tmp_path, {"a": b"one", "a (1)": b"one", "b": b"two", "c": b"other", "d": b"one"})
    assert file_copies({**paths, "gone": tmp_path / "gone"}) == {"a (1)": "a", "d": "a"}


def test_what_a_set_holds_out_itself_stays_and_its_copy_in_the_training_part_goes(tmp_path: Path) -> None:
    paths = paths_of(tmp_path, {"train/rgbs/1.jpg": b"one", "train/rgbs/2.jpg": b"two", "val/rgbs/3.jpg": b"one"})
    assert file_copies(paths) == {"train/rgbs/1.jpg": "val/rgbs/3.jpg"}


def test_the_warning_names_three_and_counts_the_rest() -> None:
    (told,) = copies_warning({f"b{index}": f"a{index}" for index in range(4)}, 9)
    assert told.startswith("4 of 9 photographs are copies") and "b2 (of a2) …" in told and "b3" not in told
    assert copies_warning({}, 9) == ()


def two_cards(folder: Path, num_photographs: int = 12) -> Path:
    photographs = sorted(HAMLET.iterdir())[:num_photographs]
    paths_of(folder, {f"{card}_{path.name}": path.read_bytes() for card in "ab" for path in photographs})
    return folder


def test_a_listing_without_copies_has_every_photograph_once(tmp_path: Path) -> None:
    listing = list_photographs(two_cards(tmp_path)).without_copies()
    assert [photo.name for photo in listing.photographs] == [f"a_{path.name}" for path in sorted(HAMLET.iterdir())]
    assert listing.left_out == listing.copies.keys() == {f"b_{path.name}" for path in HAMLET.iterdir()}


def test_copies_of_one_photograph_are_no_scene(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="all 2 photographs are copies of"):
        list_photographs(two_cards(tmp_path, 1)).without_copies()


def test_positions_for_a_plan_are_those_of_the_photographs_that_a_run_uses(tmp_path: Path) -> None:
    found = exif_waypoints(two_cards(tmp_path))
    assert found.waypoints.names == tuple(f"a_{path.name}" for path in sorted(HAMLET.iterdir()))
    assert any(warning.startswith("12 of 24 photographs are copies") for warning in found.warnings)
