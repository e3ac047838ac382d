"""`radiant export --format ortho`: the scene from straight above as a GeoTIFF, tile after tile."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.commands.export.request import ExportRequest
from radiant_app.commands.run.steps import stage_bar
from radiant_app.commands.survey.parts import cell_of, load_survey, support_of_survey
from radiant_app.events import Warned
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.export.geotiff import TiledRaster, save_tiles
from radiant_core.survey.map_grid import grid_over
from radiant_core.survey.orthophoto import from_above, ortho_tiles

BANDS = ("red", "green", "blue", "alpha", "photographs that saw it")
MIN_SEEN = 0.5
"""With less of the raster seen the export warns, and with nothing it fails."""


def export_ortho(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write the orthophoto and return its figures; BadInput where nothing is seen from above."""
    survey, tile_px = load_survey(request.model, request.crs, as_trained=request.as_trained), request.tiles_px
    ground = survey.ground
    grid = grid_over(ground.low, ground.high, cell_of(survey, request.resolution, 1.0), survey.map_frame)
    raster = TiledRaster(place=grid, shape=grid.shape, bands=BANDS, tile_px=tile_px, dtype=np.uint8, colors=True, classes=(4,))
    splats_from_above = from_above(survey.splats, support_of_survey(survey, display, 640), survey.run.scene.cameras)
    counts = {"seen": 0, "weak": 0}
    with stage_bar(display, "orthophoto") as report:

        def tiles() -> Iterator[NDArray[np.uint8]]:
            across = -(-grid.columns // tile_px)
            total = -(-grid.rows // tile_px) * across
            for number, tile in enumerate(ortho_tiles(splats_from_above, grid, survey.map_frame, ground.level, tile_px), 1):
                row, column = tile_px * ((number - 1) // across), tile_px * ((number - 1) % across)
                has_color = tile.is_known[: grid.rows - row, : grid.columns - column]
                counts["seen"] += int(has_color.sum())
                counts["weak"] += int((has_color & (tile.views[: has_color.shape[0], : has_color.shape[1]] < 2)).sum())
                report(number, total, "tiles")
                if number == total and not counts["seen"]:
                    raise BadInput("the model is nowhere opaque from above, so there is no orthophoto: train it further first.")
                yield tile.bands()

        save_tiles(request.out, raster, tiles())
    seen_share = counts["seen"] / (grid.rows * grid.columns)
    if seen_share < MIN_SEEN:
        display(Warned(stage="orthophoto", message=f"the model shows only {100 * seen_share:.2g} % of the raster: the rest has alpha 0."))
    return {
        "crs": survey.map_frame.crs,
        "cells": f"{grid.columns} x {grid.rows}",
        "resolution": grid.cell,
        "unit": survey.run.unit,
        "seen": float(f"{seen_share:.4g}"),
        "seen_by_one_photograph": float(f"{counts['weak'] / max(1, counts['seen']):.3g}"),
        "bands": ", ".join(BANDS),
    }
