"""Which photographs share a lens, and with what focal length it begins."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from radiant_core.geometry.align import compare_centers
from radiant_core.io.colmap.model import read_model
from radiant_core.io.photos.jpeg import kept_segments
from radiant_core.io.photos.listing import CameraKey, Photograph
from radiant_core.sfm.colmap.lenses import DIAGONAL_35MM, Lenses, group_by_lens, initial_focal_px
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.reconstruct import reconstruct
from radiant_core.sfm.world_frame.world import cameras_of

DRONE = {"make": "Maker", "model": "Drone", "focal_mm": 8.8, "focal_35mm": 24.0, "size_wh": (4000, 3000)}


def photograph(index: int, **tags: Any) -> Photograph:
    camera = CameraKey(**{**DRONE, **tags})
    return Photograph(name=f"{index:04d}.jpg", path=Path(f"{index:04d}.jpg"), size_wh=camera.size_wh, lat_lon_alt=None, camera=camera)


def lenses_of(*tags: dict[str, Any]) -> Lenses:
    return group_by_lens([photograph(index, **each) for index, each in enumerate(tags)])


def focal_px(focal_35mm: float, width: int, height: int) -> float:
    return focal_35mm / DIAGONAL_35MM * math.hypot(width, height)


PLAIN: dict[str, Any] = {}


@pytest.mark.parametrize(
    ("other", "focals_px"),
    [
        ({"digital_zoom": 2.0, "focal_35mm": 48.0}, (2773.4, 5546.9)),
        ({"digital_zoom": 2.0, "focal_35mm": 48.0, "focal_mm": 17.6}, (2773.4, 5546.9)),
        ({"focal_35mm": 48.0}, (2773.4, 5546.9)),
        ({"focal_mm": 12.3, "focal_35mm": 33.5}, (2773.4, 3871.3)),
        # The 35 mm equivalent is that without zoom: it is multiplied.
        ({"digital_zoom": 2.0}, (2773.4, 5546.9)),
        ({"serial": "B"}, (2773.4, 2773.4)),
        ({"lens": "another"}, (2773.4, 2773.4)),
        ({"model": "Drone 2"}, (2773.4, 2773.4)),
        # Turned: another size; the diagonal is the same.
        ({"size_wh": (3000, 4000)}, (2773.4, 2773.4)),
        # Resized by half.
        ({"size_wh": (2000, 1500)}, (2773.4, 1386.7)),
        # Cut from the whole picture, as wide: pixels are as large.
        ({"size_wh": (4000, 2250)}, (2773.4, 2773.4)),
        # Cut, and EXIF says from what.
        ({"size_wh": (2000, 2000), "taken_wh": (4000, 3000)}, (2773.4, 2773.4)),
    ],
)
def test_every_tag_of_an_optical_system_makes_a_lens(other: dict[str, Any], focals_px: tuple[float, float]) -> None:
    """24 mm of 43.267 mm are 2,773.5 of 5,000 px: FocalLengthIn35mmFilm by the diagonal, as CIPA DCG-001
    defines it and COLMAP 4.2 reads it."""
    lenses = lenses_of(PLAIN, other, PLAIN, other).lenses
    assert [lens.names for lens in lenses] == [("0000.jpg", "0002.jpg"), ("0001.jpg", "0003.jpg")]
    assert [initial_focal_px(lens) for lens in lenses] == [(pytest.approx(focal, abs=0.2), True) for focal in focals_px]


def test_equal_tags_are_one_lens_and_that_changes_nothing() -> None:
    lenses = lenses_of(PLAIN, PLAIN, PLAIN)
    assert len(lenses.lenses) == 1 and lenses.decision.changes_nothing and lenses.warnings == ()


def test_photographs_that_say_nothing_are_one_lens_a_folder() -> None:
    silent = {"make": "", "model": "", "focal_mm": None, "focal_35mm": None}
    lenses = lenses_of({**silent, "folder": "film1"}, {**silent, "folder": "film1"}, {**silent, "folder": "film2"}).lenses
    assert [len(lens.names) for lens in lenses] == [2, 1]
    assert initial_focal_px(lenses[0]) == (1.2 * 4000, False)


def test_a_focus_that_jitters_is_one_lens() -> None:
    tags = [{"focal_mm": 8.8 + 0.003 * (index % 10), "focal_35mm": 24.0 + index % 2} for index in range(40)]
    lenses = lenses_of(*tags)
    assert len(lenses.lenses) == 1 and lenses.warnings == ()


def test_a_zoom_lens_is_not_a_lens_a_photograph_and_that_is_said() -> None:
    focals = np.exp(np.linspace(math.log(24), math.log(70), 100))
    lenses = lenses_of(*({"focal_mm": float(focal), "focal_35mm": float(round(focal))} for focal in focals))
    # ln(70/24) = 1.07 in steps of 4 % is 27.
    assert 20 <= len(lenses.lenses) <= 32
    for lens in lenses.lenses:
        said = [photo.camera.focal_mm or 0.0 for photo in lens.photographs]
        assert max(said) / min(said) <= math.exp(0.04) + 1e-9
    (told,) = lenses.warnings
    assert told.startswith("100 photographs of Maker Drone have 100 different focal lengths: they are taken for")
    assert "differ by up to 4%" in told


def test_three_fixed_focal_lengths_stay_three_lenses_whatever_their_number() -> None:
    lenses = lenses_of(*({"focal_mm": focal, "focal_35mm": focal} for focal in (24.0, 35.0, 70.0)))
    assert len(lenses.lenses) == 3 and lenses.warnings == ()


@pytest.mark.parametrize(
    ("tags", "said"),
    [
        ({"focal_35mm": 65535.0}, "65,535 mm at 35 mm"),
        ({"focal_35mm": 1.0}, "1 mm at 35 mm"),
        ({"focal_35mm": 24.0, "focal_mm": 2400.0}, "24 mm at 35 mm"),
        ({"focal_35mm": None, "focal_mm": 4e9}, "4e+09 mm"),
        ({"focal_35mm": None, "focal_mm": 0.001}, "0.001 mm"),
    ],
)
def test_a_focal_length_that_no_lens_has_is_not_used_and_said(tags: dict[str, Any], said: str) -> None:
    lenses = lenses_of(*[tags] * 4)
    assert initial_focal_px(lenses.lenses[0]) == (1.2 * 4000, False)
    assert any(f"4 photographs say a focal length of {said}, which no lens of theirs has" in told for told in lenses.warnings)


@pytest.mark.parametrize("zoom", [1e6, 65535.0, 1e-4])
@pytest.mark.parametrize("focal_35mm", [24.0, None])
def test_a_digital_zoom_that_no_camera_has_is_not_used_and_said(zoom: float, focal_35mm: float | None) -> None:
    lenses = lenses_of(PLAIN, *[{"digital_zoom": zoom, "focal_35mm": focal_35mm}] * 3)
    assert initial_focal_px(lenses.lenses[1]) == (1.2 * 4000, False)
    assert any(f"3 photographs say a digital zoom of {zoom:,.6g}, which no lens of theirs has" in told for told in lenses.warnings)


@pytest.mark.parametrize("focal_35mm", [8.0, 24.0, 162.0, 2400.0])
def test_fisheyes_and_telephoto_lenses_are_believed(focal_35mm: float) -> None:
    lenses = lenses_of(*[{"focal_35mm": focal_35mm, "focal_mm": None}] * 2)
    assert initial_focal_px(lenses.lenses[0]) == (pytest.approx(focal_px(focal_35mm, 4000, 3000)), True) and lenses.warnings == ()


def test_zoom_that_the_35_mm_focal_length_leaves_out_is_said() -> None:
    lenses = lenses_of(PLAIN, {"digital_zoom": 2.0}, PLAIN)
    assert lenses.warnings == ("the 35 mm focal lengths of Maker Drone leave digital zoom out: they are multiplied by it.",)


def zoomed(hamlet: Path, folder: Path) -> Path:
    """The hamlet's photographs, every third one by digital zoom, as its tags say."""
    folder.mkdir()
    for index, path in enumerate(sorted((hamlet / "images").iterdir())):
        data = path.read_bytes()
        if index % 3 == 0:
            picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
            assert picture is not None
            height, width = picture.shape[:2]
            part = picture[height // 8 : height - height // 8, width // 8 : width - width // 8]
            jpeg = cv2.imencode(".jpg", cv2.resize(part, (width, height), interpolation=cv2.INTER_CUBIC), [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
            segments = kept_segments(data).replace(struct.pack(">HHIHH", 0xA405, 3, 1, 24, 0), struct.pack(">HHIHH", 0xA405, 3, 1, 32, 0))
            assert segments != kept_segments(data)
            data = b"\xff\xd8" + segments + jpeg.tobytes()[2:]
        (folder / path.name).write_bytes(data)
    return folder


def test_cameras_that_zoom_stand_as_high_as_the_others(hamlet: Path, tmp_path: Path) -> None:
    result = reconstruct(zoomed(hamlet, tmp_path / "images"), tmp_path / "work", SfmConfig(), lambda progress: None)
    cameras = result.scene.cameras
    assert len(cameras) == 12
    known = cameras_of(read_model(hamlet / "known"))
    fit = compare_centers(cameras.centers, known.named(cameras.names).centers).reference_from_scene
    # One lens for all leaves the zoomed ones a quarter of 30 m too low.
    assert np.linalg.norm(fit.apply(cameras.centers) - known.named(cameras.names).centers, axis=1).max() < 0.5
    long = np.array([int(name[6:10]) % 3 == 0 for name in cameras.names])
    assert np.median(cameras.Ks[long, 0, 0]) / np.median(cameras.Ks[~long, 0, 0]) == pytest.approx(4 / 3, rel=0.01)
