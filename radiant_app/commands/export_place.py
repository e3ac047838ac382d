"""Where an exported file lies: in the scene's own metres, or in the system that `--crs` names."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from radiant_app.workers.sources import has_scene, load_scene_of
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.georef.crs import Crs, parse_crs
from radiant_core.georef.given_frame import GIVEN, GivenFrame, load_given_frame
from radiant_core.georef.reference import Georeference, georeference, local_comments, local_record, require_placed
from radiant_core.georef.sidecar import save_local_sidecar, save_sidecar

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
    given: GivenFrame | None = None
    """How the scene becomes coordinates of the given model; None unless asked for."""

    @property
    def move(self) -> Georeference | GivenFrame | None:
        """What moves the scene; None where it stays."""
        return self.reference or self.given

    def write_local(self, out: Path) -> dict[str, Any]:
        """Write beside a file in the scene's own metres where on the globe those lie, if that is
        known; figures for the command line."""
        if self.frame is None or self.frame.kind != "metric":
            return {}
        return {"georeference": save_local_sidecar(out, local_record(self.frame)).name}

    def write(self, out: Path) -> dict[str, Any]:
        """Write what stands beside the file; figures for the command line."""
        if self.given is not None:
            written = save_local_sidecar(out, self.given.record())
            offset = ", ".join(f"{value:.10g}" for value in self.given.offset)
            about = {"crs": f"that of {self.given.model}", "offset": f"{offset} (add it to the file's coordinates)"}
            return {**about, "georeference": written.name}
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
    if crs == GIVEN:
        given = load_given_frame(model) if model.is_dir() else None
        if given is None:
            raise BadInput(f"{model} was made from no given model: --crs {GIVEN} needs the folder of a run or scene of a COLMAP project.")
        return ExportPlace(comments=given.comments(), given=given)
    if crs is None:
        return ExportPlace(comments=() if frame is None else local_comments(frame), frame=frame)
    if frame is None:
        raise BadInput(f"{model} is a model without a scene that says where it lies: --crs needs the folder of a run.")
    reference = georeference(frame, parse_crs(crs))
    return ExportPlace(comments=reference.comments(), reference=reference)


def grid_crs(text: str, frame: Frame) -> Crs:
    """The system of a GeoTIFF; BadInput unless EPSG has a code for it and it counts in metres."""
    require_placed(frame)
    crs = parse_crs(text)
    if crs.horizontal_epsg is None or crs.unit != "metre":
        raise BadInput(
            f"a GeoTIFF's grid is in a projected system in metres with an EPSG code: {crs.title} has none or its unit is the {crs.unit}."
        )
    if crs.vertical_epsg is not None and not frame.altitude_known:
        raise BadInput(f"the scene's heights count from no datum and {crs.title} has one: name the system without its vertical part.")
    scale = georeference(frame, crs).file_from_model.scale
    if abs(scale - 1) > MAX_STRETCH:
        raise BadInput(f"{crs.title} makes {scale:.3g} m of a metre here: name a system made for this place, such as its UTM zone.")
    return crs


def _frame_of(model: Path) -> Frame | None:
    return load_scene_of(model).frame if model.is_dir() and has_scene(model) else None
