"""The records of a COLMAP model and their checks. Format: https://colmap.github.io/format.html"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, rotmats_from_quats

MAX_SIDE_PX = 1 << 17
MAX_COORDINATE = 1e9
"""Beyond the Earth in metres; squares of it still fit everywhere."""

PARAM_COUNTS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
    "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5,
    "THIN_PRISM_FISHEYE": 12,
    "RAD_TAN_THIN_PRISM_FISHEYE": 16,
    "SIMPLE_DIVISION": 4,
    "DIVISION": 5,
    "SIMPLE_FISHEYE": 3,
    "FISHEYE": 4,
    "EUCM": 6,
    "EQUIRECTANGULAR": 2,
}
"""Number of parameters of each camera model, in the order of COLMAP's model numbers 0, 1, 2, …;
from 12 on those of COLMAP 4."""
PANORAMA = "EQUIRECTANGULAR"
BENT_PINHOLES = ("SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "FOV", "SIMPLE_DIVISION", "DIVISION")
"""Pinholes where everything behind the principal point is 0; fisheyes are none even then."""
MAX_STRAIGHT = 1e-8
"""COLMAP takes a lens with no larger coefficient for straight and leaves its pictures alone."""


@dataclass(frozen=True, kw_only=True)
class ColmapCamera:
    """One set of intrinsics; params in the order of COLMAP's model."""

    camera_id: int
    model: str
    size_wh: tuple[int, int]
    params: tuple[float, ...]

    @property
    def num_focals(self) -> int:
        """How many of `params` are focal lengths: they come first, the principal point follows."""
        if self.model == PANORAMA:
            return 0
        return 1 if self.model.startswith("SIMPLE") or self.model in ("RADIAL", "RADIAL_FISHEYE") else 2

    @property
    def is_pinhole(self) -> bool:
        """Whether the camera has no distortion at all."""
        straight = all(abs(value) <= MAX_STRAIGHT for value in self.params[self.num_focals + 2 :])
        return self.model in ("PINHOLE", "SIMPLE_PINHOLE") or (self.model in BENT_PINHOLES and straight)

    @property
    def K(self) -> FloatArray:
        """Calibration matrix (3,3) px of a pinhole camera; BadInput for another one, which COLMAP's
        undistorter passed through."""
        if not self.is_pinhole:
            raise BadInput(
                f"camera {self.camera_id} of the model is {self.model} without distortion, which COLMAP does not undistort: give it as "
                "PINHOLE if its photographs are straight, or calibrate it again."
            )
        fx, fy, cx, cy = (self.params[0], *self.params)[:4] if self.num_focals == 1 else self.params[:4]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


@dataclass(frozen=True, kw_only=True, eq=False)
class ColmapImage:
    """One posed image: quat_wxyz (4,), translation (3,) of cam_from_world; points2d (K,2) px;
    point3d_ids (K,), -1 for none."""

    image_id: int
    name: str
    camera_id: int
    quat_wxyz: FloatArray
    translation: FloatArray
    points2d: FloatArray
    point3d_ids: NDArray[np.int64]

    @property
    def cam_from_world(self) -> FloatArray:
        """Rigid pose (4,4)."""
        pose = np.eye(4)
        pose[:3, :3] = rotmats_from_quats(self.quat_wxyz[None])[0]
        pose[:3, 3] = self.translation
        return pose


@dataclass(frozen=True, kw_only=True, eq=False)
class ColmapPoints:
    """ids (P,); xyz (P,3); colors (P,3) uint8; errors_px (P,); tracks (T,3): point index, image id,
    index of its 2D point."""

    ids: NDArray[np.int64]
    xyz: FloatArray
    colors: NDArray[np.uint8]
    errors_px: FloatArray
    tracks: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class ColmapModel:
    """A whole model, images in the order of their names."""

    cameras: dict[int, ColmapCamera]
    images: tuple[ColmapImage, ...]
    points: ColmapPoints

    def observations(self) -> NDArray[np.int64]:
        """Who sees what (T,2): point index, image index; a point twice in an image counts once."""
        ids = np.array([image.image_id for image in self.images], dtype=np.int64)
        order = np.argsort(ids)
        image_indices = order[np.searchsorted(ids[order], self.points.tracks[:, 1])]
        return np.unique(np.stack([self.points.tracks[:, 0], image_indices], axis=1), axis=0)

    def without(self, names: Collection[str]) -> ColmapModel:
        """The model without the images of these names; points stay, even those seen by none."""
        images = tuple(image for image in self.images if image.name not in names)
        tracks = self.points.tracks
        tracks = tracks[np.isin(tracks[:, 1], [image.image_id for image in images])]
        return replace(self, images=images, points=replace(self.points, tracks=tracks))


def check_model(
    cameras: list[ColmapCamera], images: list[ColmapImage], points: ColmapPoints, source: str, *, panoramas: bool = False
) -> ColmapModel:
    """The records as one model if they fit each other; BadInput names `source` and a misfit, such
    as a panorama where `panoramas` is False."""
    by_id = {camera.camera_id: camera for camera in cameras}
    _require_unique("camera id", [camera.camera_id for camera in cameras], source)
    _require_unique("image id", [image.image_id for image in images], source)
    _require_unique("image name", [image.name for image in images], source)
    for camera in cameras:
        _check_camera(camera, source)
    for image in images:
        _check_image(image, by_id, source)
        if not panoramas and by_id[image.camera_id].model == PANORAMA:
            raise BadInput(_panorama_text(image, source))
    _check_points(points, images, source)
    return ColmapModel(cameras=by_id, images=tuple(sorted(images, key=lambda image: image.name)), points=points)


def _require_unique(noun: str, values: list, source: str) -> None:
    if len(set(values)) != len(values):
        passed: set = set()
        twice = next(value for value in values if value in passed or passed.add(value))
        raise BadInput(f"{source}: {noun} {twice!r} comes twice: export the model again.")


def is_image_name(name: str) -> bool:
    """Whether a COLMAP model can name an image so: relative, printable, inside its folder."""
    path = PurePosixPath(name)
    return bool(name) and name.isprintable() and "\\" not in name and not path.is_absolute() and ".." not in path.parts


def _check_camera(camera: ColmapCamera, source: str) -> None:
    label = f"{source}: camera {camera.camera_id}"
    if not all(0 < side <= MAX_SIDE_PX for side in camera.size_wh):
        raise BadInput(f"{label} has the size {camera.size_wh[0]} × {camera.size_wh[1]}, expected 1 to {MAX_SIDE_PX} px a side.")
    if not _within(MAX_COORDINATE, np.array(camera.params)) or min(camera.params[: camera.num_focals], default=1) <= 0:
        raise BadInput(f"{label} has the parameters {camera.params}, expected finite numbers under 1e9 and a positive focal length.")


def _check_image(image: ColmapImage, cameras: dict[int, ColmapCamera], source: str) -> None:
    label = f"{source}: image {image.image_id} ({image.name!r})"
    if not is_image_name(image.name):
        raise BadInput(f"{label} has a name that is no relative path inside the image folder: rename the image.")
    if image.camera_id not in cameras:
        raise BadInput(f"{label} names camera {image.camera_id}, which is not in the cameras file: export the model again.")
    pose = np.concatenate([image.quat_wxyz, image.translation])
    if not _within(MAX_COORDINATE, pose, image.points2d):
        raise BadInput(f"{label} has a pose or 2D point that is not finite or beyond {MAX_COORDINATE:g}: export it again.")
    # COLMAP writes unit quaternions with 17 digits; 1 % admits hand-written ones and no garbage.
    if abs(np.linalg.norm(image.quat_wxyz) - 1) > 0.01:
        raise BadInput(f"{label} has a quaternion of length {np.linalg.norm(image.quat_wxyz):.3g}, expected 1.")


def _panorama_text(image: ColmapImage, source: str) -> str:
    return (
        f"{source}: image {image.image_id} ({image.name!r}) is {PANORAMA}, a panorama of 360°, which becomes flat photographs with "
        "--frames shared alone: use that, or give the model of faces that COLMAP's panorama_sfm.py cuts."
    )


def _check_points(points: ColmapPoints, images: list[ColmapImage], source: str) -> None:
    if len(np.unique(points.ids)) != len(points.ids):
        raise BadInput(f"{source}: a point id comes twice in points3D: export the model again.")
    if not _within(MAX_COORDINATE, points.xyz, points.errors_px):
        raise BadInput(f"{source}: a 3D point is not finite or beyond {MAX_COORDINATE:g}: export the model again.")
    num_points2d = {image.image_id: len(image.points2d) for image in images}
    seen_ids = np.unique(points.tracks[:, 1])
    unknown = [int(image_id) for image_id in seen_ids if int(image_id) not in num_points2d]
    if unknown:
        raise BadInput(f"{source}: a track in points3D names image {unknown[0]}, which is not in the images file.")
    limits = np.array([num_points2d[int(image_id)] for image_id in seen_ids], dtype=np.int64)
    limit_of_track = limits[np.searchsorted(seen_ids, points.tracks[:, 1])] if len(seen_ids) else limits
    if ((points.tracks[:, 2] < 0) | (points.tracks[:, 2] >= limit_of_track)).any():
        raise BadInput(f"{source}: a track in points3D names a 2D point that its image does not have: export the model again.")
    for image in images:
        named = image.point3d_ids[image.point3d_ids != -1]
        if not np.isin(named, points.ids).all():
            raise BadInput(f"{source}: image {image.name!r} names a 3D point that is not in points3D: export the model again.")


def _within(limit: float, *arrays: FloatArray) -> bool:
    # Written so that NaN is not within.
    return all(bool((np.abs(array) <= limit).all()) for array in arrays)
