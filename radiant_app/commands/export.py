"""`radiant export`: a run or a model in the files of other programs, and its surface.

Every loss of a format is reported with its figure, such as the 16 bits of a position in SOG.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from radiant_app.commands.clean import measure_support, require_cleaned_model
from radiant_app.commands.export_place import ExportPlace, place_of
from radiant_app.events import Decided, Warned
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.memory import available_bytes
from radiant_core.choices import ExportFormat
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import SupportStep, Surroundings, keeps
from radiant_core.georef.crs import parse_crs
from radiant_core.georef.sidecar import require_no_sidecar
from radiant_core.io.ply import save_ply
from radiant_core.splats import Splats
from radiant_viewer.runs.model_file import load_model

if TYPE_CHECKING:
    from radiant_core.geometry.surface import Surface
    from radiant_core.io.export.geotiff import HeightGrid
    from radiant_core.scene import SfmScene
    from radiant_viewer.runs.cleaned_model import CleanedModel
    from radiant_viewer.runs.run_view import RunView

ENDINGS: dict[str, ExportFormat] = {
    ".ply": "ply", ".spz": "spz", ".sog": "sog", ".geojson": "geojson", ".json": "geojson", ".laz": "laz", ".glb": "glb", ".html": "viewer",
    "": "colmap",
}  # fmt: skip
_WANTED = {
    "ply": (".ply",),
    "spz": (".spz",),
    "sog": (".sog",),
    "geojson": (".geojson", ".json"),
    "mesh": (".ply",),
    "dsm": (".tif", ".tiff"),
    "dtm": (".tif", ".tiff"),
    "contours": (".geojson", ".json"),
    "laz": (".laz",),
    "glb": (".glb",),
    "ortho": (".tif", ".tiff"),
}
_OF_CELLS: tuple[ExportFormat, ...] = ("mesh", "dsm", "dtm", "ortho", "contours", "laz", "glb")

_CLEANED: tuple[ExportFormat, ...] = ("ply", "spz", "sog", "lod")
_LEVELLED: tuple[ExportFormat, ...] = ("lod", "viewer")
MIN_KNOWN = 1 / 9
"""Share of a surface model's cells from which on a cell has one neighbour with a height, or its
own, on the average: with fewer no gap can be told from what was seen."""
_LEVEL = "the middle of the scene's points, not from the sea"
_ADVICE = "what was seen lies scattered: look at it before anything is measured, and try a coarser --resolution, which closes gaps."


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """What to export; resolution (model's unit) is of rasters and meshes, tile_px of rasters."""

    model: Path
    out: Path
    format: ExportFormat | None = None
    resolution: float | None = None
    long_side_px: int = 640
    tile_px: int = 512
    interval: float | None = None
    """Of contours, in the model's unit."""
    clean: bool = False
    """Whether Gaussians that too few photographs constrain go into a file of their own."""
    as_trained: bool = False
    """Whether what the model's cleaning leaves out is written too."""
    crs: str | None = None
    """System of the file's coordinates; None: the scene's own metres, longitude and latitude in
    GeoJSON, the UTM zone in a GeoTIFF."""
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
    if (request.resolution is not None) and kind not in _OF_CELLS:
        raise BadInput(
            f"--resolution is of rasters and meshes, and {kind} is none: leave it out, or add --format {' or '.join(_OF_CELLS)}."
        )
    if request.interval is not None and kind != "contours":
        raise BadInput(f"--interval is of contours, and {kind} has none: leave it out, or add --format contours.")
    if request.clean and kind not in _CLEANED:
        raise BadInput(f"--clean is of a model's Gaussians, and {kind} has none: leave it out, or write {', '.join(_CLEANED)}.")
    if request.crs is not None:
        require_no_sidecar(request.out)
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


def _exported(request: ExportRequest, display: ProgressDisplay) -> tuple[Splats, dict[str, Any]]:
    """The Gaussians to write, and what a cleaning and `clean` left out of them."""
    from radiant_app.commands.steps import require_model

    if request.clean:
        return _without_unconstrained(request, display)
    require_model(request.model)
    model = load_model(request.model, as_trained=request.as_trained)
    return model.splats, _left_out(model)


def _without_unconstrained(request: ExportRequest, display: ProgressDisplay) -> tuple[Splats, dict[str, Any]]:
    """The model by its cleaning and a further step, whose Gaussians go into the side file."""
    run = _run_of(request)
    model = require_cleaned_model(run)
    support = measure_support(run, request.long_side_px, display)
    around = Surroundings(points=run.scene.points, support=lambda: support)
    loose = model.cleaned.kept & ~keeps(SupportStep(), model.whole, around)
    if not loose.any() or (loose == model.cleaned.kept).all():
        said = f"{int(loose.sum()):,} of {len(model.splats):,} Gaussians are unconstrained: nothing is left out."
        display(Warned(stage="clean", message=said))
        return model.splats, {**_left_out(model), "left_out": 0}
    save_ply(request.side_file, model.whole.select(loose))
    shown = support.shown_px
    shares = {"left_out_share_of_pixels": float(f"{shown[loose].sum() / max(shown[model.cleaned.kept].sum(), 1e-9):.3g}")}
    figures = {**_left_out(model), "left_out": int(loose.sum()), **shares, "left_out_file": str(request.side_file)}
    return model.whole.select(model.cleaned.kept & ~loose), figures


def _left_out(model: CleanedModel) -> dict[str, Any]:
    """Nothing of a model without a cleaning."""
    return {"left_out_by_cleaning": model.cleaned.num_left_out} if model.cleaning.steps else {}


def _run_of(request: ExportRequest) -> RunView:
    from radiant_viewer.runs.run_view import load_run_view

    if not request.model.is_dir():
        raise BadInput(f"{request.model} is a model alone: this format needs the cameras of a run, give its folder.")
    return load_run_view(request.model, as_trained=request.as_trained)


def _ply(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    splats, cleaned = _exported(request, display)
    splats, placed = _placed(request, splats)
    save_ply(request.out, splats, placed.comments)
    return {"gaussians": len(splats), **cleaned, **placed.write(request.out)}


def _spz(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.io.export.scene import save_spz
    from radiant_core.io.open3d_formats import SPZ_MEAN_STEP

    splats, cleaned = _exported(request, display)
    splats, placed = _placed(request, splats)
    cuts = save_spz(request.out, splats)
    figures = {"gaussians": len(splats) - cuts.num_left_out, **asdict(cuts), "position_max_error": SPZ_MEAN_STEP}
    return {**figures, **cleaned, **placed.write(request.out)}


def _sog(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_core.io.export.sog import save_sog

    splats, cleaned = _exported(request, display)
    splats, placed = _placed(request, splats)
    figures = {name: float(f"{value:.3g}") for name, value in asdict(save_sog(request.out, splats)).items()}
    return {"gaussians": len(splats), **figures, **cleaned, **placed.write(request.out)}


def _placed(request: ExportRequest, splats: Splats) -> tuple[Splats, ExportPlace]:
    """The Gaussians in the coordinates of the file, and what says where those lie."""
    place = place_of(request.model, request.crs, lambda: splats.means.mean(axis=0))
    return (splats if place.reference is None else place.reference.move(splats)), place


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


def _viewer(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_app.commands.lod_regions import lod_regions
    from radiant_app.commands.steps import stage_bar
    from radiant_app.commands.view import scene_page
    from radiant_app.files.run_folder import create_folder
    from radiant_core.lod.levels import LodLimits
    from radiant_viewer.share.folder import save_page, save_single_page

    splats = None if request.model.is_dir() else load_model(request.model, as_trained=request.as_trained).splats
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
    crs = None if request.crs is None else parse_crs(request.crs)
    save_scene_geojson(request.out, run.scene, run.cloud_plan, run.edge_plans, about, crs)
    return {"regions": sum(len(border) >= 3 for border in run.cloud_plan.borders), "cameras": len(run.scene.cameras)}


def _colmap(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_app.files.run_folder import create_folder
    from radiant_core.io.export.scene import save_colmap

    scene = _scene_without_repeats(_run_of(request), display)
    place = place_of(request.model, request.crs, lambda: scene.cameras.centers.mean(axis=0))
    if place.reference is not None:
        scene = place.reference.move_scene(scene)
    with create_folder(request.out):
        save_colmap(request.out, scene)
    figures = {"cameras": len(scene.cameras), "points": len(scene.points), "observations": len(scene.observations)}
    return {**figures, **place.write(request.out)}


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
    place = place_of(request.model, request.crs, lambda: surface.mesh.vertices.mean(axis=0))
    vertices = surface.mesh.vertices if place.reference is None else place.reference.apply(surface.mesh.vertices)
    save_mesh(request.out, vertices, surface.mesh.triangles, surface.mesh.colors, place.comments)
    return {
        "vertices": len(vertices),
        "triangles": len(surface.mesh.triangles),
        "resolution": round(surface.voxel, 4),
        "unit": run.unit,
        **(_origin_of(run) if place.reference is None else place.write(request.out)),
    }


def _of_surface(name: str) -> Callable[[ExportRequest, ProgressDisplay], dict[str, Any]]:
    """The function `name` of `export_heights`, which imports what it needs when it is called."""

    def write(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
        from radiant_app.commands import export_heights

        surface = export_heights.SurfaceExport(
            model=request.model,
            out=request.out,
            resolution=request.resolution,
            long_side_px=request.long_side_px,
            tile_px=request.tile_px,
            interval=request.interval,
            crs=request.crs,
        )
        return getattr(export_heights, name)(surface, display)

    return write


def _ortho(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    from radiant_app.commands.export_ortho import export_ortho

    return export_ortho(request.model, request.out, request.resolution, request.tile_px, display, request.crs)


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


def _epsg_text(grid: HeightGrid) -> str:
    return f"EPSG:{grid.epsg}" + (f"+{grid.vertical_epsg}" if grid.vertical_epsg else "")


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %"


def _origin_of(run: RunView) -> dict[str, Any]:
    if run.scene.frame.kind != "metric":
        return {}
    lat, lon, alt = run.scene.frame.origin_lat_lon_alt.tolist()
    height = f"{alt:.3f} m" if run.scene.frame.altitude_known else f"heights from {_LEVEL}"
    return {"origin": f"{lat:.9f}, {lon:.9f}, {height}", "axes": "east, north, up"}


_WRITERS: dict[str, Callable[[ExportRequest, ProgressDisplay], dict[str, Any]]] = {
    "ply": _ply, "spz": _spz, "sog": _sog, "lod": _lod, "viewer": _viewer, "geojson": _geojson, "colmap": _colmap, "mesh": _mesh,
    "ortho": _ortho, "dsm": _of_surface("export_dsm"), "dtm": _of_surface("export_dtm"), "contours": _of_surface("export_contours"),
    "laz": _of_surface("export_laz"), "glb": _of_surface("export_glb"),
}  # fmt: skip
