"""Folders of cameras and flights, what is read in them, and what lies beside photographs unread."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.photos.beside import beside_warning
from radiant_core.io.photos.folders import folders_warning, is_camera_folder, photograph_names, read_folder, unread_warning
from radiant_core.io.photos.listing import list_photographs
from radiant_core.waypoints.reader import exif_waypoints

HAMLET = sorted((Path(__file__).parents[3] / "sample_scenes" / "hamlet" / "images").iterdir())


def fill(folder: Path, *names: str) -> Path:
    """Files of these names: photographs of the hamlet, each another one."""
    for index, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(HAMLET[index % len(HAMLET)].read_bytes() + index.to_bytes(2, "big"))
    return folder


def test_equal_names_in_two_folders_are_two_photographs(tmp_path: Path) -> None:
    fill(tmp_path, "100MEDIA/DJI_0001.JPG", "101MEDIA/DJI_0001.JPG", "flight2/deep/DJI_0001.jpeg", "DJI_0001.jpg")
    listing = list_photographs(tmp_path)
    names = ["100MEDIA/DJI_0001.JPG", "101MEDIA/DJI_0001.JPG", "DJI_0001.jpg", "flight2/deep/DJI_0001.jpeg"]
    assert [photo.name for photo in listing.photographs] == names
    assert list(exif_waypoints(tmp_path).waypoints.names) == names
    assert folders_warning(listing.content)[0] in exif_waypoints(tmp_path).warnings


def test_what_programs_make_of_photographs_is_counted_and_not_read(tmp_path: Path) -> None:
    fill(
        tmp_path,
        "a.jpg",
        "flight/masks/a.jpg.png",
        "masks/a.jpg.png",
        "sub/depth/a.png",
        "odm_orthophoto/odm_orthophoto.tif",
        ".thumbs/a.jpg",
        "._a.jpg",
    )
    fill(tmp_path, "old run/sfm/undistorted/images/a.jpg", "old run/manifest.json")
    content = read_folder(tmp_path)
    assert content.names == ("a.jpg",)
    assert content.closed == {"flight/masks": 1, "sub/depth": 1, "odm_orthophoto": 1, "old run": 1}
    (told,) = folders_warning(content)
    assert told.startswith("4 pictures in folders of masks, depths and what programs make of photographs are not read (flight/masks/ 1, ")
    assert folders_warning(content, named=False) == (told.partition(" (")[0] + ".",)


def test_links_to_folders_are_followed_once(tmp_path: Path) -> None:
    fill(tmp_path / "card", "100MEDIA/a.jpg", "100MEDIA/b.jpg")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "one").symlink_to(tmp_path / "card" / "100MEDIA")
    (tmp_path / "photos" / "round").symlink_to(tmp_path / "photos")
    assert photograph_names(tmp_path / "photos") == ("one/a.jpg", "one/b.jpg")


@pytest.mark.parametrize("suffix", ["heic", "DNG", "webp", "cr3", "MP4", "mov", "jxl", "avif", "bmp", "lrf"])
def test_files_below_that_cannot_be_read_are_counted(suffix: str, tmp_path: Path) -> None:
    fill(tmp_path, "100MEDIA/a.JPG", f"100MEDIA/a.{suffix}", f"101MEDIA/b.{suffix}", "101MEDIA/b.jpg")
    (told,) = unread_warning(list_photographs(tmp_path).content.unread)
    assert told.startswith(f"2 .{suffix.lower()} files are not read: ")


@pytest.mark.parametrize("suffix", [".jpg", ".JPG", ".Jpeg", ".png", ".PNG", ".tif", ".TIFF"])
def test_suffixes_of_either_case_are_read(suffix: str, tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    for name in ("x/a", "y/a"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / f"{name}{suffix}").write_bytes(cv2.imencode(suffix.lower(), picture)[1].tobytes())
    assert [photo.name for photo in list_photographs(tmp_path).photographs] == [f"x/a{suffix}", f"y/a{suffix}"]


@pytest.mark.parametrize(
    ("name", "is_one"),
    [("100MEDIA", True), ("101_0001", True), ("DCIM", True), ("DJI_202511281530_001", True), ("north", False), ("flight2", False)],
)
def test_folders_of_cameras(name: str, is_one: bool) -> None:
    assert is_camera_folder(name) is is_one


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("transforms.json", "transforms.json (poses of nerfstudio or instant-ngp)"),
        ("cameras.json", "cameras.json (lenses of ODM)"),
        ("opensfm/reconstruction.json", "opensfm/ (poses of OpenSfM)"),
        ("project.psx", "1 .psx (a project of Metashape)"),
        ("cameras.xml", "cameras.xml (poses of Metashape)"),
        ("bundle.out", "bundle.out (poses of Bundler)"),
        ("sfm_data.json", "sfm_data.json (poses of OpenMVG)"),
        ("transforms_test.json", "transforms_test.json (poses of NeRF)"),
        ("poses_bounds.npy", "poses_bounds.npy (poses of LLFF)"),
        (
            "site_calibrated_external_camera_parameters.txt",
            "site_calibrated_external_camera_parameters.txt (poses of Pix4D)",
        ),
        ("flight_Timestamp.MRK", "1 .mrk (times of exposure)"),
        ("flight_PPKOBS.obs", "1 .obs (observations of satellites)"),
        ("flight.GPX", "1 .gpx (tracks)"),
        ("site.p4d", "1 .p4d (a project of Pix4D)"),
        ("site.rcproj", "1 .rcproj (a project of RealityScan)"),
        ("DJI_0001.SRT", "1 .srt (positions of a film)"),
        ("geo.txt", "geo.txt (positions)"),
        ("gcp_list.txt", "gcp_list.txt (ground control)"),
        ("ground_control_points.json", "ground_control_points.json (ground control of OpenSfM)"),
        ("masks/a.jpg.png", "masks/ (masks, which --masks takes)"),
    ],
)
@pytest.mark.parametrize("above", [False, True])
def test_one_line_names_what_lies_beside_and_is_not_used(name: str, told: str, above: bool, tmp_path: Path) -> None:
    folder = fill(tmp_path / "images" if above else tmp_path, "a.jpg", "b.jpg")
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("<document><chunk>" if name.endswith(".xml") else "x")
    assert beside_warning(folder) == (f"beside the photographs there are {told}: they are not used.",)
    assert beside_warning(folder)[0] in exif_waypoints(folder).warnings
    (unnamed,) = beside_warning(folder, named=False)
    assert unnamed == f"beside the photographs there are {told.partition('(')[2].removesuffix(')')}: they are not used."


def test_masks_that_are_used_are_not_named(tmp_path: Path) -> None:
    fill(tmp_path, "a.jpg", "masks/a.jpg.png")
    assert beside_warning(tmp_path, tmp_path / "masks") == ()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_list_of_ground_control_that_is_used_is_not_named(tmp_path: Path, encoding: str) -> None:
    fill(tmp_path / "images", "a.jpg")
    text = "EPSG:32632\r\n465287.8 5246371.9 427.6 186.3 63.8 a.jpg gcp-1\r\n"
    (tmp_path / "gcp_list.txt").write_bytes(text.encode(encoding))
    assert beside_warning(tmp_path / "images", control=text) == ()
    for other in (None, text.replace("427.6", "427.7")):
        (told,) = beside_warning(tmp_path / "images", control=other)
        assert "gcp_list.txt (ground control)" in told


def test_photographs_beside_a_folder_of_images_are_named(tmp_path: Path) -> None:
    fill(tmp_path, "images/a.jpg", "images/b.jpg", "loose.jpg", "101MEDIA/c.jpg", "film.mp4")
    (told,) = beside_warning(tmp_path / "images")
    assert told == (
        "beside the photographs there are 101MEDIA/ (1 photographs), 1 .jpg (photographs), 1 .mp4 (films or pictures that are not "
        "read): they are not used."
    )


def test_reasons_are_said_once_with_counts(tmp_path: Path) -> None:
    for index in range(5):
        (tmp_path / f"{index}.jpg").write_bytes(b"text")
    with pytest.raises(BadInput, match=r"5 skipped: 0.jpg, 1.jpg, 2.jpg and 2 more, each of which is not a JPEG, PNG or TIFF image\)"):
        list_photographs(tmp_path)
