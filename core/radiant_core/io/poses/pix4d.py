"""NAME_calibrated_camera_parameters.txt of Pix4D, with its offset and system. Once per source.

A head of seven lines, then ten lines a photograph:
    fileName width height;  K (3 rows);  R1 R2 R3;  T1 T2;  t, the centre less the offset;
    R (3 rows): cam_from_world, OpenCV's axes, so that m = K [R | −R t] X
NAME_offset.xyz has what was taken off the centres, NAME_wkt.prj their system. R1 R2 R3 T1 T2 are
OpenCV's k1 k2 k3 p1 p2. The file of external parameters, X Y Z Omega Phi Kappa in the output system
(R = Rx Ry Rz, camera to world, y up), must agree where it is there. Sources: Pix4D's support pages
202559089 and 202977149, EasyIDP's pix4d.py; poses of a public pair agree to 4e-9.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.io.poses.fields import read_text
from radiant_core.io.poses.lens import Lens
from radiant_core.io.poses.pose_file import GivenWorld, PosedView, PoseFile, SizeOf, posed_view
from radiant_core.numerics import FloatArray

INTERNAL, EXTERNAL = "calibrated_camera_parameters.txt", "calibrated_external_camera_parameters.txt"
OFFSET, SYSTEM = "offset.xyz", "wkt.prj"
HEAD_WORDS = ("fileName", "camera", "radial", "tangential")
BLOCK_LINES = 10
FLIP = np.diag([1.0, -1.0, -1.0])
MAX_AWAY, MAX_TURN = 1e-3, 1e-4
"""How far centres and rotations of the two files may be apart: their digits end at 1e-6."""


def sibling(path: Path, ending: str) -> Path:
    """The file of the same project with another ending."""
    prefix = path.name[: -len(INTERNAL)] if path.name.endswith(INTERNAL) else path.name[: -len(EXTERNAL)]
    return path.with_name(prefix + ending)


def read_pix4d(path: Path, size_of: SizeOf) -> PoseFile:
    """The calibrated cameras of a project. Raises BadInput where only the external parameters are
    there, for a lens of another form, and where the two files contradict each other."""
    del size_of
    if path.name.endswith(EXTERNAL):
        raise BadInput(f"{path} has no lenses: give {sibling(path, INTERNAL).name}, which Pix4D writes beside it.")
    lines = [line.strip() for line in read_text(path).split("\n") if line.strip()]
    while lines and lines[0].split()[0] in HEAD_WORDS:
        lines.pop(0)
    if not lines or len(lines) % BLOCK_LINES:
        raise BadInput(
            f"{path} has {len(lines)} lines behind its head, expected {BLOCK_LINES} a photograph: fisheyes have another form, which is not "
            "read here; undistort the photographs in Pix4D, or copy the file again."
        )
    offset, has_offset = _offset(path)
    lenses: dict[Lens, int] = {}
    views = [_view(lines[at : at + BLOCK_LINES], lenses, offset, path) for at in range(0, len(lines), BLOCK_LINES)]
    _require_agreement(views, path)
    system = sibling(path, SYSTEM)
    crs = read_text(system).strip() if has_offset and system.is_file() else ""
    local = () if has_offset else (f"there is no {sibling(path, OFFSET).name}: coordinates are not those of the output system.",)
    return PoseFile(
        path=path,
        program="Pix4D",
        lenses={number: lens for lens, number in lenses.items()},
        views=tuple(views),
        points=np.zeros((0, 3)),
        world=GivenWorld(kind="crs", crs=crs) if crs and not crs.startswith("LOCAL_CS") else GivenWorld(kind="metres"),
        notes=local,
    )


def _offset(path: Path) -> tuple[FloatArray, bool]:
    file = sibling(path, OFFSET)
    if not file.is_file():
        return np.zeros(3), False
    return _numbers(read_text(file).replace(",", " "), 3, str(file)), True


def _view(block: list[str], lenses: dict[Lens, int], offset: FloatArray, path: Path) -> PosedView:
    # A name may have blanks: the two numbers stand at the right.
    words = block[0].rsplit(maxsplit=2)
    if len(words) != 3 or not all(word.isascii() and word.isdigit() and len(word) < 7 for word in words[1:]) or not words[0].isprintable():
        raise BadInput(f"{path}: {block[0][:80]!r} is no photograph, expected its name, width and height: copy the file again.")
    name, size_wh = words[0], (int(words[1]), int(words[2]))
    label = f"{path}: photograph {name[:80]!r}"
    K = np.stack([_numbers(line, 3, f"{label}: K") for line in block[1:4]])
    if abs(K[2] - (0, 0, 1)).max() > 1e-9 or K[1, 0] != 0:
        raise BadInput(f"{label} has a K with the last row {K[2].tolist()}, expected 0 0 1: export it again.")
    k1, k2, k3 = _numbers(block[4], 3, f"{label}: radial distortion").tolist()
    p1, p2 = _numbers(block[5], 2, f"{label}: tangential distortion").tolist()
    lens = Lens(
        size_wh=size_wh,
        fx=float(K[0, 0]),
        fy=float(K[1, 1]),
        cx=float(K[0, 2]),
        cy=float(K[1, 2]),
        k=(k1, k2, k3, 0.0),
        p1=p1,
        p2=p2,
        skew=float(K[0, 1]),
    )
    center = _numbers(block[6], 3, f"{label}: t") + offset
    rotation = np.stack([_numbers(line, 3, f"{label}: R") for line in block[7:10]])
    return posed_view(name, lenses.setdefault(lens, len(lenses) + 1), rotation, -rotation @ center)


def _require_agreement(views: list[PosedView], path: Path) -> None:
    """Raise BadInput where the external parameters beside the file are of another alignment."""
    file = sibling(path, EXTERNAL)
    if not file.is_file():
        return
    poses = {view.name: view.cam_from_world for view in views}
    for number, line in enumerate(read_text(file).split("\n"), 1):
        words = line.rsplit(maxsplit=6)
        if number == 1 or len(words) != 7 or words[0] not in poses:
            continue
        values = _numbers(" ".join(words[1:]), 6, f"{file} line {number}")
        pose = poses[words[0]]
        rotation = FLIP @ Rotation.from_euler("XYZ", values[3:], degrees=True).as_matrix().T
        away = float(np.abs(-pose[:3, :3].T @ pose[:3, 3] - values[:3]).max())
        turn = float(np.abs(pose[:3, :3] - rotation).max())
        if away > MAX_AWAY or turn > MAX_TURN:
            raise BadInput(
                f"{path.name} and {file.name} contradict each other: photograph {words[0]!r} lies {away:.3g} apart and is turned by "
                f"{turn:.3g} rad: give both files and {sibling(path, OFFSET).name} of one export, or this one alone."
            )


def _numbers(text: str, count: int, label: str) -> FloatArray:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not (np.abs(values) < 1e9).all():
        raise BadInput(f"{label} is {text[:60]!r}, expected {count} finite numbers: copy the file again.")
    return values
