"""What a finished run's photographs and model say of each cell of its surface: the map of what is
known, as known.tif, known.geojson and known.png.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.commands.run.steps import stage_bar
from radiant_app.commands.survey.parts import Survey, support_of_survey
from radiant_app.commands.survey.surface import photographs_of_survey
from radiant_app.events import Decided, Warned
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.capture_warnings import faults_of_capture
from radiant_app.workers.sources import masks_folder_of
from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.export.geotiff import NO_DATA, TiledRaster, cut_tiles, save_tiles
from radiant_core.geometry.cleaning import keeps_places
from radiant_core.io.run_store import write_json
from radiant_core.next_flight.capture_faults import CaptureFault
from radiant_core.next_flight.facets import Facets
from radiant_core.next_flight.layers import BANDS, CLASSES, HOLE, WEAK, KnownMap, support_raster, weak_features
from radiant_core.next_flight.model_surface import MapView, facets_of_model
from radiant_core.next_flight.sightings import Sighting, Sights, known_by
from radiant_core.numerics import FloatArray
from radiant_core.survey.geojson import to_geojson
from radiant_core.survey.map_grid import grid_over

if TYPE_CHECKING:
    from radiant_core.next_flight.predicted_error import ErrorModel

PIXELS_PER_CELL = 4.0
MOST_CELLS = 20_000
"""Cells are wider than `PIXELS_PER_CELL` where they would be more: each is asked for of every
candidate view."""
LONG_SIDE_PX = 320
TILE_PX = 256
STAGE = "known"


@dataclass(frozen=True, kw_only=True, eq=False)
class FoundMap:
    """The map, how its errors were predicted, and looks at its facets; errors: None where no
    held-out photograph is at hand."""

    survey: Survey
    sights: Sights
    layers: KnownMap
    errors: ErrorModel | None
    faults: tuple[CaptureFault, ...] = ()

    @property
    def trained(self) -> Cameras:
        """The cameras whose photographs the model was trained on."""
        return self.survey.run.scene.cameras.select(np.array(self.survey.trained, np.int64))


def find_known(survey: Survey, resolution: float | None, display: ProgressDisplay) -> FoundMap:
    """What is known of the surface in cells of `resolution`, by default of four pixels of the
    photographs, and at most `MOST_CELLS` of them. BadInput where the model has no surface."""
    cell = map_cell(survey, resolution, display)
    facets = facets_of_survey(survey, cell, display)
    sights = Sights(facets, survey.map_frame)
    cameras = survey.run.scene.cameras.select(np.array(survey.trained, np.int64))
    with stage_bar(display, "views") as report:
        sightings = sights.all_of(cameras, lambda num_done, total: report(num_done, total, "photographs"))
    known_facets = known_by(sights, cameras, sightings)
    faults = faults_of_capture(survey.run.scene, photographs_of_survey(survey))
    for fault in faults:
        display(Warned(stage=STAGE, message=fault.sentence))
    error_db, model = _errors(survey, sights, sightings, known_facets.score, display)
    support = support_raster(facets, survey.map_frame, survey.splats, support_of_survey(survey, display, LONG_SIDE_PX))
    margin_db = None if model is None else model.margin_db
    layers = KnownMap(facets=facets, knowledge=known_facets, support=support, error_db=error_db, margin_db=margin_db)
    return FoundMap(survey=survey, sights=sights, layers=layers, errors=model, faults=faults)


def write_known(known_map: FoundMap, folder: Path) -> dict[str, Any]:
    """Write known.tif and known.geojson into the existing folder, and return the figures."""
    grid, survey = known_map.layers.facets.surface.grid, known_map.survey
    raster = TiledRaster(place=grid, shape=grid.shape, bands=BANDS, tile_px=TILE_PX, dtype=np.float32, no_data=NO_DATA, classes=CLASSES)
    save_tiles(folder / "known.tif", raster, cut_tiles(known_map.layers.bands(NO_DATA), TILE_PX, NO_DATA))
    _save_kinds(folder, known_map.layers)
    about = {"unit": survey.run.unit, **_error_figures(known_map.errors)}
    write_json(folder / "known.geojson", to_geojson(survey.map_frame, weak_features(known_map.layers, survey.map_frame), about))
    return {"crs": survey.map_frame.crs, "cells": f"{grid.columns} x {grid.rows}", "resolution": grid.cell, **figures_of(known_map)}


def _save_kinds(folder: Path, layers: KnownMap) -> None:
    """The kinds of cells in colours, as windows lay them over a run."""
    from radiant_viewer.charts.known_chart import kinds_image
    from radiant_viewer.layers.known_layer import KNOWN_MAP

    grid = layers.facets.surface.grid
    raster = TiledRaster(
        place=grid, shape=grid.shape, bands=("red", "green", "blue", "alpha"), tile_px=TILE_PX, dtype=np.uint8, colors=True
    )  # fmt: skip
    save_tiles(folder / Path(KNOWN_MAP).name, raster, cut_tiles(kinds_image(layers), TILE_PX))


def figures_of(known_map: FoundMap) -> dict[str, Any]:
    """Areas of holes and weak surface, and how far the predicted error can be trusted."""
    layers = known_map.layers
    areas: dict[str, Any] = {
        f"{name}_{on}": round(layers.area_of(kind, walls=walls), 1)
        for kind, name in ((HOLE, "hole"), (WEAK, "weak"))
        for on, walls in (("ground", False), ("walls", True))
    }
    total = float(layers.facets.areas.sum())
    areas["capture"] = " ".join(fault.sentence for fault in known_map.faults) or "no fault"
    return {"surface": round(total, 1), **areas, "unit": known_map.survey.run.unit, **_error_figures(known_map.errors)}


def _error_figures(model: ErrorModel | None) -> dict[str, Any]:
    if model is None:
        return {"predicted_error": "none: no held-out photograph is at hand"}
    rounded = {
        name: None if value is None else float(f"{value:.3g}")
        for name, value in (("rank", model.rank), ("good", model.good), ("margin_db", model.margin_db))
    }
    return {"error_cells": model.num_cells, "error_photographs": model.num_photographs, **rounded}


def map_cell(survey: Survey, resolution: float | None, display: ProgressDisplay) -> float:
    """The cell that was asked for, else of four pixels of the photographs, or wider; BadInput for
    no number above zero."""
    if resolution is not None:
        if not (np.isfinite(resolution) and resolution > 0):
            raise BadInput(f"a resolution of {resolution} was asked for, expected a number above zero.")
        return resolution
    ground = survey.ground
    area = float(np.prod(ground.high - ground.low))
    fine, coarse = PIXELS_PER_CELL * ground.gsd, float(np.sqrt(area / MOST_CELLS))
    cell = float(f"{max(fine, coarse):.2g}")
    reason = "four pixels of the photographs" if fine >= coarse else f"four pixels would make more than {MOST_CELLS:,} cells"
    decision = Decision(
        stage=STAGE, topic="resolution", choice=f"cells of {cell:g}", figure=cell, unit=survey.run.unit, reason=reason,
        otherwise="--resolution",
    )  # fmt: skip
    display(Decided(decision=decision))
    return cell


def facets_of_survey(survey: Survey, cell: float, display: ProgressDisplay) -> Facets:
    """The model's surface in such cells, as facets; BadInput where it has none."""
    ground, scene = survey.ground, survey.run.scene
    with stage_bar(display, "surface") as report:
        return facets_of_model(
            survey.splats,
            scene,
            ground,
            grid_over(ground.low, ground.high, cell, survey.map_frame),
            MapView(
                map_frame=survey.map_frame,
                long_side_px=LONG_SIDE_PX,
                keeps=lambda points: keeps_places(survey.cleaning, points, survey.regions),
                report=lambda num_done, total: report(num_done, total, "views"),
            ),
        )


def _errors(
    survey: Survey, sights: Sights, seen_by_trained: tuple[Sighting, ...], score: FloatArray, display: ProgressDisplay
) -> tuple[FloatArray, ErrorModel | None]:
    """Predicted error (K,) in dB of each facet, NaN where there is none, and the prediction."""
    from radiant_core.io.photos.masks import pixel_weights
    from radiant_core.next_flight.predicted_error import TrainingErrors, error_samples, errors_in_views, fit_errors
    from radiant_core.train.photographs import load_images

    nothing = np.full(len(sights.facets), np.nan)
    cameras, images = survey.run.scene.cameras.scaled(LONG_SIDE_PX), photographs_of_survey(survey)
    held_out = [row for row, name in enumerate(cameras.names) if name in survey.run.held_out]
    missing = [] if images is None else [name for name in cameras.names if not (images / name).is_file()]
    if images is None or missing or not held_out:
        why = "the photographs are not at hand" if images is None or missing else "no photograph was held out"
        display(Warned(stage=STAGE, message=f"errors are not predicted: {why}."))
        return nothing, None
    order = np.array([*survey.trained, *held_out], np.int64)
    ordered, cell = cameras.select(order), sights.facets.surface.grid.cell
    with stage_bar(display, "errors") as report:
        shares_wh = ordered.sizes_wh / survey.run.scene.cameras.select(order).sizes_wh
        # What trained photographs see is known; their pictures alone are smaller here.
        seen = [sighting.scaled(shares) for sighting, shares in zip(seen_by_trained, shares_wh, strict=False)]
        sightings = (*seen, *sights.all_of(cameras.select(held_out)))

        def photograph(index: int, folder: Path = images) -> NDArray[np.uint8]:
            return load_images(folder, ordered.select([index]))[0]

        weights = pixel_weights(masks_folder_of(survey.run.folder), ordered)
        view_errors: list[FloatArray] = []
        for error in errors_in_views(survey.splats, ordered, photograph, sightings, cell, weights):
            view_errors.append(error)
            report(len(view_errors), len(ordered), "photographs")
    split = len(survey.trained)
    train = TrainingErrors(len(sights.facets), sightings[:split], view_errors[:split])
    try:
        model = fit_errors(error_samples(train, score, sightings[split:], view_errors[split:]))
    except BadInput as error:
        display(Warned(stage=STAGE, message=f"errors are not predicted: {error}"))
        return nothing, None
    return model.predict(train.typical_db(), score), model
