"""`radiant export` of a run's surface: heights, terrain, contour lines, points, a textured mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.commands.export.request import ExportRequest
from radiant_app.commands.run.steps import stage_bar
from radiant_app.commands.survey.parts import Survey, cell_of, load_survey, support_of_survey
from radiant_app.commands.survey.surface import PIXELS_PER_CELL, SurfacePoints, points_of_survey, surface_of_survey
from radiant_app.report.progress import ProgressDisplay
from radiant_core.choices import ExportFormat
from radiant_core.export.geotiff import NO_DATA, TiledRaster, cut_tiles, save_tiles
from radiant_core.extras import require_extra
from radiant_core.georef.reference import map_offset
from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import HeightMap
from radiant_core.survey.map_grid import MapGrid, grid_over
from radiant_core.survey.terrain import Contour

BANDS = ("height", "standard deviation", "1 measured, 2 filled")
GROUND_WITHIN_GSD = 4.0
"""A point so near to the terrain is ground."""
NUM_LEVELS = 20
"""About so many contours where no interval is given."""
MAX_PICTURE_PX = 4096


@dataclass(frozen=True, kw_only=True, eq=False)
class _SurveyHeights:
    survey: Survey
    points: SurfacePoints
    heights: HeightMap

    def figures(self, heights: HeightMap) -> dict[str, Any]:
        finite = heights.heights[np.isfinite(heights.heights)]
        inside = self.survey.ground.mask(heights.grid)
        return {
            "crs": self.survey.map_frame.crs,
            "cells": f"{heights.grid.columns} x {heights.grid.rows}",
            "resolution": heights.grid.cell,
            "unit": self.survey.run.unit,
            "known": float(f"{(heights.source[inside] > 0).mean():.4g}"),
            "measured": float(f"{(heights.source[inside] == 1).mean():.4g}"),
            "filled": float(f"{(heights.source[inside] == 2).mean():.4g}"),
            "sigma": float(f"{np.nanmedian(heights.sigma):.3g}"),
            "lowest": round(float(finite.min()), 3),
            "highest": round(float(finite.max()), 3),
        }


def _find(request: ExportRequest, display: ProgressDisplay) -> _SurveyHeights:
    survey = load_survey(request.model, request.crs, as_trained=request.as_trained)
    # Before minutes of matching: a slip in what was asked for is told at once.
    cell = cell_of(survey, request.resolution, PIXELS_PER_CELL)
    grid_over(survey.ground.low, survey.ground.high, cell, survey.map_frame)
    points = points_of_survey(survey, display, request.pictures_px)
    return _SurveyHeights(survey=survey, points=points, heights=surface_of_survey(survey, points, cell, display))


def export_dsm(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Heights of the topmost surface as a GeoTIFF of three bands."""
    surface = _find(request, display)
    return _save_heights(request, surface, surface.heights)


def export_dtm(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Heights of the ground without buildings and trees, as a GeoTIFF of three bands."""
    from radiant_core.survey.terrain import terrain

    surface = _find(request, display)
    return _save_heights(request, surface, terrain(surface.heights, surface.points.gsd))


def export_contours(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Lines of equal height of the terrain as GeoJSON, in longitude and latitude where known."""
    from radiant_core.io.run_store import write_json
    from radiant_core.survey.geojson import line_feature, to_geojson
    from radiant_core.survey.terrain import contours, terrain

    surface = _find(request, display)
    ground = terrain(surface.heights, surface.points.gsd)
    interval = request.interval if request.interval is not None else _usual_interval(ground)
    lines = contours(ground, interval)
    features = [line_feature(surface.survey.map_frame, _at(line), {"height": round(line.height, 6)}) for line in lines]
    write_json(request.out, to_geojson(surface.survey.map_frame, features))
    return {**surface.figures(ground), "interval": interval, "lines": len(lines)}


def _at(line: Contour) -> FloatArray:
    """The line (K,3) at its height."""
    return np.column_stack([line.line, np.full(len(line.line), line.height)])


def export_laz(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Points of the surface with colours, ground told from the rest."""
    require_extra("survey", "LAZ cannot be written", "export --format dsm")
    from radiant_core.export.point_cloud import save_laz
    from radiant_core.survey.terrain import terrain

    surface = _find(request, display)
    ground, _ = terrain(surface.heights, surface.points.gsd).at(surface.points.points[:, :2])
    is_ground = np.abs(surface.points.points[:, 2] - ground) < GROUND_WITHIN_GSD * surface.points.gsd
    map_frame = surface.survey.map_frame
    save_laz(request.out, surface.points.points, surface.points.colors, is_ground, map_frame.epsg, map_frame.vertical_epsg)
    return {"points": len(is_ground), "ground": float(f"{is_ground.mean():.3g}"), **surface.figures(surface.heights)}


def export_glb(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """The surface with the orthophoto on it, for a browser or a modeller."""
    require_extra("survey", "GLB cannot be written", "export --format mesh")
    from radiant_core.export.mesh_glb import save_glb
    from radiant_core.survey.height_mesh import height_mesh

    surface = _find(request, display)
    map_frame = surface.survey.map_frame
    has_map = map_frame.system is not None or map_frame.map_from_world is not None
    offset = map_offset(map_frame.from_world(np.zeros((1, 3)))[0]) if has_map else np.zeros(3)
    mesh = height_mesh(surface.heights, offset)
    picture = _picture(surface, display)
    about = {"crs": map_frame.crs, "offset_east_north_height": offset.tolist(), "axes": "east, up, south"}
    save_glb(request.out, mesh.vertices, mesh.triangles, mesh.uv, picture, about)
    return {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        "offset": f"{', '.join(f'{value:.10g}' for value in offset)} (add it to east, north, height)",
        "texture": f"{picture.shape[1]} x {picture.shape[0]}",
        **surface.figures(surface.heights),
    }


def _save_heights(request: ExportRequest, surface: _SurveyHeights, heights: HeightMap) -> dict[str, Any]:
    raster = TiledRaster(
        place=heights.grid,
        shape=heights.grid.shape,
        bands=BANDS,
        tile_px=request.tiles_px,
        dtype=np.float32,
        no_data=NO_DATA,
        classes=(2,),
    )
    save_tiles(request.out, raster, cut_tiles(heights.bands(NO_DATA), request.tiles_px, NO_DATA))
    return {**surface.figures(heights), "no_data": NO_DATA, "bands": ", ".join(BANDS)}


def _picture(surface: _SurveyHeights, display: ProgressDisplay) -> NDArray[np.uint8]:
    """The orthophoto of the raster, at most 4096 px wide and high."""
    from radiant_core.survey.orthophoto import from_above, ortho_camera, render_tile

    survey, grid = surface.survey, surface.heights.grid
    cell = max(survey.ground.gsd, grid.cell * max(grid.shape) / MAX_PICTURE_PX)
    rows, columns = (max(1, round(side * grid.cell / cell)) for side in grid.shape)
    # As many cells as fit: the raster's corners are the picture's to half a pixel.
    fine = MapGrid(north_west=grid.north_west, cell=cell, rows=rows, columns=columns, epsg=grid.epsg, vertical_epsg=grid.vertical_epsg)
    splats_from_above = from_above(survey.splats, support_of_survey(survey, display, 640), survey.run.scene.cameras)
    with stage_bar(display, "orthophoto") as report:
        report(0, 1, "picture")
        tile = render_tile(splats_from_above, ortho_camera(fine, survey.map_frame, survey.ground.level, (0, 0), fine.shape))
        report(1, 1, "picture")
    return tile.image


def _usual_interval(heights: HeightMap) -> float:
    """1, 2 or 5 times a power of ten that gives some twenty levels."""
    finite: FloatArray = heights.heights[np.isfinite(heights.heights)]
    wanted = max(float(np.ptp(np.quantile(finite, [0.01, 0.99]))), 1e-6) / NUM_LEVELS
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(f"{min((step * power for step in (1, 2, 5, 10) if step * power >= wanted), default=10 * power):.6g}")


WRITERS: dict[ExportFormat, Callable[[ExportRequest, ProgressDisplay], dict[str, Any]]] = {
    "dsm": export_dsm,
    "dtm": export_dtm,
    "contours": export_contours,
    "laz": export_laz,
    "glb": export_glb,
}
"""What writes each of `OF_HEIGHTS`."""
