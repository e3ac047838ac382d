"""What is exported: a model by its cleaning, placed in the coordinates of the file, and the
options that belong to its format; others are refused before anything takes minutes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiant_app.commands.model.clean import measure_support, require_cleaned_model
from radiant_app.commands.model.given_model import given_model
from radiant_app.commands.model.place import ExportPlace, place_of
from radiant_app.events import Decided, Warned
from radiant_app.report.progress import ProgressDisplay
from radiant_core.choices import ExportFormat, SpzVersion, TileContent
from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import SupportStep, Surroundings, keeps
from radiant_core.georef.given_frame import GIVEN_CRS
from radiant_core.io.ply import save_ply
from radiant_core.splats import Splats

if TYPE_CHECKING:
    from radiant_viewer.runs.cleaned_model import CleanedModel
    from radiant_viewer.runs.run_view import RunView

OF_HEIGHTS: tuple[ExportFormat, ...] = ("dsm", "dtm", "contours", "laz", "glb")
OF_CELLS: tuple[ExportFormat, ...] = ("mesh", "ortho", *OF_HEIGHTS)
RASTERS: tuple[ExportFormat, ...] = ("dsm", "dtm", "ortho")
CLEANED: tuple[ExportFormat, ...] = ("ply", "spz", "sog", "usd", "lod", "tiles")
PLACED: tuple[ExportFormat, ...] = ("ply", "spz", "sog", "usd", "mesh", "colmap", "nerfstudio")
"""What a file beside it says the place of."""
LEVELLED: tuple[ExportFormat, ...] = ("lod", "tiles", "viewer")


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """What to export; resolution (model's unit) is of rasters and meshes, tile_px of rasters."""

    model: Path
    out: Path
    format: ExportFormat | None = None
    resolution: float | None = None
    long_side_px: int | None = None
    """Of the pictures that a surface or `clean` is measured on; None: 640."""
    tile_px: int | None = None
    """Side of a raster's tiles; None: 512."""
    interval: float | None = None
    """Of contours, in the model's unit."""
    clean: bool = False
    """Whether Gaussians that too few photographs constrain go into a file of their own."""
    as_trained: bool = False
    """Whether what the model's cleaning leaves out is written too."""
    surroundings: bool | None = None
    """Whether what lies around the scene is written; None: into files of the model, not into a
    page."""
    crs: str | None = None
    """System of the file's coordinates; None: the scene's own metres, longitude and latitude in
    GeoJSON, the UTM zone in a GeoTIFF."""
    require_grids: bool = False
    """Whether a system whose best transformation lacks a grid is refused, not warned of."""
    num_levels: int | None = None
    """Levels of detail; None: by the number of Gaussians."""
    fit_levels: bool | None = None
    """Whether coarser levels are fitted to pictures of the finest; None: if that is soon done."""
    regions: tuple[Path, ...] = ()
    """Runs whose regions chunks belong to, of a model that is no run."""
    tile_form: TileContent | None = None
    """Of 3D Tiles; None: spz."""
    spz_version: SpzVersion | None = None
    """Of SPZ files; None: 2."""
    photographs: bool = False
    """Whether the page of a run shows its worst photographs beside the model."""

    @property
    def pictures_px(self) -> int:
        """Long side of the pictures that a surface or `clean` is measured on."""
        return self.long_side_px or 640

    @property
    def tiles_px(self) -> int:
        """Side of a raster's tiles."""
        return self.tile_px or 512

    @property
    def side_file(self) -> Path:
        """Where `clean` puts them."""
        return self.out.with_name(f"{self.out.stem}_unconstrained.ply")


def require_options(request: ExportRequest, kind: ExportFormat) -> None:
    """Raise BadInput for an option that the format does not have, or a value that none can have."""
    _require_cells(request, kind)
    _require_system(request, kind)
    if request.clean and kind not in CLEANED:
        raise BadInput(f"--clean is of a model's Gaussians, and {kind} has none: leave it out, or write {', '.join(CLEANED)}.")
    if request.as_trained and kind == "geojson":
        raise BadInput("--uncleaned is of a model's Gaussians, and geojson has none: leave it out.")
    if request.surroundings is not None and kind not in (*CLEANED, "viewer"):
        raise BadInput(f"--surroundings is of a model's Gaussians, and {kind} has none: leave it out, or write {', '.join(CLEANED)}.")
    if (request.num_levels is not None or request.fit_levels is not None or request.regions) and kind not in LEVELLED:
        raise BadInput(f"--levels, --fit-levels and --regions are of levels of detail, and {kind} has none: leave them out, or add --lod.")
    if request.tile_form is not None and kind != "tiles":
        raise BadInput(f"--tiles is of 3D Tiles, and {kind} is none: leave it out, or the other format.")
    if request.spz_version is not None and kind != "spz":
        raise BadInput(f"--spz-version is of SPZ files, and {kind} is none: leave it out, or let the name end in .spz.")
    if request.photographs and kind != "viewer":
        raise BadInput(f"--photographs is of a page, and {kind} has none: leave it out, or add --format viewer.")
    if request.clean and request.side_file.exists():
        raise BadInput(f"{request.side_file} exists, where --clean would put what it takes out: choose another name.")


def _require_cells(request: ExportRequest, kind: ExportFormat) -> None:
    """What is of rasters, surfaces and contours."""
    if request.resolution is not None and kind not in OF_CELLS:
        raise BadInput(f"--resolution is of rasters and meshes, and {kind} is none: leave it out, or add --format {' or '.join(OF_CELLS)}.")
    if request.interval is not None and kind != "contours":
        raise BadInput(f"--interval is of contours, and {kind} has none: leave it out, or add --format contours.")
    for option, value in (("--resolution", request.resolution), ("--interval", request.interval)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise BadInput(f"{option} is {value}, expected a number above zero.")
    if request.tile_px is not None and kind not in RASTERS:
        raise BadInput(f"--tile-px is of GeoTIFFs, and {kind} is none: leave it out, or add --format {' or '.join(RASTERS)}.")
    if request.tile_px is not None and request.tile_px % 16:
        raise BadInput(f"--tile-px is {request.tile_px}, and TIFF has tiles of a multiple of 16: choose one, such as 512.")
    if request.long_side_px is not None and kind not in ("mesh", *OF_HEIGHTS) and not request.clean:
        raise BadInput(
            f"--long-side-px is of the pictures that a surface or --clean is measured on, and {kind} is none of them: leave it out."
        )


def _require_system(request: ExportRequest, kind: ExportFormat) -> None:
    """What has coordinates of a map."""
    if request.crs is None:
        if request.require_grids:
            raise BadInput("--require-grids is of a system that is asked for: give it with --crs.")
        return
    if request.crs == GIVEN_CRS and kind not in PLACED:
        raise BadInput(f"--crs {GIVEN_CRS} is of {', '.join(PLACED)} files: leave it out, or name a system such as EPSG:32632.")
    if kind == "tiles":
        raise BadInput("3D Tiles lie on the globe in its own axes (ECEF, EPSG:4978), as the format wants it: leave --crs out.")
    if kind in LEVELLED:
        raise BadInput(f"--crs is of files in map coordinates, and {kind} is in the scene's own metres: leave it out.")
    if kind == "contours":
        raise BadInput("contours are in longitude and latitude, as GeoJSON has it: leave --crs out, or export --format dsm or dtm.")


def exported_model(request: ExportRequest, display: ProgressDisplay) -> tuple[Splats, dict[str, Any]]:
    """The Gaussians to write, and what a cleaning and `clean` left out of them."""
    if request.clean:
        return _without_surroundings(request, *_without_unconstrained(request, display), display)
    model = given_model(request.model, display, as_trained=request.as_trained)
    return _without_surroundings(request, model.splats, left_out_of(model), display)


def _without_surroundings(
    request: ExportRequest, splats: Splats, figures: dict[str, Any], display: ProgressDisplay
) -> tuple[Splats, dict[str, Any]]:
    """The Gaussians without what lies around the scene, where that was asked for; says how many
    that is."""
    if request.surroundings is not False or not len(splats):
        return splats, figures
    from radiant_viewer.runs.run_view import load_run_view
    from radiant_viewer.runs.shown_model import framed_box, model_box, shown_model

    run = load_run_view(request.model, as_trained=request.as_trained) if request.model.is_dir() else None
    cropped = shown_model(splats, model_box(splats) if run is None else framed_box(run.scene, run.cloud_plan))
    display(Decided(decision=replace(cropped.decision, stage="export", reason="asked for by --no-surroundings", forced=True)))
    return cropped.splats, {**figures, "left_out_around": int(cropped.around.sum())}


def _without_unconstrained(request: ExportRequest, display: ProgressDisplay) -> tuple[Splats, dict[str, Any]]:
    """The model by its cleaning and a further step, whose Gaussians go into the side file."""
    run = run_of(request)
    model = require_cleaned_model(run)
    support = measure_support(run, request.pictures_px, display)
    around = Surroundings(points=run.scene.points, support=lambda: support)
    loose = model.cleaned.kept & ~keeps(SupportStep(), model.whole, around)
    if not loose.any() or (loose == model.cleaned.kept).all():
        message = f"{int(loose.sum()):,} of {len(model.splats):,} Gaussians are unconstrained: nothing is left out."
        display(Warned(stage="clean", message=message))
        return model.splats, {**left_out_of(model), "left_out": 0}
    save_ply(request.side_file, model.whole.select(loose))
    pixel_counts = support.shown_px
    shares = {"left_out_share_of_pixels": float(f"{pixel_counts[loose].sum() / max(pixel_counts[model.cleaned.kept].sum(), 1e-9):.3g}")}
    figures = {**left_out_of(model), "left_out": int(loose.sum()), **shares, "left_out_file": str(request.side_file)}
    return model.whole.select(model.cleaned.kept & ~loose), figures


def left_out_of(model: CleanedModel) -> dict[str, Any]:
    """What a cleaning left out, for the command line: nothing of a model without a cleaning."""
    return {"left_out_by_cleaning": model.cleaned.num_left_out} if model.cleaning.steps else {}


def run_of(request: ExportRequest) -> RunView:
    """The run whose model is exported; BadInput for a model alone."""
    from radiant_viewer.runs.run_view import load_run_view

    if not request.model.is_dir():
        raise BadInput(f"{request.model} is a model alone: this format needs the cameras of a run, give its folder.")
    return load_run_view(request.model, as_trained=request.as_trained)


def placed(request: ExportRequest, splats: Splats) -> tuple[Splats, ExportPlace]:
    """The Gaussians in the coordinates of the file, and what says where those lie."""
    place = place_of(request.model, request.crs)
    return (splats if place.move is None else place.move.move(splats)), place
