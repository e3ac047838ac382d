"""A Mill 19 / Mega-NeRF folder as posed pinhole photographs.

Read once per scene. Layout: coordinates.pt {origin_drb (3,), pose_scale_factor}, and for train and
val each rgbs/NNNNNN.jpg and metadata/NNNNNN.pt {H, W, intrinsics (fx, fy, cx, cy), c2w (3,4)}. The
world's axes are down, right, back; the camera's right, up, back; images are undistorted already, so
`distortion` is not applied again. Hence
    centre = pose_scale_factor · R · c2w[:, 3],   R with rows right, −back, −down: z up
The place of the middle, origin_drb, is left out: it has no latitude or longitude and only costs
digits. Source: Turki et al., Mega-NeRF, CVPR 2022, and the layout of its published data.
"""

from __future__ import annotations

from pathlib import Path
from pickle import UnpicklingError  # noqa: TID251 only the error that torch.load raises is wanted
from typing import Any
from zipfile import BadZipFile, ZipFile, is_zipfile

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.numerics import FloatArray

SUFFIXES = (".jpg", ".JPG", ".jpeg", ".png", ".PNG")
MAX_METADATA_BYTES = 1 << 20
_WORLD_FROM_DRB = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])
_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0])


def read_mill19(folder: Path) -> Cameras:
    """The posed photographs of a Mill 19 folder in its own unit (published: metres), z up.

    Named by their path in the folder ("train/rgbs/000001.jpg"); `held_out_mask` selects those in
    val/. Raises BadInput naming the file when one is missing, no such file, or makes no camera.
    """
    coordinates_path = folder / "coordinates.pt"
    coordinates = _load(coordinates_path)
    scale = float(_numbers(coordinates, "pose_scale_factor", (), coordinates_path))
    if not scale > 0:
        raise BadInput(f"{coordinates_path}: pose_scale_factor is {scale}, expected a positive number.")
    entries = [(split, path) for split in ("train", "val") for path in sorted((folder / split / "metadata").glob("*.pt"))]
    if not entries:
        raise BadInput(f"{folder} has no train/metadata/*.pt or val/metadata/*.pt: give a folder in the Mega-NeRF layout.")
    names = [_image_name(folder, split, path) for split, path in entries]
    facts = [_camera(path, scale) for _, path in entries]
    return Cameras(
        names=tuple(names),
        Ks=np.array([K for K, _, _ in facts]),
        cam_from_world=np.array([pose for _, pose, _ in facts]),
        sizes_wh=np.array([size_wh for _, _, size_wh in facts]),
    )


def images_without_pose(folder: Path, cameras: Cameras) -> tuple[str, ...]:
    """The images in train/rgbs and val/rgbs that no metadata speaks of."""
    there = sorted(path for split in ("train", "val") for path in (folder / split / "rgbs").glob("*") if path.suffix in SUFFIXES)
    return tuple(name for path in there if (name := path.relative_to(folder).as_posix()) not in set(cameras.names))


def given_from_scene(folder: Path) -> Sim3:
    """The similarity from the frame of `read_mill19` to that of c2w in the metadata."""
    path = folder / "coordinates.pt"
    scale = float(_numbers(_load(path), "pose_scale_factor", (), path))
    return Sim3(scale=1 / scale, rotation=_WORLD_FROM_DRB.T, translation=np.zeros(3))


def _image_name(folder: Path, split: str, metadata_path: Path) -> str:
    names = [name for suffix in SUFFIXES if (folder / (name := f"{split}/rgbs/{metadata_path.stem}{suffix}")).is_file()]
    # Where letter case does not count .jpg and .JPG are one file.
    names = [name for at, name in enumerate(names) if not any((folder / name).samefile(folder / earlier) for earlier in names[:at])]
    if len(names) > 1:
        raise BadInput(f"{metadata_path} has {len(names)} images, {' and '.join(names)}: leave the one that it was made from.")
    if names:
        return names[0]
    raise BadInput(f"{metadata_path} has no image {split}/rgbs/{metadata_path.stem}.jpg beside it: fetch the image or remove it.")


def _camera(path: Path, scale: float) -> tuple[FloatArray, FloatArray, tuple[int, int]]:
    """K (3,3), cam_from_world (4,4) and size of one metadata file."""
    metadata = _load(path)
    fx, fy, cx, cy = _numbers(metadata, "intrinsics", (4,), path)
    world_from_camera = _numbers(metadata, "c2w", (3, 4), path)
    rotation = _OPENGL_FROM_OPENCV @ world_from_camera[:, :3].T @ _WORLD_FROM_DRB.T
    # float32 rotations are orthonormal to 1e-7 only; the nearest rotation keeps the rest exact.
    U, singular, Vt = np.linalg.svd(rotation)
    if np.abs(singular - 1).max() > 1e-3 or round(np.linalg.det(U @ Vt)) != 1:
        raise BadInput(f"{path}: the first three columns of c2w are no rotation: export the metadata again.")
    pose = np.eye(4)
    pose[:3, :3] = U @ Vt
    pose[:3, 3] = -pose[:3, :3] @ (_WORLD_FROM_DRB @ world_from_camera[:, 3] * scale)
    width, height = (int(_numbers(metadata, key, (), path)) for key in ("W", "H"))
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), pose, (width, height)


def _load(path: Path) -> dict[str, Any]:
    """The dictionary in a .pt file; only tensors, numbers and containers are ever built from it."""
    import torch

    if not path.is_file():
        raise BadInput(f"{path} does not exist: expected a folder in the Mega-NeRF layout with coordinates.pt, train and val.")
    if path.stat().st_size > MAX_METADATA_BYTES:
        raise BadInput(f"{path} has {path.stat().st_size} bytes, expected metadata of at most {MAX_METADATA_BYTES}.")
    try:
        unpacked_bytes = _unpacked_bytes(path)
        if unpacked_bytes > MAX_METADATA_BYTES:
            raise BadInput(f"{path} unpacks to {unpacked_bytes} bytes, expected metadata of at most {MAX_METADATA_BYTES}.")
        # The file comes from elsewhere: tensors only.
        loaded = torch.load(path, map_location="cpu", weights_only=True)  # noqa: TID251
    except BadInput:
        raise
    except (RuntimeError, UnpicklingError, EOFError, ValueError, KeyError, OSError, BadZipFile) as error:
        raise BadInput(f"{path} is no readable .pt file of tensors ({type(error).__name__}): fetch it again.") from None
    if not isinstance(loaded, dict):
        raise BadInput(f"{path} holds a {type(loaded).__name__}, expected a dictionary of tensors.")
    return loaded


def _unpacked_bytes(path: Path) -> int:
    """What all parts of a .pt file take unpacked; 0 for the older form, which is never deflated."""
    if not is_zipfile(path):
        return 0
    with ZipFile(path) as parts:
        return sum(part.file_size for part in parts.infolist())


def _numbers(loaded: dict[str, Any], key: str, shape: tuple[int, ...], path: Path) -> FloatArray:
    """The finite numbers of `shape` under `key`."""
    stored_shape = tuple(getattr(loaded.get(key), "shape", shape))
    # Before anything is converted, which takes as much memory as the shape says.
    if stored_shape != shape and (shape or any(side != 1 for side in stored_shape)):
        raise BadInput(f"{path}: {key!r} has shape {stored_shape}, expected {shape}.")
    try:
        values = np.asarray(_of_shape(loaded[key], shape), dtype=np.float64).reshape(shape)
    except (KeyError, TypeError, ValueError, RuntimeError, OverflowError):
        raise BadInput(f"{path} has no numbers under {key!r}: expected the Mega-NeRF layout.") from None
    if not np.isfinite(values).all():
        raise BadInput(f"{path}: {key!r} is not finite, expected {shape} finite numbers.")
    return values


def _of_shape(value: Any, shape: tuple[int, ...]) -> Any:
    """A tensor, or nested lists, each of which is counted before it is unfolded."""
    if not isinstance(value, list | tuple):
        return value
    if not shape or len(value) != shape[0]:
        raise ValueError
    return [_of_shape(item, shape[1:]) for item in value]
