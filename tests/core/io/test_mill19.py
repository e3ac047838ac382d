"""Mill 19 / Mega-NeRF folders: right axes on generated folders, and strange files are refused."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import NoReturn
from zipfile import ZIP_DEFLATED, ZipFile

import cv2
import numpy as np
import pytest
import torch

from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io import mill19
from radiant_core.io.mill19 import given_from_scene, images_without_pose, read_mill19

SIZE_WH = (64, 48)


def save(content: object, path: Path) -> None:
    torch.save(content, path)  # noqa: TID251 the format under test is somebody else's


def metadata(right: tuple, up: tuple, back: tuple, center: tuple) -> dict[str, object]:
    """One file's content; the vectors are in the world's down, right, back axes."""
    c2w = torch.tensor(np.column_stack([right, up, back, center]), dtype=torch.float32)
    return {
        "W": SIZE_WH[0],
        "H": SIZE_WH[1],
        "c2w": c2w,
        "intrinsics": torch.tensor([60.0, 61.0, 32.0, 24.0]),
        "distortion": torch.tensor([0.1, 0.0, 0.0, 0.0]),
    }


# Looking straight down (DRB x), image top to the north (-back): right is (0,1,0), up is (0,0,-1),
# back is up in the world.
NADIR = metadata((0, 1, 0), (0, 0, -1), (-1, 0, 0), (-0.5, 0.25, -0.125))
# Looking north (-back), upright.
NORTH = metadata((0, 1, 0), (-1, 0, 0), (0, 0, 1), (0.0, 0.0, 0.0))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save({"origin_drb": torch.tensor([-10.0, 500_000.0, -4_000_000.0]), "pose_scale_factor": 200.0}, tmp_path / "coordinates.pt")
    for split, stem, content in (("train", "000000", NADIR), ("val", "000001", NORTH)):
        (tmp_path / split / "metadata").mkdir(parents=True)
        (tmp_path / split / "rgbs").mkdir()
        save(content, tmp_path / split / "metadata" / f"{stem}.pt")
        cv2.imwrite(str(tmp_path / split / "rgbs" / f"{stem}.jpg"), np.zeros((48, 64, 3), np.uint8))
    return tmp_path


def test_the_way_back_leads_to_the_numbers_of_the_metadata(folder: Path) -> None:
    back = given_from_scene(folder).apply(read_mill19(folder).centers)
    # 1e-7: c2w is float32.
    assert np.allclose(back, [[-0.5, 0.25, -0.125], [0, 0, 0]], atol=1e-7)


@pytest.mark.parametrize("suffix", [".jpg", ".JPG", ".jpeg", ".png", ".PNG"])
def test_an_image_has_any_of_the_usual_endings_and_two_are_not_chosen_between(folder: Path, suffix: str) -> None:
    images = folder / "train" / "rgbs"
    (images / "000000.jpg").rename(images / f"000000{suffix}")
    assert read_mill19(folder).names[0] == f"train/rgbs/000000{suffix}"
    (images / "000000.jpeg").touch()
    (images / "000000.png").touch()
    with pytest.raises(BadInput, match=r"has [23] images, train/rgbs/000000\..* leave the one that it was made from"):
        read_mill19(folder)


def test_images_without_metadata_are_counted(folder: Path) -> None:
    for name in ("train/rgbs/000007.jpg", "val/rgbs/000008.png", "val/rgbs/notes.txt"):
        (folder / name).touch()
    assert images_without_pose(folder, read_mill19(folder)) == ("train/rgbs/000007.jpg", "val/rgbs/000008.png")


def test_axes_scale_and_split(folder: Path) -> None:
    cameras = read_mill19(folder)
    assert cameras.names == ("train/rgbs/000000.jpg", "val/rgbs/000001.jpg")
    assert held_out_mask(cameras.names).tolist() == [False, True]
    # down −0.5, right 0.25, back −0.125 times 200: 100 up, 50 to the right, 25 forward.
    assert np.allclose(cameras.centers[0], [50, 25, 100], atol=1e-5)
    nadir, north = cameras.cam_from_world[:, :3, :3]
    assert np.allclose(nadir @ [0, 0, -1], [0, 0, 1], atol=1e-6), "down is forward in the nadir camera"
    assert np.allclose(nadir @ [0, 1, 0], [0, -1, 0], atol=1e-6), "forward in the world is up in its image"
    assert np.allclose(north @ [0, 1, 0], [0, 0, 1], atol=1e-6)
    assert np.allclose(north @ [0, 0, 1], [0, -1, 0], atol=1e-6)
    assert np.allclose(cameras.Ks[0], [[60, 0, 32], [0, 61, 24], [0, 0, 1]])
    assert cameras.sizes_wh.tolist() == [[64, 48], [64, 48]]


def test_poses_are_rotations_to_the_last_digit_though_files_hold_float32(folder: Path) -> None:
    angle = 0.3
    turned = metadata((0, np.cos(angle), np.sin(angle)), (0, np.sin(angle), -np.cos(angle)), (-1, 0, 0), (0, 0, 0))
    save(turned, folder / "train" / "metadata" / "000000.pt")
    rotation = read_mill19(folder).cam_from_world[0, :3, :3]
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-14


class _TouchesFile:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple:
        return (Path.touch, (self.path,))


def test_a_file_that_would_run_code_is_refused_and_does_not(folder: Path) -> None:
    save({"W": _TouchesFile(folder / "code-ran")}, folder / "train" / "metadata" / "000000.pt")
    with pytest.raises(BadInput, match=r"000000\.pt is no readable \.pt file"):
        read_mill19(folder)
    assert not (folder / "code-ran").exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"c2w": torch.full((3, 4), torch.nan)}, "c2w.* finite"),
        ({"c2w": torch.ones(3, 4)}, "no rotation"),
        ({"c2w": torch.ones(4, 4)}, "shape"),
        ({"intrinsics": torch.ones(3)}, "intrinsics"),
        ({"W": "wide"}, "numbers under 'W'"),
        ({"H": -3}, "not positive"),
    ],
)
def test_values_that_make_no_camera_are_named(folder: Path, change: dict, told: str) -> None:
    save({**NADIR, **change}, folder / "train" / "metadata" / "000000.pt")
    with pytest.raises(BadInput, match=told):
        read_mill19(folder)


class _NeverUnfolded(list):
    def __iter__(self) -> NoReturn:
        pytest.fail("it was unfolded")


def test_shapes_and_lists_are_counted_before_they_become_numbers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(np, "asarray", lambda *_, **__: pytest.fail("it was converted"))
        with pytest.raises(BadInput, match=r"'a' has shape \(7,\), expected \(\)"):
            mill19._numbers({"a": torch.ones(7)}, "a", (), folder)
    save({"origin_drb": torch.zeros(3), "pose_scale_factor": [[1.0, 2.0], [3.0, 4.0]]}, folder / "coordinates.pt")
    with pytest.raises(BadInput, match=r"coordinates\.pt has no numbers under 'pose_scale_factor'"):
        read_mill19(folder)
    for shape in ((), (2,)):
        with pytest.raises(ValueError, match=r"^$"):
            mill19._of_shape(_NeverUnfolded([1.0, 2.0, 3.0]), shape)


def test_a_deflated_file_is_counted_unpacked(folder: Path) -> None:
    path = folder / "coordinates.pt"
    save({"pose_scale_factor": 1.0, "more": torch.zeros(10**6)}, path)
    with ZipFile(path) as stored:
        parts = {part.filename: stored.read(part) for part in stored.infolist()}
    with ZipFile(path, "w", ZIP_DEFLATED) as packed:
        for name, data in parts.items():
            packed.writestr(name, data)
    assert path.stat().st_size < 20_000
    with pytest.raises(BadInput, match=r"coordinates\.pt unpacks to 40\d{5} bytes, expected metadata of at most"):
        read_mill19(folder)


def test_numbers_may_be_lists_and_tensors_of_one(folder: Path) -> None:
    as_tensors = read_mill19(folder)
    lists = {key: value.tolist() for key, value in NADIR.items() if isinstance(value, torch.Tensor)}
    save({**lists, "W": torch.tensor([64]), "H": torch.tensor([[48]])}, folder / "train" / "metadata" / "000000.pt")
    as_lists = read_mill19(folder)
    assert as_lists.sizes_wh.tolist() == as_tensors.sizes_wh.tolist()
    np.testing.assert_array_equal(as_lists.cam_from_world, as_tensors.cam_from_world)


def test_missing_and_damaged_files_are_named(folder: Path, tmp_path: Path) -> None:
    path = folder / "train" / "metadata" / "000000.pt"
    good = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(60):
        data = bytearray(good)
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        path.write_bytes(data[: rng.integers(len(data) // 2, len(data) + 1)])
        with contextlib.suppress(BadInput):
            assert np.isfinite(read_mill19(folder).centers).all()
    path.write_bytes(good)
    (folder / "train" / "rgbs" / "000000.jpg").unlink()
    with pytest.raises(BadInput, match="has no image"):
        read_mill19(folder)
    (folder / "coordinates.pt").unlink()
    with pytest.raises(BadInput, match=r"coordinates\.pt does not exist"):
        read_mill19(folder)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan")])
def test_a_scale_is_positive(folder: Path, scale: float) -> None:
    save({"origin_drb": torch.zeros(3), "pose_scale_factor": scale}, folder / "coordinates.pt")
    with pytest.raises(BadInput, match="pose_scale_factor"):
        read_mill19(folder)
