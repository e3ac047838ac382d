"""What a device computes when photographs stay where they were taken (`--frames gps` or `known`).

| kind | reads | writes |
|---|---|---|
| positions | task.json, the heads of the photographs it names | positions.json of a pooled folder; raster.json of a device's own |
| field | task.json, its own photographs, poses where given | {model,cameras,scene,initial,held_out}.safetensors, frame.json |
| score | task.json, inbox/{scene.ply,plan.json}, its own photographs | result.json: numbers; pictures that stay |

A device that cannot deliver (its photographs do not overlap, its frame is ambiguous) says so in frame.json and is done: the rest goes on.
Of photographs that it skips it tells the number; their names stay in its own_notes.txt (`own_names.py`).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from radiant_app.events import Decided, Event, StageProgress, Warned
from radiant_app.workers.delivering import signed_upload
from radiant_app.workers.inbox import NOTHING, moved_cameras, numbered, sim3_of
from radiant_app.workers.nodes import load_images, place_of, read_notes, sfm_progress, train_device
from radiant_app.workers.own_names import OwnNames, own_names
from radiant_core import __version__
from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput, StageFailed
from radiant_core.frames import WGS84_SEMI_MAJOR_M
from radiant_core.io.photos.copies import copies_count, file_copies
from radiant_core.io.photos.listing import photograph_positions
from radiant_core.io.records import load_cameras, load_plan, load_scene, load_splats, save_cameras, save_scene, save_splats
from radiant_core.io.run_store import SEAL_NAME, content_key, is_sealed, read_json, seal, write_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene

if TYPE_CHECKING:
    from radiant_core.sfm.config import SfmResult

Emit = Callable[[Event], None]
PLACING = ("frames", "source", "names", "held_out", "copy", "origin", "sfm", "model", "photographs")
"""What of a device's task decides its scene, with the hash of its photographs."""
SPOKEN = ("checkpoint_every_s", "changed")
"""What of a device's task decides nothing of its result: sizes and times of photographs speak for what they hold."""
MADE_FROM = "made_from.json"


def run_positions(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """GPS positions of the photographs in the folder that task.json names, copies left out; no pixel is decoded.

    Of a device's own folder only counts come out: how many training photographs lie in each cell of a raster, and how high about.
    """
    task = read_json(folder / "task.json", ("photographs", "cell_m", "held_out", "owned"))
    photographs = Path(task["photographs"])
    found = photograph_positions(photographs)
    copies = file_copies({name: photographs / name for name in found})
    if not task["owned"]:
        # Of its own a device tells when it has decoded them: of broken files none is a copy.
        _tell_copies(len(copies), len(found), (stage, emit))
    low = [name for name, place in found.items() if place is not None and np.isnan(place[2])]
    if low:
        told = f"{len(low)} of {len(found)} photographs have GPS without altitude, and a device's frame needs one"
        emit(Warned(stage=stage, message=f"{told}: they count as without a position."))
    found = {name: None if name in low else place for name, place in found.items() if name not in copies}
    if task["cell_m"] is None:
        write_json(folder / "positions.json", {"photographs": found})
        return ["positions.json"]
    held_out = set(task["held_out"])
    placed = {name: place for name, place in found.items() if place is not None}
    training = np.array([place for name, place in placed.items() if name not in held_out], np.float64).reshape(-1, 3)
    told = {**told_raster(training, task["cell_m"]), "num_photographs": len(found), "num_unplaced": len(found) - len(placed)}
    write_json(folder / "raster.json", told)
    return ["raster.json"]


def told_raster(lat_lon_alt: FloatArray, cell_m: float) -> dict[str, Any]:
    """What a device tells of positions (P,3) deg, deg, m: `cells` as [lat, lon] of their middles and a count, one `altitude_m` for all.

    Cells lie on the parallels and meridians, so that they say nothing of where the device began.
    """
    if not len(lat_lon_alt):
        return {"cells": [], "altitude_m": None}
    lat_step = np.degrees(cell_m / WGS84_SEMI_MAJOR_M)
    rows = (np.floor(lat_lon_alt[:, 0] / lat_step) + 0.5) * lat_step
    # As wide as high at the whole degree of latitude: a finer one would tell where the device is.
    lon_step = lat_step / max(1e-2, float(np.cos(np.radians(np.round(np.median(lat_lon_alt[:, 0]))))))
    columns = (np.floor(lat_lon_alt[:, 1] / lon_step) + 0.5) * lon_step
    cells, numbers = np.unique(np.stack([rows, columns], axis=1), axis=0, return_counts=True)
    return {
        "cells": [[float(lat), float(lon), int(number)] for (lat, lon), number in zip(cells, numbers, strict=True)],
        "altitude_m": float(np.round(np.median(lat_lon_alt[:, 2]), -1)),
    }


def run_field(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Structure from motion, frame and model of one device's own photographs."""
    task = read_json(folder / "task.json")
    task["photographs"] = _photographs_key(task)
    key = content_key(__version__, {name: value for name, value in task.items() if name not in SPOKEN}, *_poses_in(folder))
    made_from = {"key": key, "photographs": task["photographs"]}
    kept = _kept(folder, made_from, stage, emit)
    made = kept if kept is not None else _made(folder, task, stage, emit)
    write_json(folder / MADE_FROM, made_from)
    uploaded = signed_upload(folder, task) if read_json(folder / "frame.json", ("status",))["status"] == "placed" else []
    return [*made, MADE_FROM, *uploaded]


def _kept(folder: Path, made_from: dict[str, str], stage: str, emit: Emit) -> Sequence[str] | None:
    """The files of a device that is done with just these photographs, whenever they were touched since; None where it is to begin."""
    if not (folder / MADE_FROM).is_file() or not (folder / SEAL_NAME).is_file():
        return None
    before, sealed = read_json(folder / MADE_FROM, ("key", "photographs")), read_json(folder / SEAL_NAME, ("key", "files"))
    if before["photographs"] != made_from["photographs"]:
        emit(Warned(stage=stage, message="its photographs changed since its model was made: it is made again."))
    if before != made_from or not is_sealed(folder, sealed["key"]):
        return None
    for event in read_notes(folder, stage):
        emit(event)
    return [name for name in sealed["files"] if name not in ("notes.json", MADE_FROM, RECORD_NAME, SIGNATURE_NAME)]


def _made(folder: Path, task: dict[str, Any], stage: str, emit: Emit) -> Sequence[str]:
    """The files of a device that begins."""
    try:
        placed = _placed_once(folder, task, stage, emit)
        held = np.isin(placed.scene.cameras.names, task["held_out"])
        training = placed.scene.restricted_to(np.flatnonzero(~held))
        if len(training.cameras) < 2:
            raise BadInput(f"{len(training.cameras)} of its training photographs could be placed, expected at least 2.")
        initial, outputs = train_device(folder, training, placed.images, task, (stage, emit))
    except (BadInput, StageFailed) as error:
        # The reason stands in frame.json, which others read.
        return _missing(folder, stage, own_names("field", folder).without(str(error)), emit)
    save_splats(folder / "initial.safetensors", initial)
    save_scene(folder / "scene.safetensors", training)
    save_cameras(folder / "held_out.safetensors", placed.scene.cameras.select(held))
    save_cameras(folder / "cameras.safetensors", numbered(training.cameras, folder.name))
    write_json(folder / "frame.json", {"status": "placed", "reason": "", "uncertainty": placed.uncertainty})
    write_json(folder / "own.json", {"images": str(placed.images)})
    arrays = ("initial", "scene", "held_out", "cameras")
    return [*outputs, *(f"{name}.safetensors" for name in arrays), "frame.json", "own.json"]


def _photographs_key(task: dict[str, Any]) -> str:
    """Hash of the photographs that a device's task names; one that cannot be read counts as such."""
    paths = [Path(task["source"]) / name for name in (*task["names"], *task["held_out"])]
    return content_key([path if path.is_file() and os.access(path, os.R_OK) else None for path in paths])


def _poses_in(folder: Path) -> list[Path]:
    return [path for path in (folder / "poses", folder / "poses.safetensors") if path.exists()]


def _missing(folder: Path, stage: str, reason: str, emit: Emit) -> Sequence[str]:
    emit(Warned(stage=stage, message=f"no model of this device: {reason}"))
    write_json(folder / "frame.json", {"status": "missing", "reason": reason, "uncertainty": None})
    write_json(folder / "summary.json", {**NOTHING, "num_photographs": 0, "num_points": 0})
    return ["frame.json", "summary.json"]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Placed:
    """A device's scene in the frame that all share, its undistorted photographs, and how uncertain the frame is (None: exact)."""

    scene: SfmScene
    images: Path
    uncertainty: dict[str, float] | None


def _placed_once(folder: Path, task: dict[str, Any], stage: str, emit: Emit) -> _Placed:
    """As `_placed`, or what an earlier process of this task placed, from placed/: the points come out in another order every time, and a
    training goes on from its checkpoints only with the same scene."""
    place, placing = folder / "placed", {name: value for name, value in task.items() if name in PLACING}
    key = content_key(__version__, placing, *_poses_in(folder))
    if not is_sealed(place, key) or not (folder / read_json(place / "record.json", ("images",))["images"]).is_dir():
        placed = _placed(folder, task, stage, emit)
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        save_scene(place / "scene.safetensors", placed.scene)
        write_json(place / "record.json", {"images": place_of(placed.images, folder), "uncertainty": placed.uncertainty})
        seal(place, key, ["scene.safetensors", "record.json"])
    record = read_json(place / "record.json", ("images", "uncertainty"))
    return _Placed(scene=load_scene(place / "scene.safetensors"), images=folder / record["images"], uncertainty=record["uncertainty"])


def _placed(folder: Path, task: dict[str, Any], stage: str, emit: Emit) -> _Placed:
    photos = Path(task["source"])
    if task["copy"]:
        photos = folder / "photos"
        shutil.rmtree(photos, ignore_errors=True)
        for name in [*task["names"], *task["held_out"]]:
            (photos / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(Path(task["source"]) / name, photos / name)
    return (
        _placed_by_gps(folder, photos, task, stage, emit)
        if task["frames"] == "gps"
        else _placed_by_poses(folder, photos, task, stage, emit)
    )


def _placed_by_gps(folder: Path, photos: Path, task: dict[str, Any], stage: str, emit: Emit) -> _Placed:
    from radiant_core.sfm.config import SfmConfig
    from radiant_core.sfm.reconstruct import reconstruct
    from radiant_core.sfm.world_frame.device_frame import RefusedFrame, device_frame

    result = reconstruct(photos, folder / "sfm", SfmConfig(**task["sfm"]), lambda progress: emit(sfm_progress(stage, progress)))
    for message in _told(result, own_names("field", folder)):
        emit(Warned(stage=stage, message=message))
    for decision in (decision for decision in result.decisions if decision.topic == "memory"):
        emit(Decided(decision=replace(decision, stage=stage)))
    positions = {name: place for name, place in photograph_positions(photos).items() if place is not None and np.isfinite(place[2])}
    frame = device_frame(result.scene, positions, np.array(task["origin"]), task["sfm"]["seed"])
    if isinstance(frame, RefusedFrame):
        raise BadInput(f"its frame is refused: {frame.reason}")
    emit(Decided(decision=_frame_decision(stage, asdict(frame.uncertainty), frame.num_inliers)))
    _draw_frame(folder, frame.scene.cameras, positions, task["origin"], frame.sigma_m)
    return _Placed(scene=frame.scene, images=result.undistorted_folder, uncertainty=asdict(frame.uncertainty))


def _told(result: SfmResult, names: OwnNames) -> Sequence[str]:
    """The warnings of structure from motion, of a device's own folder with numbers in place of names."""
    if names.source is None:
        return result.warnings
    names.keep(message for message in result.warnings if message not in result.unnamed_warnings)
    where = f" Their names stay in {names.notes.name} of the device."
    return [message + where * (message not in result.warnings) for message in result.unnamed_warnings]


def _draw_frame(folder: Path, cameras: Cameras, lat_lon_alt: dict[str, tuple[float, float, float]], origin: Any, sigma_m: float) -> None:
    """frame.png: GPS against the cameras. It tells where photographs were taken, so it stays in the device's folder."""
    from radiant_core.frames import enu_from_geodetic
    from radiant_viewer.charts.frame_chart import frame_picture
    from radiant_viewer.pictures.images import save_png

    names = [name for name in cameras.names if name in lat_lon_alt]
    gps_m = enu_from_geodetic([lat_lon_alt[name] for name in names], np.array(origin))
    detail = f"{len(names)} photographs; GPS is off by {sigma_m:.1f} m per axis in the usual case"
    save_png(folder / "frame.png", frame_picture(gps_m, cameras.named(names).centers, f"Frame of {folder.name} by GPS", detail))


def _placed_by_poses(folder: Path, photos: Path, task: dict[str, Any], stage: str, emit: Emit) -> _Placed:
    from radiant_core.sfm.config import SfmConfig
    from radiant_core.sfm.copies import without_repeats
    from radiant_core.sfm.known_poses import pinhole_photographs, scene_from_poses, without_copies
    from radiant_core.sfm.memory import within_memory

    def report(progress: Any) -> None:
        emit(sfm_progress(stage, progress))

    config = SfmConfig(**task["sfm"])
    work = folder / "sfm"
    if task["model"] is None:
        cameras = load_cameras(folder / "poses.safetensors")
    else:
        cameras, photos = pinhole_photographs(folder / "poses", photos, folder / "pinhole", config.threads, report)
    given = len(cameras)
    cameras, _ = without_copies(cameras, photos)
    config, decisions = within_memory(config, [(int(width), int(height)) for width, height in cameras.sizes_wh])
    for decision in decisions:
        emit(Decided(decision=replace(decision, stage=stage)))
    scene, _ = without_repeats(scene_from_poses(cameras, photos, work, config, report), photos)
    _tell_copies(given - len(scene.cameras), given, (stage, emit))
    return _Placed(scene=scene, images=photos, uncertainty=None)


def _tell_copies(num_copies: int, num_photographs: int, reporting: tuple[str, Emit]) -> None:
    """Say how many photographs are left out as copies of others; their names stay on the device."""
    stage, emit = reporting
    for told in copies_count(num_copies, num_photographs):
        emit(Warned(stage=stage, message=told))


def _frame_decision(stage: str, uncertainty: dict[str, float], num_positions: int) -> Decision:
    return Decision(
        stage=stage,
        topic="frame",
        choice="metric, from the device's own GPS",
        figure=uncertainty["position_m"],
        unit="m",
        reason=f"from {num_positions} positions; scale known to {uncertainty['scale']:.2%}, "
        f"rotation to {np.degrees(uncertainty['rotation_rad']):.2f}°",
    )


def run_score(folder: Path, stage: str, emit: Emit) -> Sequence[str]:
    """Score the downloaded scene on the photographs that this device held out, and say how much its own synthetic views give away."""
    from radiant_app.workers.evaluation import given_lpips, image_row, region_width, save_comparison
    from radiant_core.evaluate.seam_error import seam_masks, seam_sums
    from radiant_core.io.ply import load_ply
    from radiant_core.render.rendered_view import render_views

    task = read_json(folder / "task.json")
    own = folder.parent
    images = Path(read_json(own / "own.json", ("images",))["images"])
    held_out = load_cameras(own / "held_out.safetensors").scaled(task["long_side_px"])
    leakage = _leakage(own, images, task, (stage, emit))
    result: dict[str, Any] = {"images": [], "leakage": leakage, "seam_sums": np.zeros((2, 3)).tolist()}
    if len(held_out):
        names = [f"{own.name}/held-out-{index:04d}" for index in range(len(held_out))]
        photographs = [image.astype(np.float32) / np.float32(255) for image in load_images(images, held_out)]
        cameras = held_out
        for move in task["corrections"]:
            cameras = moved_cameras(cameras, sim3_of(move))
        cameras = replace(cameras, names=tuple(names))
        rendered = list(render_views(load_ply(folder / "inbox" / "scene.ply"), cameras, task["backend"]))
        untrained = list(render_views(load_splats(own / "initial.safetensors"), held_out, task["backend"]))
        lpips = given_lpips(folder / "inbox", task)
        result["images"] = [
            image_row(view, photo, before=before, lpips=lpips) for view, before, photo in zip(rendered, untrained, photographs, strict=True)
        ]
        plan, _ = load_plan(folder / "inbox" / "plan.json")
        masks = seam_masks(cameras, [view.depth for view in rendered], plan, region_width(plan.sites))
        result["seam_sums"] = seam_sums([view.image for view in rendered], photographs, masks).tolist()
        for view, photo in zip(rendered, photographs, strict=True):
            save_comparison(folder, view, photo)
    write_json(folder / "result.json", result)
    # The pictures are not sealed: whoever checks a seal reads what it holds.
    return ["result.json"]


def _leakage(own: Path, images: Path, task: dict[str, Any], reporting: tuple[str, Emit]) -> dict[str, float]:
    """PSNR and SSIM of what the edge can render of this device's model at its training poses, against the photographs it never sees."""
    from radiant_core.evaluate.image_error import psnr_db, ssim
    from radiant_core.render.rendered_view import render_views

    stage, emit = reporting
    cameras = load_scene(own / "scene.safetensors").cameras.scaled(task["long_side_px"])
    figures = []
    for done, view in enumerate(render_views(load_splats(own / "model.safetensors"), cameras, task["backend"]), 1):
        photograph = load_images(images, cameras.select([done - 1]))[0] / 255.0
        figures.append((psnr_db(view.image, photograph), ssim(view.image, photograph)))
        emit(StageProgress(stage=stage, done=done, total=len(cameras), note="synthetic views against photographs"))
    mean = np.mean(figures, axis=0)
    return {"psnr_db": float(mean[0]), "ssim": float(mean[1]), "num_images": len(figures)}
