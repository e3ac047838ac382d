"""`radiant export` of projects that other trainers open: COLMAP's and nerfstudio's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from radiant_app.commands.export.request import ExportRequest, run_of
from radiant_app.commands.model.place import place_of
from radiant_app.events import Warned
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.io.photos.folders import in_short

if TYPE_CHECKING:
    from radiant_core.export.projects import ProjectCounts, ProjectPhotographs
    from radiant_core.scene import SfmScene
    from radiant_viewer.runs.run_view import RunView

    ProjectWriter = Callable[[Path, SfmScene, ProjectPhotographs, Callable[[int, int], None]], ProjectCounts]


def export_colmap(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """A COLMAP project: binary model, undistorted photographs, masks."""
    from radiant_core.export.projects import save_colmap_project

    return _export_project(request, display, save_colmap_project)


def export_nerfstudio(request: ExportRequest, display: ProgressDisplay) -> dict[str, Any]:
    """A nerfstudio project: transforms.json, points, undistorted photographs, masks."""
    from radiant_core.export.projects import save_nerfstudio_project

    return _export_project(request, display, save_nerfstudio_project)


def _export_project(request: ExportRequest, display: ProgressDisplay, write: ProjectWriter) -> dict[str, Any]:
    from radiant_app.commands.run.steps import stage_bar
    from radiant_app.files.run_folder import create_folder

    scene = _scene_without_repeats(run_of(request), display)
    place = place_of(request.model, request.crs)
    if place.move is not None:
        scene = place.move.move_scene(scene)
    photographs = photographs_of(request.model)
    with create_folder(request.out, whole=True), stage_bar(display, "export") as report:
        counts = write(request.out, scene, photographs, lambda num_done, total: report(num_done, total, "photographs"))
    if photographs.images is None:
        message = "the photographs stay with their devices: images/ is not written, and whoever trains needs them there."
        display(Warned(stage="export", message=message))
    elif counts.missing:
        message = f"{len(counts.missing)} of {len(scene.cameras)} photographs are no longer in {photographs.images}: "
        display(Warned(stage="export", message=f"{message}{in_short(counts.missing)}."))
    figures = {"cameras": len(scene.cameras), "points": len(scene.points), "observations": len(scene.observations)}
    return {**figures, "photographs": counts.photographs, "masks": counts.masks, **place.write(request.out)}


def photographs_of(model: Path) -> ProjectPhotographs:
    """Where the photographs lie that a model is of: undistorted, not as taken."""
    from radiant_app.workers.sources import has_scene, images_folder_of, masks_folder_of
    from radiant_core.export.projects import ProjectPhotographs

    if not has_scene(model):
        return ProjectPhotographs(images=None)
    try:
        return ProjectPhotographs(images=images_folder_of(model), masks=masks_folder_of(model))
    except BadInput:
        return ProjectPhotographs(images=None)


def _scene_without_repeats(run: RunView, display: ProgressDisplay) -> SfmScene:
    """The scene; without copies of photographs unless it is a run's, as training takes it."""
    from radiant_core.sfm.copies import without_repeats
    from radiant_viewer.runs.unplanned import unplanned_photographs

    photographs = None if run.kind == "run" else unplanned_photographs(run.folder)
    if photographs is None or not photographs.is_dir():
        return run.scene
    scene, warnings = without_repeats(run.scene, photographs)
    for message in warnings:
        display(Warned(stage="export", message=message))
    return scene
