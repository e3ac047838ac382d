"""Where an exported file lies: in the scene's own metres, or in the system that `--crs` names."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from radiant_app.workers.sources import has_scene, load_scene_of
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.georef.crs import grid_warnings, parse_crs
from radiant_core.georef.given_frame import GIVEN_CRS, GivenFrame, load_given_frame
from radiant_core.georef.reference import Georeference, georeference, local_comments, local_record
from radiant_core.georef.sidecar import save_local_sidecar, save_projection, save_sidecar
from radiant_core.numerics import FloatArray
from radiant_core.survey.run_map import is_system, projected


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

    def lowered(self, shift: FloatArray) -> ExportPlace:
        """The place of a file whose coordinates are larger by `shift` (3,) than those of others."""
        if self.model_frame is not None:
            east, north, up = shift.tolist()
            return replace(self, model_frame=replace(self.model_frame, lowered=(east, north, up)))
        assert self.reference is not None
        near = self.reference.file_from_model
        moved = replace(near, translation=near.translation + shift)
        return replace(self, reference=replace(self.reference, offset=self.reference.offset - shift, file_from_model=moved))

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
            system = None if self.model_frame.crs is None else projected(self.model_frame.crs)
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
    if model_frame is not None and (model_frame.is_default if crs is None else crs != GIVEN_CRS and is_system(crs, model_frame.crs)):
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


def crs_warnings(model: Path, crs: str, *, require_grids: bool) -> tuple[str, ...]:
    """Which grids PROJ lacks for `crs` at the model's scene and what that costs, nothing where it
    lacks none or the scene is nowhere; BadInput where `require_grids`."""
    frame = None if crs == GIVEN_CRS else _frame_of(model)
    if frame is None or frame.kind != "metric":
        return ()
    return grid_warnings(parse_crs(crs), frame.origin_lat_lon_alt[None], require_grids=require_grids)


def _frame_of(model: Path) -> Frame | None:
    return load_scene_of(model).frame if model.is_dir() and has_scene(model) else None
