"""transforms.json of nerfstudio, instant-ngp and Blender. Once per source.

    transform_matrix    world from camera (4,4), OpenGL's axes (x right, y up, z back)
    applied_transform   file = applied · original: undone, so that the world is the original's

Intrinsics stand on top or in each frame, which wins. What wrote a file shows in its keys:
applied_transform is nerfstudio's, aabb_scale instant-ngp's (whose scale and shift are lost), and
camera_angle_x without a focal length Blender's. Sources: nerfstudio's colmap_utils.py and
nerfstudio_dataparser.py, instant-ngp's colmap2nerf.py.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.io.ply_elements import read_elements
from radiant_core.io.poses.fields import Fields, read_json_file
from radiant_core.io.poses.lens import Lens, sphere_lens
from radiant_core.io.poses.pose_file import PosedView, PoseFile, SizeOf, nearest_rotation, posed_view
from radiant_core.numerics import FloatArray, require_finite

COLOURS = ("red", "green", "blue")


def read_points_ply(path: Path) -> tuple[FloatArray, NDArray[np.uint8] | None]:
    """Points (P,3) and colours (P,3) uint8, None where the file has none. Raises
    BadInput where it is no PLY with points."""
    try:
        _, tables = read_elements(path, {"vertex": "points"})
    except BadInput as error:
        raise BadInput(f"{path} cannot be read: {error}: export it again, or take its name out of the alignment.") from None
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror or error}): put the points beside the alignment.") from None
    table = tables.get("vertex")
    if table is None or not all(table.has(name, "f") for name in "xyz"):
        raise BadInput(f"{path} holds no points with x, y and z: give the PLY that the alignment was exported with.")
    points: FloatArray = table.columns("xyz", np.float64)
    require_finite(f"the points of {path.name}", points)
    if not (np.abs(points) < 1e9).all():
        raise BadInput(f"{path} has a point beyond 1e9: export it again.")
    if not all(table.has(name, "iu") for name in COLOURS):
        return points, None
    colors = table.columns(COLOURS, np.float64)
    if not ((colors >= 0) & (colors <= 255)).all():
        raise BadInput(f"{path} has colours beyond 0 to 255: export it with colours of 8 bits.")
    return points, colors.astype(np.uint8)


SPLITS = ("train", "val", "test")
FLIP = np.diag([1.0, -1.0, -1.0])
"""From OpenGL's axes of a camera to OpenCV's."""
OLD_APPLIED = np.array([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]])
"""What nerfstudio applied to COLMAP's worlds before its files said so."""
MODELS = {"OPENCV": "brown", "PINHOLE": "brown", "SIMPLE_PINHOLE": "brown", "SIMPLE_RADIAL": "brown", "RADIAL": "brown"}
MODELS |= {"OPENCV_FISHEYE": "fisheye", "EQUIRECTANGULAR": "sphere"}
UNUSED = {"mask_path": "masks, which --masks takes", "depth_file_path": "depths"}


def read_transforms(path: Path, size_of: SizeOf) -> PoseFile:
    """The alignment in `path`; of transforms_train.json those of val and test beside it too. Raises
    BadInput for a lens that is not read here, by its name."""
    splits = [path.with_name(f"transforms_{split}.json") for split in SPLITS]
    paths = [file for file in splits if file.is_file()] if path in splits else [path]
    tops = [Fields(read_json_file(file), str(file)) for file in paths]
    frames = [(top, frame) for top in tops for frame in top.objects("frames")]
    if not frames:
        raise BadInput(f"{path} has no frames: export the alignment again.")
    program, notes = _program(tops[0])
    move, applied_notes = _original_from_file(tops[0], path)
    numbers: dict[Lens, int] = {}
    views = [_view(top, frame, size_of, numbers, move) for top, frame in frames]
    points, colors = np.zeros((0, 3)), None
    if "ply_file_path" in tops[0]:
        points, colors = read_points_ply(path.parent / tops[0].text("ply_file_path"))
        points = move.apply(points)
    unused = {word: sum(key in frame for _, frame in frames) for key, word in UNUSED.items()}
    return PoseFile(
        path=path,
        program=program,
        lenses={number: lens for lens, number in numbers.items()},
        views=tuple(views),
        points=points,
        colors=colors,
        notes=(*notes, *applied_notes, *(f"{count} frames name {word}: not used." for word, count in unused.items() if count)),
    )


def _program(top: Fields) -> tuple[str, tuple[str, ...]]:
    if "applied_transform" in top or "ply_file_path" in top or "camera_model" in top:
        return "nerfstudio", ()
    if "aabb_scale" in top:
        return "instant-ngp", ("instant-ngp turns, moves and scales a scene without writing down how: its frame is taken as it is.",)
    if "camera_angle_x" in top and "fl_x" not in top:
        return "Blender", ()
    return "nerfstudio", ()


def _original_from_file(top: Fields, path: Path) -> tuple[Sim3, tuple[str, ...]]:
    """The similarity from the file's world to that before `applied_transform`."""
    applied, notes = np.eye(3, 4), ()
    if "applied_transform" in top:
        value = top.get("applied_transform")
        applied = top.numbers("applied_transform", (4 if isinstance(value, list) and len(value) == 4 else 3, 4))[:3]
    elif "aabb_scale" not in top and "fl_x" in top and (path.parent / "colmap" / "sparse" / "0").is_dir():
        applied = OLD_APPLIED
        notes = ("the file is of an older nerfstudio, which exchanged axes of COLMAP's world without saying so: undone.",)
    scale = top.number("applied_scale", 1.0)
    if not 0 < scale < 1e9:
        raise BadInput(f"{path}: 'applied_scale' is {scale:g}, expected a positive number.")
    length = float(np.cbrt(abs(np.linalg.det(applied[:, :3]))))
    if not 1e-9 < length < 1e9:
        raise BadInput(f"{path}: 'applied_transform' flattens the world: export the file again.")
    rotation = nearest_rotation(applied[:, :3] / length, "'applied_transform'")
    return Sim3(scale=scale * length, rotation=rotation, translation=scale * applied[:, 3]).inverse(), notes


def _view(top: Fields, frame: Fields, size_of: SizeOf, numbers: dict[Lens, int], move: Sim3) -> PosedView:
    name = PurePosixPath(frame.text("file_path").replace("\\", "/")).as_posix()
    lens = _lens(top, frame, name, size_of)
    value = frame.get("transform_matrix")
    pose = frame.numbers("transform_matrix", (4 if isinstance(value, list) and len(value) == 4 else 3, 4))
    rotation = FLIP @ nearest_rotation(pose[:3, :3], f"photograph {name!r}").T
    center: FloatArray = move.apply(pose[None, :3, 3])[0]
    rotation = rotation @ move.rotation.T
    return posed_view(name, numbers.setdefault(lens, len(numbers) + 1), rotation, -rotation @ center)


def _lens(top: Fields, frame: Fields, name: str, size_of: SizeOf) -> Lens:
    """The lens of a frame, whose numbers go before those on top."""
    both = Fields({**top.value, **{key: value for key, value in frame.value.items() if value is not None}}, frame.place)
    model = both.text("camera_model", "OPENCV")
    if both.value.get("is_fisheye") is True:
        model = "OPENCV_FISHEYE"
    if model not in MODELS:
        raise BadInput(
            f"{frame.place}: the camera model {model!r} is not read here, expected one of {', '.join(MODELS)}: undistort the photographs."
        )
    size_wh = (both.whole("w"), both.whole("h")) if "w" in both and "h" in both else size_of(name)
    if size_wh is None:
        raise BadInput(f"{frame.place} has no w and h, and there is no photograph {name!r} to take them from: put it there.")
    if MODELS[model] == "sphere":
        return sphere_lens(size_wh)
    if "fl_x" not in both and "camera_angle_x" not in both:
        raise BadInput(f"{frame.place} has neither fl_x nor camera_angle_x: export the file with its focal length.")
    fx = both.number("fl_x") if "fl_x" in both else _focal_px(both.number("camera_angle_x"), size_wh[0], frame.place)
    fy = both.number("fl_y") if "fl_y" in both else fx
    if "fl_y" not in both and "fl_x" not in both and "camera_angle_y" in both:
        fy = _focal_px(both.number("camera_angle_y"), size_wh[1], frame.place)
    kind: Any = MODELS[model]
    straight = model in ("PINHOLE", "SIMPLE_PINHOLE")
    coefficients = [0.0 if straight else both.number(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2")]
    return Lens(
        size_wh=size_wh,
        fx=fx,
        fy=fy,
        cx=both.number("cx", size_wh[0] / 2),
        cy=both.number("cy", size_wh[1] / 2),
        kind=kind,
        k=(coefficients[0], coefficients[1], coefficients[2], coefficients[3]),
        p1=coefficients[4] if kind == "brown" else 0.0,
        p2=coefficients[5] if kind == "brown" else 0.0,
    )


def _focal_px(angle_rad: float, side_px: int, place: str) -> float:
    if not 1e-3 < angle_rad < np.pi - 1e-3:
        raise BadInput(f"{place} has a camera angle of {angle_rad:g}, expected radians between 0 and π.")
    return 0.5 * side_px / float(np.tan(0.5 * angle_rad))
