"""`SfmScene`: what structure from motion gives, cameras and sparse points in one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.numerics import FloatArray, check_array


@dataclass(frozen=True, kw_only=True, eq=False)
class SfmScene:
    """C cameras, P points and which camera sees which point.

    points (P,3) in the frame's unit, float64; colors (P,3) uint8; observations (T,2): point index,
    camera index. Raises BadInput when shapes disagree or an observation points outside.
    """

    cameras: Cameras
    points: FloatArray
    colors: NDArray[np.uint8]
    observations: NDArray[np.int64]
    frame: Frame

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", check_array("points", self.points, (None, 3)))
        object.__setattr__(self, "colors", check_array("colors", self.colors, (len(self.points), 3), np.uint8))
        object.__setattr__(self, "observations", check_array("observations", self.observations, (None, 2), np.int64))
        limits = (len(self.points), len(self.cameras))
        if len(self.observations) and ((self.observations < 0) | (self.observations >= limits)).any():
            raise BadInput("an observation names a point or camera that is not there: check the indices of `observations`.")

    def __repr__(self) -> str:
        return f"SfmScene({len(self.cameras)} cameras, {len(self.points):,} points, {self.frame.kind})"

    def seen_by(self, camera_indices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Sorted indices (K,) of the points that at least one of these cameras observes."""
        selected = np.isin(self.observations[:, 1], camera_indices)
        return np.unique(self.observations[selected, 0])

    def points_of_cameras(self) -> list[NDArray[np.int64]]:
        """The points (K,) that each of the C cameras observes, in the order of `observations`."""
        view = self.observations[:, 1]
        ends = np.cumsum(np.bincount(view, minlength=len(self.cameras)))
        return np.split(self.observations[np.argsort(view, kind="stable"), 0], ends[:-1])

    def observed_pixels(self, cameras: Cameras) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows (K,) of `observations` whose point projects into its image, and that pixel (K,2) as
        column and row; `cameras` are the scene's in the same order, at any resolution."""
        point, view = self.observations[:, 0], self.observations[:, 1]
        in_camera = np.einsum("tij,tj->ti", cameras.cam_from_world[view, :3, :3], self.points[point]) + cameras.cam_from_world[view, :3, 3]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            pixels = np.einsum("tij,tj->ti", cameras.Ks[view], in_camera)[:, :2] / in_camera[:, 2:]
        inside = (in_camera[:, 2] > 0) & (pixels >= 0).all(axis=1) & (pixels < cameras.sizes_wh[view]).all(axis=1)
        return np.flatnonzero(inside), pixels[inside].astype(np.int64)

    def restricted_to(self, camera_indices: NDArray[np.int64]) -> SfmScene:
        """The scene as these cameras (K,) know it: they, their points and their observations."""
        points = self.seen_by(camera_indices)
        new_point = np.full(len(self.points), -1)
        new_point[points] = np.arange(len(points))
        new_camera = np.full(len(self.cameras), -1)
        new_camera[camera_indices] = np.arange(len(camera_indices))
        observations = self.observations[np.isin(self.observations[:, 1], camera_indices)]
        return SfmScene(
            cameras=self.cameras.select(camera_indices),
            points=self.points[points],
            colors=self.colors[points],
            observations=np.stack([new_point[observations[:, 0]], new_camera[observations[:, 1]]], axis=1),
            frame=self.frame,
        )
