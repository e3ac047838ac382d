"""`Cameras`: pinhole cameras with poses, what every stage passes on. C is the number of cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array


@dataclass(frozen=True, kw_only=True, eq=False)
class Cameras:
    """C undistorted cameras, OpenCV's axes (x right, y down, z forward); image corner (0,0).

    The first pixel's centre is (0.5,0.5). names (C) unique; Ks (C,3,3) px, [fx 0 cx; 0 fy cy; 0 0
    1]; cam_from_world (C,4,4) rigid, in metres; sizes_wh (C,2) px. Raises BadInput when shapes
    disagree, a value is not finite, a focal length or size is not positive, a K has another form, a
    name comes twice or a pose is not rigid.

    Example:
        >>> cameras = radiant.load_scene("SCENE").cameras
        >>> first = cameras.select([0]).scaled(64)  # px on the long side
        >>> first.sizes_wh.tolist(), first.centers.shape
        ([[64, 48]], (1, 3))
    """

    names: tuple[str, ...]
    Ks: FloatArray
    cam_from_world: FloatArray
    sizes_wh: NDArray[np.int64]

    def __post_init__(self) -> None:
        names = tuple(self.names)
        count = len(names)
        object.__setattr__(self, "names", names)
        object.__setattr__(self, "Ks", check_array("Ks", self.Ks, (count, 3, 3)))
        object.__setattr__(self, "cam_from_world", check_array("cam_from_world", self.cam_from_world, (count, 4, 4)))
        object.__setattr__(self, "sizes_wh", check_array("sizes_wh", self.sizes_wh, (count, 2), np.int64))
        if len(set(names)) != count:
            twice = next(name for name in names if names.count(name) > 1)
            raise BadInput(f"camera name {twice!r} comes twice: give every photograph its own name.")
        if (self.sizes_wh <= 0).any() or (self.Ks[:, 0, 0] <= 0).any() or (self.Ks[:, 1, 1] <= 0).any():
            raise BadInput("a camera has a width, height or focal length that is not positive: check Ks and sizes_wh.")
        zeros = self.Ks[:, [0, 1, 2, 2], [1, 0, 0, 1]]
        if (zeros != 0).any() or (self.Ks[:, 2, 2] != 1).any():
            raise BadInput("a camera matrix has skew or a last row other than 0 0 1: undistort to pinhole cameras first.")
        _require_rigid(names, self.cam_from_world)

    def __len__(self) -> int:
        return len(self.names)

    def __repr__(self) -> str:
        sizes = sorted({f"{width}×{height}" for width, height in self.sizes_wh.tolist()})
        size_text = ", ".join(sizes) if len(sizes) <= 3 else f"{len(sizes)} sizes"
        return f"Cameras({len(self)}, {size_text} px)"

    @property
    def centers(self) -> FloatArray:
        """Camera centres (C,3) in the world, metres: -R^T t."""
        rotations, translations = self.cam_from_world[:, :3, :3], self.cam_from_world[:, :3, 3]
        return -np.einsum("cji,cj->ci", rotations, translations)

    def select(self, indices: ArrayLike) -> Cameras:
        """The cameras at `indices` (K,) int, in that order, or those of a mask (C,) bool."""
        chosen: NDArray[Any] = np.asarray(indices)
        picked: NDArray[np.int64] = np.arange(len(self))[chosen if chosen.dtype == bool else chosen.astype(np.int64)]
        return Cameras(
            names=tuple(self.names[int(i)] for i in picked),
            Ks=self.Ks[picked],
            cam_from_world=self.cam_from_world[picked],
            sizes_wh=self.sizes_wh[picked],
        )

    def named(self, names: Sequence[str]) -> Cameras:
        """The cameras with these names, in that order; BadInput names the first unknown one."""
        index_of = {name: index for index, name in enumerate(self.names)}
        unknown = [name for name in names if name not in index_of]
        if unknown:
            raise BadInput(f"there is no camera named {unknown[0]!r} among {len(self)}: check the list of names.")
        return self.select([index_of[name] for name in names])

    def any_sees(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether each of the points (P,3) projects into any image; occlusion does not count."""
        points = np.asarray(points, dtype=np.float64)
        is_seen = np.zeros(len(points), bool)
        for K, pose, size_wh in zip(self.Ks, self.cam_from_world, self.sizes_wh, strict=True):
            in_camera = points @ pose[:3, :3].T + pose[:3, 3]
            in_front = in_camera[:, 2] > 0
            pixels = (in_camera @ K.T)[:, :2] / np.where(in_front, in_camera[:, 2], 1.0)[:, None]
            is_seen |= in_front & ((pixels > 0) & (pixels < size_wh)).all(axis=1)
        return is_seen

    def scaled(self, long_side_px: int) -> Cameras:
        """The same cameras with images of at most `long_side_px` on the long side; not enlarged."""
        factors = np.minimum(1.0, long_side_px / self.sizes_wh.max(axis=1, initial=1))
        sizes_wh = np.maximum(1, np.rint(self.sizes_wh * factors[:, None])).astype(np.int64)
        ratios = sizes_wh / self.sizes_wh
        Ks = self.Ks.copy()
        Ks[:, 0, :] *= ratios[:, :1]
        Ks[:, 1, :] *= ratios[:, 1:]
        return Cameras(names=self.names, Ks=Ks, cam_from_world=self.cam_from_world, sizes_wh=sizes_wh)


def concatenate_cameras(parts: Sequence[Cameras]) -> Cameras:
    """All cameras of `parts` in order; BadInput when a name comes twice."""
    return Cameras(
        names=tuple(name for part in parts for name in part.names),
        Ks=np.concatenate([part.Ks for part in parts]) if parts else np.zeros((0, 3, 3)),
        cam_from_world=np.concatenate([part.cam_from_world for part in parts]) if parts else np.zeros((0, 4, 4)),
        sizes_wh=np.concatenate([part.sizes_wh for part in parts]) if parts else np.zeros((0, 2), np.int64),
    )


def number_cameras(cameras: Cameras, prefix: str) -> Cameras:
    """The same cameras named prefix/0000, prefix/0001, …: file names are their owner's business."""
    return replace(cameras, names=tuple(f"{prefix}/{index:04d}" for index in range(len(cameras))))


def _require_rigid(names: tuple[str, ...], cam_from_world: FloatArray) -> None:
    rotations = cam_from_world[:, :3, :3]
    # A rotation's entries are at most 1; huge ones would overflow to NaN, which passes any test.
    rotations = np.clip(rotations, -10, 10)
    residual = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    # 1e-4: float32 poses from files keep 1e-6; a mirrored, scaled or transposed pose is far off.
    last_row_off = np.abs(cam_from_world[:, 3] - (0, 0, 0, 1)).max(axis=1, initial=0) > 1e-9
    bad = (residual > 1e-4) | (np.linalg.det(rotations) < 0) | last_row_off
    if bad.any():
        name = names[int(np.argmax(bad))]
        raise BadInput(f"the pose of camera {name!r} is not rigid (a rotation and a translation): check cam_from_world.")


NO_CAMERAS = concatenate_cameras([])
