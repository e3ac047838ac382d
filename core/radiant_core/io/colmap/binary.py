"""The binary files of a COLMAP model as records; counts are checked against the bytes left."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.io.colmap.records import PARAM_COUNTS, ColmapCamera, ColmapImage, ColmapPoints

SUFFIX = ".bin"
_MAX_NAME_BYTES = 1024
_MODELS = tuple(PARAM_COUNTS.items())
MODEL_NUMBERS = {model: number for number, model in enumerate(PARAM_COUNTS)}
_MIN_CAMERA_BYTES = 24 + 8 * min(PARAM_COUNTS.values())
POINT2D = np.dtype([("xy", "<f8", 2), ("point3d_id", "<i8")])
POINT3D = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("color", "u1", 3), ("error_px", "<f8"), ("num_seen", "<u8")])
TRACK_ENTRY = np.dtype([("image_id", "<u4"), ("index", "<u4")])


@dataclass
class _Cursor:
    """A place in the bytes of a file; reading past the end is a BadInput that names the place."""

    data: bytes
    path: str
    offset: int = 0

    def take(self, layout: str) -> tuple:
        """The numbers of a `struct` layout, moving on."""
        self.require(struct.calcsize(layout), "a record")
        values = struct.unpack_from(layout, self.data, self.offset)
        self.offset += struct.calcsize(layout)
        return values

    def count(self, min_record_bytes: int, noun: str) -> int:
        """A 64-bit count of records that each need at least `min_record_bytes`."""
        (count,) = self.take("<Q")
        self.require(count * min_record_bytes, f"{count} {noun}")
        return count

    def require(self, num_bytes: int, noun: str) -> None:
        """Raise BadInput unless `num_bytes` are left."""
        num_left = len(self.data) - self.offset
        if num_bytes > num_left:
            raise BadInput(
                f"{self.path} at byte {self.offset}: {noun} need {num_bytes} bytes, {num_left} are left: the file is cut or damaged."
            )

    def require_end(self) -> None:
        """Raise BadInput when bytes follow the last record."""
        if self.offset != len(self.data):
            raise BadInput(f"{self.path} at byte {self.offset}: {len(self.data) - self.offset} bytes follow the last record.")

    def text(self) -> str:
        """A name up to its zero byte."""
        end = self.data.find(b"\0", self.offset, self.offset + _MAX_NAME_BYTES)
        if end == -1:
            raise BadInput(f"{self.path} at byte {self.offset}: an image name does not end within {_MAX_NAME_BYTES} bytes.")
        try:
            name = self.data[self.offset : end].decode("utf-8")
        except UnicodeDecodeError:
            raise BadInput(f"{self.path} at byte {self.offset}: an image name is not UTF-8.") from None
        self.offset = end + 1
        return name


def parse_cameras(data: bytes, path: str) -> list[ColmapCamera]:
    """The records of cameras.bin; BadInput with the byte offset."""
    cursor = _Cursor(data, path)
    cameras = []
    for _ in range(cursor.count(_MIN_CAMERA_BYTES, "cameras")):
        camera_id, model_number, width, height = cursor.take("<IiQQ")
        if not 0 <= model_number < len(_MODELS):
            raise BadInput(
                f"{path} at byte {cursor.offset - 20}: camera model {model_number} is unknown, expected 0 to {len(_MODELS) - 1}."
            )
        model, num_params = _MODELS[model_number]
        params = cursor.take(f"<{num_params}d")
        cameras.append(ColmapCamera(camera_id=camera_id, model=model, size_wh=(width, height), params=params))
    cursor.require_end()
    return cameras


def parse_images(data: bytes, path: str) -> list[ColmapImage]:
    """The records of images.bin; BadInput with the byte offset."""
    cursor = _Cursor(data, path)
    images = []
    for _ in range(cursor.count(73, "images")):
        image_id, *pose, camera_id = cursor.take("<I7dI")
        name = cursor.text()
        num_points2d = cursor.count(POINT2D.itemsize, "2D points")
        rows = np.frombuffer(cursor.data, POINT2D, num_points2d, cursor.offset)
        cursor.offset += rows.nbytes
        images.append(
            ColmapImage(
                image_id=image_id,
                name=name,
                camera_id=camera_id,
                quat_wxyz=np.array(pose[:4]),
                translation=np.array(pose[4:]),
                points2d=rows["xy"].astype(np.float64),
                point3d_ids=rows["point3d_id"].astype(np.int64),
            )
        )
    cursor.require_end()
    return images


def parse_points(data: bytes, path: str) -> ColmapPoints:
    """The records of points3D.bin; BadInput with the byte offset. Numpy gathers the values."""
    cursor = _Cursor(data, path)
    count = cursor.count(POINT3D.itemsize, "points")
    starts, num_seen = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for index in range(count):
        starts[index] = cursor.offset
        cursor.offset += POINT3D.itemsize - 8
        num_seen[index] = length = cursor.count(TRACK_ENTRY.itemsize, "track entries")
        cursor.offset += length * TRACK_ENTRY.itemsize
    cursor.require_end()
    rows = _gather(data, starts, POINT3D)
    entry = np.arange(num_seen.sum()) - np.repeat(np.cumsum(num_seen) - num_seen, num_seen)
    entries = _gather(data, np.repeat(starts + POINT3D.itemsize, num_seen) + entry * TRACK_ENTRY.itemsize, TRACK_ENTRY)
    if count and rows["id"].max() > np.iinfo(np.int64).max:
        raise BadInput(f"{path}: a point id exceeds 2^63: export the model again.")
    return ColmapPoints(
        ids=rows["id"].astype(np.int64),
        xyz=rows["xyz"].astype(np.float64),
        colors=rows["color"].copy(),
        errors_px=rows["error_px"].astype(np.float64),
        tracks=np.stack([np.repeat(np.arange(count), num_seen), entries["image_id"], entries["index"]], axis=1).astype(np.int64),
    )


def _gather(data: bytes, starts: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """The records (n,) of `dtype` that begin at the byte offsets `starts` (n,)."""
    octets = np.frombuffer(data, np.uint8)
    return octets[starts[:, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]
