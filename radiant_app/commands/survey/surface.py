"""The surface of a run: points that its photographs agree on, else its model, and their heights."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_app.commands.run.steps import stage_bar
from radiant_app.commands.survey.parts import Survey
from radiant_app.events import Decided, Warned
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.sources import has_scene, images_folder_of, masks_folder_of
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import PolygonStep, RegionsStep, describe, keeps_land, keeps_places
from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import MATCHING, RENDERING, HeightMap, filled, height_map
from radiant_core.survey.map_grid import MapGrid, grid_over
from radiant_core.train.dense.fuse import DensePoints
from radiant_core.train.dense.points import LONG_SIDE_PX
from radiant_viewer.runs.unplanned import unplanned_photographs

PIXELS_PER_CELL = 2.0
MIN_KNOWN = 0.5
"""With less of the seen ground known nothing is written."""
USUAL_KNOWN = 0.8
"""Below it a surface is written with a warning."""
LEVEL = "the middle of the scene's points, not from the sea"


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfacePoints:
    """points (N,3) on the map, colors (N,3), and whether photographs or the model alone gave them;
    gsd: the width of a pixel of the pictures that were matched."""

    points: FloatArray
    colors: NDArray[np.uint8]
    from_photographs: bool
    gsd: float


def points_of_survey(survey: Survey, display: ProgressDisplay, long_side_px: int) -> SurfacePoints:
    """Points of the surface: of the photographs where they are at hand, else of the model."""
    from radiant_core.survey.surface_points import points_of_model

    scene = survey.run.scene
    images = photographs_of_survey(survey)
    missing = [] if images is None else [name for name in scene.cameras.names if not (images / name).is_file()]
    from_photographs = images is not None and not missing and len(scene.observations) > 0
    display(Decided(decision=_source_decision(survey, from_photographs)))
    size_px = LONG_SIDE_PX if from_photographs else long_side_px
    if from_photographs:
        _warn_of_steps(survey, display)
    with stage_bar(display, "surface") as report:

        def hear(num_done: int, total: int) -> None:
            report(num_done, total, "views")

        if from_photographs and images is not None:
            parts_found = _matched(survey, images, hear)
        else:
            parts_found = points_of_model(survey.splats, scene, long_side_px, survey.ground.reach, hear)
        parts = [_kept_part(survey, part.points, part.colors) for part in parts_found if len(part)]
    parts = [part for part in parts if len(part[0])]
    if not parts:
        raise BadInput(
            f"no three views agree on any point of the surface: {'' if from_photographs else 'train the model further, or '}"
            "add photographs that overlap."
        )
    widest = float(np.median(scene.cameras.sizes_wh.max(axis=1)))
    return SurfacePoints(
        points=np.concatenate([points for points, _ in parts]),
        colors=np.concatenate([colors for _, colors in parts]),
        from_photographs=from_photographs,
        gsd=survey.ground.gsd * max(1.0, widest / size_px),
    )


def surface_of_survey(survey: Survey, points: SurfacePoints, cell: float, display: ProgressDisplay) -> HeightMap:
    """Heights over the ground that was seen, in cells of a width, with marked fills; BadInput where
    most of it stays unknown, a warning where much of it does."""
    ground = survey.ground
    grid = grid_over(ground.low, ground.high, cell, survey.map_frame)
    inside = ground.mask(grid) & _kept_land(survey, grid)
    measured = height_map(points.points, grid, points.gsd, MATCHING if points.from_photographs else RENDERING)
    share = float((measured.source[inside] > 0).mean()) if inside.any() else 0.0
    if share < MIN_KNOWN:
        raise BadInput(
            f"three views agree on a height in only {100 * share:.2g} % of the cells of the ground that was seen, so nothing is written: "
            f"they are {cell:.3g} {survey.run.unit} wide, choose a coarser --resolution such as {_coarser(cell):g}, "
            f"{'or add photographs that overlap' if points.from_photographs else 'or train the model further'}."
        )
    if share < USUAL_KNOWN:
        text = f"three views agree on a height in {100 * share:.2g} % of the cells; what was filled in between is marked in band 3."
        display(Warned(stage="surface", message=text))
    if not survey.run.scene.frame.altitude_known:
        display(Warned(stage="surface", message=f"GPS has no altitude: heights count from {LEVEL}."))
    return filled(measured, inside)


def _coarser(cell: float) -> float:
    """About twice a width or more, of one digit: what a person would type."""
    digit = 10.0 ** math.floor(math.log10(2 * cell))
    return math.ceil(2 * cell / digit - 1e-9) * digit


def _warn_of_steps(survey: Survey, display: ProgressDisplay) -> None:
    """Tell which steps of a cleaning cannot hold for what photographs agree on."""
    steps = survey.cleaning.steps
    others = [describe(step, survey.run.unit) for step in steps if not isinstance(step, PolygonStep | RegionsStep)]
    if others:
        text = "heights are those that photographs agree on, for which the cleaning's polygons and regions hold, and not"
        display(Warned(stage="surface", message=f"{text} what is about Gaussians: {'; '.join(others)}."))


def _kept_part(survey: Survey, points: FloatArray, colors: NDArray[np.uint8]) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Points on the map, and their colours, without what the cleaning leaves out."""
    keep_mask = keeps_places(survey.cleaning, points, survey.regions)
    return survey.map_frame.from_world(points[keep_mask]), colors[keep_mask]


def _kept_land(survey: Survey, grid: MapGrid) -> NDArray[np.bool_]:
    """The cells (H,W) on which the cleaning leaves something."""
    if not survey.cleaning.steps:
        return np.ones(grid.shape, bool)
    east, north = grid.centers()
    keep_mask = np.empty(grid.shape, bool)
    for row, at in enumerate(north):
        places = np.column_stack([east, np.full(len(east), at), np.full(len(east), survey.ground.level)])
        keep_mask[row] = keeps_land(survey.cleaning, survey.map_frame.to_world(places)[:, :2], survey.regions)
    return keep_mask


def _matched(survey: Survey, images: Path, hear: Callable[[int, int], None]) -> Iterator[DensePoints]:
    from radiant_core.survey.surface_points import points_of_photographs
    from radiant_core.train.photographs import load_training_views

    scene = survey.run.scene
    views = load_training_views(images, scene.cameras.scaled(LONG_SIDE_PX), masks_folder_of(survey.run.folder))
    return points_of_photographs(scene, views, num_threads=torch.get_num_threads(), report=hear)


def photographs_of_survey(survey: Survey) -> Path | None:
    """The folder of the run's photographs, None where they stayed elsewhere."""
    if survey.run.in_field:
        return None
    folder = survey.run.folder
    if survey.run.kind != "run":
        images = unplanned_photographs(folder)
    else:
        images = images_folder_of(folder) if has_scene(folder) and (folder / "sfm" / "result.json").is_file() else None
    return images if images is not None and images.is_dir() else None


def _source_decision(survey: Survey, from_photographs: bool) -> Decision:
    count = len(survey.run.scene.cameras)
    reason = "they are at hand" if from_photographs else "the photographs, or the points that tie them, are not at hand"
    return Decision(
        stage="surface",
        topic="source of heights",
        choice="photographs matched against each other" if from_photographs else "depth rendered from the model",
        figure=float(count),
        unit="views",
        reason=f"{reason}; heights from the model alone are about four times as uncertain",
    )
