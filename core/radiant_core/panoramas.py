"""An equirectangular panorama as pinhole photographs of one rig. Pure geometry.

    pixel from ray   u = w/2 + w · atan2(x, z) / 2π,   v = h/2 + h · asin(y / |ray|) / π

with OpenCV's axes (x right, y down, z forward), which is COLMAP's EQUIRECTANGULAR, OpenSfM's and
Metashape's spherical camera. A face is named `face_WHERE/` and the panorama's name, so that names
alone say which photographs are of one rig: they are matched, judged and held out as one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from radiant_core.numerics import FloatArray

PREFIX = "face_"


@dataclass(frozen=True, kw_only=True, eq=False)
class Face:
    """One camera of the rig: its folder, and cam_from_rig (3,3); all share the rig's centre."""

    folder: str
    cam_from_rig: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceRig:
    """Faces of `fov_deg` across and down, the first of which is the rig's own frame."""

    faces: tuple[Face, ...]
    fov_deg: float

    def size_px(self, panorama_width_px: int) -> int:
        """Side of a face whose middle has the panorama's pixels to the degree at its equator."""
        return max(16, round(panorama_width_px / math.pi * math.tan(math.radians(self.fov_deg) / 2)))

    def K(self, size_px: int) -> FloatArray:
        """The intrinsics (3,3) of a face of that side."""
        f = size_px / 2 / math.tan(math.radians(self.fov_deg) / 2)
        return np.array([[f, 0, size_px / 2], [0, f, size_px / 2], [0, 0, 1]])


def turned_face(where: str, yaw_deg: float, pitch_deg: float) -> Face:
    """A face that looks `yaw_deg` to the right of the middle and `pitch_deg` up; its rows stay
    level, so that what a panorama held upright shows stays upright."""
    yaw, pitch = math.radians(yaw_deg), math.radians(pitch_deg)
    rig_from_yawed = np.array([[math.cos(yaw), 0, math.sin(yaw)], [0, 1, 0], [-math.sin(yaw), 0, math.cos(yaw)]])
    yawed_from_face = np.array([[1, 0, 0], [0, math.cos(pitch), -math.sin(pitch)], [0, math.sin(pitch), math.cos(pitch)]])
    return Face(folder=PREFIX + where, cam_from_rig=(rig_from_yawed @ yawed_from_face).T)


def ring(count: int, fov_deg: float, *, poles: bool = True) -> FaceRig:
    """`count` faces around the horizon, and one up and one down; the cube is four of 90°."""
    turns = [360 * number / count for number in range(count)]
    names = ("front", "right", "back", "left") if count == 4 else tuple(f"{round(turn):03d}" for turn in turns)
    level = [turned_face(name, turn, 0) for name, turn in zip(names, turns, strict=True)]
    ends = [turned_face("up", 0, 90), turned_face("down", 0, -90)] if poles else []
    return FaceRig(faces=(*level, *ends), fov_deg=fov_deg)


RIG = ring(4, 90.0)


def frame_of(name: str) -> str:
    """The panorama that a face was cut from, by its name; any other photograph is a frame of its
    own."""
    folder, slash, remainder = name.partition("/")
    return remainder if slash and folder.startswith(PREFIX) and remainder else name


def has_faces(names: Iterable[str]) -> bool:
    """Whether photographs of these names are cut from panoramas."""
    return any(frame_of(name) != name for name in names)


def pixels_of_rays(rays: FloatArray, size_wh: tuple[int, int]) -> FloatArray:
    """Where a panorama shows rays (…,3): (…,2) px, the first pixel's middle at 0.5."""
    width, height = size_wh
    turn, rise = np.arctan2(rays[..., 0], rays[..., 2]), np.arctan2(rays[..., 1], np.hypot(rays[..., 0], rays[..., 2]))
    return np.stack([width / 2 + width * turn / (2 * math.pi), height / 2 + height * rise / math.pi], axis=-1)


def rays_of_pixels(pixels: FloatArray, size_wh: tuple[int, int]) -> FloatArray:
    """Rays (…,3) of length 1 that a panorama shows at pixels (…,2)."""
    turn = (pixels[..., 0] / size_wh[0] - 0.5) * 2 * math.pi
    rise = (pixels[..., 1] / size_wh[1] - 0.5) * math.pi
    return np.stack([np.sin(turn) * np.cos(rise), np.sin(rise), np.cos(turn) * np.cos(rise)], axis=-1)


def rays_of_face(face: Face, K: FloatArray, size_px: int) -> FloatArray:
    """Rays (S,S,3) in the rig's frame of a face's pixels; z = 1 in the face's own."""
    column, row = np.meshgrid(np.arange(size_px) + 0.5, np.arange(size_px) + 0.5)
    inside = np.stack([(column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones_like(column)], axis=-1)
    return inside @ face.cam_from_rig
