"""`radiant join`: join the run of a new region to a finished scene, as edges are joined.

Beyond a margin about the region the scene keeps its bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from radiant_app.commands.model.given_model import given_model
from radiant_app.commands.run.steps import require_file_to_be, require_run, stage_bar
from radiant_app.events import Warned
from radiant_app.files.out_folder import folder_made_for
from radiant_app.files.run_folder import require_current
from radiant_app.report.progress import ProgressDisplay
from radiant_app.reporting import EventReporter
from radiant_app.workers.inbox import load_corrections
from radiant_app.workers.sources import DELIVERED, has_scene, load_scene_of
from radiant_core.aggregate.config import Join
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3, enu_change
from radiant_core.geometry.similarity import move_cameras
from radiant_core.hierarchy.codec import load_task
from radiant_core.hierarchy.messages import CloudTask
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import load_cameras, load_plan_waypoints
from radiant_core.numerics import FloatArray
from radiant_core.plan.regions.power_diagram import polygon_area_m2
from radiant_core.splats import Splats
from radiant_core.waypoints.region import load_region

STAGE = "extend"
MARGIN = 0.05
"""Half width of the fitted strip, as a share of the side of a square as large as the region."""

FIGURES = {
    "unchanged": "num_kept",
    "replaced": "num_replaced",
    "filled": "num_filled",
    "new": "num_added",
    "fitted": "num_fitted",
    "views": "num_shown",
}
"""What the command prints → the figure of the join."""


@dataclass(frozen=True, kw_only=True)
class ExtendRequest:
    """What `radiant join` was asked for."""

    old: Path
    """A run, or a model file in the frame of `new`."""
    new: Path
    """A run."""
    out: Path
    region: Path | None = None
    """GeoJSON; None: the convex hull of the new run's virtual cameras."""
    margin_m: float | None = None
    num_epochs: int | None = None


def extend(request: ExtendRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write the extended scene as a PLY.

    Args:
        request: the old scene, the new run, the region and the output.
        display: shows progress.

    Returns:
        Figures of the extended scene, for the command line.

    Raises:
        BadInput: the two runs have no frame in common, or the new one is of an earlier version.
    """
    from radiant_core.aggregate.extend import NewRegion, extend_scene
    from radiant_core.aggregate.synthetic_views import Teacher
    from radiant_core.hierarchy.reporter import Machine, fit_options
    from radiant_core.render.backends import resolve_backend

    if request.num_epochs is not None and request.num_epochs < 1:
        raise BadInput(f"the margin is shown {request.num_epochs} times, and nobody else fits it: give 1 or more epochs.")
    require_file_to_be(request.out)
    require_run(request.new, "scene.ply")
    require_current(request.new)
    train = load_task(CloudTask, request.new / "cloud").train
    if request.old.is_dir():
        require_run(request.old, "scene.ply")
    old = given_model(request.old, display, as_trained=True).splats
    move, origin, frames = _common_frame(request)
    new, cameras = _move_scene(load_ply(request.new / "scene.ply"), _virtual_cameras(request.new), move)
    if request.region is not None and origin is None:
        raise BadInput("a region in latitude and longitude needs scenes with GPS: leave --region out.")

    def warn(message: str) -> None:
        display(Warned(stage=STAGE, message=message))

    polygon = _hull(cameras.centers[:, :2]) if request.region is None or origin is None else load_region(request.region, origin, warn)
    side_m = float(np.sqrt(abs(polygon_area_m2(polygon))))
    margin_m = MARGIN * side_m if request.margin_m is None else request.margin_m
    addition, region = Teacher(splats=new, cameras=cameras), NewRegion(polygon=polygon, margin_m=margin_m)
    with stage_bar(display, STAGE):
        reporter = EventReporter(stage=STAGE, emit=display)
        options = fit_options(resolve_backend("auto"), reporter, Machine(), lambda: "")
        extended = extend_scene(old, addition, region, train, Join(epochs=request.num_epochs), options)
    with folder_made_for(request.out):
        save_ply(request.out, extended.splats)
    return {
        "gaussians": len(extended.splats),
        **{name: getattr(extended, count) for name, count in FIGURES.items()},
        "margin_m": round(margin_m, 3),
        "frames": frames,
        "model": str(request.out),
    }


def _common_frame(request: ExtendRequest) -> tuple[Sim3 | None, FloatArray | None, str]:
    """How the new run moves into the old one's frame (None: not at all), that frame's origin where
    it is known, and a sentence."""
    new = _origin(request.new)
    if request.old.is_file():
        return None, new, "a model file names no frame: taken to be that of the new run"
    old = _origin(request.old)
    if old is None or new is None:
        lost = request.old if old is None else request.new
        raise BadInput(
            f"{lost} has no GPS, so the two runs have no frame in common: run it with GPS, or give the old scene as a PLY in the new frame."
        )
    if np.array_equal(old, new):
        return None, old, "both runs have one origin"
    apart_m = float(np.linalg.norm(enu_change(new, old).translation))
    return enu_change(new, old), old, f"the new run was moved by {apart_m:.2f} m to the origin of the old one"


def _origin(run: Path) -> FloatArray | None:
    """Latitude, longitude and altitude of a run's origin; None without GPS."""
    place = run / DELIVERED if (run / DELIVERED).is_dir() else run
    if has_scene(place):
        frame = load_scene_of(place).frame
        return frame.origin_lat_lon_alt if frame.kind == "metric" else None
    require_run(run)
    waypoints = load_plan_waypoints(run / "plan.json")
    return None if waypoints is None else waypoints.origin


def _virtual_cameras(run: Path) -> Cameras:
    inbox = run / "cloud" / "inbox"
    # Where frames come from GPS the cloud moved what its edges sent, and left some out.
    moves = load_corrections(run / "cloud") if inbox.is_dir() else {}
    moved_files = [(path, move) for path in sorted(inbox.glob("*/virtual_cameras.safetensors")) if (move := moves.get(path.parent.name))]
    if not moved_files:
        raise BadInput(f"{inbox} holds no virtual cameras to ask the new model at: run it with a cloud that retrains, the default.")
    return concatenate_cameras([move_cameras(load_cameras(path), move) for path, move in moved_files])


def _move_scene(splats: Splats, cameras: Cameras, move: Sim3 | None) -> tuple[Splats, Cameras]:
    if move is None:
        return splats, cameras
    from radiant_core.geometry.similarity import move_splats

    poses = move.apply_to_poses(cameras.cam_from_world)
    return move_splats(splats, move), Cameras(names=cameras.names, Ks=cameras.Ks, cam_from_world=poses, sizes_wh=cameras.sizes_wh)


def _hull(places: FloatArray) -> FloatArray:
    try:
        return places[ConvexHull(places).vertices]
    except (QhullError, ValueError):
        raise BadInput(f"the {len(places)} cameras of the new run span no land: give its region with --region.") from None
