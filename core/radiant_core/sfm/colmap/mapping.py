"""From matches to one sparse model: incremental mapping, then more pairs, then globally.

Once per scene. Of several models the one with most images, then most points, is kept, without its
strays (`strays.py`). Mapping then goes on from it: an image that a few wrong matches placed early
finds its place among all others.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from radiant_core.decisions import Decision
from radiant_core.io.photos.listing import Photograph
from radiant_core.panoramas import has_faces
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.colmap.database import match_pairs
from radiant_core.sfm.colmap.pairs import Pairs, pairs_with
from radiant_core.sfm.colmap.previewed_pairs import keep_related
from radiant_core.sfm.colmap.strays import SURE_AGREEMENT, contradicted, remove, without_strays
from radiant_core.sfm.config import Report, SfmConfig, SfmProgress

GROWTH = 1.4
"""The model may grow by so much before all of it is adjusted again: 1.1 as COLMAP has it took 40 %
longer and gave the same poses (docs/experiments/sfm.md)."""
LEAST_GAIN, LEAST_LOCAL_GAIN = 1e-5, 1e-4
"""An adjustment of all photographs, or of the latest alone, ends where an iteration lowers its cost
by a smaller share: without such an end, as COLMAP has it, mapping took 50 % longer. With 1e-4 for
all, a focal length may stay anywhere: brighton's stayed at 806 px, 1 % from where squares end."""
MAX_LEFT_SHARE = 0.1


@dataclass(frozen=True, kw_only=True)
class MappingJob:
    """What every mapping attempt needs: photographs, their database, matched pairs, a folder."""

    photo_folder: Path
    photographs: tuple[Photograph, ...]
    database: Path
    pairs: Pairs
    work_folder: Path
    config: SfmConfig
    report: Report

    @property
    def has_rig(self) -> bool:
        """Whether the photographs are faces of panoramas, whose rig and lenses are exact."""
        return has_faces(photo.name for photo in self.photographs)


@dataclass(frozen=True, kw_only=True, eq=False)
class Mapped:
    """The chosen model without its strays, the photographs not in it, those in it whose place most
    of their matches contradict, and the decisions for it."""

    model: pycolmap.Reconstruction
    unregistered: tuple[str, ...]
    doubted: tuple[str, ...]
    decisions: tuple[Decision, ...]


def map_photographs(job: MappingJob) -> Mapped | None:
    """The best model of the job's photographs; None when they do not overlap enough for any."""
    if job.config.mapper == "global":
        model, decisions = _believed(job, _global_model(job)), []
    else:
        model, decisions = _improve(job, incremental_model(job, "incremental"))
    if model is None:
        return None
    doubted = tuple(model.image(image_id).name for image_id in contradicted(model, job.database))
    return Mapped(model=model, unregistered=_missing_names(job, model), doubted=doubted, decisions=tuple(decisions))


def _believed(job: MappingJob, model: pycolmap.Reconstruction | None) -> pycolmap.Reconstruction | None:
    return without_strays(model, job.photographs, job.config.seed)


def _improve(job: MappingJob, first_model: pycolmap.Reconstruction | None) -> tuple[pycolmap.Reconstruction | None, list[Decision]]:
    """Go on with all pairs of what is unregistered, a stray or misplaced, then globally; the best
    model of all."""
    decisions: list[Decision] = []
    num_misplaced = 0 if first_model is None else _remove_misplaced(job, first_model)
    model = _believed(job, first_model)
    missing = _missing_names(job, model)
    extra = keep_related(job.database, pairs_with([photo.name for photo in job.photographs], missing, job.pairs), job.config, job.report)
    match_pairs(job.database, extra, job.config, job.report)
    if extra or num_misplaced:
        wider = _believed(job, incremental_model(job, "incremental-wider", model))
        without = f", without {num_misplaced} that had been misplaced" if num_misplaced else ""
        decisions.append(_retry_decision(job, model, wider, f"{len(extra)} more pairs{without}"))
        model = _better(model, wider)
    left_share = len(_missing_names(job, model)) / len(job.photographs)
    if job.config.mapper == "auto" and left_share > MAX_LEFT_SHARE:
        overall = _believed(job, _global_model(job))
        decisions.append(_retry_decision(job, model, overall, "the global mapper"))
        model = _better(model, overall)
    return model, decisions


def _remove_misplaced(job: MappingJob, model: pycolmap.Reconstruction) -> int:
    """Take out what its own matches contradict, and count it; what finds a place again among all
    others is believed. Where that is over a tenth the matches are not of one rigid scene, and say
    nothing."""
    misplaced = contradicted(model, job.database, SURE_AGREEMENT)
    if len(misplaced) > MAX_LEFT_SHARE * model.num_reg_images():
        return 0
    remove(model, misplaced)
    return len(misplaced)


def incremental_model(job: MappingJob, name: str, begun: pycolmap.Reconstruction | None = None) -> pycolmap.Reconstruction | None:
    """The largest model that COLMAP maps into a folder `name`, or what `begun` grows to."""
    total = len(job.photographs)
    registered: list[None] = [None] * _size(begun)[0]
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = job.config.threads
    options.random_seed = job.config.seed
    # Triangulating gives all points their colours; here each photograph would be decoded for it.
    options.extract_colors = False
    if job.config.effort != "thorough":
        _adjust_seldom(options)
    if job.has_rig:
        options.ba_refine_sensor_from_rig = options.ba_refine_focal_length = options.ba_refine_extra_params = False
        options.mapper.abs_pose_refine_focal_length = options.mapper.abs_pose_refine_extra_params = False
    folder = _empty_folder(job.work_folder / name)
    if begun is not None:
        begun.write_binary(_empty_folder(folder / "begun"))
    models = call_colmap(
        "mapping",
        pycolmap.incremental_mapping,
        job.database,
        job.photo_folder,
        folder,
        input_path=str(folder / "begun") if begun is not None else "",
        options=options,
        next_image_callback=lambda: registered.append(None),
        cancellation_token=pycolmap.CancellationToken(),
        on_tick=lambda: job.report(SfmProgress(phase="mapping", done=min(len(registered), total), total=total)),
    )
    job.report(SfmProgress(phase="mapping", done=total, total=total))
    return _best(models)


def _adjust_seldom(options: pycolmap.IncrementalPipelineOptions) -> None:
    options.ba_global_frames_ratio = options.ba_global_points_ratio = GROWTH
    options.ba_global_max_refinements = 2
    options.ba_local_max_refinements = 1
    options.ba_global_function_tolerance, options.ba_local_function_tolerance = LEAST_GAIN, LEAST_LOCAL_GAIN


def _global_model(job: MappingJob) -> pycolmap.Reconstruction | None:
    total = len(job.photographs)
    job.report(SfmProgress(phase="mapping", done=0, total=total))
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads = options.mapper.num_threads = job.config.threads
    options.random_seed = options.mapper.random_seed = job.config.seed
    options.mapper.global_positioning.use_gpu = False
    options.mapper.bundle_adjustment.ceres.use_gpu = False
    if job.has_rig:
        options.mapper.refine_sensor_from_rig = False
        adjusting = options.mapper.bundle_adjustment
        adjusting.refine_sensor_from_rig = adjusting.refine_focal_length = adjusting.refine_extra_params = False
    output = _empty_folder(job.work_folder / "global")
    models = call_colmap("mapping", pycolmap.global_mapping, job.database, job.photo_folder, output, options=options)
    job.report(SfmProgress(phase="mapping", done=total, total=total))
    return _best(models)


def _empty_folder(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def _size(model: pycolmap.Reconstruction | None) -> tuple[int, int]:
    return (0, 0) if model is None else (model.num_reg_images(), model.num_points3D())


def _best(models: dict[int, pycolmap.Reconstruction]) -> pycolmap.Reconstruction | None:
    return max(models.values(), key=_size, default=None)


def _better(old: pycolmap.Reconstruction | None, new: pycolmap.Reconstruction | None) -> pycolmap.Reconstruction | None:
    return new if _size(new) > _size(old) else old


def _missing_names(job: MappingJob, model: pycolmap.Reconstruction | None) -> tuple[str, ...]:
    registered = set() if model is None else {model.image(image_id).name for image_id in model.reg_image_ids()}
    return tuple(photo.name for photo in job.photographs if photo.name not in registered)


def _retry_decision(job: MappingJob, old: pycolmap.Reconstruction | None, new: pycolmap.Reconstruction | None, means: str) -> Decision:
    better = _size(new) > _size(old)
    return Decision(
        stage="sfm",
        topic="unregistered photographs",
        choice=f"{means}: {'taken' if better else 'no gain, dropped'}",
        figure=float(_size(new)[0]),
        unit="photographs registered",
        reason=f"{_size(old)[0]} of {len(job.photographs)} were registered before",
    )
