"""Cameras: what is the same after selecting, joining and scaling, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import rotmats_from_quats


def some_cameras(count: int = 6, prefix: str = "a") -> Cameras:
    rng = np.random.default_rng(count)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = rotmats_from_quats(rng.normal(size=(count, 4)))
    poses[:, :3, 3] = rng.normal(size=(count, 3)) * 100
    sizes_wh = rng.integers(100, 5000, (count, 2))
    Ks = np.tile(np.eye(3), (count, 1, 1))
    Ks[:, [0, 1], [0, 1]] = rng.uniform(500, 900, (count, 2))
    Ks[:, :2, 2] = sizes_wh / 2 + rng.normal(size=(count, 2))
    return Cameras(names=tuple(f"{prefix}{i}" for i in range(count)), Ks=Ks, cam_from_world=poses, sizes_wh=sizes_wh)


def fields_of(cameras: Cameras) -> dict[str, Any]:
    return {name: getattr(cameras, name) for name in ("names", "Ks", "cam_from_world", "sizes_wh")}


def same(a: Cameras, b: Cameras) -> bool:
    return all(np.array_equal(fields_of(a)[name], fields_of(b)[name]) for name in fields_of(a))


def test_the_centre_is_the_point_that_a_camera_sees_at_zero() -> None:
    cameras = some_cameras()
    homogeneous = np.hstack([cameras.centers, np.ones((len(cameras), 1))])
    seen = np.einsum("cij,cj->ci", cameras.cam_from_world, homogeneous)
    np.testing.assert_allclose(seen[:, :3], 0, atol=1e-10)  # coordinates of some 100 m in float64


@pytest.mark.parametrize("long_side_px", [1, 7, 100, 640, 10**6])
def test_scaled_cameras_see_every_point_at_the_same_place_of_the_image(long_side_px: int) -> None:
    cameras = some_cameras()
    scaled = cameras.scaled(long_side_px)
    directions = np.array([[0.1, -0.2, 1.0], [0.0, 0.0, 1.0], [-0.4, 0.3, 1.0]])
    for index in range(len(cameras)):
        place = (directions @ cameras.Ks[index].T)[:, :2] / cameras.sizes_wh[index]
        scaled_place = (directions @ scaled.Ks[index].T)[:, :2] / scaled.sizes_wh[index]
        # Fractions of the image near 1, float64.
        np.testing.assert_allclose(scaled_place, place, atol=1e-12)


@pytest.mark.parametrize("long_side_px", [1, 7, 100, 640, 10**6])
def test_scaling_never_enlarges_and_keeps_the_long_side(long_side_px: int) -> None:
    cameras = some_cameras()
    sizes_wh = cameras.scaled(long_side_px).sizes_wh
    assert (sizes_wh <= cameras.sizes_wh).all()
    assert (sizes_wh.max(axis=1) == np.minimum(cameras.sizes_wh.max(axis=1), long_side_px)).all()
    assert (sizes_wh >= 1).all()


def test_parts_of_cameras_joined_again_are_the_whole() -> None:
    cameras = some_cameras()
    assert same(concatenate_cameras([cameras.select([0, 1]), cameras.select([]), cameras.select(np.arange(2, 6))]), cameras)
    assert len(concatenate_cameras([])) == 0


def test_a_mask_selects_what_its_indices_select() -> None:
    cameras = some_cameras()
    mask = np.array([False, True, True, False, False, True])
    assert same(cameras.select(mask), cameras.select(np.flatnonzero(mask)))


def test_names_select_in_their_order() -> None:
    assert some_cameras().named(["a3", "a0"]).names == ("a3", "a0")
    with pytest.raises(BadInput, match="no camera named 'b'"):
        some_cameras().named(["a3", "b"])


def test_joining_a_name_twice_is_refused() -> None:
    with pytest.raises(BadInput, match="'a0' comes twice"):
        concatenate_cameras([some_cameras(), some_cameras()])


def changed(name: str, index: tuple[int, ...], value: float) -> dict[str, Any]:
    array = np.array(fields_of(some_cameras())[name], dtype=np.float64)
    array[index] = value
    return {name: array}


@pytest.mark.parametrize(
    "wrong",
    [
        {"names": ("a0",) * 6},
        {"names": ("a0",)},
        changed("Ks", (2, 0, 0), np.nan),
        changed("Ks", (2, 0, 0), 0.0),
        changed("Ks", (2, 1, 1), -500.0),
        changed("Ks", (2, 0, 1), 0.1),
        changed("Ks", (2, 2, 2), 2.0),
        changed("sizes_wh", (0, 1), 0),
        changed("sizes_wh", (0, 1), 10.5),
        changed("cam_from_world", (1, 0, 3), np.inf),
        changed("cam_from_world", (1, 0, 0), 2.0),
        changed("cam_from_world", (1, 0, 0), 1e300),
        changed("cam_from_world", (1, 3, 3), 2.0),
        {"cam_from_world": -np.tile(np.eye(4), (6, 1, 1))},
        {"cam_from_world": np.tile(np.diag([1.0, 1.0, -1.0, 1.0]), (6, 1, 1))},
    ],
)
def test_what_is_no_pinhole_camera_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        Cameras(**{**fields_of(some_cameras()), **wrong})
