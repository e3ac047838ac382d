"""A view as in VTK (position, focal point, up, angle), and as a pinhole camera. Once per frame.

fy = H / (2 tan(angle / 2)), square pixels, middle of the picture at its centre; z forward, y down
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewPose:
    """position, focal_point (3,) in the world, up (3,) of any length, angle_deg over the picture's
    height. BadInput for an undefined direction or upward vector, or an angle outside (0°, 180°)."""

    position: FloatArray
    focal_point: FloatArray
    up: FloatArray
    angle_deg: float

    def __post_init__(self) -> None:
        for name in ("position", "focal_point", "up"):
            object.__setattr__(self, name, check_array(name, getattr(self, name), (3,)))
        if not 0 < self.angle_deg < 180:
            raise BadInput(f"a view has an angle of {self.angle_deg}°, expected more than 0° and less than 180°.")
        if np.linalg.norm(np.cross(self.focal_point - self.position, self.up)) == 0:
            raise BadInput("a view looks along its own upward direction, or at its own position: move the focal point.")

    @property
    def distance(self) -> float:
        """Distance from the position to the focal point."""
        return float(np.linalg.norm(self.focal_point - self.position))

    @property
    def rotation(self) -> FloatArray:
        """Rows (3,3): right, down and forward in the world."""
        forward = (self.focal_point - self.position) / self.distance
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(forward, right), forward])

    def camera(self, size_wh: tuple[int, int]) -> Cameras:
        """Return the pinhole camera of the view for a picture of this size."""
        width, height = size_wh
        focal_px = height / (2 * np.tan(np.radians(self.angle_deg) / 2))
        pose = np.eye(4)
        pose[:3, :3] = self.rotation
        pose[:3, 3] = -self.rotation @ self.position
        K = np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]])
        return Cameras(names=("view",), Ks=K[None], cam_from_world=pose[None], sizes_wh=np.array([[width, height]]))


def camera_pose(cameras: Cameras, index: int, distance: float) -> ViewPose:
    """Return the view of camera `index` with its focal point `distance` ahead and its picture's
    full height in view."""
    rotation = cameras.cam_from_world[index, :3, :3]
    position = cameras.centers[index]
    height = float(cameras.sizes_wh[index, 1])
    angle_deg = float(2 * np.degrees(np.arctan(height / (2 * cameras.Ks[index, 1, 1]))))
    return ViewPose(position=position, focal_point=position + distance * rotation[2], up=-rotation[1], angle_deg=angle_deg)
