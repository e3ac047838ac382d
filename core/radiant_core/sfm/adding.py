"""New photographs in the frame of a scene whose poses stay to the bit. Once per set of them.

    undistorted photographs of the scene ─ features, matches ─ points at its poses ─┐
    new photographs ─ features, matches with those and each other ──────────────────┴─ their poses,
                      lenses and points ─ undistorted ─→ the scene, and behind it what is new

Mapping goes on from the scene with its frames and lenses fixed. With GPS on both sides a new
photograph is matched with the nearest of the scene, else with all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.align import fit_sim3
from radiant_core.io.colmap.model import read_model
from radiant_core.io.photos.listing import Photograph, load_photograph, load_thumbnail
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.colmap.database import extract_features, match_pairs
from radiant_core.sfm.colmap.pairs import Pairs, gps_about, neighbor_pairs
from radiant_core.sfm.colmap.previewed_pairs import keep_promising
from radiant_core.sfm.colmap.refine import robust_options
from radiant_core.sfm.colmap.strays import MIN_POINTS, SURE_AGREEMENT, contradicted, remove
from radiant_core.sfm.colmap.undistort import undistort
from radiant_core.sfm.colmap.workspace import DATABASE_FILES, list_usable, warn_of_unused
from radiant_core.sfm.config import Phase, Report, SfmConfig, SfmProgress, number_phases, with_preview
from radiant_core.sfm.copies import THUMBNAIL_PX, find_repeats
from radiant_core.sfm.known_poses import photographs_of, posed_model, triangulate
from radiant_core.sfm.world_frame.world import cameras_of

PHASES: tuple[Phase, ...] = ("checking photographs", "features", "matching", "triangulating", "mapping", "undistorting")


@dataclass(frozen=True, kw_only=True, eq=False)
class AddedPhotographs:
    """A scene with new photographs behind its C cameras and P points, which are as they were.

    images: folder of the new ones, undistorted, by the names of their cameras; unplaced: names of
    those without a place, as they lie in the given folder."""

    scene: SfmScene
    num_before: int
    images: Path
    unplaced: tuple[str, ...]
    warnings: tuple[str, ...]


def add_photographs(scene: SfmScene, images: Path, folder: Path, work_folder: Path, config: SfmConfig, report: Report) -> AddedPhotographs:
    """Place the photographs in `folder` against a scene.

    Args:
        scene: its cameras are pinholes, of the photographs of their names in `images`.
        images: the folder of those.
        folder: the new photographs, as they were taken. Each gets the name of this folder before
            its own, since drones count from 1 on every flight.
        work_folder: gets undistorted/, a database and models.
        config: settings of structure from motion.
        report: hears of progress.

    Returns:
        The larger scene, and what could not be placed.

    Raises:
        BadInput: a name is taken, or none of the new photographs can be placed or all repeat old
            ones.
    """
    report = number_phases(report, with_preview(PHASES, config))
    listing = list_usable(folder, report)
    root, prefix = folder.resolve().parent, folder.resolve().name
    new = tuple(replace(photo, name=f"{prefix}/{photo.name}") for photo in listing.photographs)
    clashes = sorted({photo.name for photo in new} & set(scene.cameras.names))
    if clashes:
        raise BadInput(f"the scene has a photograph {clashes[0]!r} already ({len(clashes)} in all): rename the folder {folder}.")
    work_folder.mkdir(parents=True, exist_ok=True)
    for name in DATABASE_FILES:
        (work_folder / name).unlink(missing_ok=True)
    job = _Job(scene=scene, images=images, new=new, root=root, work_folder=work_folder, config=config, report=report)
    model = _mapped(job)
    placed = {model.image(number).name for number in model.reg_image_ids()} & {photo.name for photo in new}
    unplaced = tuple(photo.name.removeprefix(f"{prefix}/") for photo in new if photo.name not in placed)
    if not placed:
        raise BadInput(
            f"none of the {len(new)} photographs in {folder} could be placed against the {len(scene.cameras)} of the scene "
            f"({', '.join(unplaced[:5])}): they share too little with them; add photographs between, or make a new run of all."
        )
    larger, undistorted = _enlarged(job, model)
    larger, repeats = _without_repeats(larger, len(scene.cameras), images, undistorted)
    if len(larger.cameras) == len(scene.cameras):
        raise BadInput(f"all {len(placed)} photographs in {folder} that could be placed repeat photographs of the scene: nothing is new.")
    return AddedPhotographs(
        scene=larger,
        num_before=len(scene.cameras),
        images=undistorted,
        unplaced=unplaced,
        warnings=(*warn_of_unused(listing), *_unplaced_warning(unplaced, len(new)), *repeats),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Job:
    """`root` / name is the file of a `new` photograph."""

    scene: SfmScene
    images: Path
    new: tuple[Photograph, ...]
    root: Path
    work_folder: Path
    config: SfmConfig
    report: Report

    @property
    def database(self) -> Path:
        return self.work_folder / "database.db"


def _mapped(job: _Job) -> pycolmap.Reconstruction:
    """The model of the scene's photographs near the new ones, grown by these."""
    near_pairs, cameras = _partners(job)
    old = photographs_of(cameras, list_usable(job.images, job.report, cameras.names).photographs)
    total = len(old) + len(job.new)

    def count_all(progress: SfmProgress) -> None:
        job.report(replace(progress, total=total) if progress.phase == "features" else progress)

    extract_features(job.database, job.images, old, job.config, count_all)
    start = job.work_folder / "start"
    posed = posed_model(cameras, job.database, start)
    fixed = set(posed.cameras)
    extract_features(job.database, job.root, job.new, job.config, count_all)
    old_pairs = neighbor_pairs(list(cameras.names), cameras.centers, job.config.num_neighbors)
    new_pairs = [*near_pairs, *combinations([photo.name for photo in job.new], 2)]
    pairs, _ = keep_promising(job.database, [*old_pairs, *new_pairs], job.config, job.report)
    between_old = set(old_pairs)
    poses = dict(zip(cameras.names, cameras.cam_from_world, strict=True))
    match_pairs(job.database, [pair for pair in pairs if pair in between_old], job.config, job.report, poses)
    job.report(SfmProgress(phase="triangulating", done=0, total=len(cameras)))
    triangulate(posed, job.database, job.images, start, job.config, refinements=1)
    job.report(SfmProgress(phase="triangulating", done=len(cameras), total=len(cameras)))
    match_pairs(job.database, [pair for pair in pairs if pair not in between_old], job.config, job.report)
    model = _grown(job, start, fixed)
    names = {photo.name for photo in job.new}
    grown = [number for number in model.reg_image_ids() if model.image(number).name in names]
    wrong = [number for number in contradicted(model, job.database, SURE_AGREEMENT) if number in grown]
    few = [number for number in grown if model.image(number).num_points3D < MIN_POINTS]
    remove(model, [*wrong, *few])
    _adjust_new(model, names, fixed, job.config)
    return model


def _adjust_new(model: pycolmap.Reconstruction, names: set[str], fixed: set[int], config: SfmConfig) -> None:
    """Adjust poses and lenses of the photographs of these names, and all points, by the robust loss
    that ends every structure from motion; all else stays."""
    setup = pycolmap.BundleAdjustmentConfig()
    for number in model.reg_image_ids():
        image = model.image(number)
        setup.add_image(number)
        if image.name not in names:
            setup.set_constant_rig_from_world_pose(image.frame_id)
    for number in fixed & set(model.cameras):
        setup.set_constant_cam_intrinsics(number)
    options = robust_options(config, refine_lenses=True)
    adjuster = pycolmap.create_default_bundle_adjuster(options, setup, model)
    call_colmap("refining", adjuster.solve)


def _partners(job: _Job) -> tuple[Pairs, Cameras]:
    """Pairs of an old and a new photograph, and the cameras of the old ones among them."""
    cameras, frame = job.scene.cameras, job.scene.frame
    places = np.full((len(job.new), 3), np.nan)
    if frame.kind == "metric":
        places = gps_about(job.new, frame.origin_lat_lon_alt)
    count = min(job.config.num_neighbors, len(cameras))
    pairs: Pairs = []
    for photo, place in zip(job.new, places, strict=True):
        away = np.linalg.norm(cameras.centers[:, :2] - place[:2], axis=1)
        rows = np.argsort(away, kind="stable")[:count] if np.isfinite(place[:2]).all() else np.arange(len(cameras))
        pairs += [(cameras.names[row], photo.name) for row in rows.tolist()]
    old_names = {first for first, _ in pairs}
    return pairs, cameras.named([name for name in cameras.names if name in old_names])


def _grown(job: _Job, start: Path, fixed: set[int]) -> pycolmap.Reconstruction:
    """The model in `start` with all new photographs that fit, its frames and lenses as they are."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = job.config.threads, job.config.seed
    options.fix_existing_frames = options.mapper.fix_existing_frames = True
    options.constant_cameras = options.mapper.constant_cameras = fixed
    options.multiple_models = options.extract_colors = options.ba_refine_sensor_from_rig = False
    folder, total = job.work_folder / "grown", len(job.new)
    folder.mkdir(exist_ok=True)
    registered: list[None] = []
    models = call_colmap(
        "mapping",
        pycolmap.incremental_mapping,
        job.database,
        job.root,
        folder,
        input_path=str(start),
        options=options,
        next_image_callback=lambda: registered.append(None),
        cancellation_token=pycolmap.CancellationToken(),
        on_tick=lambda: job.report(SfmProgress(phase="mapping", done=min(len(registered), total), total=total)),
    )
    job.report(SfmProgress(phase="mapping", done=total, total=total))
    return next(iter(models.values()), None) or pycolmap.Reconstruction(start)


def _enlarged(job: _Job, model: pycolmap.Reconstruction) -> tuple[SfmScene, Path]:
    """The scene with the new cameras and the points that they see, and the folder of their
    undistorted photographs."""
    back = _to_scene(model, job.scene.cameras)
    model.transform(pycolmap.Sim3d(back.scale, pycolmap.Rotation3d(back.rotation), back.translation))
    names = [photo.name for photo in job.new]
    alone, new_names = pycolmap.Reconstruction(model), set(names)
    remove(alone, [number for number in alone.reg_image_ids() if alone.image(number).name not in new_names])
    folder = job.work_folder / "added"
    folder.mkdir(exist_ok=True)
    alone.write_binary(folder)
    undistorted = undistort(folder, job.root, job.work_folder, job.config.threads, job.report)
    cameras = cameras_of(read_model(undistorted.model_folder))
    larger = concatenate_cameras([job.scene.cameras, cameras])
    points, observations = _new_points(model, larger.names, len(job.scene.cameras))
    colors = _colors(points, cameras, undistorted.image_folder)
    numbered = observations + np.array([len(job.scene.points), 0])
    scene = replace(
        job.scene,
        cameras=larger,
        points=np.concatenate([job.scene.points, points]),
        colors=np.concatenate([job.scene.colors, colors]),
        observations=np.concatenate([job.scene.observations, numbered]),
    )
    return scene, undistorted.image_folder


def _to_scene(model: pycolmap.Reconstruction, cameras: Cameras) -> Sim3:
    """What moves the model, which COLMAP may have normalised, back onto the scene's cameras."""
    centers = {model.image(number).name: model.image(number).projection_center() for number in model.reg_image_ids()}
    names = [name for name in cameras.names if name in centers]
    return fit_sim3(np.array([centers[name] for name in names]), cameras.named(names).centers)


def _new_points(model: pycolmap.Reconstruction, names: Sequence[str], num_before: int) -> tuple[FloatArray, NDArray[np.int64]]:
    """Points (Q,3) that a new camera sees, and who sees each (T,2): point, camera."""
    row_of = {name: row for row, name in enumerate(names)}
    row_of_image = {number: row_of.get(model.image(number).name, -1) for number in model.reg_image_ids()}
    points, pairs = [], []
    for point in model.points3D.values():
        rows = {row_of_image.get(element.image_id, -1) for element in point.track.elements} - {-1}
        if len(rows) > 1 and max(rows) >= num_before:
            pairs += [(len(points), row) for row in sorted(rows)]
            points.append(point.xyz)
    return np.array(points, np.float64).reshape(-1, 3), np.array(pairs, np.int64).reshape(-1, 2)


def _colors(points: FloatArray, cameras: Cameras, images: Path) -> NDArray[np.uint8]:
    """The colour (Q,3) of each point in the last of the new photographs that it lies in."""
    colors = np.full((len(points), 3), 127, np.uint8)
    for K, pose, size_wh, name in zip(cameras.Ks, cameras.cam_from_world, cameras.sizes_wh, cameras.names, strict=True):
        in_camera = points @ pose[:3, :3].T + pose[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = (in_camera @ K.T)[:, :2] / in_camera[:, 2:]
        rows = np.flatnonzero((in_camera[:, 2] > 0) & (pixels >= 0).all(axis=1) & (pixels < size_wh).all(axis=1))
        picture = load_photograph(images / name, (int(size_wh[0]), int(size_wh[1])))
        x, y = pixels[rows].astype(np.int64).T
        colors[rows] = np.rint(255 * picture[y, x])
    return colors


def _without_repeats(scene: SfmScene, num_before: int, images: Path, added: Path) -> tuple[SfmScene, tuple[str, ...]]:
    """The scene without new cameras that repeat another, and what is said of them."""
    names = scene.cameras.names
    repeated = find_repeats(
        scene.cameras, scene.points, lambda row: load_thumbnail((images if row < num_before else added) / names[row], THUMBNAIL_PX)
    )
    # Of a pair the later one goes, whichever has the name that is worth more.
    dropped = sorted({max(pair) for pair in repeated.items()} - set(range(num_before)))
    if not dropped:
        return scene, ()
    staying = np.setdiff1d(np.arange(len(names)), dropped)
    new_row = np.full(len(names), -1)
    new_row[staying] = np.arange(len(staying))
    observations = scene.observations[new_row[scene.observations[:, 1]] >= 0]
    observations = np.column_stack([observations[:, 0], new_row[observations[:, 1]]])
    sentence = f"{len(dropped)} new photographs repeat others and are left out: {', '.join(names[row] for row in dropped[:5])}."
    return replace(scene, cameras=scene.cameras.select(staying), observations=observations), (sentence,)


def _unplaced_warning(unplaced: Sequence[str], total: int) -> tuple[str, ...]:
    if not unplaced:
        return ()
    return (f"{len(unplaced)} of {total} new photographs could not be placed and are left out: {', '.join(unplaced[:10])}.",)
