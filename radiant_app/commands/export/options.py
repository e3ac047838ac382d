"""Which options of `radiant export` belong to which formats: the others are refused at once, in one
sentence, before anything takes minutes."""

from __future__ import annotations

import math

from radiant_app.commands.export.request import ExportRequest
from radiant_core.choices import ExportFormat
from radiant_core.errors import BadInput
from radiant_core.georef.given_frame import GIVEN

OF_HEIGHTS: tuple[ExportFormat, ...] = ("dsm", "dtm", "contours", "laz", "glb")
OF_CELLS: tuple[ExportFormat, ...] = ("mesh", "ortho", *OF_HEIGHTS)
RASTERS: tuple[ExportFormat, ...] = ("dsm", "dtm", "ortho")
CLEANED: tuple[ExportFormat, ...] = ("ply", "spz", "sog", "usd", "lod", "tiles")
PLACED: tuple[ExportFormat, ...] = ("ply", "spz", "sog", "usd", "mesh", "colmap", "nerfstudio")
"""What a file beside it says the place of."""
LEVELLED: tuple[ExportFormat, ...] = ("lod", "tiles", "viewer")


def require_options(request: ExportRequest, kind: ExportFormat) -> None:
    """Raise BadInput for an option that the format does not have, or a value that none can have."""
    _require_cells(request, kind)
    _require_system(request, kind)
    if request.clean and kind not in CLEANED:
        raise BadInput(f"--clean is of a model's Gaussians, and {kind} has none: leave it out, or write {', '.join(CLEANED)}.")
    if request.as_trained and kind == "geojson":
        raise BadInput("--uncleaned is of a model's Gaussians, and geojson has none: leave it out.")
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
    if request.crs == GIVEN and kind not in PLACED:
        raise BadInput(f"--crs {GIVEN} is of {', '.join(PLACED)} files: leave it out, or name a system such as EPSG:32632.")
    if kind == "tiles":
        raise BadInput("3D Tiles lie on the globe in its own axes (ECEF, EPSG:4978), as the format wants it: leave --crs out.")
    if kind in LEVELLED:
        raise BadInput(f"--crs is of files in map coordinates, and {kind} is in the scene's own metres: leave it out.")
    if kind == "contours":
        raise BadInput("contours are in longitude and latitude, as GeoJSON has it: leave --crs out, or export --format dsm or dtm.")
