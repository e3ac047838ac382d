"""Sources of a run: photographs, a film, a COLMAP project or another alignment, or a Mill 19
folder."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from radiant_app.workers.folder_kinds import require_photographs
from radiant_app.workers.tasks import SfmTask
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.georef.given_frame import NAME as GIVEN_FRAME
from radiant_core.georef.given_frame import save_given_frame
from radiant_core.io.colmap.candidates import find_models, notes_on_project, picture_folder
from radiant_core.io.photos.folders import photograph_names
from radiant_core.io.photos.mask_folders import find_mask_folder
from radiant_core.io.poses.recognise import find_alignments, photographs_beside, the_alignment
from radiant_core.io.records import load_scene
from radiant_core.io.run_store import read_json
from radiant_core.scene import SfmScene
from radiant_core.sfm.config import SfmConfig, SfmProgress, SfmResult
from radiant_core.sfm.intake import AS_FOUND, FACE_MASKS, FACES, Intake
from radiant_core.sfm.world_frame.placement import Placement

if TYPE_CHECKING:
    from radiant_core.light.captures import Captures

SURVEY = "ground_control"
"""What result.json and metrics.json name the fit to surveyed points and positions by."""
POSITIONS, DOUBTS = "gps_positions", "doubts"
"""What they name the count of GPS positions that place the scene by, and doubts about that."""
SourceKind = Literal["photographs", "colmap", "alignment", "mill19", "film"]
NO_POSES = Path("none")
"""What `--poses` is given to place photographs anew, whatever lies beside them."""
FRAMES = "frames"
"""Folder of structure from motion with the frames of films."""


def detect_source(source: Path, poses: Path | None = None) -> tuple[SourceKind, Path, Path | None]:
    """Kind, folder of photographs, and the COLMAP model's folder or the alignment's file if there
    is one: `images/` beside `sparse/` is a COLMAP project, of whose models `find_models` chooses;
    `train/metadata` is Mill 19; a film, or a folder with films and no photographs, is one;
    `recognise.py` knows other alignments. `poses` goes before them all. BadInput when it is of
    another kind, one with several alignments, or a film with poses."""
    if not is_film(source):
        require_photographs(source)
    return locate_source(source, poses)


def locate_source(source: Path, poses: Path | None = None) -> tuple[SourceKind, Path, Path | None]:
    """`detect_source` of a folder that may be of another kind."""
    pictures = picture_folder(source)
    images = source / "images" if (source / "images").is_dir() else source
    if poses is not None and poses != NO_POSES:
        if is_film(images):
            raise BadInput(f"{images} is a film or holds films alone, whose frames are taken and placed by the run: leave out --poses.")
        if poses.is_dir():
            return "colmap", pictures or source, poses
        return "alignment", photographs_beside(poses, pictures or source), poses
    if source.is_file():
        return "film", source, None
    if poses is None and (source / "train" / "metadata").is_dir():
        return "mill19", source, None
    models = find_models(source)
    if poses is None and models and pictures is not None:
        return "colmap", pictures, models[0].folder
    if is_film(images):
        return "film", images, None
    alignment = the_alignment(source) if poses is None else None
    if alignment is not None:
        return "alignment", photographs_beside(alignment, pictures or source), alignment
    return "photographs", images, None


def is_film(source: Path) -> bool:
    """Whether this is a film, or a folder with films and without photographs to read."""
    from radiant_core.io.film.formats import films_in

    if not source.exists() or not films_in(source):
        return False
    return source.is_file() or not photograph_names(source)


def notes_on_source(source: Path, poses: Path | None = None) -> tuple[str, ...]:
    """What a source holds that is not used although it could be; names no photograph."""
    kind = detect_source(source, poses)[0]
    if kind == "film":
        alignments = find_alignments(source) if source.is_dir() else ()
        listed = ", ".join(path.relative_to(source).as_posix() for path in alignments)
        return (f"not used: {listed}, since the frames of a film are placed by themselves.",) if alignments else ()
    if kind != "mill19":
        return notes_on_project(source) if poses is None and kind != "alignment" else ()
    unused = [path.name for path in (source / "images", source / "sparse") if path.is_dir()]
    return (f"train/metadata makes {source.name} a Mill 19 folder; not used: {', '.join(unused)}.",) if unused else ()


def list_files(source: Path, excluded: Path) -> list[tuple[str, int, int]]:
    """Name, size and modification time of the source's files, but of those in `excluded`."""
    excluded = excluded.resolve()
    files = [path for path in source.rglob("*") if path.is_file() and not path.resolve().is_relative_to(excluded)]
    return sorted((str(path.relative_to(source)), path.stat().st_size, path.stat().st_mtime_ns) for path in files)


def sfm_task(  # noqa: PLR0913
    source: Path,
    sfm: SfmConfig,
    masks: Path | None,
    placement: Placement,
    poses: Path | None = None,
    *,
    refine_poses: bool = False,
    intake: Intake = AS_FOUND,
) -> SfmTask:
    """Structure from motion of a source within a folder of masks, given or beside the photographs,
    and by `poses`, if there are any. BadInput where several masks or alignments would do."""
    if intake.mask_ignores == "nothing" and masks is not None:
        raise BadInput(f"--masks {masks} is given and --mask-ignores is nothing: leave one of them out.")
    if masks is None and intake.mask_ignores != "nothing" and source.is_dir():
        kind, images, _ = locate_source(source, poses)
        masks = None if kind == "film" else find_mask_folder(images, photograph_names(images))[0]
    return SfmTask(
        source=str(source.resolve()),
        sfm=sfm,
        masks=None if masks is None else str(masks.resolve()),
        placement=placement,
        poses=None if poses is None else str(poses) if poses == NO_POSES else str(poses.resolve()),
        refine_poses=refine_poses,
        intake=intake,
    )


def poses_of(task: SfmTask) -> Path | None:
    """The alignment that a task names."""
    return None if task.poses is None else Path(task.poses)


def reconstruct_source(task: SfmTask, folder: Path, report: Callable[[SfmProgress], None]) -> SfmResult:
    """Run structure from motion in `folder` on the source that the task names."""
    from radiant_core.sfm.masks_in_use import masks_in_use

    prepared = prepare_photographs(task, folder, report)
    task_masks = None if task.masks is None else Path(task.masks)
    names = photograph_names(prepared.images)
    with masks_in_use(task_masks, task.intake.mask_ignores, prepared.images, names, folder) as masks:
        cut, masks_folder = faces_of(task, prepared, masks.folder, folder, report)
        result = _reconstruct(task, cut, masks_folder, folder, report)
    prepared = replace(cut, decisions=(*prepared.decisions, *cut.decisions), warnings=(*prepared.warnings, *cut.warnings))
    notes = (*notes_on_source(Path(task.source), poses_of(task)), *prepared.warnings)
    return replace(
        result,
        decisions=(*prepared.decisions, *masks.decisions, *result.decisions),
        warnings=(*notes, *masks.warnings, *result.warnings),
        unnamed_warnings=(*notes, *masks.unnamed_warnings, *result.unnamed_warnings),
    )


@dataclass(frozen=True, kw_only=True)
class PreparedPhotographs:
    """Photographs as structure from motion reads them: as they lie there, or made of films."""

    kind: SourceKind
    images: Path
    model: Path | None
    decisions: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()


def prepare_photographs(task: SfmTask, folder: Path, report: Callable[[SfmProgress], None]) -> PreparedPhotographs:
    """What is made of the source in `folder` before structure from motion, and where it lies."""
    kind, images, model = detect_source(Path(task.source), poses_of(task))
    if kind == "colmap":
        from radiant_core.io.poses.colmap_panoramas import has_panoramas

        assert model is not None
        kind = "alignment" if has_panoramas(model) else kind
    if kind != "film":
        return PreparedPhotographs(kind=kind, images=images, model=model)
    if task.refine_poses:
        raise BadInput(f"{images} is a film or holds films alone, whose frames have no poses to adjust: leave out --refine-poses.")
    from radiant_core.io.film.formats import films_in
    from radiant_core.io.film.frames import take_frames

    frames = take_frames(
        films_in(images),
        folder / FRAMES,
        task.intake.film_frames,
        lambda phase, num_done, total: report(SfmProgress(phase=phase, done=num_done, total=total)),
    )
    return PreparedPhotographs(kind="photographs", images=frames.folder, model=None, decisions=(frames.decision,), warnings=frames.warnings)


def faces_of(
    task: SfmTask, prepared: PreparedPhotographs, masks: Path | None, folder: Path, report: Callable[[SfmProgress], None]
) -> tuple[PreparedPhotographs, Path | None]:
    """The faces of panoramas in place of them, and of their masks; all as it is where there are
    none. Photographs that come with poses are left to who reads those."""
    from radiant_core.io.panoramas.recognise import find_panoramas

    names = photograph_names(prepared.images)
    if prepared.kind != "photographs":
        if task.intake.panoramas is not None:
            raise BadInput(f"--panoramas is of photographs without poses, and {prepared.images} comes with poses: leave it out.")
        if prepared.kind != "alignment":
            shutil.rmtree(folder / FACES, ignore_errors=True)
        return replace(prepared, decisions=(), warnings=()), masks
    panoramas = find_panoramas(prepared.images, names, task.intake.panoramas)
    if not panoramas.names:
        shutil.rmtree(folder / FACES, ignore_errors=True)
        return replace(prepared, decisions=(), warnings=panoramas.warnings), masks
    return _cut(task, prepared, masks, folder, report)


def _cut(
    task: SfmTask, prepared: PreparedPhotographs, masks: Path | None, folder: Path, report: Callable[[SfmProgress], None]
) -> tuple[PreparedPhotographs, Path | None]:
    from radiant_core.io.panoramas.cutting import cut_masks, cut_panoramas
    from radiant_core.io.photos.listing import photograph_size_wh
    from radiant_core.io.photos.masks import find_masks

    names = photograph_names(prepared.images)
    faces = cut_panoramas(
        prepared.images,
        names,
        folder / FACES,
        lambda num_done, total: report(SfmProgress(phase="cutting panoramas", done=num_done, total=total)),
    )
    if masks is not None:
        sizes = {name: size_wh for name in names if (size_wh := photograph_size_wh(prepared.images / name)) is not None}
        cut_masks(find_masks(masks, names), sizes, folder / FACE_MASKS, faces)
        masks = folder / FACE_MASKS
    note = f"{len(names)} photographs are panoramas: each becomes {len(faces.rig.faces)} faces of {faces.size_px} px, placed as one rig."
    return PreparedPhotographs(
        kind="photographs",
        images=faces.folder,
        model=None,
        decisions=(faces.decision(len(names), forced=task.intake.panoramas == "all"),),
        warnings=(note,),
    ), masks


def photographs_of_task(task: SfmTask, folder: Path) -> Path:
    """Where the photographs lie, as taken, that structure from motion in `folder` has used."""
    kind, images, _ = detect_source(Path(task.source), poses_of(task))
    if (folder / FACES).is_dir():
        return folder / FACES
    return folder / FRAMES if kind == "film" else images


def _reconstruct(
    task: SfmTask, prepared: PreparedPhotographs, masks: Path | None, folder: Path, report: Callable[[SfmProgress], None]
) -> SfmResult:
    from radiant_core.sfm.known_poses import scene_from_mill19
    from radiant_core.sfm.pose_project import Alignment, NoAlignment, scene_from_alignment, scene_from_rough_colmap
    from radiant_core.sfm.reconstruct import reconstruct, scene_from_colmap

    kind, images, model = prepared.kind, prepared.images, prepared.model
    if kind == "colmap":
        assert model is not None
        if task.refine_poses:
            alignment = Alignment(path=model, photos=images, refine_poses=True)
            return _named_model(model, scene_from_rough_colmap(alignment, folder, report, masks, task.placement))
        return _named_model(model, scene_from_colmap(model, images, folder, report, masks, task.placement))
    if kind == "alignment":
        assert model is not None
        alignment = Alignment(path=model, photos=images, refine_poses=task.refine_poses)
        try:
            return scene_from_alignment(alignment, folder, report, masks, task.placement)
        except NoAlignment as error:
            if task.poses is not None:
                raise
            raise BadInput(f"{error} It lies beside the photographs: --poses {NO_POSES} leaves it aside.") from None
    if task.refine_poses:
        subject = "a Mill 19 folder, whose poses are used as they are" if kind == "mill19" else "photographs without an alignment"
        raise BadInput(f"{images} is {subject}: leave out --refine-poses, or name the poses to adjust with --poses.")
    if kind == "mill19":
        if replace(task.placement, contradictions="stop") != Placement():
            raise BadInput(
                f"{images} brings its own frame, which is used as it is: leave out --up, --north, --distance, --height and --gcp."
            )
        return scene_from_mill19(images, folder, report, masks=masks)
    return reconstruct(images, folder, task.sfm, report, masks, task.placement)


def _named_model(model: Path, result: SfmResult) -> SfmResult:
    """The result with a first line that says which COLMAP model was used, as those of alignments
    have."""
    name = f"sparse/{model.name}" if model.parent.name == "sparse" else model.name
    note = f"{name} of COLMAP gives the poses of {len(result.scene.cameras)} photographs and {len(result.scene.points)} points."
    return replace(result, warnings=(note, *result.warnings))


def save_given_frames(folder: Path, result: SfmResult) -> list[str]:
    """Write the way back to the frame of a given model beside its scene; names of files."""
    if result.given_frame is None:
        (folder / GIVEN_FRAME).unlink(missing_ok=True)
        return []
    return [save_given_frame(folder, result.given_frame)]


def sfm_record(result: SfmResult, folder: Path) -> dict[str, Any]:
    """The content of result.json: the photographs' and masks' places, photographs without pose."""
    masks = {} if result.masks_folder is None else {"masks": portable_path(result.masks_folder, folder)}
    survey = {} if result.survey is None else {SURVEY: result.survey}
    positions = {} if result.positions is None else {POSITIONS: result.positions}
    doubts = {DOUBTS: list(result.doubts)} if result.doubts else {}
    images = portable_path(result.undistorted_folder, folder)
    return {"images": images, "unregistered": list(result.unregistered), **masks, **survey, **positions, **doubts}


def portable_path(images: Path, folder: Path) -> str:
    """The path of `images`, relative if it lies in `folder`, so that a run can be moved."""
    images, folder = images.resolve(), folder.resolve()
    return str(images.relative_to(folder) if images.is_relative_to(folder) else images)


DELIVERED = "delivered"
"""Folder of a run on devices: the delivered cameras and their plan, in the frame of its scene."""


def has_scene(folder: Path) -> bool:
    """Whether the folder of a run or of `radiant sfm` holds a scene."""
    return any((folder / name).is_file() for name in ("sfm/scene.safetensors", "scene.safetensors"))


def load_scene_of(folder: Path) -> SfmScene:
    """The scene in the folder of a run or of `radiant sfm`; BadInput where there is none."""
    inner = folder / "sfm" / "scene.safetensors"
    path = inner if inner.is_file() else folder / "scene.safetensors"
    if not path.is_file():
        raise BadInput(f"{folder} holds no scene.safetensors: give the folder of 'radiant sfm' or of a run.")
    return load_scene(path)


def load_scored_scene(folder: Path) -> tuple[SfmScene, tuple[str, ...], Path]:
    """A scene without photographs that repeat others, warnings about those, and the folder of its
    photographs: a held-out one must not be trained on under another name."""
    from radiant_core.sfm.copies import without_repeats

    scene, images = load_scene_of(folder), images_folder_of(folder)
    return *without_repeats(scene, images), images


def is_held_out(folder: Path, names: Sequence[str]) -> NDArray[np.bool_]:
    """Which photographs of a folder's scene no model of it was trained on: those that its
    metrics.json scores, by the rule where nothing was scored. A model that photographs were added
    to holds out what it held out before and some of the new ones."""
    path = folder / "metrics.json"
    rows = read_json(path).get("images") if path.is_file() else None
    scored = [row.get("name") for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    mask = np.array([name in scored for name in names], bool)
    return mask if mask.any() else held_out_mask(names)


def images_folder_of(folder: Path) -> Path:
    """The folder of a scene's undistorted photographs; raises as `load_scene_of`."""
    owner = _owner_of_scene(folder)
    if not (owner / "result.json").is_file():
        raise BadInput(f"{owner} holds no result.json that names its photographs: give the folder of 'radiant sfm' or of a run.")
    return owner / read_json(owner / "result.json", ("images",))["images"]


def masks_folder_of(folder: Path) -> Path | None:
    """The folder of masks as large as the photographs of `images_folder_of`; None where none is."""
    owner = _owner_of_scene(folder)
    masks = read_json(owner / "result.json").get("masks") if (owner / "result.json").is_file() else None
    return None if masks is None else owner / masks


def captures_of(folder: Path) -> Captures:
    """When the photographs of a scene were taken and how exposed, as far as its folder says."""
    from radiant_core.light.captures import load_captures

    return load_captures(_owner_of_scene(folder))


def _owner_of_scene(folder: Path) -> Path:
    return folder / "sfm" if (folder / "sfm" / "result.json").is_file() else folder
