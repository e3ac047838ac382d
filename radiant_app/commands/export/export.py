"""`radiant export`: a run or a model in the files of other programs, and its surface.

Every loss of a format is reported with its figure, such as the 16 bits of a position in SOG.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from glob import escape as glob_escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from radiant_app.commands.export.levels import export_lod, export_tiles, export_viewer
from radiant_app.commands.export.project import export_colmap, export_nerfstudio
from radiant_app.commands.export.request import OF_HEIGHTS, PLACED, ExportRequest, exported_model, placed, require_options, run_of
from radiant_app.commands.model.place import crs_warnings, place_of
from radiant_app.events import Decided, Warned
from radiant_app.files.out_folder import folder_made_for
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.memory import available_bytes
from radiant_core.choices import ExportFormat
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.georef.crs import parse_crs
from radiant_core.georef.sidecar import require_no_sidecar
from radiant_core.io.ply import save_ply
from radiant_core.numerics import FloatArray

if TYPE_CHECKING:
    from radiant_core.geometry.surface import Surface
    from radiant_viewer.runs.run_view import RunView

ENDINGS: dict[str, ExportFormat] = {
    ".ply": "ply", ".spz": "spz", ".sog": "sog", ".geojson": "geojson", ".json": "geojson", ".laz": "laz", ".glb": "glb", ".html": "viewer",
    ".usd": "usd", ".usdc": "usd", ".usda": "usd", ".usdz": "usd", "": "colmap",
}  # fmt: skip
_WANTED = {
    "ply": (".ply",),
    "spz": (".spz",),
    "sog": (".sog",),
    "usd": (".usdc", ".usd", ".usda", ".usdz"),
    "geojson": (".geojson", ".json"),
    "mesh": (".ply",),
    "dsm": (".tif", ".tiff"),
    "dtm": (".tif", ".tiff"),
    "contours": (".geojson", ".json"),
    "laz": (".laz",),
    "glb": (".glb",),
    "ortho": (".tif", ".tiff"),
}
_SHARING_A_SIDECAR = (*_WANTED["ply"], *_WANTED["spz"], *_WANTED["sog"], *_WANTED["usd"])
SHARE_OF_LIMIT = 0.95
"""Of a millimetre: what float32 rounds comes on top."""
MIN_KNOWN = 1 / 9
"""Share of a surface model's cells from which on a cell has one neighbour with a height, or its
own, on the average: with fewer no gap can be told from what was seen."""
_LEVEL = "the middle of the scene's points, not from the sea"
_ADVICE = "what was seen lies scattered: look at it before anything is measured, and try a coarser --resolution, which closes gaps."


def export(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write the file and return its figures; BadInput names what is missing or already exists."""
    from radiant_app.commands.run.steps import require_file_to_be

    kind = _format_of(request)
    require_file_to_be(request.out)
    require_options(request, kind)
    if request.crs is not None or kind in PLACED:
        require_no_sidecar(request.out)
    if request.crs is not None and kind in PLACED:
        _require_alone(request.out)
    if request.crs is not None:
        for message in crs_warnings(request.model, request.crs, require_grids=request.require_grids):
            display(Warned(stage="export", message=message))
    with folder_made_for(request.out):
        figures = _WRITERS[kind](request, display)
    return {"written": str(request.out), "format": kind, **figures}


def _require_alone(out: Path) -> None:
    """Raise BadInput where the file that says the place of `out` would speak of another one too."""
    others = sorted(path.name for path in out.parent.glob(f"{glob_escape(out.stem)}.*") if path.suffix.lower() in _SHARING_A_SIDECAR)
    if others:
        raise BadInput(f"{others[0]} stands beside it, whose place {out.stem}.georef.json would seem to be: choose another name.")


def _format_of(request: ExportRequest) -> ExportFormat:
    suffix = request.out.suffix.lower()
    kind = request.format or ENDINGS.get(suffix)
    if kind is None and suffix in (".tif", ".tiff"):
        raise BadInput(
            f"{request.out.name} could be a picture or heights: add --format ortho for an orthophoto, or --format dsm for a surface model."
        )
    if kind is None:
        raise BadInput(f"what {request.out.name} is to be is not clear: add --format, one of {', '.join(get_args(ExportFormat))}.")
    wanted = _WANTED.get(kind)
    if wanted is not None and suffix not in wanted:
        raise BadInput(f"{request.out.name} is no name for {kind}: let it end in {' or '.join(wanted)}.")
    return kind


def _ply(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    splats, cleaned = exported_model(request, display)
    splats, place = placed(request, splats)
    save_ply(request.out, splats, place.comments)
    return {"gaussians": len(splats), **cleaned, **place.write(request.out)}


def _spz(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.export.scene import DEFAULT_SPZ_VERSION, save_spz

    splats, cleaned = exported_model(request, display)
    splats, place = placed(request, splats)
    cuts = save_spz(request.out, splats, request.spz_version or DEFAULT_SPZ_VERSION)
    if lost := cuts.sentence():
        display(Warned(stage="export", message=lost))
    counts = {name: value for name, value in asdict(cuts).items() if name.startswith("num_")}
    figures = {"gaussians": len(splats) - cuts.num_left_out, **counts, "position_max_error": cuts.step}
    return {**figures, **cleaned, **place.write(request.out)}


def _sog(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.export.sog import FINE_M, finer_shift, moved_sentence, save_sog

    splats, cleaned = exported_model(request, display)
    splats, place = placed(request, splats)
    shift = np.zeros(3)
    if place.move is not None and len(splats):
        shift = finer_shift(splats.means.astype(np.float64), SHARE_OF_LIMIT * FINE_M / place.unit_m)
        splats, place = replace(splats, means=(splats.means + shift).astype(np.float32)), place.lowered(shift)
    if lost := moved_sentence(splats):
        display(Warned(stage="export", message=lost))
    errors = save_sog(request.out, splats)
    # In the file's unit, which may be a foot.
    errors = replace(errors, position_max_m=errors.position_max_m * place.unit_m)
    if shift.any() or (place.move is not None and errors.position_max_m > FINE_M):
        display(Decided(decision=_sog_decision(errors.position_max_m, shift)))
    figures = {name: float(f"{value:.3g}") for name, value in asdict(errors).items()}
    return {"gaussians": len(splats), **figures, **cleaned, **place.write(request.out)}


def _sog_decision(error_m: float, shift: FloatArray) -> Decision:
    east, north, up = shift
    if shift.any():
        choice, why = f"an offset that is {east:.0f}, {north:.0f}, {up:.0f} less than in other files", "keep a millimetre of them there"
    else:
        choice, why = "the offset of the other files", "keep no millimetre of a scene as wide: PLY does"
    reason = f"SOG has 16 bits for ln(1 + |x|) of a coordinate, which {why}"
    return Decision(stage="export", topic="positions of SOG", choice=choice, figure=1000 * error_m, unit="mm", reason=reason)


def _usd(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.export.usd import save_usd
    from radiant_core.extras import require_extra

    require_extra("usd", "no USD can be written", "write PLY, SPZ or SOG, which need nothing more")
    splats, cleaned = exported_model(request, display)
    splats, place = placed(request, splats)
    save_usd(request.out, splats, place.unit_m, place.comments)
    return {"gaussians": len(splats), **cleaned, **place.write(request.out)}


def _geojson(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.export.scene import save_scene_geojson

    run = run_of(request)
    roles, psnr_db = run.roles, run.psnr_db or {}
    about: dict[str, dict[str, Any]] = {}
    for index, name in enumerate(run.scene.cameras.names):
        edge, device = int(roles.edge_of_camera[index]), int(roles.device_of_camera[index])
        properties = {
            "held_out": bool(roles.held_out[index]),
            "edge": None if edge < 0 else roles.edge_ids[edge],
            "device": None if device < 0 else roles.device_ids[device],
            "psnr_db": psnr_db.get(name),
        }
        about[name] = {key: value for key, value in properties.items() if value is not None}
    crs = None if request.crs is None else parse_crs(request.crs)
    save_scene_geojson(request.out, run.scene, run.cloud_plan, run.edge_plans, about, crs)
    return {"regions": sum(len(border) >= 3 for border in run.cloud_plan.borders), "cameras": len(run.scene.cameras)}


def _mesh(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.export.mesh_ply import save_mesh

    surface, run = _surface(request, display)
    if surface.most_covered < MIN_KNOWN:
        text = f"its triangles could cover {_percent(surface.most_covered)} of the ground at most; {_ADVICE}"
        display(Warned(stage="surface", message=text))
    place = place_of(request.model, request.crs)
    vertices = surface.mesh.vertices if place.move is None else place.move.apply(surface.mesh.vertices)
    save_mesh(request.out, vertices, surface.mesh.triangles, surface.mesh.colors, place.comments)
    return {
        "vertices": len(vertices),
        "triangles": len(surface.mesh.triangles),
        "resolution": round(surface.voxel / place.unit_m, 4),
        "unit": run.unit if place.reference is None else place.reference.crs.unit,
        **(_origin_of(run) if place.move is None else place.write(request.out)),
    }


def _heights(kind: ExportFormat) -> Callable[[ExportRequest, ProgressDisplay], dict[str, Any]]:
    """Writes one of `OF_HEIGHTS`; what it needs is imported when it is called."""

    def write(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
        from radiant_app.commands.export.heights import WRITERS

        return WRITERS[kind](request, display)

    return write


def _ortho(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_app.commands.export.ortho import export_ortho

    return export_ortho(request, display)


def _surface(request: ExportRequest, display: ProgressDisplay) -> tuple[Surface, RunView]:
    from radiant_app.commands.run.steps import stage_bar
    from radiant_core.geometry.surface import extract_surface
    from radiant_viewer.runs.run_view import require_splats

    run = run_of(request)
    splats = require_splats(run)
    with stage_bar(display, "surface") as report:
        surface = extract_surface(
            splats,
            run.scene.cameras,
            resolution=request.resolution,
            long_side_px=request.pictures_px,
            memory_bytes=available_bytes(),
            scratch=request.out.parent,
            report=lambda num_done, total: report(num_done, total, "views"),
        )
    if surface.voxel > surface.finest_voxel:
        display(Decided(decision=_resolution_decision(surface, run.unit)))
    return surface, run


def _resolution_decision(surface: Surface, unit: str) -> Decision:
    return Decision(
        stage="surface",
        topic="resolution",
        choice=f"cells of {surface.voxel:.3g} {unit}",
        figure=surface.finest_voxel,
        unit=unit,
        reason=f"two pixels of the photographs are {surface.finest_voxel:.3g} {unit}, which takes more memory than is free",
    )


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _origin_of(run: RunView) -> dict[str, Any]:
    if run.scene.frame.kind != "metric":
        return {}
    lat, lon, alt = run.scene.frame.origin_lat_lon_alt.tolist()
    height = f"{alt:.3f} m" if run.scene.frame.altitude_known else f"heights from {_LEVEL}"
    return {"origin": f"{lat:.9f}, {lon:.9f}, {height}", "axes": "east, north, up"}


_WRITERS: dict[str, Callable[[ExportRequest, ProgressDisplay], dict[str, Any]]] = {
    "ply": _ply,
    "spz": _spz,
    "sog": _sog,
    "usd": _usd,
    "geojson": _geojson,
    "colmap": export_colmap,
    "nerfstudio": export_nerfstudio,
    "mesh": _mesh,
    "ortho": _ortho,
    "lod": export_lod,
    "tiles": export_tiles,
    "viewer": export_viewer,
    **{kind: _heights(kind) for kind in OF_HEIGHTS},
}
