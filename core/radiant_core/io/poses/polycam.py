"""Raw data of Polycam: keyframes/cameras/*.json or corrected_cameras/*.json. Once per source.

    t_00 … t_23   rows of the world from camera (3,4), OpenGL's axes, metres, y up
    fx fy cx cy   px of a picture of width × height

The world is turned so that z is up: (x, y, z) becomes (z, x, y), as nerfstudio does. A file of the
folder stands for all. Source: nerfstudio's polycam_utils.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from radiant_core.io.poses.fields import Fields, read_json_file
from radiant_core.io.poses.lens import Lens
from radiant_core.io.poses.pose_file import GivenWorld, PosedView, PoseFile, SizeOf, nearest_rotation, posed_view

FOLDERS = ("corrected_cameras", "cameras")
"""Of keyframes/, the better first."""
FLIP = np.diag([1.0, -1.0, -1.0])
UPRIGHT = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])


def read_polycam(path: Path, size_of: SizeOf) -> PoseFile:
    """All cameras in the folder of `path`."""
    del size_of
    lenses: dict[Lens, int] = {}
    views = [_view(camera_path, lenses) for camera_path in sorted(path.parent.glob("*.json"))]
    return PoseFile(
        path=path.parent,
        program="Polycam",
        lenses={number: lens for lens, number in lenses.items()},
        views=tuple(views),
        points=np.zeros((0, 3)),
        world=GivenWorld(kind="metres"),
    )


def _view(path: Path, lenses: dict[Lens, int]) -> PosedView:
    camera = Fields(read_json_file(path), str(path))
    pose = np.array([[camera.number(f"t_{row}{column}") for column in range(4)] for row in range(3)])
    lens = Lens(
        size_wh=(camera.whole("width"), camera.whole("height")),
        fx=camera.number("fx"),
        fy=camera.number("fy"),
        cx=camera.number("cx"),
        cy=camera.number("cy"),
    )
    rotation = FLIP @ nearest_rotation(pose[:, :3], f"photograph {path.stem!r}").T @ UPRIGHT.T
    return posed_view(path.stem, lenses.setdefault(lens, len(lenses) + 1), rotation, -rotation @ UPRIGHT @ pose[:, 3])
