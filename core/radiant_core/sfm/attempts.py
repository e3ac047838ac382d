"""Poses of the photographs, and once more where the short way loses some. Once per scene.

`SfmConfig.effort` auto leaves out what photographs that overlap well do not need. Where more than a
tenth of them finds no place by it, COLMAP's own features and all candidates are tried in thorough/,
with a database of its own, and what places more photographs is taken. Why photographs came to
no model is said in one sentence, asked in this order: are they one picture, do they show anything,
do they overlap, are they from more than one place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import Photograph, load_thumbnail
from radiant_core.panoramas import has_faces
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.database import extract_features, match_pairs
from radiant_core.sfm.colmap.epipolar import MIN_MATCHES
from radiant_core.sfm.colmap.kept_database import database_key, prepare_database
from radiant_core.sfm.colmap.lenses import group_by_lens
from radiant_core.sfm.colmap.mapping import GROWTH, MAX_LEFT_SHARE, Mapped, MappingJob, map_photographs
from radiant_core.sfm.colmap.pairs import choose_pairs
from radiant_core.sfm.colmap.previewed_pairs import keep_promising
from radiant_core.sfm.colmap.quick_database import LEAST_TRIALS, MOST_TRIALS
from radiant_core.sfm.colmap.rig import apply_rig
from radiant_core.sfm.colmap.workspace import THOROUGH_FOLDER
from radiant_core.sfm.config import Report, SfmConfig
from radiant_core.sfm.copies import SAME_PICTURE
from radiant_core.sfm.masks import take_masks


@dataclass(frozen=True, kw_only=True)
class PhotographSet:
    """Photographs of one folder, with a folder of masks if there is one."""

    folder: Path
    given_folder: Path
    """What the user named: `folder` may hold the same photographs in 8 bits."""
    photographs: tuple[Photograph, ...]
    masks: Path | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Attempt:
    """What one way of finding poses came to; None for photographs that do not overlap enough."""

    mapped: Mapped | None
    database: Path
    given_masks: Path | None
    config: SfmConfig
    decisions: tuple[Decision, ...]
    warnings: tuple[str, ...] = ()

    @property
    def num_registered(self) -> int:
        """Photographs with a pose."""
        return 0 if self.mapped is None else int(self.mapped.model.num_reg_images())


def find_poses(photos: PhotographSet, work_folder: Path, config: SfmConfig, report: Report) -> Attempt:
    """The attempt that places most photographs; its `mapped` is there. Raises BadInput where none
    places any."""
    attempt = _attempt(photos, work_folder, config, report)
    left_share = 1 - attempt.num_registered / len(photos.photographs)
    if config.effort == "thorough" or left_share <= MAX_LEFT_SHARE:
        return _require_mapped(attempt, photos)
    thorough = _attempt(photos, work_folder / THOROUGH_FOLDER, replace(config, effort="thorough"), report)
    best = thorough if thorough.num_registered > attempt.num_registered else attempt
    decision = Decision(
        stage="sfm",
        topic="effort",
        choice="done again thoroughly, and taken" if best is thorough else "done again thoroughly: no gain, dropped",
        figure=float(thorough.num_registered),
        unit="photographs registered",
        reason=f"{attempt.num_registered} of {len(photos.photographs)} were registered before",
    )
    # Masks are the same whichever database they went into.
    best = replace(best, given_masks=attempt.given_masks, decisions=(*best.decisions, decision))
    return _require_mapped(best, photos)


def _require_mapped(attempt: Attempt, photos: PhotographSet) -> Attempt:
    if attempt.mapped is None:
        raise no_model(photos.photographs, photos.given_folder, photos.folder, attempt.database)
    return attempt


def _attempt(photos: PhotographSet, work_folder: Path, config: SfmConfig, report: Report) -> Attempt:
    with prepare_database(work_folder, database_key(photos.photographs, config, photos.masks)) as database:
        original_masks = take_masks(photos.masks, photos.photographs, work_folder)
        candidates, matching = choose_pairs(photos.photographs, config)
        extract_features(database, photos.folder, photos.photographs, config, report, original_masks)
        if has_faces(photo.name for photo in photos.photographs):
            apply_rig(database, photos.folder)
        pairs, previewed = keep_promising(database, candidates, config, report)
        match_pairs(database, pairs, config, report)
        job = MappingJob(
            photo_folder=photos.folder,
            photographs=photos.photographs,
            database=database,
            pairs=pairs,
            work_folder=work_folder / "models",
            config=config,
            report=report,
        )
        mapped = map_photographs(job)
    lenses = group_by_lens(photos.photographs)
    # Faces of panoramas have a lens of their own each, all alike.
    by_lens = () if has_faces(photo.name for photo in photos.photographs) else (lenses.decision,)
    decisions = (matching, *by_lens, *_shortened(config), *previewed, *(mapped.decisions if mapped else ()))
    return Attempt(
        mapped=mapped, database=database, given_masks=original_masks, config=config, decisions=decisions, warnings=lenses.warnings
    )


def _shortened(config: SfmConfig) -> tuple[Decision, ...]:
    """What is left out before anything is known of the photographs."""
    if config.effort == "thorough":
        return ()
    adjusting = Decision(
        stage="sfm",
        topic="adjustment",
        choice=f"all photographs, each time the model has grown by a factor of {GROWTH:g}",
        figure=GROWTH,
        unit="times",
        reason="adjusting after every tenth photograph takes 40 % longer and gives the same poses",
    )
    features = Decision(
        stage="sfm",
        topic="features",
        choice=f"OpenCV's SIFT, at most {config.max_num_features:,} per photograph",
        figure=float(config.max_num_features),
        unit="features per photograph",
        reason="a third of the time of COLMAP's features, with the same poses",
    )
    verifying = Decision(
        stage="sfm",
        topic="verification",
        choice=f"{LEAST_TRIALS} to {MOST_TRIALS:,} samples per pair",
        figure=float(MOST_TRIALS),
        unit="samples per pair at most",
        reason="COLMAP's 100 to 10,000 take four times as long and verify 1 % more pairs",
    )
    return (features, verifying, adjusting)


COMPARED_PX = 64
MAX_COMPARED = 400
"""Each is compared with every picture that differs from those before: at most 80,000 times."""
FEW_FEATURES = 100
"""Photographs with fewer show sky, water or fog, or are out of focus."""


def no_model(photographs: Sequence[Photograph], folder: Path, read_from: Path, database: Path) -> BadInput:
    """The error for photographs that no model came of; `read_from` holds their pictures and
    `database` their features and matches."""
    number = len(photographs)
    pictures = _different_pictures([read_from / photo.name for photo in photographs[:MAX_COMPARED]])
    if number <= MAX_COMPARED and pictures < min(3, number):
        return BadInput(
            f"the {number} photographs in {folder} are the same picture saved again ({pictures} different of {number}): "
            "give photographs of one place from several places."
        )
    features, verified = _counts(database)
    poor = sum(count < FEW_FEATURES for count in features)
    if features and poor > number / 2:
        return BadInput(
            f"{poor} of the {number} photographs in {folder} show too little: fewer than {FEW_FEATURES} points stand out in each, "
            "as in sky, water, fog or a picture of little contrast. Give others."
        )
    if verified >= number - 1 and number > 2:
        return BadInput(
            f"the {number} photographs in {folder} overlap ({verified} pairs do), but no two of them fix a place: they are taken from one "
            "place, or their tags say wrong focal lengths. Take photographs from several places, with one lens."
        )
    return BadInput(
        f"the {number} photographs in {folder} do not overlap enough for structure "
        "from motion: take photographs of one place in which neighbours share more than half of their view."
    )


def _different_pictures(paths: Sequence[Path]) -> int:
    different: list[NDArray[np.float32]] = []
    for path in paths:
        picture = _small(load_thumbnail(path, COMPARED_PX))
        if all(np.abs(picture - earlier).mean() >= SAME_PICTURE for earlier in different):
            different.append(picture)
    return len(different)


def _small(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    return np.asarray(cv2.resize(picture, (COMPARED_PX, COMPARED_PX), interpolation=cv2.INTER_AREA), np.float32)


def _counts(database: Path) -> tuple[list[int], int]:
    """Features of each photograph, and the number of pairs whose matches fit one geometry."""
    if not database.is_file():
        return [], 0
    with pycolmap.Database.open(database) as store:
        features = [
            len(store.read_keypoints(image.image_id)) if store.exists_keypoints(image.image_id) else 0 for image in store.read_all_images()
        ]
        verified = sum(len(geometry.inlier_matches) >= MIN_MATCHES for geometry in store.read_two_view_geometries()[1])
    return features, verified
