"""The map of a run: the system that is asked for, that of the alignment it was made from, or its
UTM zone. Once per survey, and once per window that shows one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3
from radiant_core.georef.crs import Crs, parse_crs
from radiant_core.georef.given_frame import load_given_frame
from radiant_core.georef.reference import georeference, require_heights, require_placed
from radiant_core.survey.map_grid import MapFrame, map_frame_of

MAX_STRETCH = 0.01
"""Of a raster's system; UTM stretches by 4e-4 within its zone."""


def map_of_run(folder: Path, frame: Frame, crs: str | None = None) -> MapFrame:
    """The map of the run in `folder`; in metres without a place, those of its alignment. BadInput
    where no GeoTIFF can be in the system `crs`, or the frame has no place on the globe."""
    if frame.kind == "metric" or crs is not None:
        return map_frame_of(frame, *_system_of(folder, crs, frame))
    return map_frame_of(frame, map_from_world=local_metres_of(folder, frame))


def local_metres_of(folder: Path, frame: Frame) -> Sim3 | None:
    """What leads from a scene in metres without a place to those of the alignment that it was made
    from; None where they are the same, or it was made from none."""
    model_frame = load_given_frame(folder) if frame.kind == "scaled" else None
    if model_frame is None or not model_frame.is_default or model_frame.is_same:
        return None
    move = model_frame.given_from_scene
    return move if move.scale == 1 and (move.rotation == np.eye(3)).all() else None


def _system_of(folder: Path, crs: str | None, frame: Frame) -> tuple[Crs | None, Sim3 | None]:
    """The system of a run's GeoTIFF, by default that of the alignment that it was made from, and
    the exact way to it from the scene where it is that. None: its UTM zone; raises as
    `grid_crs`."""
    model_frame = load_given_frame(folder)
    named = None if model_frame is None or model_frame.crs is None else projected(model_frame.crs)
    if model_frame is None or model_frame.crs is None or named is None or frame.kind != "metric":
        return None if crs is None else grid_crs(crs, frame), None
    if crs is not None and not is_system(crs, model_frame.crs):
        return grid_crs(crs, frame), None
    if crs is None and (named.horizontal_epsg is None or named.unit_m != 1.0 or named.axes != ("east", "north")):
        # No GeoTIFF can be in such a system: nobody asked for one.
        return None, None
    return grid_crs(model_frame.crs if crs is None else crs, frame), model_frame.given_from_scene


def grid_crs(text: str, frame: Frame) -> Crs:
    """The system of a GeoTIFF or LAZ; BadInput unless EPSG has a code for it, with its datum of
    heights where it has one, and plane and heights count in metres."""
    require_placed(frame)
    crs = parse_crs(text)
    if crs.horizontal_epsg is None or crs.unit_m != 1.0:
        raise BadInput(
            f"a GeoTIFF's grid is in a projected system in metres with an EPSG code: {crs.title} has none or its unit is the {crs.unit}."
        )
    if crs.axes != ("east", "north"):
        raise BadInput(f"a GeoTIFF's columns go east, its rows south, and {crs.title} counts {' and '.join(crs.axes)}: name another one.")
    if crs.height_unit_m != 1.0:
        raise BadInput(f"a GeoTIFF's heights are in metres, and {crs.title} has them in units of 1 {crs.height_unit}: name another datum.")
    if crs.vertical_name and crs.vertical_epsg is None:
        raise BadInput(f"a GeoTIFF names its datum of heights by an EPSG code, and {crs.vertical_name} has none: give EPSG:NNNN+MMMM.")
    require_heights(frame, crs)
    reference = georeference(frame, crs)
    scale = reference.file_from_model.scale
    if abs(scale - 1) > MAX_STRETCH:
        raise BadInput(f"{crs.title} makes {scale:.3g} m of a metre here: name a system made for this place, such as its UTM zone.")
    return reference.crs


def projected(text: str) -> Crs | None:
    """The system that a given frame names; None of one without east and north, as ECEF."""
    try:
        return parse_crs(text)
    except BadInput:
        return None


def is_system(wanted_crs: str, frame_crs: str | None) -> bool:
    """Whether `--crs` names the system of the given frame."""
    system = None if frame_crs is None else projected(frame_crs)
    if system is None:
        return False
    wanted = parse_crs(wanted_crs)
    codes = (wanted.horizontal_epsg, wanted.vertical_epsg)
    return wanted.definition == system.definition or (codes[0] is not None and codes == (system.horizontal_epsg, system.vertical_epsg))
