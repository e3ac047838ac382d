"""reconstruction.json of OpenSfM and ODM, with cameras.json and tracks.csv beside it. Once per
source.

    rotation       axis-angle [rad] of cam_from_world; `translation` is its t, no position
    focal, c_x     shares of the larger side; the principal point counts from the picture's middle
    reference_lla  latitude, longitude, altitude: coordinates are metres east, north, up about it

Source: OpenSfM's io.py, camera.py and tracking.py; checked on its Berlin example.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.io.poses.fields import Fields, numbers_of, read_json_file, read_text
from radiant_core.io.poses.lens import Lens, sphere_lens
from radiant_core.io.poses.pose_file import UNKNOWN_WORLD, GivenWorld, PosedView, PoseFile, SizeOf, posed_view
from radiant_core.numerics import FloatArray

TRACKS_MARK = "OPENSFM_TRACKS_VERSION_v"
PROGRAM = "OpenSfM"
SPHERES = ("spherical", "equirectangular")
READ_TYPES = ("perspective", "simple_radial", "radial", "brown", "fisheye", "fisheye_opencv", *SPHERES)
Observations = dict[str, tuple[FloatArray, NDArray[np.int64]]]


def read_opensfm(path: Path, size_of: SizeOf) -> PoseFile:
    """The largest reconstruction in `path`. Raises BadInput for a lens that is not read here, by
    its name."""
    del size_of
    parts = read_json_file(path)
    if not isinstance(parts, list) or not parts:
        raise BadInput(f"{path} holds no reconstruction: expected OpenSfM's list of them.")
    reconstructions = [Fields(part, f"{path}: reconstruction {number}") for number, part in enumerate(parts)]
    counts = [len(part.object("shots").value) for part in reconstructions]
    largest = int(np.argmax(counts))
    chosen = reconstructions[largest]
    notes = []
    if len(parts) > 1:
        notes.append(f"of {len(parts)} reconstructions in {path.name} the one with {counts[largest]} of {sum(counts)} photographs is used.")
    cameras = _cameras(chosen, path)
    numbers = {name: number for number, name in enumerate(cameras, 1)}
    ids, points, colors = _points(chosen)
    shots = chosen.items("shots")
    observations = _observations(path.with_name("tracks.csv"), ids, {name: cameras.get(shot.text("camera")) for name, shot in shots})
    return PoseFile(
        path=path,
        program=PROGRAM,
        lenses={number: cameras[name] for name, number in numbers.items()},
        views=tuple(_view(name, shot, numbers, observations) for name, shot in shots),
        points=points,
        colors=colors,
        world=_world(chosen, path),
        notes=tuple(notes),
    )


def _cameras(chosen: Fields, path: Path) -> dict[str, Lens]:
    """Lens by the id of its camera; of those that lack cameras.json is asked."""
    wanted = {shot.text("camera") for _, shot in chosen.items("shots")}
    there = dict(chosen.items("cameras")) if "cameras" in chosen else {}
    cameras_path = path.with_name("cameras.json")
    if wanted - there.keys() and cameras_path.is_file():
        there |= Fields({"cameras": read_json_file(cameras_path)}, str(cameras_path)).items("cameras")
    lost = sorted(wanted - there.keys())
    if lost:
        raise BadInput(f"{path} has no camera {lost[0]!r}, which a shot names: put cameras.json beside it or export it again.")
    return {name: _lens(camera) for name, camera in there.items() if name in wanted}


def _lens(camera: Fields) -> Lens:
    kind = camera.text("projection_type", "perspective")
    if kind not in READ_TYPES:
        raise BadInput(
            f"{camera.place} is of the projection type {kind!r}, which is not read here, expected one of {', '.join(READ_TYPES)}: "
            "undistort the photographs in the program that aligned them."
        )
    size_wh = camera.whole("width"), camera.whole("height")
    if kind in SPHERES:
        return sphere_lens(size_wh)
    larger = max(size_wh)
    focal = camera.number("focal") if "focal" in camera else camera.number("focal_x")
    ratio = camera.number("focal_y", focal) if "focal" not in camera else focal
    k1, k2, k3, k4 = (camera.number(key, 0.0) for key in ("k1", "k2", "k3", "k4"))
    brown = kind == "brown"
    return Lens(
        size_wh=size_wh,
        fx=focal * larger,
        fy=ratio * larger,
        cx=camera.number("c_x", 0.0) * larger + size_wh[0] / 2,
        cy=camera.number("c_y", 0.0) * larger + size_wh[1] / 2,
        kind="fisheye" if kind.startswith("fisheye") else "brown",
        k=(k1, k2, k3 if brown or kind == "fisheye_opencv" else 0.0, k4 if kind == "fisheye_opencv" else 0.0),
        p1=camera.number("p1", 0.0) if brown else 0.0,
        p2=camera.number("p2", 0.0) if brown else 0.0,
    )


def _points(chosen: Fields) -> tuple[list[str], FloatArray, NDArray[np.uint8] | None]:
    points = chosen.items("points") if "points" in chosen else []
    xyz = numbers_of([point.get("coordinates") for _, point in points], (None, 3), f"{chosen.place}: points")
    colored = bool(points) and all("color" in point for _, point in points)
    if not colored:
        return [name for name, _ in points], xyz, None
    colors = numbers_of([point.get("color") for _, point in points], (None, 3), f"{chosen.place}: colours")
    return [name for name, _ in points], xyz, np.clip(colors, 0, 255).round().astype(np.uint8)


def _view(name: str, shot: Fields, numbers: dict[str, int], observations: Observations) -> PosedView:
    turn = shot.numbers("rotation", (3,))
    if not np.abs(turn).max() < 1e3:
        raise BadInput(f"{shot.place}: 'rotation' is {turn.tolist()}, expected an axis times radians: export the file again.")
    rotation = Rotation.from_rotvec(turn).as_matrix()
    return posed_view(name, numbers[shot.text("camera")], rotation, shot.numbers("translation", (3,)), observations.get(name))


def _observations(path: Path, ids: list[str], lens_of: dict[str, Lens | None]) -> Observations:
    """What each photograph sees, by tracks.csv: image, track, feature, x and y as shares of the
    larger side from the middle, …; nothing where there is no such file."""
    if not path.is_file():
        return {}
    lines = read_text(path).split("\n")
    start = 1 if lines[0].startswith(TRACKS_MARK) else 0
    row_of = {name: row for row, name in enumerate(ids)}
    gathered: dict[str, list[tuple[int, str, str]]] = {}
    for number, line in enumerate(lines[start:], start + 1):
        cells = line.split("\t")
        if len(cells) < 5:
            if line.strip():
                raise BadInput(f"{path} line {number} has {len(cells)} columns, expected image, track, feature, x, y and more.")
            continue
        if cells[0] in lens_of and cells[1] in row_of:
            gathered.setdefault(cells[0], []).append((row_of[cells[1]], cells[3], cells[4]))
    observations: Observations = {}
    for name, rows in gathered.items():
        lens = lens_of[name]
        assert lens is not None
        try:
            shares = np.array([(float(x), float(y)) for _, x, y in rows])
        except ValueError:
            raise BadInput(f"{path}: a place that {name!r} sees is no number: export the tracks again.") from None
        if not (np.abs(shares) < 1e3).all():
            raise BadInput(f"{path}: a place that {name!r} sees lies far outside of it: export the tracks again.")
        observations[name] = shares * max(lens.size_wh) + np.array(lens.size_wh) / 2, np.array([row for row, _, _ in rows], np.int64)
    return observations


def _world(chosen: Fields, path: Path) -> GivenWorld:
    reference_path = path.with_name("reference_lla.json")
    if "reference_lla" in chosen:
        reference = chosen.object("reference_lla")
    elif reference_path.is_file():
        reference = Fields(read_json_file(reference_path), str(reference_path))
    else:
        return UNKNOWN_WORLD
    lat, lon, alt = reference.number("latitude"), reference.number("longitude"), reference.number("altitude", 0.0)
    if (lat, lon) == (0, 0):
        # What OpenSfM writes where no photograph has GPS.
        return UNKNOWN_WORLD
    if abs(lat) > 90 or abs(lon) > 180 or abs(alt) > 1e5:
        raise BadInput(f"{reference.place} is latitude {lat:g}°, longitude {lon:g}°, altitude {alt:g} m, which is not on the globe.")
    return GivenWorld(kind="enu", origin_lat_lon_alt=(lat, lon, alt))
