"""Rough poses adjusted to their photographs, in the frame that they were given in. Once per source.

Poses of phones, flight logs and merges are wrong by pixels. Features are matched without them
(RANSAC, not the given epipolar lines), points are triangulated from them with a wide limit, and
poses and points are adjusted together (`refine.py`'s loss, lenses stay); then again with narrower
limits. The similarity that fits the adjusted centres to the given ones best brings the model back:
place, scale and up are those of all given poses together.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.geometry.align import fit_sim3
from radiant_core.io.colmap.model import read_model
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.colmap.database import extract_features, match_pairs
from radiant_core.sfm.colmap.kept_database import database_key, prepare_database
from radiant_core.sfm.colmap.pairs import neighbor_pairs
from radiant_core.sfm.colmap.previewed_pairs import keep_promising
from radiant_core.sfm.colmap.refine import adjust
from radiant_core.sfm.colmap.undistort import undistort
from radiant_core.sfm.colmap.workspace import list_usable
from radiant_core.sfm.config import Report, SfmConfig, SfmProgress
from radiant_core.sfm.known_poses import photographs_of, posed_model
from radiant_core.sfm.masks import keep_masks, take_masks, undistort_masks
from radiant_core.sfm.memory import limit_to_memory
from radiant_core.sfm.reconstruct import GivenModel
from radiant_core.sfm.world_frame.world import cameras_of

REFINED = "refined"
LIMITS_PX = (24.0, 8.0, 4.0)
"""How far a point may be from where a photograph sees it, round by round; the last is COLMAP's."""
LIMITS_DEG = (6.0, 2.0, 2.0)
MIN_SHARE = 0.9
"""Of the photographs that must see points in the end."""


def refined_model(source: GivenModel, work_folder: Path, report: Report, masks: Path | None) -> tuple[GivenModel, Path | None, Decision]:
    """The model of `source` with adjusted poses and new points, straight photographs and masks, in
    `work_folder`/refined. Raises BadInput where its photographs do not fit each other by it."""
    place = work_folder / REFINED
    place.mkdir(parents=True, exist_ok=True)
    config = SfmConfig()
    model, images = read_model(source.folder), source.images
    original_masks = take_masks(masks, list_usable(images, report, tuple(image.name for image in model.images)).photographs, place)
    if all(model.cameras[image.camera_id].is_pinhole for image in model.images):
        masks = keep_masks(original_masks, place)
    else:
        undistorted = undistort(source.folder, images, place, config.threads, report)
        masks = undistort_masks(original_masks, source.folder, place, config.threads)
        model, images = read_model(undistorted.model_folder), undistorted.image_folder
    cameras = cameras_of(model)
    folder = _adjusted(cameras, images, place / "poses", report, masks)
    adjusted = read_model(folder)
    seeing = {image.name for image in adjusted.images if (image.point3d_ids != -1).any()}
    if len(seeing) < max(2, MIN_SHARE * len(cameras)):
        raise BadInput(
            f"{source.title}: {len(seeing)} of {len(cameras)} photographs fit the others after their poses were adjusted, expected "
            f"{MIN_SHARE:.0%} or more: the poses are too rough; place the photographs anew with --poses none."
        )
    moved = {image.name: -image.cam_from_world[:3, :3].T @ image.translation for image in adjusted.images}
    away = np.linalg.norm(np.array([moved[name] for name in cameras.names]) - cameras.centers, axis=1)
    decision = Decision(
        stage="sfm",
        topic="refined poses",
        choice="poses adjusted to their photographs, in the frame of the file",
        figure=float(np.median(away)),
        unit="units of the file, median move of a camera",
        reason="asked for by --refine-poses",
        forced=True,
    )
    return replace(source, folder=folder, images=images), masks, decision


def _adjusted(cameras: Cameras, photo_folder: Path, work_folder: Path, report: Report, masks: Path | None) -> Path:
    """The folder of the adjusted model, moved back onto the given centres."""
    photographs = photographs_of(cameras, list_usable(photo_folder, report, cameras.names).photographs)
    config, _ = limit_to_memory(SfmConfig(), [photo.size_wh for photo in photographs])
    with prepare_database(work_folder, database_key(photographs, config, masks)) as database:
        original_masks = take_masks(masks, photographs, work_folder)
        extract_features(database, photo_folder, photographs, config, report, original_masks)
        folder = work_folder / "sparse"
        model = posed_model(cameras, database, folder)
        pairs, _ = keep_promising(database, neighbor_pairs(list(cameras.names), cameras.centers, config.num_neighbors), config, report)
        match_pairs(database, pairs, config, report)
        for num_done, limits in enumerate(zip(LIMITS_PX, LIMITS_DEG, strict=True), 1):
            _triangulate(model, database, photo_folder, folder, limits)
            report(SfmProgress(phase="refining", done=num_done, total=len(LIMITS_PX)))
            model = pycolmap.Reconstruction(folder)
            if not model.num_points3D():
                break
            model = adjust(model, config, refine_lenses=False)
            _move_back(model, cameras)
        model.write_binary(folder)
    return folder


def _triangulate(model: pycolmap.Reconstruction, database: Path, photo_folder: Path, folder: Path, limits: tuple[float, float]) -> None:
    limit_px, limit_deg = limits
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = SfmConfig().threads
    options.random_seed = 0
    options.extract_colors = limits == (LIMITS_PX[-1], LIMITS_DEG[-1])
    options.mapper.filter_max_reproj_error = limit_px
    triangulation = options.triangulation
    triangulation.merge_max_reproj_error = triangulation.complete_max_reproj_error = limit_px
    triangulation.create_max_angle_error = triangulation.continue_max_angle_error = limit_deg
    call_colmap(
        "triangulating",
        pycolmap.triangulate_points,
        model,
        database,
        photo_folder,
        folder,
        clear_points=True,
        options=options,
        cancellation_token=pycolmap.CancellationToken(),
    )


def _move_back(model: pycolmap.Reconstruction, cameras: Cameras) -> None:
    """Move a model by the similarity that fits its centres to the given ones best."""
    centers = {model.image(number).name: model.image(number).projection_center() for number in model.reg_image_ids()}
    names = [name for name in cameras.names if name in centers]
    back = fit_sim3(np.array([centers[name] for name in names]), cameras.named(names).centers)
    model.transform(pycolmap.Sim3d(back.scale, pycolmap.Rotation3d(back.rotation), back.translation))
