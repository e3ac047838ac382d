"""bundle.out of Bundler and the list of its photographs. Once per source.

    camera   f k1 k2, R (3 rows), t: cam_from_world, looking along −z with y up
    point    x y z, r g b, n × (camera, key, x, y): pixels from the picture's middle, y up
    lens     p = −P/P.z,  pixel = f (1 + k1‖p‖² + k2‖p‖⁴) p

The photographs are those of list.txt (COLMAP: NAME.list.txt), in the order of the cameras; a focal
length of 0 is a camera that is not placed. Source: Snavely, Bundler 0.4, README.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.poses.fields import read_text
from radiant_core.io.poses.lens import Lens
from radiant_core.io.poses.pose_file import PoseFile, SizeOf, posed_view
from radiant_core.numerics import FloatArray

MARK = "# Bundle file v0.3"
FLIP = np.diag([1.0, -1.0, -1.0])
MAX_CAMERAS, MAX_POINTS = 1_000_000, 100_000_000


def list_of(path: Path) -> Path | None:
    """The list of the photographs of a bundle file; None where none lies beside it."""
    stem = path.name.removesuffix(".out").removesuffix(".bundle")
    names = (f"{stem}.list.txt", f"{stem}.txt", "list.txt", "../list.txt")
    return next((path.parent / name for name in names if (path.parent / name).is_file()), None)


def read_bundler(path: Path, size_of: SizeOf) -> PoseFile:
    """The placed cameras and the points of a bundle file. Raises BadInput without its list, or for
    a photograph that is not there, whose size is needed."""
    names = _names(path)
    text = read_text(path)
    if not text.startswith(MARK):
        raise BadInput(f"{path} begins with {text[:40]!r}, expected {MARK!r}: export it in this form.")
    words = iter(text[text.index("\n") + 1 :].split() if "\n" in text else ())
    num_cameras, num_points = (int(value) for value in _take(words, 2, path))
    if not (0 < num_cameras <= MAX_CAMERAS and 0 <= num_points <= MAX_POINTS):
        raise BadInput(f"{path} says {num_cameras} cameras and {num_points} points: export it again.")
    if num_cameras != len(names):
        raise BadInput(f"{path} has {num_cameras} cameras and its list {len(names)} photographs: give the list that was written with it.")
    cameras = [_take(words, 15, path) for _ in range(num_cameras)]
    placed = [number for number, camera in enumerate(cameras) if camera[0] > 0]
    sizes = {number: _size(names[number], size_of, path) for number in placed}
    points, colors, observations = _points(words, num_points, sizes, path)
    lenses: dict[Lens, int] = {}
    views = []
    for number in placed:
        lens = _lens(cameras[number][:3], sizes[number])
        rotation, translation = cameras[number][3:12].reshape(3, 3), cameras[number][12:]
        view = posed_view(
            names[number], lenses.setdefault(lens, len(lenses) + 1), FLIP @ rotation, FLIP @ translation, observations.get(number)
        )
        views.append(view)
    unplaced = num_cameras - len(placed)
    return PoseFile(
        path=path,
        program="Bundler",
        lenses={number: lens for lens, number in lenses.items()},
        views=tuple(views),
        points=points,
        colors=colors,
        notes=(f"{unplaced} of {num_cameras} cameras have no focal length: they are not placed and left out.",) if unplaced else (),
    )


def _lens(values: FloatArray, size_wh: tuple[int, int]) -> Lens:
    f, k1, k2 = (float(value) for value in values)
    return Lens(size_wh=size_wh, fx=f, fy=f, cx=size_wh[0] / 2, cy=size_wh[1] / 2, k=(k1, k2, 0.0, 0.0))


def _names(path: Path) -> list[str]:
    list_path = list_of(path)
    if list_path is None:
        raise BadInput(f"{path} names no photographs, and there is no list.txt beside it: put the list of its photographs there.")
    lines = [line.strip() for line in read_text(list_path).split("\n") if line.strip()]
    return [_name(line) for line in lines]


def _name(line: str) -> str:
    """A line of the list without the 0 and the focal length that may follow the name."""
    words = line.rsplit(maxsplit=2)
    name = words[0] if len(words) == 3 and words[1] == "0" else line
    return name if name.isprintable() else repr(name)


def _size(name: str, size_of: SizeOf, path: Path) -> tuple[int, int]:
    size_wh = size_of(name)
    if size_wh is None:
        raise BadInput(f"{path} needs the size of the photograph {name!r}, which is not there: give the folder of its photographs.")
    return size_wh


def _points(
    words: Iterator[str], num_points: int, sizes: dict[int, tuple[int, int]], path: Path
) -> tuple[FloatArray, NDArray[np.uint8], dict[int, tuple[FloatArray, NDArray[np.int64]]]]:
    xyz: list[FloatArray] = []
    colors: list[FloatArray] = []
    rows: dict[int, list[tuple[int, float, float]]] = {number: [] for number in sizes}
    for row in range(num_points):
        head = _take(words, 7, path)
        xyz.append(head[:3])
        colors.append(head[3:6])
        if not 0 <= head[6] <= MAX_CAMERAS:
            raise BadInput(f"{path}: point {row} is seen {head[6]:g} times: export it again.")
        track = _take(words, 4 * int(head[6]), path).reshape(-1, 4)
        for camera, _, x, y in track:
            if int(camera) in rows:
                rows[int(camera)].append((row, x, y))
            elif not 0 <= camera < MAX_CAMERAS:
                raise BadInput(f"{path}: point {row} is seen by camera {camera:g}: export it again.")
    observations: dict[int, tuple[FloatArray, NDArray[np.int64]]] = {}
    for number, entries in rows.items():
        places = np.array([(x, -y) for _, x, y in entries]).reshape(-1, 2) + np.array(sizes[number]) / 2
        observations[number] = places, np.array([row for row, _, _ in entries], np.int64)
    return np.array(xyz).reshape(-1, 3), np.clip(np.array(colors).reshape(-1, 3), 0, 255).astype(np.uint8), observations


def _take(words: Iterator[str], count: int, path: Path) -> FloatArray:
    """The next numbers of the file."""
    numbers_text = list(islice(words, count))
    try:
        values = np.array([float(word) for word in numbers_text])
    except ValueError as error:
        raise BadInput(f"{path}: {str(error)[:80]}, expected a number: export it again.") from None
    if len(values) != count:
        raise BadInput(f"{path} ends early: {len(values)} of {count} numbers are left where a record stands; copy it again.")
    if not (np.abs(values) < 1e9).all():
        raise BadInput(f"{path} has a number that is not finite or beyond 1e9: export it again.")
    return values
