"""The orthophoto of a run as the map's background. Read once per window."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.geometry.cleaning_file import cleaning_path
from radiant_core.georef.crs import parse_crs
from radiant_core.io.map_picture import MapPicture, load_map_picture
from radiant_core.survey.map_grid import MapFrame
from radiant_viewer.layers.layer import Layer, LayerPicture, LegendEntry
from radiant_viewer.layers.palette import GREY

NAME = "Orthophoto"
ORTHO = "survey/ortho.tif"
"""Its file in the folder of a run."""
MAX_PX = 4096
"""Of the picture on the graphics card: 64 MiB."""


def ortho_layer(run: Path, frame: Frame, height: float) -> Layer | None:
    """The layer of a run's orthophoto at the `height` of its ground; None where it has none,
    BadInput where that cannot be read or lies elsewhere."""
    path = run / ORTHO
    if not path.is_file():
        return None
    picture = load_map_picture(path, MAX_PX)
    if (picture.epsg is None) != (frame.kind != "metric"):
        raise BadInput(f"{path} and the run do not both have a place on the globe: make the orthophoto anew.")
    system = None if picture.epsg is None else parse_crs(f"EPSG:{picture.epsg}").at(*frame.origin_lat_lon_alt[:2].tolist())
    corners = MapFrame(frame=frame, system=system).to_world(_corners(picture, frame, height))
    note = " (older than the model: make it anew)" if _is_outdated(path, run) else ""
    return Layer(
        name=NAME,
        picture=LayerPicture(image=picture.image, corners=corners),
        legend=(LegendEntry(text=f"{picture.image.shape[1]} × {picture.image.shape[0]} px{note}", color=GREY, marker="area"),),
    )


def _corners(picture: MapPicture, frame: Frame, height: float) -> np.ndarray:
    """North-west, north-east, south-east, south-west (4,3) of the map."""
    (west, north), (east, south) = picture.north_west, picture.south_east
    level = height + (float(frame.origin_lat_lon_alt[2]) if picture.epsg is not None else 0.0)
    return np.array([[west, north, level], [east, north, level], [east, south, level], [west, south, level]])


def _is_outdated(path: Path, run: Path) -> bool:
    made_ns = path.stat().st_mtime_ns
    model = run / "scene.ply"
    return any(file.is_file() and file.stat().st_mtime_ns > made_ns for file in (model, cleaning_path(run)))
