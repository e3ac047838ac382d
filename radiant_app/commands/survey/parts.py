"""What the commands of a survey share: a run, its map, what was seen, and who saw each Gaussian."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radiant_app.commands.run.steps import stage_bar
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import Cleaning
from radiant_core.geometry.support import Support
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_core.survey.map_grid import MapFrame
from radiant_core.survey.run_map import map_of_run
from radiant_core.survey.seen_ground import SeenGround, seen_ground
from radiant_viewer.runs.run_view import RunView, load_run_view, require_splats, run_support

FINEST_SHARE = 0.05
"""Cells finer than this share of the ground sampling distance are a slip of the unit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """A run with a model, its map and the ground that its photographs saw."""

    run: RunView
    splats: Splats
    map_frame: MapFrame
    ground: SeenGround

    @property
    def cleaning(self) -> Cleaning:
        """The steps by which the model was cleaned."""
        return Cleaning() if self.run.model is None else self.run.model.cleaning

    @property
    def regions(self) -> tuple[FloatArray, ...]:
        """Borders (V,2) of the plan's regions in the world."""
        return tuple(border for border in self.run.cloud_plan.borders if len(border) >= 3)

    @property
    def trained(self) -> list[int]:
        """Indices of the cameras whose photographs the model was trained on."""
        return [row for row, name in enumerate(self.run.scene.cameras.names) if name not in self.run.held_out]


def load_survey(folder: Path, crs: str | None = None, *, as_trained: bool = False) -> Survey:
    """The survey of a run folder on the map that `crs` names, else its alignment's or its UTM zone,
    of the model by its cleaning unless `as_trained`; BadInput for a model alone, or a run without
    ground."""
    if not folder.is_dir():
        raise BadInput(f"{folder} is no folder of a run: a survey needs the cameras beside the model.")
    run = load_run_view(folder, as_trained=as_trained)
    map_frame = map_of_run(folder, run.scene.frame, crs)
    return Survey(run=run, splats=require_splats(run), map_frame=map_frame, ground=seen_ground(run.scene, map_frame))


def cell_of(survey: Survey, resolution: float | None, pixels: float) -> float:
    """The cell that was asked for, or so many pixels of the photographs; BadInput where it is finer
    than any photograph shows."""
    if resolution is None:
        # Two digits: a cell of 0.1 m is asked for by name again.
        return float(f"{pixels * survey.ground.gsd:.2g}")
    finest = FINEST_SHARE * survey.ground.gsd
    if not resolution >= finest:
        raise BadInput(f"a resolution of {resolution} was asked for, expected a number of at least {finest:.3g}: choose a coarser one.")
    return resolution


def support_of_survey(survey: Survey, display: ProgressDisplay, long_side_px: int) -> Support:
    """Which photographs constrain each Gaussian: as the run measured it, else measured now."""
    from radiant_core.evaluate.support import support_of

    stored = run_support(survey.run)
    if stored is not None:
        return stored
    cameras = survey.run.scene.cameras.select(np.array(survey.trained, np.int64)).scaled(long_side_px)
    with stage_bar(display, "support") as report:
        return support_of(survey.splats, cameras, report=lambda num_done, total: report(num_done, total, "views"))
