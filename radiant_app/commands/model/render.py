"""`radiant render`: pictures or a film of a model, from cameras or along a path. Once per call."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from radiant_app.commands.model.evaluate import DEFAULT_LONG_SIDE_PX, load_scored_cameras
from radiant_app.commands.model.given_model import given_model
from radiant_app.commands.run.steps import require_file_to_be, require_model, stage_bar
from radiant_app.events import Decided, Warned
from radiant_app.files.out_folder import folder_made_for
from radiant_app.files.run_folder import create_folder
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.evaluation import png_bytes
from radiant_core.cameras import Cameras
from radiant_core.choices import Trajectory
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.records import load_cameras
from radiant_core.io.run_store import read_bounded, write_atomic
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.borders import Border, shared_borders
from radiant_core.render.reach import Reach
from radiant_core.render.trajectories import Lens, along_border, cameras_looking_at, orbit, through_keyframes
from radiant_core.splats import Splats
from radiant_viewer.pictures.movie import ENDINGS, NOT_FOR_BROWSERS, MovieWriter
from radiant_viewer.runs.run_view import RunView, load_run_view
from radiant_viewer.runs.unplanned import folder_kind, scene_box

OTHER_FILMS = (".avi", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".wmv", ".apng", ".webp")
"""Endings that no one means for a folder of frames."""
MAX_KEYFRAME_BYTES = 1 << 24
PICTURE, OTHER_PICTURES = ".png", (".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
ORBIT_ELEVATION_DEG, ORBIT_RADII = 35.0, 0.9
"""Distance of an orbit, in diagonals of the regions."""
FLIGHT_HEIGHTS = 0.5
"""Height along a border as a share of the cameras' own; at least a twentieth of the border."""


@dataclass(frozen=True, kw_only=True)
class RenderRequest:
    """What `radiant render` was asked for; at most one of cameras, trajectory and keyframes."""

    model: Path
    out: Path
    cameras: Path | None = None
    trajectory: Trajectory | None = None
    border: tuple[str, ...] | None = None
    keyframes: Path | None = None
    num_frames: int = 120
    fps: float = 24.0
    size_wh: tuple[int, int] = (960, 540)
    long_side_px: int | None = None
    as_trained: bool = False
    """Whether what the model's cleaning leaves out is shown too."""
    surroundings: bool = False
    """Whether what lies around the scene, or far before it, is shown too."""

    @property
    def shows_all(self) -> bool:
        """Whether nothing of the model is hidden for its pictures."""
        return self.as_trained or self.surroundings


def render(request: RenderRequest, display: ProgressDisplay) -> dict[str, Any]:
    """Write PNG pictures into the new folder `out`, or a film; returns what was written. Raises
    BadInput before anything is rendered, and where a picture does not fit into memory."""
    request, is_film = _one_picture(request), request.out.suffix.lower() in ENDINGS
    if request.out.suffix.lower() in OTHER_FILMS:
        raise BadInput(f"{request.out.name} is a film of a kind that is not written here: let its name end in {', '.join(ENDINGS)}.")
    if is_film:
        require_file_to_be(request.out)
        if request.cameras is None and request.trajectory is None and request.keyframes is None:
            raise BadInput("a film needs a path: add --trajectory orbit, --trajectory border, --keyframes or --cameras.")
    model = _ModelOnce(request, display)
    cameras, scene = _cameras(request, model)
    _require_one(request, cameras)
    cameras = cameras if request.long_side_px is None else cameras.scaled(request.long_side_px)
    splats = model.splats
    splats = splats if scene is None else _scene_alone(splats, scene, display)
    near_m = _near_planes(splats, cameras, display) if request.keyframes is not None and not request.shows_all else None
    if is_film:
        if request.out.suffix.lower() == ".mp4":
            display(Warned(stage="render", message=f"{request.out.name} will hold {NOT_FOR_BROWSERS}."))
        if len(np.unique(cameras.sizes_wh, axis=0)) > 1:
            raise BadInput("the cameras are of different sizes, which no film can show: render single pictures into a folder.")
        size_wh = (int(cameras.sizes_wh[0, 0]) // 2 * 2, int(cameras.sizes_wh[0, 1]) // 2 * 2)
        with folder_made_for(request.out), MovieWriter(request.out, size_wh, request.fps) as film, stage_bar(display, "render") as report:
            for number, (name, image) in enumerate(_pictures(splats, cameras, near_m), 1):
                film.add(np.ascontiguousarray(image[: size_wh[1], : size_wh[0]]))
                report(number, len(cameras), name)
        return {"film": str(request.out), "frames": len(cameras), "seconds": round(len(cameras) / request.fps, 2)}
    if request.out.suffix.lower() == PICTURE:
        with folder_made_for(request.out):
            _, image = next(_pictures(splats, cameras, near_m))
            write_atomic(request.out, png_bytes(image))
        return {"picture": str(request.out)}
    with create_folder(request.out), stage_bar(display, "render") as report:
        for number, (name, image) in enumerate(_pictures(splats, cameras, near_m), 1):
            path = request.out / f"{name}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, png_bytes(image))
            report(number, len(cameras), name)
    return {"pictures": len(cameras), "folder": str(request.out)}


def _one_picture(request: RenderRequest) -> RenderRequest:
    """The request of a single picture, where `out` is named as one: without any path a look at the
    scene from outside. BadInput where it would be more than one, or of a kind that is not
    written."""
    name, ending = request.out.name, request.out.suffix.lower()
    if ending in OTHER_PICTURES:
        raise BadInput(f"{name} is a picture of a kind that is not written here: let its name end in {PICTURE}.")
    if ending != PICTURE:
        return request
    require_file_to_be(request.out)
    if request.trajectory is None and request.cameras is None and request.keyframes is None:
        return replace(request, trajectory="orbit", num_frames=1)
    if request.trajectory is not None and request.num_frames != 1:
        raise BadInput(f"{name} is one picture, and {request.num_frames} were asked for: add --frames 1, or name a folder or a film.")
    return request


def _require_one(request: RenderRequest, cameras: Cameras) -> None:
    if request.out.suffix.lower() == PICTURE and len(cameras) != 1:
        raise BadInput(f"{request.out.name} is one picture, and the path has {len(cameras)}: name a folder or a film.")


def _pictures(splats: Splats, cameras: Cameras, near_m: FloatArray | None) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Name and picture (H,W,3) of each of C cameras, from depths near_m (C,) on; BadInput where one
    does not fit into memory."""
    from radiant_core.render.rendered_view import render_views

    views = render_views(splats, cameras, near_m=near_m)
    for width, height in cameras.sizes_wh:
        try:
            view = next(views)
            image = view.image_bytes
        except MemoryError:
            size = f"a picture of {width} × {height} px does not fit into the free memory"
            raise BadInput(f"{size}: add --long-side-px 4000, or less.") from None
        yield view.name, image


def _near_planes(splats: Splats, cameras: Cameras, display: ProgressDisplay) -> FloatArray | None:
    """From which depth on (C,) m each view shows the model, as the inspector shows it."""
    if not len(splats):
        return None
    reach = Reach.of(splats)
    if (far := int(reach.hides(splats, cameras).sum())) > 0:
        decision = Decision(
            stage="render",
            topic="sky and haze",
            choice="Gaussians far in front of the scene are not drawn",
            figure=far,
            unit=f"of {len(cameras)} pictures",
            reason="the views are far outside the scene, and sky and haze would hide it; --surroundings draws them",
        )
        display(Decided(decision=decision))
    return reach.near_m(cameras)


def _scene_alone(splats: Splats, box: FloatArray, display: ProgressDisplay) -> Splats:
    """What lies in the scene's box (2,3); all where that would be nothing."""
    from radiant_viewer.runs.shown_model import shown_model

    cropped = shown_model(splats, box)
    display(Decided(decision=replace(cropped.decision, stage="render", reason=f"{cropped.decision.reason}; --surroundings shows it")))
    return cropped.splats


class _ModelOnce:
    """The model of a request, read where it is asked for, once."""

    def __init__(self, request: RenderRequest, display: ProgressDisplay) -> None:
        self._request, self._display = request, display

    @cached_property
    def splats(self) -> Splats:
        """The Gaussians that are drawn; BadInput without any."""
        return given_model(self._request.model, self._display, as_trained=self._request.as_trained).splats


def _cameras(request: RenderRequest, model: _ModelOnce) -> tuple[Cameras, FloatArray | None]:
    """The cameras, and for an orbit the box (2,3) of the scene that it looks at."""
    chosen = [name for name in ("cameras", "trajectory", "keyframes") if getattr(request, name) is not None]
    if len(chosen) > 1:
        raise BadInput(f"--{chosen[0]} and --{chosen[1]} both say from where to look: keep one of them.")
    if request.border is not None and request.trajectory != "border":
        raise BadInput("--border is of --trajectory border: leave one of them out.")
    require_model(request.model)
    lens = Lens(size_wh=request.size_wh)
    if request.keyframes is not None:
        return keyframe_cameras(request.keyframes, request.fps, request.size_wh), None
    if request.trajectory is not None:
        cameras, box = _flight(request, lens, model)
        return cameras, None if request.shows_all or request.trajectory != "orbit" else box
    if request.cameras is None and not request.model.is_dir():
        raise BadInput(f"{request.model} is a model alone: say from where to look by --trajectory orbit, --cameras or --keyframes.")
    if request.cameras is not None:
        return load_cameras(request.cameras), None
    if folder_kind(request.model) == "training":
        return held_out_of_training(load_run_view(request.model)), None
    cameras = load_scored_cameras(request.model)
    if cameras is None:
        raise BadInput(f"{request.model} has no held-out cameras: say from where to look by --trajectory orbit, --cameras or --keyframes.")
    return cameras, None


def held_out_of_training(run: RunView) -> Cameras:
    """The cameras whose photographs a training held out, as scored: at most 1600 px long."""
    held_out = [index for index, name in enumerate(run.scene.cameras.names) if name in run.held_out]
    return run.scene.cameras.select(held_out).scaled(DEFAULT_LONG_SIDE_PX)


def _flight(request: RenderRequest, lens: Lens, model: _ModelOnce) -> tuple[Cameras, FloatArray]:
    """The cameras of a flight, and the box (2,3) of the scene."""
    from radiant_viewer.runs.run_layers import ground_height
    from radiant_viewer.runs.shown_model import framed_box, model_box

    if not request.model.is_dir():
        _require_orbit(request, "is a model alone")
        box = model_box(model.splats)
        return _orbit_around(box, request.num_frames, lens), box
    run = load_run_view(request.model)
    if run.kind != "run":
        _require_orbit(request, "was made without a plan")
        box = scene_box(run.scene)
        return _orbit_around(box, request.num_frames, lens), box
    box = framed_box(run.scene, run.cloud_plan)
    ground = ground_height(run.scene)
    corners = np.concatenate([border for border in run.cloud_plan.borders if len(border)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    if request.trajectory == "orbit":
        center = np.append((low + high) / 2, ground)
        return orbit(center, ORBIT_RADII * float(np.linalg.norm(high - low)), ORBIT_ELEVATION_DEG, request.num_frames, lens), box
    border = _border(run, request.border)
    above = float(np.median(run.scene.cameras.centers[:, 2])) - ground
    return along_border(border.ends, ground, max(FLIGHT_HEIGHTS * above, border.length_m / 20), request.num_frames, lens), box


def _require_orbit(request: RenderRequest, problem: str) -> None:
    if request.trajectory != "orbit":
        raise BadInput(f"{request.model} {problem} and has no borders to fly along: use --trajectory orbit, --keyframes or --cameras.")


def _orbit_around(box: FloatArray, num_frames: int, lens: Lens) -> Cameras:
    """Once around the middle of a box (2,3), z up."""
    side = float(np.linalg.norm(box[1] - box[0]))
    return orbit(box.mean(axis=0), ORBIT_RADII * max(side, 1e-6), ORBIT_ELEVATION_DEG, num_frames, lens)


def _border(run: Any, names: tuple[str, ...] | None) -> Border:
    from radiant_viewer.runs.run_pictures import worst_border

    edge_ids = run.cloud_plan.edge_ids
    if names is None:
        return worst_border(run)
    pairs = {frozenset((edge_ids[border.first], edge_ids[border.second])): border for border in shared_borders(run.cloud_plan)}
    chosen_border = pairs.get(frozenset(name.strip() for name in names))
    if chosen_border is None or len(names) != 2:
        listed = "; ".join(",".join(sorted(pair)) for pair in pairs) or "there is none"
        raise BadInput(f"{','.join(names)} is no border of two regions: name one of {listed}.")
    return chosen_border


Triple = Annotated[tuple[float, float, float], Field()]


class _Keyframe(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    time_s: float
    position: Triple
    target: Triple


class _Keyframes(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    field_of_view_deg: float = 60.0
    keyframes: list[_Keyframe]


def keyframe_cameras(path: Path, fps: float, size_wh: tuple[int, int]) -> Cameras:
    """The frames of a flight in JSON: field_of_view_deg, keyframes of time_s, position, target;
    BadInput names the first place in the file that is not so."""
    try:
        record = _Keyframes.model_validate_json(read_bounded(path, MAX_KEYFRAME_BYTES))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"])) or "the whole"
        raise BadInput(f"{path} is no list of keyframes ({place}: {first['msg']}): see `radiant render --help`.") from error
    lens = Lens(size_wh=size_wh, field_of_view_deg=record.field_of_view_deg)
    rows = record.keyframes
    positions, targets = np.array([row.position for row in rows]).reshape(-1, 3), np.array([row.target for row in rows]).reshape(-1, 3)
    if len(rows) == 1:
        return cameras_looking_at(positions, targets, lens)
    return through_keyframes([row.time_s for row in rows], positions, targets, fps, lens)
