"""The points of a PLY file that lies beside an alignment. Once per source."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.ply_elements import read_elements
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
