"""`radiant clean`: the rules by which Gaussians are left out of a model, made, listed, taken back.

Once per call; measuring the support takes a render and its backward per photograph.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.commands.model.given_model import given_model
from radiant_app.commands.run.steps import require_model, stage_bar
from radiant_app.events import Warned
from radiant_app.files.run_folder import read_manifest
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import (
    CleaningStep,
    OpacityStep,
    PolygonStep,
    RegionsStep,
    SizeStep,
    SupportStep,
    Surroundings,
    describe,
)
from radiant_core.geometry.cleaning_file import cleaning_path, load_cleaning, save_cleaning, step_record
from radiant_core.geometry.support import MIN_PARALLAX_DEG, MIN_VIEWS, Support, save_support
from radiant_core.io.run_store import RunLock, read_json
from radiant_core.waypoints.region import load_region
from radiant_viewer.runs.cleaned_model import OWN_SUPPORT, CleanedModel, cleaned_model, find_support, surroundings
from radiant_viewer.runs.run_view import METRICS_NAME, RunView, load_run_view, require_splats
from radiant_viewer.runs.sent_pages import older_sentence
from radiant_viewer.runs.unplanned import finish_command, folder_kind

MEASURED_LONG_SIDE_PX = 640
Warn = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class CleanRequest:
    """Steps to add, in this order, after steps taken back or made again; polygons are a GeoJSON
    file or "x,y x,y x,y" of the model's coordinates, heights (low, high) hold for them."""

    model: Path
    keep: str | None = None
    remove: str | None = None
    heights: tuple[float | None, float | None] = (None, None)
    regions_margin: float | None = None
    min_views: int | None = None
    min_parallax_deg: float | None = None
    min_opacity: float | None = None
    max_size: float | None = None
    undo: int = 0
    redo: bool = False
    measure: bool = False
    pages: bool = False
    """Whether the pages of the run that are sent are made anew."""


def clean(request: CleanRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Change the cleaning of a model as wanted, and say what each of its steps leaves out.

    Raises BadInput where a step does not fit to the model or nothing would be left; the file is
    then as it was.
    """
    require_model(request.model)
    run = load_run_view(request.model, as_trained=True) if request.model.is_dir() else None
    model = given_model(request.model, display, as_trained=True) if run is None else require_cleaned_model(run)
    path, steps = cleaning_path(request.model), _steps(request, run, lambda message: display(Warned(stage="clean", message=message)))
    if request.measure or any(isinstance(step, SupportStep) for step in steps):
        _measure(run, model, display, anew=request.measure)
    before = load_cleaning(path)
    after = before.undo(request.undo) if request.undo else before
    after = after.redo() if request.redo else after
    after = after.add(*steps) if steps else after
    result = cleaned_model(model.whole, after, _around(run, model))
    if after != before:
        save_cleaning(path, after)
    figures = _figures(result, path, "units" if run is None else run.unit)
    if request.pages:
        return {**figures, **rewrite_pages(request.model, display)}
    if sentence := older_sentence(request.model):
        display(Warned(stage="clean", message=f"{sentence}: 'radiant clean {request.model} --pages' makes them anew."))
    return figures


def rewrite_pages(run: Path, display: ProgressDisplay) -> dict[str, Any]:
    """Write report.html and scene.html of a finished run as its model is cleaned now; BadInput
    where the folder holds none, or the run is at work."""
    from radiant_app.report.html import write_report

    if not run.is_dir() or folder_kind(run) != "run":
        raise BadInput(f"{run} has no pages that are sent: give the folder that 'radiant run --out' made, or leave --pages out.")
    if not (run / METRICS_NAME).is_file():
        raise BadInput(f"{run} has no {METRICS_NAME}, of which its report tells: {finish_command(run)}.")
    with RunLock(run):
        return {"pages": str(write_report(run, read_manifest(run), read_json(run / METRICS_NAME), display))}


def require_cleaned_model(run: RunView) -> CleanedModel:
    """Return a run's model; BadInput with the command that makes it where there is none."""
    require_splats(run)
    assert run.model is not None
    return run.model


def measure_support(run: RunView, long_side_px: int, display: ProgressDisplay) -> Support:
    """The support of a run's whole model by the cameras that it was trained on."""
    from radiant_core.evaluate.support import support_of

    trained = [row for row, name in enumerate(run.scene.cameras.names) if name not in run.held_out]
    with stage_bar(display, "clean") as report:
        cameras = run.scene.cameras.select(np.array(trained, np.int64)).scaled(long_side_px)
        return support_of(require_cleaned_model(run).whole, cameras, report=lambda num_done, total: report(num_done, total, "views"))


def _measure(run: RunView | None, model: CleanedModel, display: ProgressDisplay, *, anew: bool) -> None:
    if run is None:
        raise BadInput("a model alone has no cameras that could support it: give the folder of a run, or leave --min-views out.")
    if anew or find_support(run.folder, len(model.whole)) is None:
        save_support(run.folder / OWN_SUPPORT, measure_support(run, MEASURED_LONG_SIDE_PX, display))


def _around(run: RunView | None, model: CleanedModel) -> Surroundings:
    return Surroundings() if run is None else surroundings(run.folder, run.scene, run.cloud_plan, len(model.whole))


def _steps(request: CleanRequest, run: RunView | None, warn: Warn) -> list[CleaningStep]:
    low, high = request.heights
    if (low, high) != (None, None) and request.keep is None and request.remove is None:
        raise BadInput("--heights is of a polygon: add --keep or --remove.")
    steps: list[CleaningStep] = []
    if request.keep is not None:
        steps.append(PolygonStep(corners=_corners(request.keep, run, warn), keep="inside", low=low, high=high))
    if request.remove is not None:
        steps.append(PolygonStep(corners=_corners(request.remove, run, warn), keep="outside", low=low, high=high))
    if request.regions_margin is not None:
        steps.append(RegionsStep(margin=request.regions_margin))
    if request.min_views is not None or request.min_parallax_deg is not None:
        views = MIN_VIEWS if request.min_views is None else request.min_views
        angle = MIN_PARALLAX_DEG if request.min_parallax_deg is None else request.min_parallax_deg
        steps.append(SupportStep(num_views=views, parallax_deg=angle))
    if request.min_opacity is not None:
        steps.append(OpacityStep(at_least=request.min_opacity))
    if request.max_size is not None:
        steps.append(SizeStep(at_most=request.max_size))
    return steps


def _corners(text: str, run: RunView | None, warn: Warn) -> tuple[tuple[float, float], ...]:
    if Path(text).suffix.lower() in (".geojson", ".json"):
        return _geojson_corners(Path(text), run, warn)
    try:
        pairs = [tuple(float(part) for part in corner.split(",")) for corner in text.split()]
        return tuple((x, y) for x, y in pairs)
    except ValueError:
        raise BadInput(f'{text!r} is no polygon: write "x,y x,y x,y" in the model\'s coordinates, or name a .geojson file.') from None


def _geojson_corners(path: Path, run: RunView | None, warn: Warn) -> tuple[tuple[float, float], ...]:
    """The outer ring of a file's polygon, in WGS84, in the run's frame."""
    if run is None or run.scene.frame.kind != "metric":
        raise BadInput(f'{path} is in degrees, and this model has no place on earth: write the polygon as "x,y x,y x,y".')
    return tuple((float(x), float(y)) for x, y in load_region(path, run.scene.frame.origin_lat_lon_alt, warn))


def _figures(model: CleanedModel, path: Path, unit: str) -> dict[str, Any]:
    steps = zip(model.cleaning.steps, model.cleaned.removed, strict=True)
    return {
        "cleaning": str(path) if path.exists() else "none",
        "gaussians": len(model.whole),
        "left_out": model.cleaned.num_left_out,
        "kept": len(model.splats),
        "steps": [{"step": step_record(step), "keeps": describe(step, unit), "left_out": count} for step, count in steps],
        "undone": len(model.cleaning.undone),
    }
