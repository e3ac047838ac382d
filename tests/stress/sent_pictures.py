"""The pictures that an edge of a finished run sent to the cloud, compared with the photograph whose camera is nearest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.evaluate.image_error import psnr_db
from radiant_core.io.messages import VIRTUAL_CAMERAS, VIRTUAL_VIEWS
from radiant_core.io.records import load_cameras, load_scene
from radiant_core.io.run_store import read_json
from radiant_core.io.view_file import load_views
from radiant_core.train.photographs import load_images


@dataclass(frozen=True, kw_only=True)
class SentPictures:
    """Per photograph (V,): PSNR of the nearest picture, and distance and angle between the two cameras."""

    psnr_db: NDArray[np.float64]
    moved_m: NDArray[np.float64]
    turned_deg: NDArray[np.float64]


def sent_pictures(run: Path, edge: str, devices: list[str], long_side_px: int) -> SentPictures | None:
    """Compare what `edge` sent with the photographs of its `devices`; None where it sent no pictures."""
    inbox = run / "cloud" / "inbox" / edge
    virtual = load_cameras(inbox / VIRTUAL_CAMERAS).scaled(long_side_px)
    if not (inbox / VIRTUAL_VIEWS).is_file():
        return None
    pictures = load_views(inbox / VIRTUAL_VIEWS, [(int(width), int(height)) for width, height in virtual.sizes_wh])
    rows: list[tuple[float, float, float]] = []
    for name in devices if pictures else ():
        device = run / "devices" / name
        cameras = load_scene(device / "scene.safetensors").cameras.scaled(long_side_px)
        distances_m = np.linalg.norm(cameras.centers[:, None] - virtual.centers, axis=2)
        # The photographs lie in the device's folder, or where a note in it says.
        note = device / "own.json"
        folder = Path(read_json(note, ("images",))["images"]) if note.is_file() else device / "photos"
        for row, photograph in enumerate(load_images(folder, cameras)):
            near = int(distances_m[row].argmin())
            turn = cameras.cam_from_world[row, :3, :3] @ virtual.cam_from_world[near, :3, :3].T
            angle_deg = float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(turn - np.eye(3)) / np.sqrt(8)))))
            shown = cv2.resize(pictures[near][0], (photograph.shape[1], photograph.shape[0]))
            rows.append((psnr_db(np.asarray(shown) / 255, photograph / 255), float(distances_m[row, near]), angle_deg))
    if not rows:
        return None
    psnrs_db, moved_m, turned_deg = np.array(rows).T
    return SentPictures(psnr_db=psnrs_db, moved_m=moved_m, turned_deg=turned_deg)
