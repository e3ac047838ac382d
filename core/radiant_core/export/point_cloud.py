"""Points of a surface as LAZ (LAS 1.2, format 2: position, class and colour). Once per export.

Positions are whole multiples of `step` from the middle of the points, so a millimetre at UTM
northings costs four bytes. Class 2 is ground, 1 is not classified (ASPRS). The EPSG codes of the
map and of its heights go into the GeoTIFF keys that LAS 1.2 has for them. Written by laspy with
lazrs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.io.run_store import atomic_path
from radiant_core.numerics import check_array

STEP = 0.001
AT_ONCE = 1 << 20
UNCLASSIFIED, GROUND = 1, 2
_MODEL_TYPE, _PROJECTED_CRS, _PROJECTED, _USER_DEFINED = 1024, 3072, 1, 32767
_LINEAR_UNITS, _VERTICAL_CRS, _VERTICAL_UNITS, _METRE = 3076, 4096, 4099, 9001


def save_laz(
    path: Path,
    points: ArrayLike,
    colors: NDArray[np.uint8],
    is_ground: NDArray[np.bool_],
    epsg: int | None,
    vertical_epsg: int | None = None,
) -> None:
    """Write points (N,3) on the map, their colors (N,3), and which are ground (N,), atomically.

    Raises BadInput without points or where they spread over more than 2,000 km, CannotWrite if it
    fails.
    """
    import laspy

    points = check_array("points", points, (None, 3))
    colors = check_array("colors", colors, (len(points), 3), np.uint8)
    if not len(points):
        raise BadInput("there are no points to write as LAZ: look at the surface model first.")
    middle = np.floor((points.min(axis=0) + points.max(axis=0)) / 2)
    if np.abs(points - middle).max() > STEP * (2**31 - 1):
        raise BadInput("the points spread over more than 2,000 km: they are no survey.")
    header = laspy.LasHeader(version="1.2", point_format=2)
    header.offsets, header.scales = middle, np.full(3, STEP)
    header.generating_software = f"radiant {__version__}"
    header.vlrs.append(_geo_keys(epsg, vertical_epsg))
    with (
        atomic_path(path) as temporary,
        temporary.open("xb") as file,
        laspy.open(file, mode="w", header=header, do_compress=True, closefd=False) as writer,
    ):
        for start in range(0, len(points), AT_ONCE):
            rows = slice(start, start + AT_ONCE)
            record = laspy.ScaleAwarePointRecord.zeros(len(points[rows]), header=header)
            record.x, record.y, record.z = points[rows].T
            # LAS has colours of 16 bits.
            record.red, record.green, record.blue = (colors[rows].astype(np.uint16) * 257).T
            record.classification = np.where(is_ground[rows], GROUND, UNCLASSIFIED).astype(np.uint8)
            writer.write_points(record)


def _geo_keys(epsg: int | None, vertical_epsg: int | None) -> Any:
    from laspy import VLR

    keys = [(_MODEL_TYPE, _PROJECTED if epsg else _USER_DEFINED)]
    if epsg:
        keys += [(_PROJECTED_CRS, epsg), (_LINEAR_UNITS, _METRE)]
    if epsg and vertical_epsg:
        keys += [(_VERTICAL_CRS, vertical_epsg), (_VERTICAL_UNITS, _METRE)]
    directory = [1, 1, 0, len(keys), *(number for key, value in keys for number in (key, 0, 1, value))]
    return VLR(
        user_id="LASF_Projection", record_id=34735, description="GeoKeyDirectoryTag", record_data=np.array(directory, "<u2").tobytes()
    )
