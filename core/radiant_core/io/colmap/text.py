"""The text files of a COLMAP model as records; '#' starts a comment, errors name their line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.colmap.records import PARAM_COUNTS, ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from radiant_core.io.run_store import write_atomic
from radiant_core.numerics import FloatArray

SUFFIX = ".txt"
_MAX_ID = (1 << 63) - 1


def parse_cameras(data: bytes, path: str) -> list[ColmapCamera]:
    """The records of cameras.txt; BadInput with the line number."""
    cameras = []
    for place, line in _records(_lines(data, path), path):
        words = line.split()
        if len(words) > 4 and words[1] not in PARAM_COUNTS:
            raise BadInput(f"{place}: {line[:60]!r} is no camera: {words[1]!r} is none of the models {', '.join(PARAM_COUNTS)}.")
        if PARAM_COUNTS.get("".join(words[1:2])) != len(words) - 4:
            raise BadInput(f"{place}: {line[:60]!r} is no camera: expected id, a known model, width, height and its parameters.")
        camera_id, width, height = _integers([words[0], words[2], words[3]], place)
        params = tuple(float(value) for value in _floats(words[4:], place))
        cameras.append(ColmapCamera(camera_id=camera_id, model=words[1], size_wh=(width, height), params=params))
    return cameras


def parse_images(data: bytes, path: str) -> list[ColmapImage]:
    """The records of images.txt, two lines each, of which the second may be empty; BadInput with
    the line number."""
    lines = _lines(data, path)
    images = []
    for place, line in _records(lines, path):
        words = line.split(maxsplit=9)
        if len(words) != 10:
            raise BadInput(f"{place}: {line[:60]!r} is no image: expected id, quaternion, translation, camera id and name.")
        _, second = next(lines, (0, ""))
        points2d, point3d_ids = _points2d(second.split(), place)
        image_id, camera_id = _integers([words[0], words[8]], place)
        pose = _floats(words[1:8], place)
        images.append(
            ColmapImage(
                image_id=image_id,
                name=words[9].strip(),
                camera_id=camera_id,
                quat_wxyz=pose[:4],
                translation=pose[4:],
                points2d=points2d,
                point3d_ids=point3d_ids,
            )
        )
    return images


def parse_points(data: bytes, path: str) -> ColmapPoints:
    """The records of points3D.txt; BadInput with the line number."""
    ids, xyz, colors, errors_px, tracks = [], [], [], [], []
    for index, (place, line) in enumerate(_records(_lines(data, path), path)):
        words = line.split()
        if len(words) < 8 or len(words) % 2:
            raise BadInput(f"{place}: {line[:60]!r} is no point: expected id, x y z, r g b, error and pairs of a track.")
        point_id, *color = _integers([words[0], *words[4:7]], place)
        x, y, z, error_px = _floats([*words[1:4], words[7]], place)
        if max(color) > 255:
            raise BadInput(f"{place}: the colour {color} is not in 0..255.")
        ids.append(point_id)
        xyz.append((x, y, z))
        colors.append(color)
        errors_px.append(error_px)
        track = np.array(_integers(words[8:], place), np.int64)
        tracks.append(np.column_stack([np.full(len(track) // 2, index), track[0::2], track[1::2]]))
    return ColmapPoints(
        ids=np.array(ids, np.int64),
        xyz=np.array(xyz, np.float64).reshape(len(ids), 3),
        colors=np.array(colors, np.uint8).reshape(len(ids), 3),
        errors_px=np.array(errors_px, np.float64),
        tracks=np.concatenate(tracks) if tracks else np.zeros((0, 3), np.int64),
    )


def write_model(folder: Path, model: ColmapModel) -> None:
    """Write cameras.txt, images.txt and points3D.txt into `folder`, each atomically; raises as
    `write_atomic`."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras = [f"{c.camera_id} {c.model} {c.size_wh[0]} {c.size_wh[1]} {_join_numbers(c.params)}\n" for c in model.cameras.values()]
    write_atomic(folder / "cameras.txt", "".join(["# camera_id model width height params\n", *cameras]).encode())
    images = [
        f"{i.image_id} {_join_numbers(i.quat_wxyz)} {_join_numbers(i.translation)} {i.camera_id} {i.name}\n"
        + " ".join(f"{_join_numbers(xy)} {point}" for xy, point in zip(i.points2d, i.point3d_ids, strict=True))
        + "\n"
        for i in model.images
    ]
    header = "# image_id qw qx qy qz tx ty tz camera_id name, then a line of x y point3d_id\n"
    write_atomic(folder / "images.txt", "".join([header, *images]).encode())
    points, (first, last) = model.points, _track_bounds(model.points)
    lines = [
        f"{points.ids[p]} {_join_numbers(points.xyz[p])} {' '.join(map(str, points.colors[p]))} {_join_numbers([points.errors_px[p]])} "
        + " ".join(f"{image} {index}" for _, image, index in points.tracks[first[p] : last[p]])
        + "\n"
        for p in range(len(points.ids))
    ]
    write_atomic(folder / "points3D.txt", "".join(["# point3d_id x y z r g b error (image_id point2d_index)*\n", *lines]).encode())


def _track_bounds(points: ColmapPoints) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    indices = np.arange(len(points.ids))
    return np.searchsorted(points.tracks[:, 0], indices, "left"), np.searchsorted(points.tracks[:, 0], indices, "right")


def _join_numbers(numbers: object) -> str:
    return " ".join(repr(float(number)) for number in np.ravel(np.asarray(numbers, np.float64)))


def _lines(data: bytes, path: str) -> Iterator[tuple[int, str]]:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise BadInput(f"{path} at byte {error.start} is not UTF-8 text: export the model again.") from None
    yield from enumerate(text.split("\n"), start=1)


def _records(lines: Iterator[tuple[int, str]], path: str) -> Iterator[tuple[str, str]]:
    """Place ("file line 7") and content of each line that is neither empty nor a comment."""
    for number, line in lines:
        if line.strip() and not line.lstrip().startswith("#"):
            yield f"{path} line {number}", line.strip()


def _points2d(words: list[str], place: str) -> tuple[FloatArray, NDArray[np.int64]]:
    if len(words) % 3:
        raise BadInput(f"{place}: the line after it holds {len(words)} numbers, expected triples of x, y and point id.")
    xs, ys = _floats(words[0::3], place), _floats(words[1::3], place)
    ids = [-1 if word == "-1" else _integers([word], place)[0] for word in words[2::3]]
    return np.stack([xs, ys], axis=1), np.array(ids, np.int64)


def _floats(words: list[str], place: str) -> FloatArray:
    try:
        return np.array([float(word) for word in words], dtype=np.float64)
    except ValueError as error:
        raise BadInput(f"{place}: {str(error)[:80]}, expected a number.") from None


def _integers(words: list[str], place: str) -> list[int]:
    """Non-negative integers below 2^63."""
    for word in words:
        if not (word.isascii() and word.isdigit() and len(word) <= 19 and int(word) <= _MAX_ID):
            raise BadInput(f"{place}: {word[:40]!r} is no whole number from 0 to 2^63 - 1.")
    return [int(word) for word in words]
