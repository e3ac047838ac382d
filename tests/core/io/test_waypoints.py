"""Readers of waypoints: the three formats say the same, a stranger's file ends in waypoints or one
sentence, photographs give their GPS."""

from __future__ import annotations

import gc
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import list_photographs
from radiant_core.waypoints import reader as waypoints
from radiant_core.waypoints.reader import MAX_FILE_BYTES, exif_waypoints, read_waypoints
from tests.core.io.waypoint_files import GOOD, assert_rows, csv_text, written

HAMLET = Path(__file__).parents[3] / "sample_scenes" / "hamlet" / "images"


@pytest.mark.parametrize("suffix", GOOD)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_every_format_and_mark_gives_the_same_waypoints(tmp_path: Path, suffix: str, encoding: str) -> None:
    assert_rows(written(tmp_path, "a" + suffix.upper(), GOOD[suffix]().encode(encoding)))


def test_what_is_no_waypoint_file_is_refused(tmp_path: Path) -> None:
    large = tmp_path / "large.csv"
    with large.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)  # sparse: nothing is stored, and nothing is read
    os.mkfifo(tmp_path / "pipe.csv")
    cases = [
        (tmp_path / "none.csv", "No such file"),
        (written(tmp_path, "a.kmz", b"PK"), "unzip it"),
        (written(tmp_path, "a.txt", csv_text()), "must end in .csv"),
        (tmp_path / "pipe.csv", "not a file"),
        (large, f"{MAX_FILE_BYTES + 1} bytes, expected at most {MAX_FILE_BYTES}"),
    ]
    (tmp_path / "folder.csv").mkdir()
    for path, told in [*cases, (tmp_path / "folder.csv", "Is a directory")]:
        with pytest.raises(BadInput, match=told):
            read_waypoints(path)


@pytest.mark.parametrize("suffix", [".csv", ".geojson", ".kml"])
def test_fifteen_hundred_mutations_of_each_format_raise_bad_input_only(tmp_path: Path, suffix: str) -> None:
    good = GOOD[suffix]().encode()
    pieces = b'\x00 \xff\xfe \xef\xbb\xbf " , \n < & - 1e999 NaN [ ] {} null <a> \xed\xa0\x80'.split(b" ")
    rng = np.random.default_rng(8)
    outcomes = {"read": 0, "refused": 0}
    for _ in range(1500):
        data = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            at, cut = int(rng.integers(0, len(data) + 1)), int(rng.integers(0, 6))
            data[at : at + cut] = pieces[rng.integers(len(pieces))] if rng.random() < 0.5 else rng.bytes(int(rng.integers(0, 3)))
        if rng.random() < 0.1:
            data = data[: rng.integers(len(data))]
        path = written(tmp_path, "a" + suffix, bytes(data))
        said = refusal(path)
        assert said is None or "a" + suffix in said
        outcomes["read" if said is None else "refused"] += 1
    assert min(outcomes.values()) > 20, outcomes


def refusal(path: Path) -> str | None:
    """What is said against the file, None when it is taken; any other exception goes on."""
    try:
        assert np.isfinite(read_waypoints(path).waypoints.positions_m).all()
    except BadInput as error:
        return str(error)
    return None


def test_a_file_of_the_largest_size_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, "a.csv", csv_text())
    size = path.stat().st_size
    monkeypatch.setattr(waypoints, "MAX_FILE_BYTES", size)
    assert_rows(path)
    monkeypatch.setattr(waypoints, "MAX_FILE_BYTES", size - 1)
    with pytest.raises(BadInput, match=f"has {size} bytes, expected at most {size - 1}: split it into several flights"):
        read_waypoints(path)


def test_the_collector_of_cycles_is_left_as_it_was(tmp_path: Path) -> None:
    path = written(tmp_path, "a.csv", csv_text())
    bad = written(tmp_path, "b.csv", "x\n")
    try:
        for wanted in (True, False):
            (gc.enable if wanted else gc.disable)()
            assert_rows(path)
            assert gc.isenabled() is wanted
            with pytest.raises(BadInput):
                read_waypoints(bad)
            assert gc.isenabled() is wanted
    finally:
        gc.enable()


def test_photographs_give_the_positions_that_decoding_them_gives() -> None:
    found = exif_waypoints(HAMLET)
    decoded = list_photographs(HAMLET).photographs
    assert found.waypoints.names == tuple(photo.name for photo in decoded)
    np.testing.assert_array_equal(found.waypoints.lat_lon_alt, [photo.lat_lon_alt for photo in decoded])
    assert found.warnings == found.without_gps == ()


def without_exif(path: Path, target: Path) -> None:
    """The photograph saved anew, its name at the end: files of the same bytes are copies of one."""
    import cv2

    image = cv2.imread(str(path))
    assert image is not None
    assert cv2.imwrite(str(target), image)
    target.write_bytes(target.read_bytes() + target.name.encode())


def test_photographs_without_gps_are_named_and_only_heads_are_read(tmp_path: Path) -> None:
    photos = sorted(HAMLET.iterdir())
    shutil.copy(photos[0], tmp_path / "a.jpg")
    # At one position: both were taken.
    (tmp_path / "b.jpg").write_bytes(photos[0].read_bytes() + b"another")
    for index in range(7):
        without_exif(photos[1], tmp_path / f"c{index}.jpg")
    # Cut behind its EXIF: not noticed, no pixel is decoded.
    (tmp_path / "d.JPG").write_bytes(photos[2].read_bytes()[:40_000])
    with (tmp_path / "d.JPG").open("ab") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    (tmp_path / "notes.txt").write_text("x")
    seen: list[tuple[int, int]] = []
    found = exif_waypoints(tmp_path, lambda done, total: seen.append((done, total)))
    assert found.waypoints.names == ("a.jpg", "b.jpg", "d.JPG")
    assert found.without_gps == tuple(f"c{index}.jpg" for index in range(7))
    assert "7 of 10 photographs without GPS" in found.warnings[0]
    assert found.warnings[0].endswith("c0.jpg, c1.jpg, c2.jpg, c3.jpg, c4.jpg and 2 more.")
    assert seen[-1] == (10, 10)


def test_up_to_five_photographs_without_gps_are_named(tmp_path: Path) -> None:
    photos = sorted(HAMLET.iterdir())
    shutil.copy(photos[0], tmp_path / "a.jpg")
    for index in range(5):
        without_exif(photos[1], tmp_path / f"c{index}.jpg")
    found = exif_waypoints(tmp_path)
    assert found.warnings == ("5 of 6 photographs without GPS in EXIF or XMP are not planned: c0.jpg, c1.jpg, c2.jpg, c3.jpg, c4.jpg.",)


def test_folders_without_a_position_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="does not exist"):
        exif_waypoints(tmp_path / "none")
    with pytest.raises(BadInput, match="no photographs"):
        exif_waypoints(tmp_path)
    without_exif(sorted(HAMLET.iterdir())[0], tmp_path / "a.jpg")
    with pytest.raises(BadInput, match="none of the 1 photographs"):
        exif_waypoints(tmp_path)
