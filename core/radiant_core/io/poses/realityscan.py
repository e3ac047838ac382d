"""CSV of RealityScan (RealityCapture): internal and external camera parameters. Once per source.

    world from camera = Rz(−heading) Rx(pitch) Ry(roll), OpenGL's axes, degrees; x, y, alt: centre
    f in mm of a 36 mm wide film over the longer side; px, py: shares of it from the middle
    k1 … k4: r² … r⁸; t1, t2: p1, p2

Columns are a template that users change: they go by name, and k*, t*, px, py may lack. The file has
no sizes: those of the photographs are used. Sources: nerfstudio's realitycapture_utils.py, brush's
realitycapture.rs.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.io.poses.fields import read_text
from radiant_core.io.poses.lens import Lens
from radiant_core.io.poses.pose_file import GivenWorld, PosedView, PoseFile, SizeOf, posed_view

FILM_MM = 36.0
NEEDED = ("name", "x", "y", "alt", "heading", "pitch", "roll", "f")
OPTIONAL = ("px", "py", "k1", "k2", "k3", "k4", "t1", "t2")
FLIP = np.diag([1.0, -1.0, -1.0])


def header_of(line: str) -> list[str]:
    """The columns that a line names, in lower case."""
    separator = max(",;\t", key=line.count)
    return [cell.strip().strip('"').lstrip("#").strip().lower() for cell in line.split(separator)]


def is_header(line: str) -> bool:
    """Whether a line is the head of such a table."""
    columns = header_of(line)
    return {"name", "x", "y", "alt"} <= set(columns) and "heading" in columns


def read_realityscan(path: Path, size_of: SizeOf) -> PoseFile:
    """The cameras of a table. Raises BadInput where a column lacks or a photograph is not there,
    whose size is needed."""
    lines = [line for line in read_text(path).splitlines() if line.strip()]
    at = next((number for number, line in enumerate(lines) if is_header(line)), None)
    if at is None:
        raise BadInput(f"{path} has no head with the columns {', '.join(NEEDED)}: export internal and external camera parameters.")
    columns = header_of(lines[at])
    lacking = [name for name in NEEDED if name not in columns]
    if lacking:
        raise BadInput(f"{path} has no column {', '.join(lacking)}: export internal and external camera parameters.")
    separator = max(",;\t", key=lines[at].count)
    lenses: dict[Lens, int] = {}
    views = []
    try:
        table = list(csv.reader(lines[at + 1 :], delimiter=separator))
    except csv.Error as error:
        raise BadInput(f"{path} is no table ({error}): export it again.") from None
    for number, row in enumerate(table, 1):
        if row and row[0].lstrip().startswith("#"):
            continue
        if len(row) != len(columns):
            raise BadInput(f"{path}: row {number} has {len(row)} columns and the head {len(columns)}: export it again.")
        views.append(_view(dict(zip(columns, row, strict=True)), size_of, lenses, f"{path}: row {number}"))
    return PoseFile(
        path=path,
        program="RealityScan",
        lenses={number: lens for lens, number in lenses.items()},
        views=tuple(views),
        points=np.zeros((0, 3)),
        world=GivenWorld(kind="metres"),
    )


def _view(cells: dict[str, str], size_of: SizeOf, lenses: dict[Lens, int], place: str) -> PosedView:
    name = cells["name"].strip()
    if not name or not name.isprintable():
        raise BadInput(f"{place} names no photograph: export it again.")
    values = {key: _number(cells.get(key, ""), f"{place}: {key}") for key in (*NEEDED[1:], *OPTIONAL)}
    size_wh = size_of(name)
    if size_wh is None:
        raise BadInput(f"{place} needs the size of the photograph {name!r}, which is not there: give the folder of its photographs.")
    larger = max(size_wh)
    lens = Lens(
        size_wh=size_wh,
        fx=values["f"] * larger / FILM_MM,
        fy=values["f"] * larger / FILM_MM,
        cx=values["px"] * larger + size_wh[0] / 2,
        cy=values["py"] * larger + size_wh[1] / 2,
        k=(values["k1"], values["k2"], values["k3"], values["k4"]),
        p1=values["t1"],
        p2=values["t2"],
    )
    world_from_gl = Rotation.from_euler("ZXY", [-values["heading"], values["pitch"], values["roll"]], degrees=True).as_matrix()
    rotation = FLIP @ world_from_gl.T
    center = np.array([values["x"], values["y"], values["alt"]])
    return posed_view(name, lenses.setdefault(lens, len(lenses) + 1), rotation, -rotation @ center)


def _number(text: str, place: str) -> float:
    try:
        value = float(text) if text.strip() else 0.0
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e9:
        raise BadInput(f"{place} is {text[:40]!r}, expected a number: export it again.")
    return value
