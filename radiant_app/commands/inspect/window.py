"""`radiant inspect`: what is looked at, and with which machines its plan may be changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from radiant_app.commands.plan.pictures import SYSTEM, sibling
from radiant_app.files.constraints_file import dump_constraints
from radiant_app.files.system_file import dump_system, load_system
from radiant_app.report.prediction_error import SYSTEM_NAME
from radiant_core.choices import Painter
from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.model_reader import model_kind
from radiant_core.io.records import PlanFile, load_plan, load_plan_file
from radiant_core.plan.system import System
from radiant_viewer.runs.run_view import SCENE_NAME
from radiant_viewer.runs.unplanned import folder_kind

if TYPE_CHECKING:
    from radiant_core.scene import SfmScene
    from radiant_viewer.editing.store.plan_files import PlanSetting
    from radiant_viewer.window.inspector import Opening

EDITS = "_edits.json"
"""Ending of the file beside a plan that keeps what was changed in the window."""


def plan_file_of(source: Path) -> Path | None:
    """The plan file that `source` is, or a folder's only plan; None for a run and anything else.
    Raises BadInput for a folder with several plans, and for a run that lost its manifest."""
    if source.is_file():
        return source if source.suffix == ".json" and model_kind(source) is None else None
    if not source.is_dir() or (source / "manifest.json").is_file():
        return None
    if (source / "plan.json").is_file() and (source / SCENE_NAME).is_file():
        raise BadInput(
            f"{source} is a run that lost its manifest.json: bring that file back, or look at the plan alone with "
            f"'radiant inspect {source / 'plan.json'} --scene {source}'."
        )
    plans = [path for path in sorted(source.glob("*.json")) if not path.stem.endswith("_start") and _is_plan(path)]
    if len(plans) > 1 and source / "plan.json" not in plans:
        raise BadInput(f"{source} holds {len(plans)} plans, {plans[0].name} and {plans[1].name} among them: name one of the files.")
    return (source / "plan.json" if source / "plan.json" in plans else plans[0]) if plans else None


def open_inspector(source: Path, system: Path | None = None, scene: Path | None = None, painter: Painter | None = None) -> int:
    """Show a run or a plan until its window is closed, its model drawn by a painter; returns the
    exit code. Raises BadInput as `plan_file_of` and the readers."""
    from radiant_viewer.window.inspector import open_window

    opened = opening_of(source, system, scene)
    return open_window(opened.path, opened.feeds, setting=opened.setting, scene=opened.scene, painter=painter)


def opening_of(source: Path, system: Path | None = None, scene: Path | None = None) -> Opening:
    """How the inspector opens a run, a model or a plan; raises as `open_inspector`."""
    from radiant_app.commands.inspect.feeds import feeds_of
    from radiant_viewer.runs.run_feeds import RunFeeds
    from radiant_viewer.window.inspector import Opening

    plan = plan_file_of(source)
    if plan is None:
        if scene is not None:
            raise BadInput("a run knows its scene: leave out --scene, or give a plan file.")
        setting = (lambda: run_setting(source, system)) if source.is_dir() else None
        return Opening(path=source, feeds=feeds_of(source), setting=setting)
    loaded = None if scene is None else _load_planned_scene(scene)
    return Opening(path=plan, feeds=RunFeeds(), setting=lambda: plan_setting(plan, system), scene=loaded)


def open_start_window() -> int:
    """Show the window in which a run is begun or chosen, and then that; returns the exit code."""
    from radiant_app.commands.inspect.feeds import start_feeds
    from radiant_viewer.window.inspector import open_start

    return open_start(start_feeds(), opening_of)


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A view's size (width, height) px, photograph, and scene where a plan has no waypoints."""

    size_wh: tuple[int, int] = (1280, 900)
    camera: str | None = None
    scene: Path | None = None


def save_picture(source: Path, view: str | None, path: Path, picture: Picture = Picture()) -> str:
    """Write a view (or the usual one) as PNG; BadInput for a wrong view or an existing `path`."""
    if path.suffix.lower() != ".png":
        raise BadInput(f"cannot write {path}: give a name that ends in .png.")
    from radiant_app.commands.run.steps import require_file_to_be
    from radiant_app.files.out_folder import folder_made_for

    require_file_to_be(path)
    with folder_made_for(path):
        return _save_picture(source, view, path, picture)


def _save_picture(source: Path, view: str | None, path: Path, picture: Picture) -> str:
    if source.is_file() and model_kind(source) is not None:
        return _save_model_picture(source, view, path, picture)
    plan, scene = plan_file_of(source), picture.scene
    if plan is None:
        from radiant_app.commands.run.steps import screenshot

        return screenshot(source, view, path, picture.size_wh, picture.camera)
    if picture.camera is not None:
        raise BadInput("a plan has no photographs: leave out --camera.")
    view = view or "regions"
    if view not in ("regions", "cameras"):
        raise BadInput(f"a plan has no {view} yet, nothing was trained: use --view regions or cameras.")
    from radiant_viewer.pictures.images import save_png
    from radiant_viewer.runs.plan_view import load_plan_view
    from radiant_viewer.runs.run_pictures import cameras_picture, plan_picture

    plan_view = load_plan_view(plan, None if scene is None else _load_planned_scene(scene))
    if view == "regions":
        save_png(path, plan_picture(plan_view.scene, plan_view.cloud_plan, plan_view.edge_plans, size_wh=picture.size_wh))
    else:
        save_png(path, cameras_picture(plan_view.scene, plan_view.roles, size_wh=picture.size_wh))
    return f"written: {path}"


def _save_model_picture(source: Path, view: str | None, path: Path, picture: Picture) -> str:
    if view not in (None, "splats"):
        raise BadInput(f"{source} is a model alone, of which there are no {view}: use --view splats, or give the folder of a run.")
    if picture.camera is not None or picture.scene is not None:
        raise BadInput(f"{source} is a model alone, without photographs and plan: leave out --camera and --scene.")
    from radiant_app.commands.model.given_model import given_model
    from radiant_app.report.progress import terminal_display
    from radiant_viewer.pictures.images import save_png
    from radiant_viewer.runs.run_pictures import model_picture
    from radiant_viewer.runs.shown_model import model_box, shown_model

    splats = given_model(source, terminal_display()).splats
    save_png(path, model_picture(splats, picture.size_wh))
    hidden = shown_model(splats, model_box(splats)).sentence
    more = f"\nof {len(splats):,} Gaussians {hidden}: radiant render MODEL PICTURE.png --surroundings shows them" if hidden else ""
    return f"written: {path}{more}"


def inspect_with_open3d(source: Path, view: str | None, path: Path | None, picture: Picture = Picture()) -> int:
    """Show a run, a plan or a model in Open3D's window, or write what it would show as PNG; returns
    the exit code. Raises BadInput for what Open3D does not show."""
    from radiant_viewer.open3d_window.launch import open_open3d_window, save_open3d_picture

    plan = plan_file_of(source) if source.exists() else None
    if view not in (None, "splats"):
        raise BadInput(f"Open3D shows the whole scene, and {view} is a picture of our own: leave out --view or --viewer open3d.")
    if picture.scene is not None:
        raise BadInput("--viewer open3d shows runs, models and plans with waypoints: leave out --scene or --viewer open3d.")
    if path is None:
        return open_open3d_window(plan or source, picture.size_wh, picture.camera)
    if path.suffix.lower() != ".png":
        raise BadInput(f"cannot write {path}: give a name that ends in .png.")
    from radiant_app.commands.run.steps import require_file_to_be
    from radiant_app.files.out_folder import folder_made_for

    require_file_to_be(path)
    with folder_made_for(path):
        save_open3d_picture(plan or source, path, picture.size_wh, picture.camera)
    return 0


def run_setting(run: Path, system: Path | None = None) -> PlanSetting:
    """With which machines the plan of a run may be changed: those it was planned for."""
    reason = f"The plan cannot be changed: {run.name} has no {SYSTEM_NAME}, it was planned by an earlier version; name one by --system."
    if folder_kind(run) != "run":
        reason = f"There is no plan to change: {run.name} was made without one."
    system_path = run / SYSTEM_NAME
    return _setting(_machines(system, [system_path], reason), run / f"plan{EDITS}")


def plan_setting(plan: Path, system: Path | None = None) -> PlanSetting:
    """As `run_setting`, of a plan file."""
    reason = "The plan cannot be changed: its machines are not known; name the system file it was made with by --system."
    machines = _machines(system, [sibling(plan, SYSTEM), plan.parent / SYSTEM_NAME], reason)
    return _setting(machines, sibling(plan, EDITS), load_plan_file(plan))


def _machines(named: Path | None, places: Sequence[Path], reason: str) -> tuple[System | None, str]:
    """The system that was named, else the first of `places`, else None and why: only a named file
    raises an error if it is broken, since everything but editing the plan works without."""
    if named is not None:
        return load_system(named, curves=True), ""
    existing = [path for path in places if path.is_file()]
    if not existing:
        return None, reason
    try:
        return load_system(existing[0], curves=True), ""
    except (BadInput, StoreDamaged) as error:
        return None, f"The plan cannot be changed: {error}"


def _setting(machines: tuple[System | None, str], edits_path: Path, plan: PlanFile | None = None) -> PlanSetting:
    from radiant_viewer.editing.store.plan_files import PlanSetting

    system, reason = machines
    return PlanSetting(
        system=system,
        reason=reason,
        edits_path=edits_path,
        waypoints=None if plan is None else plan.waypoints,
        ground_m=None if plan is None else plan.ground_m,
        system_text=dump_system,
        constraints_text=dump_constraints,
    )


def _load_planned_scene(scene: Path) -> SfmScene:
    """The cameras of a scene that a plan deals: those that are not held out."""
    # Imported here: half a second that a window of a run need not wait for.
    from radiant_app.commands.run.steps import training_part
    from radiant_app.workers.sources import load_scene_of

    return training_part(load_scene_of(scene))


def _is_plan(path: Path) -> bool:
    try:
        load_plan(path)
    except (BadInput, StoreDamaged):
        return False
    return True
