"""Panoramas as pinhole photographs of one rig, in a folder. Once per source.

    FOLDER/rig_config.json                  the rig as COLMAP reads it (rig_configurator)
    FOLDER/faces.json                       what the faces were made from
    FOLDER/face_front/NAME.jpg …            the faces of a panorama, with its position

What is there of the same panoramas is not made again: a job that was interrupted goes on.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput, RadiantError
from radiant_core.io.film.exif import with_position
from radiant_core.io.photos.facts import read_exif_of
from radiant_core.io.photos.listing import MAX_FILE_BYTES, decode_image, photograph_size_wh
from radiant_core.io.photos.masks import load_mask, mask_name, save_mask
from radiant_core.io.photos.samples import sample_kind
from radiant_core.io.run_store import content_key, read_bounded, read_json, write_atomic, write_json
from radiant_core.panoramas import RIG, Face, FaceRig, pixels_of_rays, rays_of_face

RECORD, RIG_CONFIG = "faces.json", "rig_config.json"
JPEG_QUALITY = 95
FORM = 1
"""Of the faces; another one makes all anew."""
MARGIN_PX = 4
"""What is put around a panorama for the pixels that interpolation takes beyond its sides."""
OnDone = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class CutFaces:
    """The folder of the faces, their side in px, and the rig that they are of."""

    folder: Path
    size_px: int
    rig: FaceRig = RIG

    @property
    def K(self) -> NDArray[np.float64]:
        """The intrinsics (3,3) of every face."""
        return self.rig.K(self.size_px)

    def decision(self, num_panoramas: int, *, forced: bool) -> Decision:
        """How many faces a panorama has, and why."""
        return Decision(
            stage="sfm",
            topic="panoramas",
            choice=f"{num_panoramas} panoramas as {len(self.rig.faces)} faces each, of {self.rig.fov_deg:g}° and {self.size_px} px",
            figure=float(num_panoramas * len(self.rig.faces)),
            unit="photographs",
            reason="a cube shows the sphere once; more faces or wider ones place it no better (docs/begun_elsewhere.md)",
            forced=forced,
        )


def cut_panoramas(photo_folder: Path, names: Sequence[str], folder: Path, on_done: OnDone, rig: FaceRig = RIG) -> CutFaces:
    """Write the faces of the panoramas `names` of `photo_folder` into `folder`, all of one size.

    Raises BadInput where one cannot be decoded, is no 8-bit picture, or two have one face's name.
    """
    _require_names(names)
    sizes = {name: photograph_size_wh(photo_folder / name) for name in names}
    unread = next((name for name, size_wh in sizes.items() if size_wh is None), None)
    if unread is not None:
        raise BadInput(f"the panorama {photo_folder / unread} cannot be read: save it again as JPEG, or remove it.")
    size_px = rig.size_px(max(size_wh[0] for size_wh in sizes.values() if size_wh is not None))
    status = [[name, (photo_folder / name).stat().st_size, (photo_folder / name).stat().st_mtime_ns] for name in names]
    key = content_key(FORM, size_px, rig.fov_deg, [[face.folder, face.cam_from_rig.tolist()] for face in rig.faces], status)
    if not _is_record(folder, key):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        write_json(folder / RIG_CONFIG, rig_config(rig, size_px))
        write_json(folder / RECORD, {"key": key})
    for num_done, name in enumerate(names, 1):
        _cut(photo_folder / name, name, folder, size_px, rig)
        on_done(num_done, len(names))
    return CutFaces(folder=folder, size_px=size_px, rig=rig)


def cut_masks(masks: Mapping[str, Path], sizes_wh: Mapping[str, tuple[int, int]], folder: Path, faces: CutFaces) -> None:
    """Write the faces of panoramas' masks into `folder`; a face without a used pixel has a mask of
    one, since a mask that leaves nothing is refused. Raises BadInput as `load_mask`."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, path in masks.items():
        used = load_mask(path, sizes_wh[name]).astype(np.uint8)
        for face in faces.rig.faces:
            columns, rows = _sources(face, faces.size_px, faces.rig, sizes_wh[name])
            is_used = cv2.remap(_framed(used), columns, rows, cv2.INTER_NEAREST) > 0
            is_used[0, 0] |= not is_used.any()
            save_mask(folder / mask_name(face_name(face.folder, name)), is_used)


def face_name(face_folder: str, name: str) -> str:
    """Where a panorama's face lies in the folder of faces."""
    return f"{face_folder}/{name}" if name.lower().endswith((".jpg", ".jpeg")) else f"{face_folder}/{name}.jpg"


def rig_config(rig: FaceRig, size_px: int) -> list[dict[str, Any]]:
    """COLMAP's description of the rig; its cameras' lenses are the faces' own."""
    K = rig.K(size_px)
    cameras: list[dict[str, Any]] = []
    for number, face in enumerate(rig.faces):
        x, y, z, w = Rotation.from_matrix(face.cam_from_rig).as_quat().tolist()
        place = {"ref_sensor": True} if number == 0 else {"cam_from_rig_rotation": [w, x, y, z], "cam_from_rig_translation": [0, 0, 0]}
        lens = {"camera_model_name": "PINHOLE", "camera_params": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]}
        cameras.append({"image_prefix": f"{face.folder}/", **place, **lens})
    return [{"cameras": cameras}]


def _require_names(names: Sequence[str]) -> None:
    panorama_of_face: dict[str, str] = {}
    for name in names:
        panorama = panorama_of_face.setdefault(face_name("", name).casefold(), name)
        if panorama != name:
            raise BadInput(f"the panoramas {panorama} and {name} would have faces of one name: rename one.")


def _is_record(folder: Path, key: str) -> bool:
    try:
        return read_json(folder / RECORD, ("key",))["key"] == key and (folder / RIG_CONFIG).is_file()
    except RadiantError:
        return False


def _cut(path: Path, name: str, folder: Path, size_px: int, rig: FaceRig) -> None:
    """Write the faces of one panorama that are not there yet."""
    missing = [face for face in rig.faces if not (folder / face_name(face.folder, name)).is_file()]
    if not missing:
        return
    data = read_bounded(path, MAX_FILE_BYTES)
    if not sample_kind(data).is_plain:
        raise BadInput(f"the panorama {path} has more than 8 bits a channel, expected 8: save it so, all by one stretch.")
    pixels = decode_image(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if pixels is None:
        raise BadInput(f"the panorama {path} is not whole or cannot be decoded: remove it or fetch it again.")
    position = read_exif_of(path, MAX_FILE_BYTES).lat_lon_alt
    framed = _framed(pixels)
    for face in missing:
        columns, rows = _sources(face, size_px, rig, (pixels.shape[1], pixels.shape[0]))
        cut = cv2.remap(framed, columns, rows, cv2.INTER_CUBIC)
        _, encoded = cv2.imencode(".jpg", cut, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        jpeg = encoded.tobytes() if position is None else with_position(encoded.tobytes(), position)
        to = folder / face_name(face.folder, name)
        to.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(to, jpeg)


def _framed(pixels: NDArray[Any]) -> NDArray[Any]:
    """A panorama with what lies beyond its sides: the other side, and over a pole the meridian
    opposite."""
    half = pixels.shape[1] // 2
    above = np.roll(pixels[:MARGIN_PX][::-1], half, axis=1)
    below = np.roll(pixels[-MARGIN_PX:][::-1], half, axis=1)
    tall = np.concatenate([above, pixels, below])
    return np.concatenate([tall[:, -MARGIN_PX:], tall, tall[:, :MARGIN_PX]], axis=1)


def _sources(face: Face, size_px: int, rig: FaceRig, size_wh: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Column and row (S,S) of the framed panorama, by index, that each pixel of a face shows."""
    places = pixels_of_rays(rays_of_face(face, rig.K(size_px), size_px), size_wh) - 0.5 + MARGIN_PX
    return places[..., 0].astype(np.float32), places[..., 1].astype(np.float32)
