"""`PoseFile`: what a reader makes of another program's alignment. Once per source.

Whatever a file counts in, here poses are cam_from_world with OpenCV's axes (x right, y down, z
forward), pixels have the first one's middle at (0.5, 0.5), and the world is the file's own, in
float64. `GivenWorld` says what that is: a place on the earth, metres, or nothing that is known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.io.colmap.image_files import ImageFiles
from radiant_core.io.colmap.records import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints, check_model
from radiant_core.io.poses.lens import Lens
from radiant_core.numerics import FloatArray, check_array

MAX_TILT = 1e-3
"""How far from a rotation the columns of a file's matrix may be: six printed digits keep 1e-6."""
SizeOf = Callable[[str], tuple[int, int] | None]
"""Size in px of the photograph that a file names so; None where there is none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenWorld:
    """What a file's coordinates are.

    unknown: any unit, up is not known. metres: metres, z up, no known place. enu: metres east,
    north, up of `origin_lat_lon_alt`. ecef: WGS84 geocentric metres. crs: east, north, up in `crs`.
    """

    kind: Literal["unknown", "metres", "enu", "ecef", "crs"] = "unknown"
    origin_lat_lon_alt: tuple[float, float, float] | None = None
    crs: str | None = None

    @property
    def title(self) -> str:
        """For messages."""
        if self.kind == "enu":
            assert self.origin_lat_lon_alt is not None
            return "metres east, north, up of latitude {:.6f}, longitude {:.6f}, height {:.2f}".format(*self.origin_lat_lon_alt)
        names = {"unknown": "its own unit", "metres": "metres, z up", "ecef": "EPSG:4978 (ECEF)", "crs": self.crs or ""}
        return names[self.kind]


UNKNOWN_WORLD = GivenWorld()


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedView:
    """One photograph: its name in the file, its lens, cam_from_world (4,4), and what it sees:
    pixels (K,2) of rows (K,) of the file's points."""

    name: str
    lens_id: int
    cam_from_world: FloatArray
    pixels: FloatArray
    point_rows: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseFile:
    """An alignment; points (P,3), colors (P,3) uint8 or None where the file has none."""

    path: Path
    program: str
    lenses: dict[int, Lens]
    views: tuple[PosedView, ...]
    points: FloatArray
    colors: NDArray[np.uint8] | None = None
    world: GivenWorld = UNKNOWN_WORLD
    notes: tuple[str, ...] = ()
    """What of the file is not used, or is taken for another."""

    @property
    def title(self) -> str:
        """How messages name it."""
        folder = "sparse/" if self.path.parent.name == "sparse" else ""
        return f"{folder}{self.path.name} of {self.program}"

    @property
    def num_seen(self) -> int:
        """How many observations it has."""
        return sum(len(view.point_rows) for view in self.views)

    def named(self, files: ImageFiles) -> PoseFile:
        """The same with the names of the photographs' files, in their order."""
        views = [replace(view, name=files.files[view.name]) for view in self.views]
        return replace(self, views=tuple(sorted(views, key=lambda view: view.name)))

    def model(self) -> ColmapModel:
        """A COLMAP model; a lens that COLMAP has no model for is a pinhole of its focal length.
        Raises BadInput where records do not fit each other."""
        cameras = [lens.camera(number) or straight_camera(number, lens) for number, lens in sorted(self.lenses.items())]
        tracks = [
            np.column_stack([view.point_rows, np.full(len(view.point_rows), number), np.arange(len(view.point_rows))])
            for number, view in enumerate(self.views, 1)
        ]
        joined = np.concatenate([*tracks, np.zeros((0, 3))]).astype(np.int64)
        ids = np.arange(1, len(self.points) + 1)
        colors = np.full((len(ids), 3), 128, np.uint8) if self.colors is None else self.colors
        points = ColmapPoints(
            ids=ids,
            xyz=self.points,
            colors=colors,
            errors_px=np.zeros(len(ids)),
            tracks=joined[np.argsort(joined[:, 0], kind="stable")],
        )
        images = [_image(number, view) for number, view in enumerate(self.views, 1)]
        return check_model(cameras, images, points, str(self.path))


def straight_camera(camera_id: int, lens: Lens) -> ColmapCamera:
    """The pinhole with the focal length and principal point of a lens."""
    return ColmapCamera(camera_id=camera_id, model="PINHOLE", size_wh=lens.size_wh, params=(lens.fx, lens.fy, lens.cx, lens.cy))


def posed_view(
    name: str, lens_id: int, rotation: FloatArray, translation: FloatArray, observations: tuple[FloatArray, NDArray[np.int64]] | None = None
) -> PosedView:
    """A view from x_cam = R x_world + t; `observations`: pixels (K,2), rows (K,) of points. Raises
    BadInput where R is no rotation or a number is not finite."""
    pose = np.eye(4)
    pose[:3, :3] = nearest_rotation(rotation, f"photograph {name!r}")
    pose[:3, 3] = check_array(f"the translation of {name!r}", translation, (3,))
    pixels, rows = (np.zeros((0, 2)), np.zeros(0, np.int64)) if observations is None else observations
    return PosedView(name=name, lens_id=lens_id, cam_from_world=pose, pixels=pixels, point_rows=rows)


def views_of(model: ColmapModel) -> tuple[PosedView, ...]:
    """The images of a COLMAP model, with what they see of its points."""
    order = np.argsort(model.points.ids)
    views = []
    for image in model.images:
        has_point = image.point3d_ids != -1
        rows = order[np.searchsorted(model.points.ids[order], image.point3d_ids[has_point])] if len(order) else np.zeros(0, np.int64)
        views.append(
            PosedView(
                name=image.name,
                lens_id=image.camera_id,
                cam_from_world=image.cam_from_world,
                pixels=image.points2d[has_point],
                point_rows=rows,
            )
        )
    return tuple(views)


def nearest_rotation(matrix: FloatArray, subject: str) -> FloatArray:
    """The rotation (3,3) that a file printed to few digits; BadInput where it is none."""
    matrix = check_array(f"the rotation of {subject}", matrix, (3, 3))
    if not (np.abs(matrix) <= 2).all() or np.abs(matrix @ matrix.T - np.eye(3)).max() > MAX_TILT or np.linalg.det(matrix) < 0:
        raise BadInput(f"the pose of {subject} is no rotation (scaled, mirrored or of another order): export it again.")
    U, _, Vt = np.linalg.svd(matrix)
    return U @ Vt


def _image(number: int, view: PosedView) -> ColmapImage:
    x, y, z, w = Rotation.from_matrix(view.cam_from_world[:3, :3]).as_quat()
    return ColmapImage(
        image_id=number,
        name=view.name,
        camera_id=view.lens_id,
        quat_wxyz=np.array([w, x, y, z]),
        translation=view.cam_from_world[:3, 3],
        points2d=view.pixels,
        point3d_ids=view.point_rows + 1,
    )
