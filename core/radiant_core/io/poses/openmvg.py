"""sfm_data.json of openMVG. Once per source.

    extrinsics   rotation (three rows) of cam_from_world, OpenCV's axes; `center` is the position
    intrinsics   focal_length and principal_point px; disto_k1, _k3: r², r⁴, r⁶ as OpenCV's;
                 disto_t2: k1 k2 k3 p1 p2; fisheye: θ³ … θ⁹ as OpenCV's
    structure    X and the pixels where views see it

A polymorphic name stands only at the first object of its kind, later ones have the id alone. A view
whose id_pose has no extrinsic is not placed. Source: openMVG's sfm_data_io_cereal.cpp,
Camera_Pinhole_*_io.hpp, pose3_io.hpp.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.poses.fields import Fields, numbers_of, read_json_file
from radiant_core.io.poses.lens import Lens
from radiant_core.io.poses.pose_file import PosedView, PoseFile, SizeOf, posed_view
from radiant_core.numerics import FloatArray

ID_MASK = 0x7FFFFFFF
COEFFICIENTS = {
    "pinhole": ("", 0),
    "pinhole_radial_k1": ("disto_k1", 1),
    "pinhole_radial_k3": ("disto_k3", 3),
    "pinhole_brown_t2": ("disto_t2", 5),
    "fisheye": ("fisheye", 4),
}
"""Camera model → the key of its coefficients, and how many they are."""
Observations = dict[int, tuple[FloatArray, NDArray[np.int64]]]


def read_openmvg(path: Path, size_of: SizeOf) -> PoseFile:
    """The placed views and the structure of a scene. Raises BadInput for a lens that is not read
    here, by its name."""
    del size_of
    top = Fields(read_json_file(path), str(path))
    lenses = _lenses(top)
    poses = {entry.whole("key"): entry.object("value") for entry in top.objects("extrinsics")}
    data = [_data(view) for view in top.objects("views")]
    placed = {view.whole("id_view"): view for view in data if view.whole("id_pose") in poses and view.whole("id_intrinsic") in lenses}
    if not placed:
        raise BadInput(f"{path} has no view with a pose and an intrinsic: give the sfm_data.json that a reconstruction wrote.")
    points, observations = _structure(top, set(placed))
    numbers = {key: number for number, key in enumerate(lenses, 1)}
    views = [_view(number, view, poses[view.whole("id_pose")], numbers, observations) for number, view in placed.items()]
    used = {view.lens_id for view in views}
    unplaced = len(data) - len(placed)
    return PoseFile(
        path=path,
        program="openMVG",
        lenses={numbers[key]: lens for key, lens in lenses.items() if numbers[key] in used},
        views=tuple(views),
        points=points,
        notes=(f"{unplaced} of {len(data)} views have no pose and are left out.",) if unplaced else (),
    )


def _data(entry: Fields) -> Fields:
    return entry.object("value").object("ptr_wrapper").object("data")


def _lenses(top: Fields) -> dict[int, Lens]:
    names: dict[int, str] = {}
    lenses: dict[int, Lens] = {}
    for entry in top.objects("intrinsics"):
        value = entry.object("value")
        kind = value.whole("polymorphic_id") & ID_MASK
        if "polymorphic_name" in value:
            names[kind] = value.text("polymorphic_name")
        if kind not in names:
            raise BadInput(f"{value.place} is of a kind whose name stands nowhere before it: export the scene again.")
        lenses[entry.whole("key")] = _lens(names[kind], _data(entry))
    return lenses


def _lens(name: str, data: Fields) -> Lens:
    if name not in COEFFICIENTS:
        raise BadInput(
            f"{data.place} is of the camera model {name!r}, which is not read here, expected one of {', '.join(COEFFICIENTS)}: undistort "
            "the photographs first."
        )
    key, count = COEFFICIENTS[name]
    values = data.numbers(key, (count,)).tolist() if count else []
    size_wh = data.whole("width"), data.whole("height")
    focal, (cx, cy) = data.number("focal_length"), data.numbers("principal_point", (2,)).tolist()
    radial = [*values[: 4 if name == "fisheye" else 3], 0.0, 0.0, 0.0, 0.0]
    tangential = values[3:5] if name == "pinhole_brown_t2" else [0.0, 0.0]
    return Lens(
        size_wh=size_wh,
        fx=focal,
        fy=focal,
        cx=cx,
        cy=cy,
        kind="fisheye" if name == "fisheye" else "brown",
        k=(radial[0], radial[1], radial[2], radial[3]),
        p1=tangential[0],
        p2=tangential[1],
    )


def _view(number: int, view: Fields, pose: Fields, numbers: dict[int, int], observations: Observations) -> PosedView:
    folder, file = view.text("local_path", "").strip("/"), view.text("filename")
    rotation = pose.numbers("rotation", (3, 3))
    center = pose.numbers("center", (3,))
    name = f"{folder}/{file}" if folder else file
    return posed_view(name, numbers[view.whole("id_intrinsic")], rotation, -rotation @ center, observations.get(number))


def _structure(top: Fields, placed: set[int]) -> tuple[FloatArray, Observations]:
    landmarks = [entry.object("value") for entry in top.objects("structure")] if "structure" in top else []
    points = numbers_of([landmark.get("X") for landmark in landmarks], (None, 3), f"{top.place}: structure")
    rows: dict[int, list[tuple[int, FloatArray]]] = {}
    for row, landmark in enumerate(landmarks):
        for entry in landmark.objects("observations"):
            view = entry.whole("key")
            if view in placed:
                rows.setdefault(view, []).append((row, entry.object("value").numbers("x", (2,))))
    observations = {
        view: (np.array([place for _, place in entries]), np.array([row for row, _ in entries], np.int64)) for view, entries in rows.items()
    }
    return points, observations
