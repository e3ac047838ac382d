"""Sparse points for photographs of known poses: features, neighbours by position, triangulation.

Once per scene, for folders with poses and without points (Mill 19). Triangulation and the clean-up
of points are COLMAP's; camera poses and intrinsics are not touched.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.frames import Frame
from radiant_core.georef.given_frame import GivenFrame
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.records import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints, check_model
from radiant_core.io.colmap.text import write_model
from radiant_core.io.mill19 import given_from_scene, images_without_pose, read_mill19
from radiant_core.io.photos.copies import copies_warning, file_copies
from radiant_core.io.photos.listing import CameraKey, Photograph
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.colmap.database import extract_features, match_pairs
from radiant_core.sfm.colmap.kept_database import database_key, prepare_database
from radiant_core.sfm.colmap.pairs import neighbor_pairs
from radiant_core.sfm.colmap.previewed_pairs import keep_promising
from radiant_core.sfm.colmap.undistort import undistort
from radiant_core.sfm.colmap.workspace import list_usable
from radiant_core.sfm.config import Report, SfmConfig, SfmProgress, SfmResult, number_phases, with_preview
from radiant_core.sfm.copies import without_repeats
from radiant_core.sfm.masks import FINAL, keep_masks, masks_decision, take_masks
from radiant_core.sfm.memory import limit_to_memory
from radiant_core.sfm.time_left import TimeLeft, predict_phases
from radiant_core.sfm.world_frame.world import cameras_of

DEFAULT_CONFIG = SfmConfig()
UNDISTORTED_CHANGE = 0.05
"""Shares of a side by which undistorting changes it, for lenses of drones."""
NO_POINTS = ColmapPoints(
    ids=np.zeros(0, np.int64),
    xyz=np.zeros((0, 3)),
    colors=np.zeros((0, 3), np.uint8),
    errors_px=np.zeros(0),
    tracks=np.zeros((0, 3), np.int64),
)


def scene_from_mill19(
    folder: Path, work_folder: Path, report: Report, config: SfmConfig = DEFAULT_CONFIG, masks: Path | None = None
) -> SfmResult:
    """The scene of a Mill 19 / Mega-NeRF folder: its poses, points triangulated from its
    photographs. Raises BadInput for another layout, or an image or a mask that is unusable."""
    cameras_of_folder = read_mill19(folder)
    unposed = images_without_pose(folder, cameras_of_folder)
    cameras, copied = without_copies(cameras_of_folder, folder)
    scene = scene_from_poses(cameras, folder, work_folder, config, report, masks)
    scene, repeats = without_repeats(scene, folder)
    masks = work_folder / FINAL if (work_folder / FINAL).is_dir() else None
    decision = Decision(
        stage="sfm",
        topic="frame",
        choice="the poses of the folder, z up",
        figure=float(len(cameras)),
        unit="photographs",
        reason="coordinates.pt gives a scale and no place on the globe",
    )
    count = len(cameras_of_folder) + len(unposed)
    named = ", ".join(unposed[:10])
    unposed_note = (f"{len(unposed)} of {count} images in rgbs have no metadata and are left out: {named}.",) if unposed else ()
    warning = "the folder's poses are used as they are; its unit is the metre only if whoever made it said so."
    return SfmResult(
        scene=scene,
        undistorted_folder=folder,
        unregistered=unposed,
        decisions=(decision, *masks_decision(scene, masks)),
        warnings=(*copied, *unposed_note, *repeats, warning),
        masks_folder=masks,
        given_frame=GivenFrame(given_from_scene=given_from_scene(folder), model="the Mill 19 folder (c2w of its metadata)"),
    )


def pinhole_photographs(
    model_folder: Path, photo_folder: Path, work_folder: Path, num_threads: int, report: Report
) -> tuple[Cameras, Path]:
    """The cameras of a COLMAP model of any lens and its photographs, undistorted into `work_folder`
    where the lens distorts."""
    model = read_model(model_folder)
    if not all(model.cameras[image.camera_id].is_pinhole for image in model.images):
        undistorted = undistort(model_folder, photo_folder, work_folder, num_threads, report)
        model, photo_folder = read_model(undistorted.model_folder), undistorted.image_folder
    return cameras_of(model), photo_folder


def scene_from_poses(
    cameras: Cameras, photo_folder: Path, work_folder: Path, config: SfmConfig, report: Report, masks: Path | None = None
) -> SfmScene:
    """Points for C pinhole cameras with known poses and the photographs of their names;
    `work_folder` gets masks/ where a folder of `masks` is given, and no point lies where they are
    0. Raises BadInput when a photograph is missing or not of its camera's size, or when no point
    can be triangulated."""
    model = triangulated_model(cameras, photo_folder, work_folder, config, report, masks)
    return SfmScene(
        cameras=cameras.named([image.name for image in model.images]),
        points=model.points.xyz,
        colors=model.points.colors,
        observations=model.observations(),
        frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)),
    )


def triangulated_model(
    cameras: Cameras, photo_folder: Path, work_folder: Path, config: SfmConfig, report: Report, masks: Path | None = None
) -> ColmapModel:
    """The same as a COLMAP model, in `work_folder`/sparse too; raises alike."""
    phases = with_preview(("checking photographs", "features", "matching", "triangulating"), config)
    report = number_phases(report, phases)
    photographs = photographs_of(cameras, list_usable(photo_folder, report, cameras.names).photographs)
    config, _ = limit_to_memory(config, [photo.size_wh for photo in photographs])
    report = TimeLeft(report=report, phases=phases, predicted_s=predict_phases([photo.size_wh for photo in photographs], config))
    with prepare_database(work_folder, database_key(photographs, config, masks)) as database:
        original_masks = take_masks(masks, photographs, work_folder)
        extract_features(database, photo_folder, photographs, config, report, original_masks)
        keep_masks(original_masks, work_folder)
        model_folder = work_folder / "sparse"
        posed = posed_model(cameras, database, model_folder)
        candidates = neighbor_pairs(list(cameras.names), cameras.centers, config.num_neighbors)
        pairs, _ = keep_promising(database, candidates, config, report)
        match_pairs(database, pairs, config, report, dict(zip(cameras.names, cameras.cam_from_world, strict=True)))
        report(SfmProgress(phase="triangulating", done=0, total=len(cameras)))
        triangulate(posed, database, photo_folder, model_folder, config)
        report(SfmProgress(phase="triangulating", done=len(cameras), total=len(cameras)))
    model = read_model(model_folder)
    if not len(model.points.ids):
        raise BadInput(f"no point can be triangulated in {photo_folder}: check that the poses belong to these photographs.")
    return model


def without_copies(cameras: Cameras, photo_folder: Path) -> tuple[Cameras, tuple[str, ...]]:
    """The cameras without those whose photograph holds the same bytes as another's, and warnings.
    Raises BadInput where they are all copies of one."""
    copies = file_copies({name: photo_folder / name for name in cameras.names})
    if 0 < len(copies) == len(cameras) - 1:
        raise BadInput(f"all {len(cameras)} photographs are copies of one another: at least 2 that overlap are needed.")
    return cameras.named([name for name in cameras.names if name not in copies]), copies_warning(copies, len(cameras))


def triangulate(
    model: pycolmap.Reconstruction, database: Path, photo_folder: Path, model_folder: Path, config: SfmConfig, refinements: int = 5
) -> None:
    """Points from the matches in `database` for the poses of `model`, which stay, beside those it
    has; writes the model to `model_folder`. Those that two photographs see count too: the mappers
    leave them out, and they are 36 to 53 % of all (docs/experiments/sfm.md). Points are adjusted
    and sorted out in up to so many `refinements`."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = config.threads
    options.random_seed = config.seed
    options.triangulation.ignore_two_view_tracks = False
    options.ba_global_max_refinements = refinements
    # Poses stay; without this the places of cameras in their rig would not.
    options.ba_refine_sensor_from_rig = False
    call_colmap(
        "triangulating",
        pycolmap.triangulate_points,
        model,
        database,
        photo_folder,
        model_folder,
        clear_points=False,
        options=options,
        cancellation_token=pycolmap.CancellationToken(),
    )


def photographs_of(cameras: Cameras, photographs: tuple[Photograph, ...]) -> tuple[Photograph, ...]:
    """The photographs in the order of the cameras, grouped by calibration instead of EXIF."""
    by_name = {photo.name: photo for photo in photographs}
    lost = [name for name in cameras.names if name not in by_name]
    if lost:
        raise BadInput(f"photograph {lost[0]!r} is missing or cannot be decoded ({len(lost)} in all): fetch it or drop its pose.")
    grouped = []
    for name, K, size_wh in zip(cameras.names, cameras.Ks, cameras.sizes_wh, strict=True):
        photo = by_name[name]
        if photo.size_wh != tuple(size_wh):
            raise BadInput(misfit_text(f"photograph {name!r}", photo.size_wh, (int(size_wh[0]), int(size_wh[1]))))
        grouped.append(replace(photo, camera=CameraKey(make="", model=repr(K.tolist()), focal_mm=None, size_wh=photo.size_wh)))
    return tuple(grouped)


def is_almost(size_wh: tuple[int, int], camera_wh: tuple[int, int]) -> bool:
    """Whether a photograph is of another size than its camera, by little: undistorting does that,
    and no reduced copy is so large."""
    return size_wh != camera_wh and all(
        abs(side / of_camera - 1) < UNDISTORTED_CHANGE for side, of_camera in zip(size_wh, camera_wh, strict=True)
    )


def misfit_text(subject: str, size_wh: tuple[int, int], camera_wh: tuple[int, int]) -> str:
    """What is said of a photograph (`subject`) of another size than the camera of its pose."""
    sizes = f"{subject} has {size_wh} px and its camera {camera_wh}"
    if is_almost(size_wh, camera_wh):
        return (
            f"{sizes}: the poses are of undistorted photographs and these are as they were taken: give the undistorted ones, which a run "
            "has in sfm/undistorted/images, or poses of these."
        )
    return f"{sizes}: give the photographs that the poses were made from, in their size."


def posed_model(cameras: Cameras, database: Path, folder: Path) -> pycolmap.Reconstruction:
    """The known poses as a model without points, with the database's numbers, whose calibrations
    they replace."""
    index_of = {name: index for index, name in enumerate(cameras.names)}
    intrinsics: dict[int, ColmapCamera] = {}
    images = []
    with pycolmap.Database.open(database) as store:
        for image in store.read_all_images():
            index = index_of[image.name]
            K, (width, height) = cameras.Ks[index], cameras.sizes_wh[index]
            params = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
            intrinsics[image.camera_id] = ColmapCamera(
                camera_id=image.camera_id, model="PINHOLE", size_wh=(int(width), int(height)), params=params
            )
            images.append(_posed_image(image, cameras.cam_from_world[index]))
        for camera in store.read_all_cameras():
            camera.model = pycolmap.CameraModelId.PINHOLE
            camera.params = intrinsics[camera.camera_id].params
            camera.has_prior_focal_length = True
            store.update_camera(camera)
        names = {image.image_id: image.name for image in store.read_all_images()}
    write_model(folder, check_model([*intrinsics.values()], images, NO_POINTS, str(folder)))
    posed = pycolmap.Reconstruction(folder)
    for image_id, name in names.items():
        posed.image(image_id).name = name
    return posed


def _posed_image(image: pycolmap.Image, cam_from_world: FloatArray) -> ColmapImage:
    x, y, z, w = Rotation.from_matrix(cam_from_world[:3, :3]).as_quat()
    return ColmapImage(
        image_id=image.image_id,
        # COLMAP's text reader cuts a name at its first space: numbers now, the real names once it
        # is read.
        name=str(image.image_id),
        camera_id=image.camera_id,
        quat_wxyz=np.array([w, x, y, z]),
        translation=cam_from_world[:3, 3],
        points2d=np.zeros((0, 2)),
        point3d_ids=np.zeros(0, np.int64),
    )
