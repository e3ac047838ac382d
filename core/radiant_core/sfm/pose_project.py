"""From another program's alignment and its photographs to a scene. Once per source.

The alignment is read, its names and sizes are held against the photographs, it is checked
(`pose_check.py`), its world becomes the scene's (`georef/given_world.py`), lenses that COLMAP has
no model for are straightened, and what is left is a COLMAP model like any other.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.frames import Frame, Sim3
from radiant_core.georef.given_world import place_world
from radiant_core.io.colmap.image_files import ImageFiles, match_images, read_with_files, require_files
from radiant_core.io.colmap.records import ColmapModel
from radiant_core.io.photos.beside import OPENING
from radiant_core.io.photos.folders import photograph_names
from radiant_core.io.photos.listing import photograph_size_wh
from radiant_core.io.poses.lens import Lens
from radiant_core.io.poses.pose_file import PosedView, PoseFile, SizeOf
from radiant_core.io.poses.recognise import alignment_files, read_alignment
from radiant_core.sfm.colmap.other_lenses import straighten, straighten_masks
from radiant_core.sfm.colmap.spaced_names import write_for_colmap
from radiant_core.sfm.colmap.workspace import start_clean
from radiant_core.sfm.config import Report, SfmResult
from radiant_core.sfm.known_poses import misfit_text
from radiant_core.sfm.model_check import check_model_poses
from radiant_core.sfm.panorama_poses import with_faces
from radiant_core.sfm.pose_check import check_poses
from radiant_core.sfm.pose_refinement import REFINED, refined_model
from radiant_core.sfm.reconstruct import GivenModel, scene_from_model
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.sfm.world_frame.world import UNPLACED

ORIGINAL, STRAIGHT = "given", "straight"
"""Folders of a work folder: the model of the alignment, photographs without distortion."""
MAX_ASPECT = 0.01
"""By how much the shapes of a photograph and its lens may differ: rounding of a reduced size."""


class NoAlignment(BadInput):
    """A file that was taken for an alignment cannot be read as one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedProject:
    """An alignment that fits its photographs, moved into the scene's world."""

    alignment: PoseFile
    """In the world of the file."""
    model: ColmapModel
    """In that of the scene."""
    given_from_scene: Sim3
    frame: Frame | None
    """None where the file does not say what its coordinates are."""
    check: Decision | None
    """None where nobody looked at the photographs."""

    @property
    def other_lenses(self) -> dict[str, Lens]:
        """Photograph → its lens, of those that COLMAP has no model for."""
        lenses = self.alignment.lenses
        return {view.name: lenses[view.lens_id] for view in self.alignment.views if lenses[view.lens_id].camera(1) is None}


def read_project(path: Path, photos: Path) -> PosedProject:
    """The alignment in `path` of the photographs in `photos`, checked. Raises BadInput where it
    cannot be read, is of other photographs, or does not fit them."""
    return placed_project(read_named(path, photos), photos)


def read_named(path: Path, photos: Path) -> PoseFile:
    """The alignment in `path` by the names of its photographs in `photos`, not checked; raises as
    `read_with_photographs`, and where a photograph lacks."""
    alignment, files = read_with_photographs(path, photos)
    require_files(files, [view.name for view in alignment.views])
    return alignment.named(files)


def read_with_photographs(path: Path, photos: Path) -> tuple[PoseFile, ImageFiles]:
    """The alignment in `path` and which of its photographs are in `photos`, not checked. Raises
    BadInput where it cannot be read, or has fewer than two poses or one twice."""
    try:
        alignment = read_alignment(path, _sizes_in(photos))
    except BadInput as error:
        raise NoAlignment(str(error)) from error
    names = [view.name for view in alignment.views]
    if len(names) < 2:
        raise BadInput(f"{path} has {len(names)} pose, expected those of all photographs: export the alignment again.")
    twice = next((name for name in names if names.count(name) > 1), None) if len(set(names)) < len(names) else None
    if twice is not None:
        raise BadInput(f"{path} has the photograph {twice!r} twice: leave one pose of it.")
    return alignment, match_images(names, photos)


def placed_project(alignment: PoseFile, photos: Path | None, *, rough: bool = False) -> PosedProject:
    """The alignment in the scene's world; with `photos`, by whose names its own go, it is held
    against them first. Raises BadInput where it does not fit them, or is of panoramas, which
    `with_faces` cuts."""
    for lens in alignment.lenses.values():
        lens.camera(1)
    if photos is not None:
        alignment = _in_their_size(alignment, photos)
    check = None if photos is None else check_poses(alignment, photos, rough=rough)
    centers = np.array([-view.cam_from_world[:3, :3].T @ view.cam_from_world[:3, 3] for view in alignment.views])
    given_from_scene, frame = place_world(alignment.world, centers)
    return PosedProject(
        alignment=alignment,
        model=_moved(alignment, given_from_scene.inverse()).model(),
        given_from_scene=given_from_scene,
        frame=frame,
        check=check,
    )


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """What a scene is made from."""

    path: Path
    """Of the alignment: a file, or the folder of a COLMAP model."""
    photos: Path
    refine_poses: bool = False
    """Whether poses are adjusted to the photographs, in the frame that they were given in."""


def scene_from_rough_colmap(
    request: Alignment, work_folder: Path, report: Report, masks: Path | None = None, placement: Placement = UNPLACED
) -> SfmResult:
    """`scene_from_colmap` with poses that are adjusted first; raises alike."""
    start_clean(work_folder)
    shutil.rmtree(work_folder / ORIGINAL, ignore_errors=True)
    model, files = read_with_files(request.path, request.photos)
    checked = check_model_poses(model, request.path, request.photos, rough=True)
    write_for_colmap(model, work_folder / ORIGINAL)
    rough = GivenModel(folder=work_folder / ORIGINAL, images=request.photos, is_checked=True)
    source, masks, refined = refined_model(rough, work_folder, report, masks)
    result = scene_from_model(source, work_folder, report, masks, placement)
    return replace(result, decisions=(checked, refined, *result.decisions), warnings=(*files.notes(), *result.warnings))


def scene_from_alignment(
    request: Alignment, work_folder: Path, report: Report, masks: Path | None = None, placement: Placement = UNPLACED
) -> SfmResult:
    """The scene of another program's alignment and its photographs; raises as `read_project` and
    `scene_from_colmap`."""
    path = request.path
    start_clean(work_folder)
    faced = with_faces(read_named(path, request.photos), request.photos, masks, work_folder, report)
    photos, masks = faced.photos, faced.masks
    if faced.faces is not None and request.refine_poses:
        raise BadInput(f"{faced.alignment.title} has panoramas, whose poses are not adjusted here: leave out --refine-poses.")
    project = placed_project(faced.alignment, photos, rough=request.refine_poses)
    if project.frame is not None and replace(placement, contradictions="stop") != UNPLACED:
        raise BadInput(
            f"{project.alignment.title} says what its coordinates are ({project.alignment.world.title}), which is used as it is: leave out "
            "--up, --north, --distance, --height and --gcp."
        )
    for name in (ORIGINAL, STRAIGHT, REFINED):
        shutil.rmtree(work_folder / name, ignore_errors=True)
    images, masks = _straight(project, photos, work_folder, report, masks)
    write_for_colmap(project.model, work_folder / ORIGINAL)
    source = GivenModel(
        folder=work_folder / ORIGINAL,
        images=images,
        title=project.alignment.title,
        frame=project.frame,
        given_from_model=project.given_from_scene,
        crs=crs_of(project.alignment),
        used=frozenset(alignment_files(path)),
        is_checked=True,
    )
    decisions = [] if project.check is None else [project.check]
    if faced.faces is not None:
        decisions.append(faced.faces.decision(len(faced.alignment.views) // len(faced.faces.rig.faces), forced=False))
    if request.refine_poses:
        source, masks, refined = refined_model(source, work_folder, report, masks)
        decisions.append(refined)
    result = scene_from_model(source, work_folder, report, masks, placement)
    return replace(
        result,
        decisions=(*decisions, *result.decisions),
        warnings=(*_in_one_line(said_of(project.alignment), result.warnings), *project.alignment.notes),
    )


def _in_one_line(used: str, warnings: tuple[str, ...]) -> tuple[str, ...]:
    """What is used and what is left beside it as the first warning, then the others."""
    lines = [warning for warning in warnings if warning.startswith(OPENING)]
    return ("; ".join([used.removesuffix("."), *lines]) if lines else used, *(warning for warning in warnings if warning not in lines))


def said_of(alignment: PoseFile) -> str:
    """One line that says what is used of an alignment."""
    points = f", {len(alignment.points)} points" if len(alignment.points) else ""
    return f"{alignment.title} gives the poses of {len(alignment.views)} photographs{points}, in {alignment.world.title}."


def crs_of(alignment: PoseFile) -> str | None:
    """The system of an alignment's coordinates, where it has a name."""
    return "EPSG:4978" if alignment.world.kind == "ecef" else alignment.world.crs


def _straight(project: PosedProject, photos: Path, work_folder: Path, report: Report, masks: Path | None) -> tuple[Path, Path | None]:
    """The folders of photographs and masks to use: new ones where lenses are straightened."""
    others = project.other_lenses
    if not others:
        return photos, masks
    if len(others) < len(project.alignment.views):
        raise BadInput(
            f"{project.alignment.title} has {len(others)} of {len(project.alignment.views)} photographs by lenses with k4 or skew, and "
            "others by lenses without: give them as two projects, or undistort all photographs in the program that aligned them."
        )
    straighten(others, photos, work_folder / STRAIGHT / "images", report)
    if masks is None:
        return work_folder / STRAIGHT / "images", None
    straighten_masks(others, masks, work_folder / STRAIGHT / "masks")
    return work_folder / STRAIGHT / "images", work_folder / STRAIGHT / "masks"


def _moved(alignment: PoseFile, move: Sim3) -> PoseFile:
    """The alignment in the frame that `move` leads to; what photographs of other lenses see stands
    where a pinhole has it."""
    poses = move.apply_to_poses(np.array([view.cam_from_world for view in alignment.views]))
    views = [replace(view, cam_from_world=pose) for view, pose in zip(alignment.views, poses, strict=True)]
    views = [_straight_view(view, alignment.lenses[view.lens_id]) for view in views]
    return replace(alignment, views=tuple(views), points=move.apply(alignment.points))


def _straight_view(view: PosedView, lens: Lens) -> PosedView:
    if lens.camera(1) is not None or not len(view.pixels):
        return view
    rays = lens.cam_from_img(view.pixels)
    pixels = np.column_stack([lens.cx + lens.fx * rays[:, 0] / rays[:, 2], lens.cy + lens.fy * rays[:, 1] / rays[:, 2]])
    is_inside = np.isfinite(pixels).all(axis=1) & ((pixels >= 0) & (pixels < lens.size_wh)).all(axis=1)
    return replace(view, pixels=pixels[is_inside], point_rows=view.point_rows[is_inside])


def _in_their_size(alignment: PoseFile, photos: Path) -> PoseFile:
    """The alignment with lenses of the size that the photographs have. Raises BadInput where that
    is of another shape; of each lens one photograph is looked at."""
    factors: dict[int, np.ndarray] = {}
    lenses = dict(alignment.lenses)
    for view in {view.lens_id: view for view in alignment.views}.values():
        size_wh, lens = photograph_size_wh(photos / view.name), lenses[view.lens_id]
        if size_wh is None or size_wh == lens.size_wh:
            continue
        across, down = (side / of_lens for side, of_lens in zip(size_wh, lens.size_wh, strict=True))
        if abs(across / down - 1) > MAX_ASPECT:
            turned = size_wh == lens.size_wh[::-1]
            raise BadInput(
                f"photograph {view.name!r} has {size_wh} px as it is stored and its lens {lens.size_wh}: {alignment.program} turned it by "
                "its EXIF orientation: save the photographs upright, without that tag, and align them again."
                if turned
                else misfit_text(f"photograph {view.name!r}", size_wh, lens.size_wh)
            )
        lenses[view.lens_id], factors[view.lens_id] = lens.scaled(size_wh), np.array([across, down])
    views = [replace(view, pixels=view.pixels * factors.get(view.lens_id, np.ones(2))) for view in alignment.views]
    return replace(alignment, lenses=lenses, views=tuple(views)) if factors else alignment


def _sizes_in(photos: Path) -> SizeOf:
    """The size of the photograph that a file means by a name, by its end."""
    by_stem: dict[str, list[str]] = {}
    for name in photograph_names(photos) if photos.is_dir() else ():
        by_stem.setdefault(PurePosixPath(name).stem.casefold(), []).append(name)

    def size_of(name: str) -> tuple[int, int] | None:
        last = PurePosixPath(name.replace("\\", "/")).name.casefold()
        there = by_stem.get(last, []) or by_stem.get(PurePosixPath(last).stem, [])
        sizes = {photograph_size_wh(photos / name) for name in there}
        return sizes.pop() if len(sizes) == 1 else None

    return size_of
