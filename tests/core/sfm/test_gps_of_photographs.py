"""GPS as cameras and editors write it: altitude on all, some or no photographs, and outliers."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from radiant_core.frames import enu_change
from radiant_core.geometry.align import compare_centers
from radiant_core.io.colmap.model import read_model
from radiant_core.io.photos.gps import ALTITUDE, LATITUDE
from radiant_core.io.photos.jpeg import GPS_POINTER, read_jpeg_facts
from radiant_core.io.photos.listing import list_photographs
from radiant_core.sfm.colmap.pairs import choose_pairs
from radiant_core.sfm.config import SfmConfig, SfmResult
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.sfm.world_frame.world import cameras_of
from radiant_core.waypoints.reader import exif_waypoints

UNUSED_TAG = 0xEEEE
Change = Callable[[bytearray, int, int], None]
"""Changes the entry of a GPS tag: the EXIF block, where the entry begins, its tag."""


def with_gps_changed(data: bytes, change: Change) -> bytes:
    """A JPEG of the sample scenes (big-endian EXIF) after `change` of each entry of its GPS."""
    start = data.index(b"Exif\0\0") + 6
    length = int.from_bytes(data[start - 8 : start - 6], "big") - 8
    block = bytearray(data[start : start + length])
    assert block[:2] == b"MM"

    def entries(offset: int) -> list[int]:
        return [offset + 2 + 12 * index for index in range(struct.unpack_from(">H", block, offset)[0])]

    main = entries(struct.unpack_from(">I", block, 4)[0])
    pointer = next(entry for entry in main if struct.unpack_from(">H", block, entry)[0] == GPS_POINTER)
    for entry in entries(struct.unpack_from(">I", block, pointer + 8)[0]):
        change(block, entry, struct.unpack_from(">H", block, entry)[0])
    return data[:start] + bytes(block) + data[start + length :]


def without_altitude(block: bytearray, entry: int, tag: int) -> None:
    if tag in (ALTITUDE - 1, ALTITUDE):
        struct.pack_into(">H", block, entry, UNUSED_TAG)


def twenty_degrees_off(block: bytearray, entry: int, tag: int) -> None:
    if tag == LATITUDE:
        place = struct.unpack_from(">I", block, entry + 8)[0]
        degrees, of = struct.unpack_from(">2I", block, place)
        struct.pack_into(">2I", block, place, degrees + 20 * of, of)


def hamlet_with(hamlet: Path, folder: Path, change: Change, num_changed: int = 12) -> Path:
    folder.mkdir()
    for index, path in enumerate(sorted((hamlet / "images").iterdir())):
        data = path.read_bytes()
        (folder / path.name).write_bytes(with_gps_changed(data, change) if index < num_changed else data)
    return folder


def scene_of(hamlet: Path, images: Path, work: Path) -> SfmResult:
    return scene_from_colmap(hamlet / "known", images, work, lambda progress: None)


@pytest.fixture(scope="module")
def flat(hamlet: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hamlet_with(hamlet, tmp_path_factory.mktemp("gps") / "flat", without_altitude)


def test_a_position_without_altitude_is_one(flat: Path, hamlet: Path) -> None:
    for path in sorted(flat.iterdir()):
        place = read_jpeg_facts(path.read_bytes()).exif.lat_lon_alt
        whole = read_jpeg_facts((hamlet / "images" / path.name).read_bytes()).exif.lat_lon_alt
        assert place is not None and whole is not None
        assert place[:2] == whole[:2] and math.isnan(place[2])


def test_photographs_without_altitude_are_matched_with_their_neighbours(flat: Path) -> None:
    _, decision = choose_pairs(list_photographs(flat).photographs, SfmConfig(num_neighbors=3))
    assert decision.choice.startswith("spatial") and decision.figure == 100


def test_without_altitudes_scale_heading_and_place_come_from_the_horizontal_positions(flat: Path, hamlet: Path, tmp_path: Path) -> None:
    result, whole = scene_of(hamlet, flat, tmp_path / "flat"), scene_of(hamlet, hamlet / "images", tmp_path / "whole")
    scene = result.scene
    assert scene.frame.kind == "metric" and scene.frame.origin_lat_lon_alt[2] == 0
    assert not scene.frame.altitude_known and whole.scene.frame.altitude_known
    known = cameras_of(read_model(hamlet / "known"))
    # GPS is off by at most 1 m over a site of 40 m.
    assert compare_centers(scene.cameras.centers, known.centers).reference_from_scene.scale == pytest.approx(1.0, abs=0.05)
    there = enu_change(scene.frame.origin_lat_lon_alt, whole.scene.frame.origin_lat_lon_alt).apply(scene.cameras.centers)
    assert np.linalg.norm((there - whole.scene.cameras.centers)[:, :2], axis=1).max() < 2.0
    # Ground and photographs are level to a few degrees in this scene.
    assert np.degrees(np.arccos(tilt(scene.cameras.cam_from_world, whole.scene.cameras.cam_from_world))) < 4.0
    assert abs(np.median(scene.points[:, 2])) < 1.0 and scene.cameras.centers[:, 2].min() > 5.0
    (told,) = [warning for warning in result.warnings if "altitude" in warning]
    assert told.startswith("12 of 12 GPS positions have no altitude") and not any("no GPS" in warning for warning in result.warnings)


def tilt(first: np.ndarray, second: np.ndarray) -> float:
    """Cosine between up in two frames of the same cameras."""
    return float((first[0, :3, :3] @ (0, 0, 1)) @ (second[0, :3, :3] @ (0, 0, 1)))


def test_where_most_have_an_altitude_the_others_take_their_height_from_those(hamlet: Path, tmp_path: Path) -> None:
    images = hamlet_with(hamlet, tmp_path / "images", without_altitude, num_changed=5)
    result, whole = scene_of(hamlet, images, tmp_path / "some"), scene_of(hamlet, hamlet / "images", tmp_path / "whole")
    there = enu_change(result.scene.frame.origin_lat_lon_alt, whole.scene.frame.origin_lat_lon_alt).apply(result.scene.cameras.centers)
    # Seven noisy altitudes instead of twelve.
    assert np.linalg.norm(there - whole.scene.cameras.centers, axis=1).max() < 2.0
    assert any(warning.startswith("5 of 12 GPS positions have no altitude") for warning in result.warnings)


def test_a_plan_from_photographs_takes_positions_without_altitude(flat: Path, hamlet: Path) -> None:
    found, whole = exif_waypoints(flat), exif_waypoints(hamlet / "images")
    np.testing.assert_array_equal(found.waypoints.lat_lon_alt[:, :2], whole.waypoints.lat_lon_alt[:, :2])
    assert found.waypoints.heights_m is None and not found.waypoints.altitude_known and not found.waypoints.absolute
    assert any("None of 12 photographs with GPS has an altitude" in warning for warning in found.warnings)
    assert not any("altitude" in warning for warning in whole.warnings)


def test_photographs_with_gps_far_off_are_named(hamlet: Path, tmp_path: Path) -> None:
    images = hamlet_with(hamlet, tmp_path / "images", twenty_degrees_off, num_changed=4)
    result = scene_of(hamlet, images, tmp_path / "work")
    (told,) = [warning for warning in result.warnings if "are not used" in warning]
    assert told.startswith("the GPS positions of 4 of 12 photographs are up to 2,1")
    assert all(f"drone_000{index}.jpg" in told for index in range(4)) and "drone_0004" not in told
    whole = scene_of(hamlet, hamlet / "images", tmp_path / "whole")
    assert not any("are not used" in warning for warning in whole.warnings)
