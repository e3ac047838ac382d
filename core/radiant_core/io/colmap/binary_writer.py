"""A COLMAP model as its three binary files, which every COLMAP loader opens. Once per export.

Rigs and frames, which COLMAP writes since 3.12, are made by it where a model has none.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from radiant_core.io.colmap.binary import MODEL_NUMBERS, POINT2D, POINT3D, TRACK_ENTRY
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.run_store import write_atomic


def write_binary_model(folder: Path, model: ColmapModel) -> None:
    """Write cameras.bin, images.bin and points3D.bin into `folder`, each atomically; raises as
    `write_atomic`."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras = [
        struct.pack("<IiQQ", camera.camera_id, MODEL_NUMBERS[camera.model], *camera.size_wh)
        + struct.pack(f"<{len(camera.params)}d", *camera.params)
        for camera in model.cameras.values()
    ]
    _write(folder / "cameras.bin", cameras)
    images = []
    for image in model.images:
        records = np.empty(len(image.points2d), POINT2D)
        records["xy"], records["point3d_id"] = image.points2d, image.point3d_ids
        head = struct.pack("<I7dI", image.image_id, *image.quat_wxyz, *image.translation, image.camera_id)
        images.append(b"".join((head, image.name.encode(), b"\0", struct.pack("<Q", len(records)), records.tobytes())))
    _write(folder / "images.bin", images)
    points = model.points
    lengths = np.bincount(points.tracks[:, 0], minlength=len(points.ids))
    rows = np.empty(len(points.ids), POINT3D)
    rows["id"], rows["xyz"], rows["color"] = points.ids, points.xyz, points.colors
    rows["error_px"], rows["num_seen"] = points.errors_px, lengths
    tracks = np.empty(len(points.tracks), TRACK_ENTRY)
    tracks["image_id"], tracks["index"] = points.tracks[:, 1], points.tracks[:, 2]
    ends = np.cumsum(lengths)
    _write(folder / "points3D.bin", [rows[k].tobytes() + tracks[ends[k] - lengths[k] : ends[k]].tobytes() for k in range(len(rows))])


def _write(path: Path, records: list[bytes]) -> None:
    write_atomic(path, struct.pack("<Q", len(records)) + b"".join(records))
