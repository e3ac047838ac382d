"""`radiant measure B --since A`: what changed from one run to a later one of the same ground.

The later run is moved onto the earlier one by what did not change, both are laid onto one grid, and
heights and colours are compared there. OUT gets change.tif (three bands), change.geojson (patches)
and report.html.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.commands.run.steps import stage_bar
from radiant_app.commands.survey.parts import Survey, cell_of, load_survey, support_of_survey
from radiant_app.commands.survey.surface import PIXELS_PER_CELL, SurfacePoints, points_of_survey
from radiant_app.files.run_folder import create_folder
from radiant_app.report.change_page import write_change_page
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.export.geotiff import NO_DATA, TiledRaster, cut_tiles, save_tiles
from radiant_core.frames import Sim3
from radiant_core.geometry.similarity import move_splats
from radiant_core.io.run_store import write_json
from radiant_core.survey.change import Change, DateRasters, find_change
from radiant_core.survey.dates import fit_dates, levelled
from radiant_core.survey.geojson import polygon_feature, to_geojson
from radiant_core.survey.heights import MATCHING, RENDERING, height_map
from radiant_core.survey.map_grid import MapGrid, grid_over
from radiant_core.survey.orthophoto import OrthoTile, from_above, ortho_camera, render_tile

BANDS = ("height change", "colour change in levels of 255", "0 none, 1 height, 2 colour, 3 both")
TILE_PX = 512
MAX_CELLS = 64_000_000
"""Both dates are held at once: some 100 bytes a cell."""
LONG_SIDE_PX = 400


@dataclass(frozen=True, kw_only=True)
class ChangeRequest:
    """Which two runs, where to, and how fine; min_area in square units of the map."""

    older: Path
    newer: Path
    out: Path
    resolution: float | None = None
    min_area: float | None = None


def change(request: ChangeRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write the layer, the patches and the page, and return the figures."""
    if request.older.resolve() == request.newer.resolve():
        raise BadInput(f"{request.older} was given twice: name the earlier run and then the later one.")
    if request.min_area is not None and not (np.isfinite(request.min_area) and request.min_area > 0):
        raise BadInput(f"--min-area is {request.min_area}, expected square metres above zero.")
    older, newer = load_survey(request.older), load_survey(request.newer)
    cell = cell_of(older, request.resolution, PIXELS_PER_CELL)
    grid = grid_over(older.ground.low, older.ground.high, cell, older.map_frame)
    if grid.rows * grid.columns > MAX_CELLS:
        raise BadInput(
            f"cells of {cell} make {grid.columns} x {grid.rows} of them, more than {MAX_CELLS:,}: choose a coarser --resolution."
        )
    with create_folder(request.out):
        return _compare(request, (older, newer), grid, display)


def _compare(request: ChangeRequest, surveys: tuple[Survey, Survey], grid: MapGrid, display: ProgressDisplay) -> dict[str, Any]:
    older, newer = surveys
    with stage_bar(display, "alignment") as report:
        report(0, 1, "models")
        first, second = ((survey.splats, survey.run.scene.cameras, survey.run.scene.frame) for survey in surveys)
        fit = fit_dates(first, second)
        report(1, 1, "models")
    points = [points_of_survey(survey, display, LONG_SIDE_PX) for survey in surveys]
    # Points of the newer date lie on its own map: back to its world, and over to the older one.
    world = newer.map_frame.to_world(points[1].points)
    moved = replace(points[1], points=older.map_frame.from_world(fit.older_from_newer.apply(world)))
    before, after = _heights(points[0], grid), _heights(moved, grid)
    after, plane = levelled(before, after)
    tiles = [_picture(older, older, grid, None, display), _picture(newer, older, grid, fit.older_from_newer, display)]
    gsd = max(part.gsd for part in points)
    change = find_change(DateRasters.of(before, tiles[0]), DateRasters.of(after, tiles[1]), gsd, request.min_area)
    figures = {
        "crs": older.map_frame.crs,
        "cells": f"{grid.columns} x {grid.rows}",
        "resolution": grid.cell,
        "unit": older.run.unit,
        "aligned_by_points": fit.num_points,
        "points_followed": fit.num_followed,
        "shift": [round(float(value), 3) for value in fit.shift],
        "left_between_points": round(fit.residual, 3),
        "height_taken_out": round(float(plane[0]), 3),
        "comparable": float(f"{change.comparable.mean():.3g}"),
        "patches": len(change.patches),
        "changed_area": round(sum(patch.area for patch in change.patches), 1),
    }
    _write(request.out, older, change, tiles, figures)
    return {"written": str(request.out), **figures}


def _heights(points: SurfacePoints, grid: MapGrid) -> Any:
    return height_map(points.points, grid, points.gsd, MATCHING if points.from_photographs else RENDERING)


def _picture(survey: Survey, onto: Survey, grid: MapGrid, move: Sim3 | None, display: ProgressDisplay) -> OrthoTile:
    splats, cameras = survey.splats, survey.run.scene.cameras
    support = support_of_survey(survey, display, LONG_SIDE_PX)
    if move is not None:
        splats = move_splats(splats, move)
        cameras = replace(cameras, cam_from_world=move.apply_to_poses(cameras.cam_from_world))
    camera = ortho_camera(grid, onto.map_frame, onto.ground.level, (0, 0), grid.shape)
    return render_tile(from_above(splats, support, cameras), camera)


def _write(out: Path, older: Survey, change: Change, tiles: list[OrthoTile], figures: dict[str, Any]) -> None:
    layer = np.dstack([change.height_change, change.color_change, change.by_height + 2 * change.by_color]).astype(np.float32)
    raster = TiledRaster(place=change.grid, shape=change.grid.shape, bands=BANDS, tile_px=TILE_PX, dtype=np.float32, no_data=NO_DATA)
    save_tiles(out / "change.tif", raster, cut_tiles(np.where(np.isfinite(layer), layer, np.float32(NO_DATA)), TILE_PX, NO_DATA))
    rows = [
        {
            "number": number,
            "kind": patch.kind,
            "area": round(patch.area, 2),
            "height_change": round(patch.height_change, 3) if np.isfinite(patch.height_change) else None,
            "volume": round(patch.volume, 2) if np.isfinite(patch.volume) else None,
            "color_change": round(patch.color_change, 1),
        }
        for number, patch in enumerate(change.patches, 1)
    ]
    features = [polygon_feature(older.map_frame, patch.outline, row) for patch, row in zip(change.patches, rows, strict=True)]
    write_json(out / "change.geojson", to_geojson(older.map_frame, features))
    write_change_page(out / "report.html", change, [tile.image for tile in tiles], rows, figures)
