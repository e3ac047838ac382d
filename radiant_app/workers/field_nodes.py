"""Workers of devices that keep their own photographs (`--frames gps` or `known`).

    positions  the heads of the photographs that its task names
               → positions.json of a pooled folder; raster.json of a device's own
    field      its own photographs, poses where given
               → {model,cameras,scene,initial,held_out}.safetensors, frame.json, own.json,
                 captures.json

A device that cannot deliver (its photographs do not overlap, its frame is ambiguous) gives the
reason in frame.json and is done; the run goes on. It reports the number of photographs that it
skips; their names stay in own_notes.txt (`redaction.py`).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from radiant_app.reporting import EventReporter, read_notes
from radiant_app.together.places import mark_gone, meeting_of
from radiant_app.workers.delivering import sign_upload
from radiant_app.workers.redaction import Redactor, make_redactor
from radiant_app.workers.sources import portable_path
from radiant_app.workers.tasks import HELD_OUT_NAME, INITIAL_NAME, OWN_NAME, FieldTask, PlacingTask, PositionsTask
from radiant_app.workers.training import remove_checkpoints, train_from_folder
from radiant_core import __version__
from radiant_core.cameras import Cameras, number_cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput, StageFailed
from radiant_core.frames import WGS84_SEMI_MAJOR_M, FrameUncertainty
from radiant_core.hierarchy.codec import NOTHING, load_uncertainty, save_device_model, save_frame, task_key
from radiant_core.io.photos.beside import beside_warning
from radiant_core.io.photos.copies import copies_count, file_copies
from radiant_core.io.photos.folders import folders_warning, read_folder, unread_warning
from radiant_core.io.photos.listing import doubts_warning, photograph_heads, photograph_positions, sea_warning
from radiant_core.io.records import load_cameras, load_scene, save_cameras, save_scene, save_splats
from radiant_core.io.run_store import SEAL_NAME, content_key, is_sealed, read_json, seal, write_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.sfm.config import SfmConfig, SfmResult

if TYPE_CHECKING:
    from radiant_core.sfm.world_frame.device_frame import DeviceFrame

MADE_FROM, OWN_POSES = "made_from.json", "own/poses"


def run_positions(folder: Path, task: PositionsTask, reporter: EventReporter) -> Sequence[str]:
    """GPS positions of the photographs in the folder that task.json names, copies left out; no
    pixel is decoded.

    Of a device's own folder only counts are written: training photographs in each cell of a raster,
    and an approximate altitude.
    """
    photographs = Path(task.source)
    heads = photograph_heads(photographs)
    lat_lon_alt_of = {name: exif.lat_lon_alt for name, exif in heads.items()}
    content = read_folder(photographs)
    named = not task.owned
    doubts = doubts_warning({name: exif.position_doubt for name, exif in heads.items()}, len(heads), named=named)
    for message in (
        *folders_warning(content, named=named),
        *unread_warning(content.unread),
        *beside_warning(photographs, named=named),
        *doubts,
        *sea_warning([exif.altitude_from_sea for exif in heads.values()]),
    ):
        reporter.warn(message)
    copies = file_copies({name: photographs / name for name in lat_lon_alt_of})
    if not task.owned:
        # A device reports its own copies after decoding: a broken file is no copy.
        _warn_about_copies(len(copies), len(lat_lon_alt_of), reporter)
    low = [name for name, place in lat_lon_alt_of.items() if place is not None and np.isnan(place[2])]
    if low:
        counted = f"{len(low)} of {len(lat_lon_alt_of)} photographs have GPS without altitude, and a device's frame needs one"
        reporter.warn(f"{counted}: they are treated as having no position.")
    lat_lon_alt_of = {name: None if name in low else place for name, place in lat_lon_alt_of.items() if name not in copies}
    if task.cell_m is None:
        write_json(folder / "positions.json", {"photographs": lat_lon_alt_of})
        return ["positions.json"]
    held_out = set(task.held_out)
    placed = {name: place for name, place in lat_lon_alt_of.items() if place is not None}
    training = np.array([place for name, place in placed.items() if name not in held_out], np.float64).reshape(-1, 3)
    counts = {"num_photographs": len(lat_lon_alt_of), "num_unplaced": len(lat_lon_alt_of) - len(placed)}
    write_json(folder / "raster.json", {**raster_record(training, task.cell_m), **counts})
    return ["raster.json"]


def raster_record(lat_lon_alt: FloatArray, cell_m: float) -> dict[str, Any]:
    """Count positions (P,3) deg, deg, m: `cells` as [lat, lon] of their centres and a count, one
    `altitude_m` for all.

    Cells are aligned with parallels and meridians, so that they do not reveal where the device
    started.
    """
    if not len(lat_lon_alt):
        return {"cells": [], "altitude_m": None}
    lat_step = np.degrees(cell_m / WGS84_SEMI_MAJOR_M)
    rows = (np.floor(lat_lon_alt[:, 0] / lat_step) + 0.5) * lat_step
    # Square at a whole degree of latitude: a finer one would reveal where the device is.
    lon_step = lat_step / max(1e-2, float(np.cos(np.radians(np.round(np.median(lat_lon_alt[:, 0]))))))
    columns = (np.floor(lat_lon_alt[:, 1] / lon_step) + 0.5) * lon_step
    cells, numbers = np.unique(np.stack([rows, columns], axis=1), axis=0, return_counts=True)
    return {
        "cells": [[float(lat), float(lon), int(number)] for (lat, lon), number in zip(cells, numbers, strict=True)],
        "altitude_m": float(np.round(np.median(lat_lon_alt[:, 2]), -1)),
    }


def run_field(folder: Path, task: FieldTask, reporter: EventReporter) -> Sequence[str]:
    """Structure from motion, frame and model of one device's own photographs."""
    photographs = _photographs_key(task.placing)
    key = content_key(__version__, task_key(replace(task, changed=())), photographs, *_poses_in(folder))
    made_from = {"key": key, "photographs": photographs}
    reused = _reuse_model(folder, made_from, reporter)
    names = reused if reused is not None else _make_model(folder, task, photographs, reporter)
    write_json(folder / MADE_FROM, made_from)
    uploaded = sign_upload(folder) if read_json(folder / "frame.json", ("status",))["status"] == "placed" else []
    return [*names, MADE_FROM, *uploaded]


def _reuse_model(folder: Path, made_from: dict[str, str], reporter: EventReporter) -> Sequence[str] | None:
    """The files of a device that is done with these photographs; None if it must train."""
    if not (folder / MADE_FROM).is_file() or not (folder / SEAL_NAME).is_file():
        return None
    before, sealed = read_json(folder / MADE_FROM, ("key", "photographs")), read_json(folder / SEAL_NAME, ("key", "files"))
    if before["photographs"] != made_from["photographs"]:
        reporter.warn("its photographs have changed since its model was made: the model is made again.")
    if before != made_from or not is_sealed(folder, sealed["key"]):
        return None
    for event in read_notes(folder, reporter.stage):
        reporter.emit(event)
    return [name for name in sealed["files"] if name not in ("notes.json", MADE_FROM, RECORD_NAME, SIGNATURE_NAME)]


def _make_model(folder: Path, task: FieldTask, photographs: str, reporter: EventReporter) -> Sequence[str]:
    """Place and train a device; returns its files."""
    try:
        placed = _place_once(folder, task.placing, photographs, reporter)
        is_held_out = np.isin(placed.scene.cameras.names, task.placing.held_out)
        training = placed.scene.restricted_to(np.flatnonzero(~is_held_out))
        if len(training.cameras) < 2:
            raise BadInput(f"{len(training.cameras)} of its training photographs could be placed, expected at least 2.")
        from radiant_core.hierarchy.messages import device_task

        device = device_task(task, training)
        model = train_from_folder(folder, device, placed.images, reporter)
    except (BadInput, StageFailed) as error:
        if task.seat is not None:
            # Those that it trains together with need not wait.
            mark_gone(meeting_of(folder, task.seat.parent), folder.name)
        # frame.json with the reason leaves the device.
        return _report_missing(folder, make_redactor("field", folder).redact(str(error)), reporter)
    from radiant_core.light.captures import read_captures, save_captures

    assert model.initial is not None
    save_splats(folder / INITIAL_NAME, model.initial)
    save_scene(folder / "scene.safetensors", training)
    save_cameras(folder / HELD_OUT_NAME, placed.scene.cameras.select(is_held_out))
    frame = save_frame(folder, placed.uncertainty)
    write_json(folder / OWN_NAME, {"images": str(placed.images)})
    photos = folder / "photos" if task.placing.fetch else Path(task.placing.source)
    captures = save_captures(folder, read_captures(photos, placed.scene.cameras.names))
    sent = replace(model, cameras=number_cameras(training.cameras, folder.name), uncertainty=placed.uncertainty)
    names = save_device_model(folder, sent, task.upload, reporter.warn)
    remove_checkpoints(folder)
    return [*names, INITIAL_NAME, "scene.safetensors", HELD_OUT_NAME, frame, OWN_NAME, captures]


def _photographs_key(task: PlacingTask) -> str:
    """Hash of the photographs that a device's task names; an unreadable one counts as None."""
    paths = [Path(task.source) / name for name in (*task.names, *task.held_out)]
    return content_key([path if path.is_file() and os.access(path, os.R_OK) else None for path in paths])


def _poses_in(folder: Path) -> list[Path]:
    return [path for path in (folder / name for name in ("poses", "poses.safetensors", OWN_POSES)) if path.exists()]


def _report_missing(folder: Path, reason: str, reporter: EventReporter) -> Sequence[str]:
    reporter.warn(f"no model of this device: {reason}")
    write_json(folder / "summary.json", {**NOTHING, "num_photographs": 0, "num_points": 0})
    return [save_frame(folder, None, reason), "summary.json"]


@dataclass(frozen=True, kw_only=True, eq=False)
class _PlacedScene:
    """A device's scene in the common frame, its undistorted photographs, and how uncertain that
    frame is (None: exact)."""

    scene: SfmScene
    images: Path
    uncertainty: FrameUncertainty | None


def _place_once(folder: Path, task: PlacingTask, photographs: str, reporter: EventReporter) -> _PlacedScene:
    """As `_place`, or the scene that an earlier process of this task placed, from placed/: the
    order of points varies, and a training resumes from its checkpoints only with the same scene."""
    place = folder / "placed"
    key = content_key(__version__, task_key(task), photographs, *_poses_in(folder))
    if not is_sealed(place, key) or not (folder / read_json(place / "record.json", ("images",))["images"]).is_dir():
        placed = _place(folder, task, reporter)
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        save_scene(place / "scene.safetensors", placed.scene)
        write_json(place / "record.json", {"images": portable_path(placed.images, folder)})
        seal(place, key, ["scene.safetensors", "record.json", save_frame(place, placed.uncertainty)])
    images = folder / read_json(place / "record.json", ("images",))["images"]
    return _PlacedScene(scene=load_scene(place / "scene.safetensors"), images=images, uncertainty=load_uncertainty(place))


def _place(folder: Path, task: PlacingTask, reporter: EventReporter) -> _PlacedScene:
    photos = Path(task.source)
    if task.fetch:
        photos = folder / "photos"
        shutil.rmtree(photos, ignore_errors=True)
        for name in [*task.names, *task.held_out]:
            (photos / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(Path(task.source) / name, photos / name)
    return (_place_by_gps if task.frames == "gps" else _place_by_poses)(folder, photos, task, reporter)


def _place_by_gps(folder: Path, photos: Path, task: PlacingTask, reporter: EventReporter) -> _PlacedScene:
    from radiant_core.sfm.reconstruct import reconstruct
    from radiant_core.sfm.world_frame.device_frame import RefusedFrame, device_frame

    result = reconstruct(photos, folder / "sfm", SfmConfig(**asdict(task.sfm)), reporter.sfm_progress)
    for message in _redact_warnings(result, make_redactor("field", folder)):
        reporter.warn(message)
    for decision in (decision for decision in result.decisions if decision.topic == "memory"):
        reporter.decide(decision)
    positions = {name: place for name, place in photograph_positions(photos).items() if place is not None and np.isfinite(place[2])}
    frame = device_frame(result.scene, positions, np.array(task.origin), task.sfm.seed)
    if isinstance(frame, RefusedFrame):
        raise BadInput(f"its frame is refused: {frame.reason}")
    reporter.decide(_frame_decision(reporter.stage, frame))
    _draw_frame(folder, frame.scene.cameras, positions, task.origin, frame.sigma_m)
    return _PlacedScene(scene=frame.scene, images=result.undistorted_folder, uncertainty=frame.uncertainty)


def _redact_warnings(result: SfmResult, names: Redactor) -> Sequence[str]:
    """The warnings of structure from motion; of a device's own folder with numbers for names."""
    if names.source is None:
        return result.warnings
    names.keep(message for message in result.warnings if message not in result.unnamed_warnings)
    where = f" Their names stay in {names.notes.name} of the device."
    return [message + where * (message not in result.warnings) for message in result.unnamed_warnings]


def _draw_frame(folder: Path, cameras: Cameras, lat_lon_alt: dict[str, tuple[float, float, float]], origin: Any, sigma_m: float) -> None:
    """Draw GPS against the cameras in frame.png, which stays on the device, since it shows where
    photographs were taken."""
    from radiant_core.frames import enu_from_geodetic
    from radiant_viewer.charts.frame_chart import frame_picture
    from radiant_viewer.pictures.images import save_png

    names = [name for name in cameras.names if name in lat_lon_alt]
    gps_m = enu_from_geodetic([lat_lon_alt[name] for name in names], np.array(origin))
    detail = f"{len(names)} photographs; GPS is off by {sigma_m:.1f} m per axis in the usual case"
    save_png(folder / "frame.png", frame_picture(gps_m, cameras.named(names).centers, f"Frame of {folder.name} by GPS", detail))


def _place_by_poses(folder: Path, photos: Path, task: PlacingTask, reporter: EventReporter) -> _PlacedScene:
    from radiant_core.sfm.copies import without_repeats
    from radiant_core.sfm.known_poses import pinhole_photographs, scene_from_poses, without_copies
    from radiant_core.sfm.memory import limit_to_memory

    config = SfmConfig(**asdict(task.sfm))
    if task.poses == "poses.safetensors":
        cameras = load_cameras(folder / "poses.safetensors")
    else:
        poses_folder = folder / (task.poses or "poses")
        cameras, photos = pinhole_photographs(poses_folder, photos, folder / "pinhole", config.threads, reporter.sfm_progress)
    num_given = len(cameras)
    cameras, _ = without_copies(cameras, photos)
    config, decisions = limit_to_memory(config, [(int(width), int(height)) for width, height in cameras.sizes_wh])
    for decision in decisions:
        reporter.decide(decision)
    scene, _ = without_repeats(scene_from_poses(cameras, photos, folder / "sfm", config, reporter.sfm_progress), photos)
    _warn_about_copies(num_given - len(scene.cameras), num_given, reporter)
    return _PlacedScene(scene=scene, images=photos, uncertainty=None)


def _warn_about_copies(num_copies: int, num_photographs: int, reporter: EventReporter) -> None:
    """Warn about the number of photographs left out as copies; their names stay on the device."""
    for message in copies_count(num_copies, num_photographs):
        reporter.warn(message)


def _frame_decision(stage: str, frame: DeviceFrame) -> Decision:
    uncertainty = frame.uncertainty
    return Decision(
        stage=stage,
        topic="frame",
        choice="metric, from the device's own GPS",
        figure=uncertainty.position_m,
        unit="m",
        reason=f"{frame.num_inliers} of {frame.num_positions} positions count; scale known to {uncertainty.scale:.2%}, "
        f"rotation to {np.degrees(uncertainty.rotation_rad):.2f}°",
    )
