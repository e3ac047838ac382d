"""Where an exported file lies: in the scene's own metres, or in the system that `--crs` names."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from radiant_app.workers.sources import has_scene, load_scene_of
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3
from radiant_core.georef.crs import Crs, grid_warnings, parse_crs
from radiant_core.georef.given_frame import GIVEN_CRS, GivenFrame, load_given_frame
from radiant_core.georef.reference import Georeference, georeference, local_comments, local_record, require_heights, require_placed
from radiant_core.georef.sidecar import save_local_sidecar, save_projection, save_sidecar

MAX_STRETCH = 0.01
"""Of a raster's system; UTM stretches by 4e-4 within its zone."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ExportPlace:
    """What is known of a file's coordinates."""

    comments: tuple[str, ...] = ()
    """For the header of a PLY."""
    reference: Georeference | None = None
    """How the scene becomes coordinates of `--crs`; None without it."""
    frame: Frame | None = None
    """Of the scene, None of a model without one."""
    model_frame: GivenFrame | None = None
    """How the scene becomes coordinates of the given model; None unless asked for."""

    @property
    def move(self) -> Georeference | GivenFrame | None:
        """What moves the scene; None where it stays."""
        return self.reference or self.model_frame

    @property
    def unit_m(self) -> float:
        """Metres of the file's unit; 1 where it is the scene's."""
        return 1.0 if self.reference is None else self.reference.crs.unit_m or 1.0

    def _local_record(self) -> dict[str, Any]:
        """Where on the globe a scene in the given frame lies, if that is known."""
        if self.frame is None or self.frame.kind != "metric":
            return {}
        return {"origin_lat_lon_alt": self.frame.origin_lat_lon_alt.tolist()}

    def write_local(self, out: Path) -> dict[str, Any]:
        """Write beside a file in the scene's own metres where on the globe those lie, if that is
        known; figures for the command line."""
        if self.frame is None or self.frame.kind != "metric":
            return {}
        return {"georeference": save_local_sidecar(out, local_record(self.frame)).name}

    def write(self, out: Path) -> dict[str, Any]:
        """Write what stands beside the file; figures for the command line."""
        if self.model_frame is not None:
            written = [save_local_sidecar(out, {**self.model_frame.record(), **self._local_record()})]
            system = None if self.model_frame.crs is None else _projected(self.model_frame.crs)
            if system is not None:
                written.append(save_projection(out, system))
            offset = ", ".join(f"{value:.10g}" for value in self.model_frame.offset)
            named = "" if self.model_frame.crs is None else f" ({self.model_frame.crs if system is None else system.title})"
            about = {"crs": f"that of {self.model_frame.model}{named}", "offset": f"{offset} (add it to the file's coordinates)"}
            return {**about, "georeference": ", ".join(path.name for path in written)}
        if self.reference is None:
            return {}
        written = save_sidecar(out, self.reference)
        offset = ", ".join(f"{value:.10g}" for value in self.reference.offset)
        return {
            "crs": self.reference.crs.title,
            "offset": f"{offset} (add it to the file's coordinates)",
            "heights": self.reference.crs.heights,
            "georeference": ", ".join(path.name for path in written),
        }


def place_of(model: Path, crs: str | None) -> ExportPlace:
    """What to write of a model's place; BadInput where the scene has none, or the model is a file
    without a scene."""
    frame = _frame_of(model)
    model_frame = load_given_frame(model) if model.is_dir() else None
    if model_frame is not None and (model_frame.is_default if crs is None else crs != GIVEN_CRS and _is_system(crs, model_frame.crs)):
        # What is asked for is the given frame itself, which no map has to bend.
        return ExportPlace(comments=model_frame.comments(), model_frame=model_frame, frame=frame)
    if crs == GIVEN_CRS:
        if model_frame is None:
            raise BadInput(
                f"{model} was made from no given model: --crs {GIVEN_CRS} needs the folder of a run or scene of a COLMAP project or of "
                "another alignment."
            )
        return ExportPlace(comments=model_frame.comments(), model_frame=model_frame)
    if crs is None:
        return ExportPlace(comments=() if frame is None else local_comments(frame), frame=frame)
    if frame is None:
        raise BadInput(f"{model} is a model without a scene that says where it lies: --crs needs the folder of a run.")
    reference = georeference(frame, parse_crs(crs))
    return ExportPlace(comments=reference.comments(), reference=reference)


def _projected(text: str) -> Crs | None:
    """The system that a given frame names; None of one without east and north, as ECEF."""
    try:
        return parse_crs(text)
    except BadInput:
        return None


def _is_system(wanted_crs: str, frame_crs: str | None) -> bool:
    """Whether `--crs` names the system of the given frame."""
    system = None if frame_crs is None else _projected(frame_crs)
    if system is None:
        return False
    wanted = parse_crs(wanted_crs)
    codes = (wanted.horizontal_epsg, wanted.vertical_epsg)
    return wanted.definition == system.definition or (codes[0] is not None and codes == (system.horizontal_epsg, system.vertical_epsg))


def crs_warnings(model: Path, crs: str, *, require_grids: bool) -> tuple[str, ...]:
    """Which grids PROJ lacks for `crs` at the model's scene and what that costs, nothing where it
    lacks none or the scene is nowhere; BadInput where `require_grids`."""
    frame = None if crs == GIVEN_CRS else _frame_of(model)
    if frame is None or frame.kind != "metric":
        return ()
    return grid_warnings(parse_crs(crs), frame.origin_lat_lon_alt[None], require_grids=require_grids)


def grid_system(folder: Path, crs: str | None, frame: Frame) -> tuple[Crs | None, Sim3 | None]:
    """The system of a run's GeoTIFF, by default that of the alignment that it was made from, and
    the exact way to it from the scene where it is that. None: its UTM zone; raises as
    `grid_crs`."""
    model_frame = load_given_frame(folder)
    named = None if model_frame is None or model_frame.crs is None else _projected(model_frame.crs)
    if model_frame is None or model_frame.crs is None or named is None or frame.kind != "metric":
        return None if crs is None else grid_crs(crs, frame), None
    if crs is not None and not _is_system(crs, model_frame.crs):
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


def _frame_of(model: Path) -> Frame | None:
    return load_scene_of(model).frame if model.is_dir() and has_scene(model) else None
