"""`radiant inspect`: what is to be looked at, a run or a plan without one, and with which machines its plan may be changed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from radiant_app import commands
from radiant_app.commands import training_part
from radiant_app.constraints_file import dump_constraints
from radiant_app.plan_pictures import SYSTEM, beside
from radiant_app.prediction_error import SYSTEM_NAME
from radiant_app.sources import load_scene_of
from radiant_app.system_file import dump_system, load_system
from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.io.records import load_plan, load_plan_waypoints
from radiant_core.plan.waypoints import Waypoints

if TYPE_CHECKING:
    from radiant_viewer.plan_files import PlanSetting

EDITS = "_edits.json"
"""Ending of the file beside a plan that keeps what was changed in the window."""


def plan_file_of(source: Path) -> Path | None:
    """The plan file where `source` is one, or a folder without a run that holds exactly one plan; None for a run, and for anything else.

    Raises BadInput for a folder with several plans.
    """
    if source.is_file():
        return source if source.suffix == ".json" else None
    if not source.is_dir() or (source / "manifest.json").is_file():
        return None
    found = [path for path in sorted(source.glob("*.json")) if not path.stem.endswith("_start") and _is_plan(path)]
    if len(found) > 1 and source / "plan.json" not in found:
        raise BadInput(f"{source} holds {len(found)} plans, {found[0].name} and {found[1].name} among them: name one of the files.")
    return (source / "plan.json" if source / "plan.json" in found else found[0]) if found else None


def open_inspector(source: Path, system: Path | None = None, scene: Path | None = None) -> int:
    """Show a run or a plan until its window is closed; returns the exit code. BadInput as `plan_file_of` and the readers."""
    from radiant_app.inspect_feeds import feeds_of
    from radiant_viewer.inspector import open_window

    plan = plan_file_of(source)
    if plan is None:
        if scene is not None:
            raise BadInput("a run knows its scene: leave out --scene, or give a plan file.")
        return open_window(source, feeds_of(source), setting=run_setting(source, system) if source.is_dir() else None)
    known = None if scene is None else training_part(load_scene_of(scene))
    return open_window(plan, setting=plan_setting(plan, system), scene=known)


@dataclass(frozen=True, kw_only=True)
class Picture:
    """How a view is drawn: size (width, height) px, the photograph it is about, and the scene of a plan that has no waypoints."""

    size_wh: tuple[int, int] = (1280, 900)
    camera: str | None = None
    scene: Path | None = None


def save_picture(source: Path, view: str, path: Path, picture: Picture = Picture()) -> str:
    """Write one view of a run, or of a plan as PNG; BadInput where there is no such view of it."""
    if source.suffix.lower() == ".ply" and source.is_file():
        raise BadInput(
            f"{source} is a model alone and --screenshot draws the views of a run or a plan: leave it out to open the window, or draw "
            "pictures by 'radiant render MODEL.ply --keyframes FILE'."
        )
    plan, scene = plan_file_of(source), picture.scene
    if plan is None:
        return commands.screenshot(source, view, path, picture.size_wh, picture.camera)
    if picture.camera is not None:
        raise BadInput("a plan has no photographs: leave out --camera.")
    if path.suffix.lower() != ".png" or not path.parent.is_dir():
        raise BadInput(f"cannot write {path}: give a name that ends in .png in a folder that exists.")
    if view not in ("regions", "cameras"):
        raise BadInput(f"a plan has no {view} yet, nothing was trained: use --view regions or cameras.")
    from radiant_viewer.images import save_png
    from radiant_viewer.plan_view import load_plan_view
    from radiant_viewer.views import cameras_picture, plan_picture

    shown = load_plan_view(plan, None if scene is None else training_part(load_scene_of(scene)))
    if view == "regions":
        save_png(path, plan_picture(shown.scene, shown.cloud_plan, shown.edge_plans, size_wh=picture.size_wh))
    else:
        save_png(path, cameras_picture(shown.scene, shown.roles, size_wh=picture.size_wh))
    return f"written: {path}"


def run_setting(run: Path, system: Path | None = None) -> PlanSetting:
    """With which machines the plan of a run may be changed: those it was planned for."""
    reason = f"The plan cannot be changed: {run.name} has no {SYSTEM_NAME}, it was planned by an earlier version; name one by --system."
    own = run / SYSTEM_NAME
    return _setting(system or (own if own.is_file() else None), reason, run / f"plan{EDITS}", None)


def plan_setting(plan: Path, system: Path | None = None) -> PlanSetting:
    """As `run_setting`, of a plan file."""
    places = [path for path in (beside(plan, SYSTEM), plan.parent / SYSTEM_NAME) if path.is_file()]
    reason = "The plan cannot be changed: its machines are not known; name the system file it was made with by --system."
    return _setting(system or (places[0] if places else None), reason, beside(plan, EDITS), load_plan_waypoints(plan))


def _setting(system: Path | None, reason: str, keep_in: Path, waypoints: Waypoints | None) -> PlanSetting:
    from radiant_viewer.plan_files import PlanSetting

    return PlanSetting(
        system=None if system is None else load_system(system, curves=True),
        reason=reason if system is None else "",
        keep_in=keep_in,
        waypoints=waypoints,
        system_text=dump_system,
        constraints_text=dump_constraints,
    )


def _is_plan(path: Path) -> bool:
    try:
        load_plan(path)
    except (BadInput, StoreDamaged):
        return False
    return True
