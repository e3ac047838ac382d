"""The land that the chunks of an exported model belong to: the regions of one or more runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import enu_change
from radiant_core.lod.cells import LodRegion, region_of_polygon, whole_region
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats

if TYPE_CHECKING:
    from radiant_viewer.runs.run_view import RunView


def lod_regions(model: Path, splats: Splats, runs: Sequence[Path]) -> tuple[LodRegion, ...]:
    """Regions of `runs` in the frame of the first, else of the run `model`, else all land.

    The regions of a run that was joined later come after those before it and take land over.
    Raises BadInput as the readers, and where two runs have no frame in common.
    """
    from radiant_viewer.runs.run_view import load_run_view

    named = tuple(runs) or ((model,) if model.is_dir() else ())
    views = [load_run_view(run) for run in named]
    regions = [region for view in views for region in _regions_of(view, views[0])]
    return tuple(regions) or (whole_region(splats.means),)


def _regions_of(run: RunView, first: RunView) -> list[LodRegion]:
    height_m = float(run.scene.cameras.centers[:, 2].mean()) if len(run.scene.cameras) else 0.0
    polygons = [border for border in run.cloud_plan.borders if len(border) > 2]
    return [region_of_polygon(_moved(polygon, run, first), height_m) for polygon in polygons]


def _moved(polygon: FloatArray, run: RunView, first: RunView) -> FloatArray:
    """A polygon (V,2) m of one run in the frame of another."""
    frame, first_frame = run.scene.frame, first.scene.frame
    if run is first or np.array_equal(frame.origin_lat_lon_alt, first_frame.origin_lat_lon_alt):
        return polygon
    if frame.kind != "metric" or first_frame.kind != "metric":
        raise BadInput(f"{run.folder} and {first.folder} have no frame in common: name runs with GPS, or one run alone.")
    corners = np.column_stack([polygon, np.zeros(len(polygon))])
    return enu_change(frame.origin_lat_lon_alt, first_frame.origin_lat_lon_alt).apply(corners)[:, :2]
