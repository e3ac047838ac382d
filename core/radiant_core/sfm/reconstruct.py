"""Structure from motion: from a folder of photographs to cameras and points in one world frame.

Once per scene: list and check the photographs, features, pairs, matches, poses (`attempts.py`,
`refine.py`), the points that two photographs see, undistort to pinhole (`undistort.py`), then the
world frame (`world.py`). EXIF orientation is ignored for pixels throughout.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3, compose
from radiant_core.geometry.align import fit_sim3
from radiant_core.georef.given_frame import GivenFrame
from radiant_core.io.colmap.image_files import photographs_without_pose, read_with_files, unposed_count
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.photos.beside import beside_warning
from radiant_core.io.photos.copies import copies_count
from radiant_core.io.photos.listing import Photograph, PhotoListing
from radiant_core.numerics import FloatArray
from radiant_core.panoramas import has_faces
from radiant_core.scene import SfmScene
from radiant_core.sfm.attempts import Attempt, PhotographSet, find_poses
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.refine import refine
from radiant_core.sfm.colmap.rig import flatten, without_blind_faces
from radiant_core.sfm.colmap.spaced_names import write_for_colmap
from radiant_core.sfm.colmap.undistort import fit_model, remove_images, undistort
from radiant_core.sfm.colmap.workspace import list_usable, start_clean, warn_of_unused
from radiant_core.sfm.config import Phase, Report, SfmConfig, SfmProgress, SfmResult, number_phases, with_preview
from radiant_core.sfm.control.before_matching import check_control
from radiant_core.sfm.control.place import place_surveyed, survey_record
from radiant_core.sfm.control.survey import Surveyed, adjust_to_survey
from radiant_core.sfm.copies import without_repeats
from radiant_core.sfm.given_points import POINT_PHASES, with_points
from radiant_core.sfm.gps_outliers import MANY, gps_outliers
from radiant_core.sfm.known_poses import is_almost, misfit_text, triangulate
from radiant_core.sfm.masks import keep_masks, masks_decision, take_masks, undistort_masks, without_masked_points
from radiant_core.sfm.memory import limit_to_memory, undistorting_threads
from radiant_core.sfm.model_check import check_model_poses
from radiant_core.sfm.readable import readable_folder, remove_readable, stretch_decisions
from radiant_core.sfm.time_left import TimeLeft, predict_phases
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.sfm.world_frame.world import UNPLACED, PlacedScene, scene_as_given, scene_in_world, with_warnings

GIVEN_MODEL = "the COLMAP model"
PHASES: tuple[Phase, ...] = ("checking photographs", "features", "matching", "mapping", "refining", "triangulating", "undistorting")


def reconstruct(
    photo_folder: Path, work_folder: Path, config: SfmConfig, report: Report, masks: Path | None = None, placement: Placement = UNPLACED
) -> SfmResult:
    """Cameras, points and undistorted photographs of the usable photographs in `photo_folder`.

    `work_folder` gets undistorted/ and sparse/, whose COLMAP models are in the scene's frame, and
    masks/ for a folder of `masks`; features and matches of an interrupted attempt with the same
    photographs, masks and settings are used, all else there is removed. Raises BadInput when fewer
    than two photographs can be used or they do not overlap, or `masks` or `placement` do not fit.
    """
    phases = with_preview(PHASES, config)
    report = number_phases(report, phases)
    listing = list_usable(photo_folder, report, stretch=True)
    photographs, sizes_wh = listing.photographs, [photo.size_wh for photo in listing.photographs]
    placement.check_copies(listing.copies)
    placement.check_names((photo.name for photo in photographs), of_model=False)
    contradicted = check_control(placement, photographs, {photo.name: photo.size_wh for photo in photographs})
    config, limited = limit_to_memory(config, sizes_wh)
    report = TimeLeft(report=report, phases=phases, predicted_s=predict_phases(sizes_wh, config))
    given_masks, project_notes = masks, beside_warning(photo_folder, masks, control=placement.control_text)
    given_folder, photo_folder = photo_folder, readable_folder(listing, photo_folder, work_folder)
    photos = PhotographSet(folder=photo_folder, given_folder=given_folder, photographs=photographs, masks=masks)
    attempt = find_poses(photos, work_folder, config, report)
    mapped, original_masks = attempt.mapped, attempt.given_masks
    assert mapped is not None
    sparse = work_folder / "sparse"
    sparse.mkdir()
    refined = refine(mapped.model, config, report)
    surveyed = adjust_to_survey(refined, photographs, placement.parsed_control([photo.name for photo in photographs]), report)
    blind = _triangulate(refined, attempt, photo_folder, sparse, report)
    undistorted = undistort(sparse, photo_folder, work_folder, undistorting_threads(config, sizes_wh), report)
    remove_readable(work_folder)
    masks = undistort_masks(original_masks, sparse, work_folder, config.threads)
    placed = _placed(read_model(undistorted.model_folder), surveyed, photographs, config.seed, placement)
    scene, repeats = without_repeats(placed.scene, undistorted.image_folder)
    for folder in (sparse, undistorted.model_folder):
        fit_model(folder, placed.world_from_model, scene.cameras)
    remove_images(undistorted.image_folder, scene.cameras)
    outliers = gps_outliers(scene, photographs)
    placed = with_warnings(placed, contradicted)
    return SfmResult(
        scene=scene,
        undistorted_folder=undistorted.image_folder,
        unregistered=mapped.unregistered,
        decisions=(*limited, *stretch_decisions(listing), *attempt.decisions, *placed.decisions, *masks_decision(scene, masks)),
        warnings=(
            *warn_of_unused(listing, project_notes),
            *attempt.warnings,
            *repeats,
            *_named(_unregistered_counts(mapped.unregistered, photographs), mapped.unregistered),
            *_named(_doubted_counts(mapped.doubted), mapped.doubted),
            *blind,
            *outliers.warning(),
            *placed.warnings,
        ),
        unnamed_warnings=(
            *warn_of_unused(listing, beside_warning(given_folder, given_masks, control=placement.control_text, named=False), named=False),
            *attempt.warnings,
            *copies_count(len(placed.scene.cameras) - len(scene.cameras), len(placed.scene.cameras)),
            *_unregistered_counts(mapped.unregistered, photographs),
            *_doubted_counts(mapped.doubted),
            *blind,
            *outliers.warning(named=False),
            *placed.warnings,
        ),
        masks_folder=masks,
        survey=None if surveyed is None else survey_record(surveyed),
        positions=None if placed.positions is None else placed.positions.record,
        doubts=(*placed.doubts, *outliers.doubt(), *_many_doubted(mapped.doubted, len(scene.cameras))),
    )


def _triangulate(refined: pycolmap.Reconstruction, attempt: Attempt, photo_folder: Path, folder: Path, report: Report) -> tuple[str, ...]:
    """Write the model with all its points; what is said of faces of panoramas that it leaves
    out."""
    total = int(refined.num_reg_images())
    report(SfmProgress(phase="triangulating", done=0, total=total))
    # Once: what more photographs see has just been adjusted.
    triangulate(refined, attempt.database, photo_folder, folder, attempt.config, refinements=1)
    report(SfmProgress(phase="triangulating", done=total, total=total))
    return flatten(folder) if has_faces(image.name for image in refined.images.values()) else ()


def _placed(
    model: ColmapModel,
    surveyed: Surveyed | None,
    photographs: tuple[Photograph, ...],
    seed: int,
    placement: Placement,
    *,
    keeps_frame: bool = False,
) -> PlacedScene:
    if surveyed is not None:
        return place_surveyed(model, surveyed, photographs, placement)
    return scene_in_world(model, photographs, seed, placement, keeps_frame=keeps_frame)


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenModel:
    """A COLMAP model that a scene is made from, and what is known of it beyond its files."""

    folder: Path
    images: Path
    title: str = GIVEN_MODEL
    frame: Frame | None = None
    """What its coordinates are, where whoever made it says so; None: GPS or its own z decide."""
    given_from_model: Sim3 | None = None
    """To the coordinates of the file that it was read from; None: they are its own."""
    crs: str | None = None
    """The system of those, where they have one."""
    used: frozenset[Path] = frozenset()
    """Files that it was read from; none for a COLMAP model."""
    is_checked: bool = False
    """Whether it was held against its photographs before."""


def scene_from_colmap(
    model_folder: Path, image_folder: Path, work_folder: Path, report: Report, masks: Path | None = None, placement: Placement = UNPLACED
) -> SfmResult:
    """The scene of an existing COLMAP model, binary or text, and its images.

    Pinhole images are used where they are; others are undistorted into `work_folder`, with a model
    in the scene's frame. The frame comes from GPS where images have it; undecodable ones are
    skipped and named. Points seen only where `masks` are 0 are left out. BadInput for an unreadable
    model, an image that is missing or not of its camera's shape, or arguments that do not fit.
    """
    return scene_from_model(GivenModel(folder=model_folder, images=image_folder), work_folder, report, masks, placement)


def scene_from_model(
    source: GivenModel, work_folder: Path, report: Report, masks: Path | None = None, placement: Placement = UNPLACED
) -> SfmResult:
    """`scene_from_colmap` of a model of which more is known than its files say."""
    model_folder, image_folder = source.folder, source.images
    model, files = read_with_files(model_folder, image_folder)
    unposed = photographs_without_pose(files)
    placement.check_names((image.name for image in model.images), of_model=True)
    pinhole = all(model.cameras[image.camera_id].is_pinhole for image in model.images)
    report = number_phases(report, _phases_of(model, placement, pinhole=pinhole))
    listing = list_usable(image_folder, report, tuple(image.name for image in model.images), stretch=True)
    placement.check_copies(listing.copies)
    listing = listing if pinhole else listing.without_odd_suffixes()
    model = model.without(listing.left_out)
    given_centers = _centers_of(model)
    _require_images(model, listing, image_folder)
    _require_tracks(model, model_folder, placement)
    checked = () if source.is_checked else (check_model_poses(model, model_folder, image_folder),)
    contradicted = check_control(placement, listing.photographs, _sizes_of(model))
    project_notes = beside_warning(image_folder, masks, control=placement.control_text, used=source.used)
    if masks is not None or placement.control is not None or not pinhole:
        start_clean(work_folder)
    image_folder = readable_folder(listing, image_folder, work_folder)
    if files.renamed and (placement.control is not None or not pinhole):
        model_folder = _written(model, work_folder / "named")
    surveyed = None
    if placement.control is not None:
        model_folder, surveyed = _adjusted_copy(model_folder, work_folder / "adjusted", listing.photographs, placement, report)
        model = read_model(model_folder)
    original_masks = take_masks(masks, listing.photographs, work_folder)
    if pinhole:
        masks, images_to_use = keep_masks(original_masks, work_folder), image_folder
    else:
        if listing.left_out or any(" " in image.name for image in model.images):
            model_folder = _written(model, work_folder / "sparse")
        model, images_to_use, masks = _undistorted(model_folder, image_folder, work_folder, original_masks, report)
    model, point_notes = with_points(model, images_to_use, work_folder, report, masks)
    model, blind = without_blind_faces(model)
    if source.frame is not None:
        placed = scene_as_given(model, source.frame)
    else:
        placed = with_warnings(_placed(model, surveyed, listing.photographs, 0, placement, keeps_frame=True), contradicted)
    given_frame = _given_frame(placed, source, given_centers if surveyed is not None else None)
    scene, repeats = without_repeats(placed.scene, images_to_use)
    outliers = gps_outliers(scene, listing.photographs)
    if not pinhole:
        _fit_models(work_folder, placed, scene, images_to_use)
    return SfmResult(
        scene=without_masked_points(scene, masks),
        undistorted_folder=images_to_use,
        unregistered=unposed,
        decisions=(*checked, *stretch_decisions(listing), *placed.decisions, *masks_decision(scene, masks)),
        warnings=(
            *files.notes(),
            *_named(unposed_count(unposed, files), unposed),
            *warn_of_unused(listing, project_notes),
            *point_notes,
            *blind,
            *repeats,
            *outliers.warning(),
            *placed.warnings,
            *given_frame.notes(),
        ),
        masks_folder=masks,
        given_frame=given_frame,
        survey=None if surveyed is None else survey_record(surveyed),
        positions=None if placed.positions is None else placed.positions.record,
        doubts=(*placed.doubts, *outliers.doubt()),
    )


def _undistorted(
    model_folder: Path, image_folder: Path, work_folder: Path, masks: Path | None, report: Report
) -> tuple[ColmapModel, Path, Path | None]:
    """Model, images and masks without distortion."""
    undistorted = undistort(model_folder, image_folder, work_folder, SfmConfig().threads, report)
    masks = undistort_masks(masks, model_folder, work_folder, SfmConfig().threads)
    remove_readable(work_folder)
    return read_model(undistorted.model_folder), undistorted.image_folder, masks


def _phases_of(model: ColmapModel, placement: Placement, *, pinhole: bool) -> tuple[Phase, ...]:
    needed: dict[Phase, bool] = {"checking photographs": True, "refining": placement.control is not None, "undistorting": not pinhole}
    phases: tuple[Phase, ...] = tuple(phase for phase, is_needed in needed.items() if is_needed)
    return phases if len(model.points.ids) else (*phases, *POINT_PHASES)


def _centers_of(model: ColmapModel) -> dict[str, FloatArray]:
    return {image.name: -image.cam_from_world[:3, :3].T @ image.translation for image in model.images}


def _sizes_of(model: ColmapModel) -> dict[str, tuple[int, int]]:
    return {image.name: model.cameras[image.camera_id].size_wh for image in model.images}


def _require_tracks(model: ColmapModel, model_folder: Path, placement: Placement) -> None:
    if placement.control is not None and not len(model.points.tracks):
        raise BadInput(
            f"the model in {model_folder} does not say which points its images see, which --gcp needs to move them together: give a "
            "model with its tracks, or the photographs alone."
        )


def _written(model: ColmapModel, folder: Path) -> Path:
    write_for_colmap(model, folder)
    return folder


def _fit_models(work_folder: Path, placed: PlacedScene, scene: SfmScene, images: Path) -> None:
    """Models and `images` become those of the scene. What was given stays as it is; sparse/ is
    there where COLMAP could not read it as it was."""
    remove_images(images, scene.cameras)
    for folder in (work_folder / "sparse", work_folder / "undistorted" / "sparse"):
        if folder.is_dir():
            fit_model(folder, placed.world_from_model, scene.cameras)


def _given_frame(placed: PlacedScene, source: GivenModel, centers: dict[str, FloatArray] | None) -> GivenFrame:
    """The way back to the given model: exact, or what fits its `centers` (3,) best where its poses
    were adjusted."""
    back, error = placed.world_from_model.inverse(), 0.0
    if centers is not None:
        cameras = placed.scene.cameras
        given_centers = np.array([centers[name] for name in cameras.names])
        back = fit_sim3(cameras.centers, given_centers)
        error = float(np.linalg.norm(back.apply(cameras.centers) - given_centers, axis=1).max())
    if source.given_from_model is not None:
        back = compose(source.given_from_model, back)
    return GivenFrame(given_from_scene=back, model=source.title, largest_error=error, crs=source.crs, is_default=bool(source.used))


def _adjusted_copy(
    model_folder: Path, folder: Path, photographs: tuple[Photograph, ...], placement: Placement, report: Report
) -> tuple[Path, Surveyed | None]:
    """A copy of a given model without the images that are left out, adjusted to ground control."""
    names = {photo.name for photo in photographs}
    model = pycolmap.Reconstruction(model_folder)
    for image in [image for image in model.images.values() if image.has_pose and image.name not in names]:
        model.deregister_frame(image.frame_id)
    surveyed = adjust_to_survey(model, photographs, placement.parsed_control([photo.name for photo in photographs]), report)
    folder.mkdir(parents=True)
    model.write_binary(folder)
    return folder, surveyed


def _require_images(model: ColmapModel, listing: PhotoListing, image_folder: Path) -> None:
    """Raise BadInput unless every image of the model is there, in the shape of its camera, and in
    its size where it has to be undistorted."""
    sizes = {photo.name: photo.size_wh for photo in listing.photographs}
    lost = [image.name for image in model.images if image.name not in sizes]
    if lost:
        raise BadInput(f"image {lost[0]!r} of the model is not in {image_folder} ({len(lost)} in all): give the folder of its images.")
    for image in model.images:
        camera = model.cameras[image.camera_id]
        width, height = (side / of_camera for side, of_camera in zip(sizes[image.name], camera.size_wh, strict=True))
        # A reduced pinhole image may be off by a pixel of rounding; points of a distorted one are
        # undistorted in its own pixels.
        fits = abs(width - height) <= 0.01 * max(width, height) if camera.is_pinhole else width == height == 1
        if not fits or is_almost(sizes[image.name], camera.size_wh):
            raise BadInput(misfit_text(f"image {image.name!r}", sizes[image.name], camera.size_wh))


def _unregistered_counts(unregistered: tuple[str, ...], photographs: tuple[Photograph, ...]) -> tuple[str, ...]:
    if not unregistered:
        return ()
    return (f"{len(unregistered)} of {len(photographs)} photographs have no pose and are left out.",)


def _doubted_counts(doubted: tuple[str, ...]) -> tuple[str, ...]:
    if not doubted:
        return ()
    return (f"{len(doubted)} of the photographs have a pose that most of their matches contradict.",)


def _many_doubted(doubted: tuple[str, ...], total: int) -> tuple[str, ...]:
    """Poses that most matches contradict put a scene in doubt where they are many."""
    return _doubted_counts(doubted) if len(doubted) > MANY * total else ()


def _named(warnings: tuple[str, ...], names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{warning.removesuffix('.')}: {', '.join(names[:10])}." for warning in warnings)
