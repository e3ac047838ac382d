"""The orthophoto of a run as the map's background. Read once per window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.geometry.cleaning_file import cleaning_path
from radiant_core.georef.crs import parse_crs
from radiant_core.io.map_picture import MapPicture, load_map_picture
from radiant_core.survey.map_grid import MapFrame
from radiant_core.survey.run_map import local_metres_of
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
    return map_picture_layer(run / ORTHO, run, frame, height, Layer(name=NAME))


def map_picture_layer(path: Path, run: Path, frame: Frame, height: float, layer: Layer) -> Layer | None:
    """`layer` with the picture of a GeoTIFF and, in its legend, the picture's size; None and
    BadInput as `ortho_layer`."""
    if not path.is_file():
        return None
    picture = load_map_picture(path, MAX_PX)
    if (picture.epsg is None) != (frame.kind != "metric"):
        raise BadInput(f"{path} and the run do not both have a place on the globe: make it anew.")
    system = None if picture.epsg is None else parse_crs(f"EPSG:{picture.epsg}").at(*frame.origin_lat_lon_alt[:2].tolist())
    local = None if picture.epsg is not None else local_metres_of(run, frame)
    map_frame = MapFrame(frame=frame, system=system, map_from_world=local)
    corners = map_frame.to_world(_corners(picture, map_frame, height))
    note = " (older than the model: make it anew)" if _is_outdated(path, run) else ""
    size = LegendEntry(text=f"{picture.image.shape[1]} × {picture.image.shape[0]} px{note}", color=GREY, marker="area")
    return replace(layer, picture=LayerPicture(image=picture.image, corners=corners), legend=(*layer.legend, size))


def _corners(picture: MapPicture, map_frame: MapFrame, height: float) -> np.ndarray:
    """North-west, north-east, south-east, south-west (4,3) of the map."""
    (west, north), (east, south) = picture.north_west, picture.south_east
    altitude = float(map_frame.frame.origin_lat_lon_alt[2])
    level = height + altitude if picture.epsg is not None else float(map_frame.from_world([[0.0, 0.0, height]])[0, 2])
    return np.array([[west, north, level], [east, north, level], [east, south, level], [west, south, level]])


def _is_outdated(path: Path, run: Path) -> bool:
    made_ns = path.stat().st_mtime_ns
    model = run / "scene.ply"
    return any(file.is_file() and file.stat().st_mtime_ns > made_ns for file in (model, cleaning_path(run)))
