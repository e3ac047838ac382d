"""From matches to one sparse model: incremental mapping, then more pairs, then globally.

Once per scene. Of several models the one with most images, then most points, is kept. An image is a
stray when it sees almost no point, when few points and its GPS is far from where the model puts it,
or when no chain of images with common points leads to most others, so that nothing fixes where it
is: the global mapper claims every image and leaves such.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from radiant_core.decisions import Decision
from radiant_core.io.photos.listing import Photograph
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.colmap.database import match_pairs
from radiant_core.sfm.colmap.pairs import Pairs, gps_positions, pairs_with
from radiant_core.sfm.config import Report, SfmConfig, SfmProgress
from radiant_core.sfm.world_frame.align import robust_sim3

MIN_POINTS = 15
FEW_POINTS = 60
GPS_FACTOR = 5.0
GROWTH = 1.4
"""The model may grow by so much before all of it is adjusted again: 1.1 as COLMAP has it took 40 %
longer and gave the same poses (docs/experiments/sfm.md)."""
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Mapped:
    """The chosen model without its strays, the photographs not in it, and the decisions for it."""

    model: pycolmap.Reconstruction
    unregistered: tuple[str, ...]
    decisions: tuple[Decision, ...]


def map_photographs(job: MappingJob) -> Mapped | None:
    """The best model of the job's photographs; None when they do not overlap enough for any."""
    if job.config.mapper == "global":
        candidate, decisions = without_strays(job, _global_model(job)), []
    else:
        candidate = without_strays(job, _incremental_model(job, "incremental"))
        candidate, decisions = _improve(job, candidate)
    if candidate is None:
        return None
    return Mapped(model=candidate, unregistered=_missing_names(job, candidate), decisions=tuple(decisions))


def _improve(job: MappingJob, model: pycolmap.Reconstruction | None) -> tuple[pycolmap.Reconstruction | None, list[Decision]]:
    """Try what is unregistered again with all its pairs, then globally; the best model of all."""
    decisions: list[Decision] = []
    extra = pairs_with([photo.name for photo in job.photographs], _missing_names(job, model), job.pairs)
    if extra:
        match_pairs(job.database, extra, job.config, job.report)
        wider = without_strays(job, _incremental_model(job, "incremental-wider"))
        decisions.append(_retry_decision(job, model, wider, f"{len(extra)} more pairs"))
        model = _better(model, wider)
    left = len(_missing_names(job, model)) / len(job.photographs)
    if job.config.mapper == "auto" and left > MAX_LEFT_SHARE:
        overall = without_strays(job, _global_model(job))
        decisions.append(_retry_decision(job, model, overall, "the global mapper"))
        model = _better(model, overall)
    return model, decisions


def _incremental_model(job: MappingJob, name: str) -> pycolmap.Reconstruction | None:
    total = len(job.photographs)
    registered: list[None] = []
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = job.config.threads
    options.random_seed = job.config.seed
    if job.config.effort != "thorough":
        _adjust_seldom(options)
    models = call_colmap(
        "mapping",
        pycolmap.incremental_mapping,
        job.database,
        job.photo_folder,
        _empty_folder(job.work_folder / name),
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


def _global_model(job: MappingJob) -> pycolmap.Reconstruction | None:
    total = len(job.photographs)
    job.report(SfmProgress(phase="mapping", done=0, total=total))
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads = options.mapper.num_threads = job.config.threads
    options.random_seed = options.mapper.random_seed = job.config.seed
    options.mapper.global_positioning.use_gpu = False
    options.mapper.bundle_adjustment.ceres.use_gpu = False
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


def without_strays(job: MappingJob, model: pycolmap.Reconstruction | None) -> pycolmap.Reconstruction | None:
    """The model without its strays; None with fewer than two images or too few points left."""
    if model is None:
        return None
    # A removed image takes points along, on which others may have hung.
    while strays := _strays(job, model) or _unconnected_images(model):
        for image_id in strays:
            model.deregister_frame(model.image(image_id).frame_id)
    return model if model.num_reg_images() >= 2 and model.num_points3D() >= MIN_POINTS else None


def _strays(job: MappingJob, model: pycolmap.Reconstruction) -> list[int]:
    ids = sorted(model.reg_image_ids())
    num_points = np.array([model.image(image_id).num_points3D for image_id in ids])
    far = _far_from_gps(job, model, ids)
    stray = (num_points < MIN_POINTS) | (far & (num_points < FEW_POINTS))
    return [ids[index] for index in np.flatnonzero(stray)]


def _unconnected_images(model: pycolmap.Reconstruction) -> list[int]:
    """Images outside the largest set in which each hangs on another by 15 common points or more."""
    ids = sorted(model.reg_image_ids())
    row_of = {image_id: row for row, image_id in enumerate(ids)}
    seen_by = [(row, row_of[element.image_id]) for row, point in enumerate(model.points3D.values()) for element in point.track.elements]
    rows, columns = np.array(seen_by, np.int64).reshape(-1, 2).T
    seen = csr_array((np.ones(len(rows), np.int32), (rows, columns)), shape=(model.num_points3D(), len(ids)))
    _, part = connected_components((seen.T @ seen) >= MIN_POINTS, directed=False)
    largest = np.bincount(part).argmax() if ids else 0
    return [image_id for image_id, number in zip(ids, part, strict=True) if number != largest]


def _far_from_gps(job: MappingJob, model: pycolmap.Reconstruction, ids: list[int]) -> np.ndarray:
    """Which images (N,) lie farther from GPS than five times a robust fit's median residual."""
    positions_m, _ = gps_positions(job.photographs)
    row_of = {photo.name: row for row, photo in enumerate(job.photographs)}
    target = positions_m[[row_of[model.image(image_id).name] for image_id in ids]]
    centers = np.array([model.image(image_id).projection_center() for image_id in ids]).reshape(-1, 3)
    known = np.isfinite(target).all(axis=1)
    far = np.zeros(len(ids), bool)
    fit = robust_sim3(centers[known], target[known], job.config.seed)
    if fit.target_from_source is not None:
        far[known] = fit.residuals > GPS_FACTOR * np.median(fit.residuals)
    return far
