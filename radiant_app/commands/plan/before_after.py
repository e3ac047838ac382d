"""What is known of each cell of a surface before and after photographs were added, as
known_change.tif and known_change.png. The surface is that of the model afterwards."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.commands.plan.known_map import LONG_SIDE_PX, TILE_PX, facets_of_survey, map_cell
from radiant_app.commands.run.steps import stage_bar
from radiant_app.commands.survey.parts import Survey
from radiant_app.commands.survey.surface import photographs_of_survey
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.sources import masks_folder_of
from radiant_core.export.geotiff import NO_DATA, TiledRaster, cut_tiles, save_tiles
from radiant_core.io.photos.masks import pixel_weights
from radiant_core.next_flight.layers import HOLE, WEAK, KnownMap
from radiant_core.next_flight.predicted_error import errors_in_views, mean_errors_db
from radiant_core.next_flight.sightings import Sighting, Sights, known_by
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_core.train.photographs import load_images

CHANGE_NAME, PICTURE_NAME = "known_change.tif", "known_change.png"
LAYERS = {"photographs": 0, "largest parallax in degrees": 1, "PSNR of held-out photographs in dB": 4, "1 known, 2 weak, 3 hole": 6}
"""Of a map of what is known, the layers that stand here before and after: name → band there."""
BANDS = tuple(f"{name}, {when}" for name in LAYERS for when in ("before", "after"))


@dataclass(frozen=True, kw_only=True, eq=False)
class BeforeAfter:
    """Two maps of one surface, whose errors are those measured in held-out photographs."""

    survey: Survey
    before: KnownMap
    after: KnownMap

    def figures(self) -> dict[str, Any]:
        """Areas of holes and of weak surface, and how the cells of held-out photographs changed."""
        areas: dict[str, Any] = {}
        for kind, name in ((HOLE, "hole"), (WEAK, "weak")):
            for on, walls in (("ground", False), ("walls", True)):
                was, is_now = (round(known_map.area_of(kind, walls=walls), 1) for known_map in (self.before, self.after))
                areas[f"{name}_{on}"] = f"{was:g} → {is_now:g} {self.survey.run.unit}²"
        change = self.after.error_db - self.before.error_db
        change = change[np.isfinite(change)]
        if len(change):
            areas["cells_scored"] = len(change)
            areas["cells_better"] = round(float((change > 0).mean()), 3)
            areas["cells_median_db"] = round(float(np.median(change)), 2)
        return areas


def known_before_after(survey: Survey, earlier: Survey, display: ProgressDisplay) -> BeforeAfter:
    """The maps of a run with added photographs (`survey`) and of the one that it extends."""
    cell = map_cell(survey, None, display)
    facets = facets_of_survey(survey, cell, display)
    sights, cameras = Sights(facets, survey.map_frame), survey.run.scene.cameras
    with stage_bar(display, "views") as report:
        sightings = sights.all_of(cameras, lambda num_done, total: report(num_done, total, "photographs"))
    trained_before = {earlier.run.scene.cameras.names[row] for row in earlier.trained}
    maps = []
    nothing = np.full(facets.surface.grid.shape, np.nan)
    for model, is_trained in (
        (earlier.splats, lambda name: name in trained_before),
        (survey.splats, lambda name: name not in survey.run.held_out),
    ):
        rows = np.array([row for row, name in enumerate(cameras.names) if is_trained(name)], np.int64)
        knowledge = known_by(sights, cameras.select(rows), [sightings[row] for row in rows.tolist()])
        errors = _held_out_db(survey, model, sights, sightings, display)
        maps.append(KnownMap(facets=facets, knowledge=knowledge, support=nothing, error_db=errors, margin_db=None))
    return BeforeAfter(survey=survey, before=maps[0], after=maps[1])


def _held_out_db(survey: Survey, model: Splats, sights: Sights, sightings: tuple[Sighting, ...], display: ProgressDisplay) -> FloatArray:
    """PSNR (K,) of a model at each facet in the held-out photographs that see it; NaN elsewhere."""
    cameras, images = survey.run.scene.cameras, photographs_of_survey(survey)
    assert images is not None
    held_out = np.array([row for row, name in enumerate(cameras.names) if name in survey.run.held_out], np.int64)
    smaller, cell, errors = cameras.select(held_out).scaled(LONG_SIDE_PX), sights.facets.surface.grid.cell, list[FloatArray]()
    shares_wh = smaller.sizes_wh / cameras.select(held_out).sizes_wh
    seen = [sightings[row].scaled(shares) for row, shares in zip(held_out.tolist(), shares_wh, strict=True)]

    def photograph(index: int, folder: Path = images) -> NDArray[np.uint8]:
        return load_images(folder, smaller.select([index]))[0]

    weights = pixel_weights(masks_folder_of(survey.run.folder), smaller)
    with stage_bar(display, "held-out photographs") as report:
        for error in errors_in_views(model, smaller, photograph, seen, cell, weights):
            errors.append(error)
            report(len(errors), len(smaller), "photographs")
    return mean_errors_db(len(sights.facets), seen, errors)


def write_before_after(change: BeforeAfter, folder: Path) -> None:
    """Write map and picture into the existing folder."""
    from radiant_viewer.charts.change_of_known_chart import change_of_known_picture
    from radiant_viewer.pictures.images import save_png

    grid = change.after.facets.surface.grid
    layers = [known_map.bands(NO_DATA) for known_map in (change.before, change.after)]
    bands = np.stack([one[..., band] for band in LAYERS.values() for one in layers], axis=-1)
    classes = (len(BANDS) - 2, len(BANDS) - 1)
    raster = TiledRaster(place=grid, shape=grid.shape, bands=BANDS, tile_px=TILE_PX, dtype=np.float32, no_data=NO_DATA, classes=classes)
    save_tiles(folder / CHANGE_NAME, raster, cut_tiles(bands, TILE_PX, NO_DATA))
    save_png(folder / PICTURE_NAME, change_of_known_picture(change.before, change.after, change.survey.run.unit))
