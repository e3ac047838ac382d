"""`radiant export`: a run or a model in the files of other programs, and its surface.

Every loss of a format is reported with its figure, such as the 16 bits of a position in SOG.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from radiant_app.events import Decided, Warned
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.memory import available_bytes
from radiant_core.choices import ExportFormat
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import load_splats
from radiant_core.splats import Splats

if TYPE_CHECKING:
    from radiant_core.geometry.surface import Surface
    from radiant_core.scene import SfmScene
    from radiant_viewer.runs.run_view import RunView

ENDINGS: dict[str, ExportFormat] = {
    ".ply": "ply", ".spz": "spz", ".sog": "sog", ".geojson": "geojson", ".json": "geojson", ".tif": "dsm", ".tiff": "dsm",
    ".html": "viewer", "": "colmap",
}  # fmt: skip
_WANTED = {
    "ply": (".ply",),
    "spz": (".spz",),
    "sog": (".sog",),
    "geojson": (".geojson", ".json"),
    "mesh": (".ply",),
    "dsm": (".tif", ".tiff"),
}

_CLEANED: tuple[ExportFormat, ...] = ("ply", "spz", "sog", "lod", "tiles")
_LEVELLED: tuple[ExportFormat, ...] = ("lod", "tiles", "viewer")
MIN_KNOWN = 1 / 9
"""Share of a surface model's cells from which on a cell has one neighbour with a height, or its
own, on the average: with fewer no gap can be told from what was seen."""
_LEVEL = "the middle of the scene's points, not from the sea"
_ADVICE = "what was seen lies scattered: look at it before anything is measured, and try a coarser --resolution, which closes gaps."


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """What to export; resolution (model's unit) and long_side_px are of mesh and surface model."""

    model: Path
    out: Path
    format: ExportFormat | None = None
    resolution: float | None = None
    long_side_px: int = 640
    clean: bool = False
    """Whether Gaussians that too few photographs constrain go into a file of their own."""
    num_levels: int | None = None
    """Levels of detail; None: by the number of Gaussians."""
    regions: tuple[Path, ...] = ()
    """Runs whose regions chunks belong to, of a model that is no run."""
    photographs: bool = False
    """Whether the page of a run shows its worst photographs beside the model."""

    @property
    def side_file(self) -> Path:
        """Where `clean` puts them."""
        return self.out.with_name(f"{self.out.stem}_unconstrained.ply")


def export(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write the file and return its figures; BadInput names what is missing or already exists."""
    kind = _format_of(request)
    if request.out.exists():
        raise BadInput(f"{request.out} exists: choose another name.")
    if not request.out.parent.is_dir():
        raise BadInput(f"there is no folder {request.out.parent} to write {request.out.name} into: make it first.")
    if (request.resolution is not None) and kind not in ("mesh", "dsm"):
        raise BadInput(f"--resolution is of a mesh or surface model, and {kind} has none: leave it out, or add --format mesh or dsm.")
    if request.clean and kind not in _CLEANED:
        raise BadInput(f"--clean is of a model's Gaussians, and {kind} has none: leave it out, or write {', '.join(_CLEANED)}.")
    if (request.num_levels is not None or request.regions) and kind not in _LEVELLED:
        raise BadInput(f"--levels and --regions are of levels of detail, and {kind} has none: leave them out, or add --lod.")
    if request.photographs and kind != "viewer":
        raise BadInput(f"--photographs is of a page, and {kind} has none: leave it out, or add --format viewer.")
    if request.clean and request.side_file.exists():
        raise BadInput(f"{request.side_file} exists, where --clean would put what it takes out: choose another name.")
    figures = _WRITERS[kind](request, display)
    return {"written": str(request.out), "format": kind, **figures}


def _format_of(request: ExportRequest) -> ExportFormat:
    suffix = request.out.suffix.lower()
    kind = request.format or ENDINGS.get(suffix)
    if kind is None:
        raise BadInput(f"what {request.out.name} is to be is not clear: add --format, one of {', '.join(get_args(ExportFormat))}.")
    wanted = _WANTED.get(kind)
    if wanted is not None and suffix not in wanted:
        raise BadInput(f"{request.out.name} is no name for {kind}: let it end in {' or '.join(wanted)}.")
    return kind


def _splats_of(model: Path) -> Splats:
    from radiant_app.commands.steps import require_model

    if model.is_dir():
        require_model(model)
        return load_ply(model / "scene.ply")
    if model.suffix == ".safetensors":
        return load_splats(model)
    if model.suffix == ".ply":
        return load_ply(model)
    if model.suffix == ".sog" or model.name in ("meta.json", "lod-meta.json"):
        from radiant_core.io.lod_reader import load_lod_level
        from radiant_core.io.sog_reader import load_sog

        return load_lod_level(model) if model.name == "lod-meta.json" else load_sog(model)
    raise BadInput(f"{model} is neither a run folder nor a model.safetensors, .ply, .sog or lod-meta.json: give one of these.")


def _exported(request: ExportRequest, display: ProgressDisplay) -> tuple[Splats, dict[str, Any]]:
    """The Gaussians to write, and what `clean` took out of them: both together are the model."""
    splats = _splats_of(request.model)
    if not request.clean:
        return splats, {}
    from radiant_app.commands.steps import stage_bar
    from radiant_core.evaluate.support import support_of
    from radiant_core.geometry.support import unconstrained

    run = _run_of(request)
    trained = [row for row, name in enumerate(run.scene.cameras.names) if name not in run.held_out]
    with stage_bar(display, "clean") as report:
        cameras = run.scene.cameras.select(np.array(trained, np.int64)).scaled(request.long_side_px)
        support = support_of(splats, cameras, report=lambda done, total: report(done, total, "views"))
    loose = unconstrained(splats, support, run.scene.points)
    if not loose.any() or loose.all():
        display(Warned(stage="clean", message=f"{int(loose.sum()):,} of {len(loose):,} Gaussians are unconstrained: nothing is left out."))
        return splats, {"left_out": 0}
    save_ply(request.side_file, splats.select(loose))
    shares = {"left_out_share_of_pixels": float(f"{support.shown_px[loose].sum() / max(support.shown_px.sum(), 1e-9):.3g}")}
    return splats.select(~loose), {"left_out": int(loose.sum()), **shares, "left_out_file": str(request.side_file)}


def _run_of(request: ExportRequest) -> RunView:
    from radiant_viewer.runs.run_view import load_run_view

    if not request.model.is_dir():
        raise BadInput(f"{request.model} is a model alone: this format needs the cameras of a run, give its folder.")
    return load_run_view(request.model)


def _ply(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    splats, cleaned = _exported(request, display)
    save_ply(request.out, splats)
    return {"gaussians": len(splats), **cleaned}


def _spz(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.io.export.scene import save_spz
    from radiant_core.io.open3d_formats import SPZ_MEAN_STEP

    splats, cleaned = _exported(request, display)
    cuts = save_spz(request.out, splats)
    return {"gaussians": len(splats) - cuts.num_left_out, **asdict(cuts), "position_max_error": SPZ_MEAN_STEP, **cleaned}


def _sog(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.io.export.sog import save_sog

    splats, cleaned = _exported(request, display)
    figures = {name: float(f"{value:.3g}") for name, value in asdict(save_sog(request.out, splats)).items()}
    return {"gaussians": len(splats), **figures, **cleaned}


def _lod(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_app.commands.lod_regions import lod_regions
    from radiant_app.commands.steps import stage_bar
    from radiant_app.files.run_folder import create_folder
    from radiant_core.io.export.lod import save_lod
    from radiant_core.lod.levels import LodLimits

    splats, cleaned = _exported(request, display)
    regions = lod_regions(request.model, splats, request.regions)
    with create_folder(request.out), stage_bar(display, "levels") as report:
        figures = save_lod(
            request.out,
            splats,
            regions,
            LodLimits(num_levels=request.num_levels),
            lambda done, total: report(done, total, "Gaussians"),
        )
    errors = {name: float(f"{value:.3g}") for name, value in asdict(figures.errors).items()}
    levels = {"levels": ", ".join(f"{count:,}" for count in figures.counts), "far_field": figures.num_far, "chunks": figures.num_chunks}
    return {"gaussians": len(splats), **levels, **errors, **cleaned}


def _tiles(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_app.commands.lod_regions import lod_regions
    from radiant_app.commands.steps import stage_bar
    from radiant_app.files.run_folder import create_folder
    from radiant_core.io.export.tiles import TILE_LIMITS, save_tiles

    splats, cleaned = _exported(request, display)
    regions = lod_regions(request.model, splats, request.regions)
    frame = _run_of(request).scene.frame if request.model.is_dir() else None
    if frame is None or frame.kind != "metric":
        display(Warned(stage="export", message="no GPS says where the model lies: the tiles have no place on the globe."))
    with create_folder(request.out), stage_bar(display, "tiles") as report:
        counts = save_tiles(
            request.out,
            splats,
            regions,
            frame,
            replace(TILE_LIMITS, num_levels=request.num_levels),
            lambda done, total: report(done, total, "Gaussians"),
        )
    return {"gaussians": len(splats), "levels": ", ".join(f"{count:,}" for count in counts), **cleaned}


def _viewer(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_app.commands.lod_regions import lod_regions
    from radiant_app.commands.steps import stage_bar
    from radiant_app.commands.view import scene_page
    from radiant_app.files.run_folder import create_folder
    from radiant_core.lod.levels import LodLimits
    from radiant_viewer.share.folder import save_page, save_single_page

    splats = None if request.model.is_dir() else _splats_of(request.model)
    page = scene_page(request.model, splats, with_photographs=request.photographs)
    shown = {"gaussians": len(page.splats), "places": len(page.places), "photographs": len(page.pairs)}
    if request.out.suffix.lower() == ".html":
        if request.num_levels is not None or request.regions:
            raise BadInput("--levels and --regions are of a folder, and one file has no levels: leave them out.")
        return {**shown, "bytes": save_single_page(request.out, page)}
    regions, limits = lod_regions(request.model, page.splats, request.regions), LodLimits(num_levels=request.num_levels)
    with create_folder(request.out), stage_bar(display, "page") as report:
        figures = save_page(request.out, page, regions, limits, lambda done, total: report(done, total, "Gaussians"))
    return {**shown, "levels": ", ".join(f"{count:,}" for count in figures.counts), "open": "on any static host: index.html"}


def _geojson(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.io.export.scene import save_scene_geojson

    run = _run_of(request)
    roles, psnr_db = run.roles, run.psnr_db or {}
    about: dict[str, dict[str, Any]] = {}
    for index, name in enumerate(run.scene.cameras.names):
        edge, device = int(roles.edge_of_camera[index]), int(roles.device_of_camera[index])
        known = {
            "held_out": bool(roles.held_out[index]),
            "edge": None if edge < 0 else roles.edge_ids[edge],
            "device": None if device < 0 else roles.device_ids[device],
            "psnr_db": psnr_db.get(name),
        }
        about[name] = {key: value for key, value in known.items() if value is not None}
    save_scene_geojson(request.out, run.scene, run.cloud_plan, run.edge_plans, about)
    return {"regions": sum(len(border) >= 3 for border in run.cloud_plan.borders), "cameras": len(run.scene.cameras)}


def _colmap(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_app.files.run_folder import create_folder
    from radiant_core.io.export.scene import save_colmap

    scene = _scene_without_repeats(_run_of(request), display)
    with create_folder(request.out):
        save_colmap(request.out, scene)
    return {"cameras": len(scene.cameras), "points": len(scene.points), "observations": len(scene.observations)}


def _scene_without_repeats(run: RunView, display: ProgressDisplay) -> SfmScene:
    """The scene; without copies of photographs unless it is a run's, as training takes it."""
    from radiant_core.sfm.copies import without_repeats
    from radiant_viewer.runs.unplanned import unplanned_photographs

    photographs = None if run.kind == "run" else unplanned_photographs(run.folder)
    if photographs is None or not photographs.is_dir():
        return run.scene
    scene, warnings = without_repeats(run.scene, photographs)
    for message in warnings:
        display(Warned(stage="export", message=message))
    return scene


def _mesh(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.io.export.mesh_ply import save_mesh

    surface, run = _surface(request, display)
    if surface.most_covered < MIN_KNOWN:
        text = f"its triangles could cover {_percent(surface.most_covered)} of the ground at most; {_ADVICE}"
        display(Warned(stage="surface", message=text))
    save_mesh(request.out, surface.mesh.vertices, surface.mesh.triangles, surface.mesh.colors)
    return {
        "vertices": len(surface.mesh.vertices),
        "triangles": len(surface.mesh.triangles),
        "resolution": round(surface.voxel, 4),
        "unit": run.unit,
        **_origin_of(run),
    }


def _dsm(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.geometry.surface import surface_grid
    from radiant_core.io.export.geotiff import NO_DATA, save_geotiff

    surface, run = _surface(request, display)
    grid = surface_grid(surface, run.scene.frame)
    if grid.known < MIN_KNOWN:
        text = f"only {_percent(grid.known)} of {grid.heights.size:,} cells have a height; {_ADVICE}"
        display(Warned(stage="surface", message=text))
    save_geotiff(request.out, grid)
    if not run.scene.frame.altitude_known:
        display(Warned(stage="surface", message=f"GPS has no altitude: heights count from {_LEVEL}."))
    height, width = grid.heights.shape
    return {
        "crs": "none, the model's own coordinates" if grid.epsg is None else f"EPSG:{grid.epsg}",
        "cells": f"{width} x {height}",
        "resolution": round(grid.cell, 4),
        "unit": run.unit,
        "known": float(f"{grid.known:.4g}"),
        "no_data": NO_DATA,
        "lowest": round(float(np.nanmin(grid.heights)), 3),
        "highest": round(float(np.nanmax(grid.heights)), 3),
    }


def _surface(request: ExportRequest, display: ProgressDisplay) -> tuple[Surface, RunView]:
    from radiant_app.commands.steps import stage_bar
    from radiant_core.geometry.surface import extract_surface
    from radiant_viewer.runs.run_view import require_splats

    run = _run_of(request)
    splats = require_splats(run)
    with stage_bar(display, "surface") as report:
        surface = extract_surface(
            splats,
            run.scene.cameras,
            resolution=request.resolution,
            long_side_px=request.long_side_px,
            memory_bytes=available_bytes(),
            scratch=request.out.parent,
            report=lambda done, total: report(done, total, "views"),
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
    "ply": _ply, "spz": _spz, "sog": _sog, "lod": _lod, "tiles": _tiles, "viewer": _viewer, "geojson": _geojson,
    "colmap": _colmap, "mesh": _mesh, "dsm": _dsm,
}  # fmt: skip
