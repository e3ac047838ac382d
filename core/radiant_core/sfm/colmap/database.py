"""Features and matches in a COLMAP database, with progress. Once per scene.

This is the slowest part of all. What an interrupted attempt has left in a database is not done
again (`kept_database.py`).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

from radiant_core.io.photos.listing import Photograph
from radiant_core.io.photos.masks import mask_name
from radiant_core.panoramas import has_faces
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.colmap.lenses import group_by_lens, set_focal
from radiant_core.sfm.colmap.pairs import Pairs
from radiant_core.sfm.colmap.quick_database import Poses, extract_quickly, match_quickly
from radiant_core.sfm.config import Report, SfmConfig, SfmProgress

Item = TypeVar("Item")
PHOTOS_PER_CALL_AND_THREAD = 6


def extract_features(
    database: Path, photo_folder: Path, photographs: tuple[Photograph, ...], config: SfmConfig, report: Report, masks: Path | None = None
) -> None:
    """Write features into `database`, one camera per lens (`lenses.py`); none where a mask is
    0."""
    camera_ids = _cameras_by_name(database) if database.is_file() else {}
    num_done = len(camera_ids)

    def count(num_photographs: int) -> None:
        nonlocal num_done
        num_done += num_photographs
        report(SfmProgress(phase="features", done=num_done, total=len(photographs)))

    count(0)
    for lens in group_by_lens(photographs).lenses:
        camera_id = next((camera_ids[name] for name in lens.names if name in camera_ids), -1)
        names = [name for name in lens.names if name not in camera_ids]
        for chunk in _chunks(names, PHOTOS_PER_CALL_AND_THREAD * config.threads):
            for part, folder in _by_mask(chunk, masks):
                if config.effort == "thorough":
                    _extract((database, photo_folder, folder), part, camera_id, config)
                    count(len(part))
                else:
                    extract_quickly((database, photo_folder, folder), part, camera_id, config, lambda: count(1))
                camera_id = camera_id if camera_id >= 0 else _camera_of(database, part[0])
        if not has_faces(lens.names):
            set_focal(database, camera_id, lens)


def _cameras_by_name(database: Path) -> dict[str, int]:
    """Images that have their features, and their cameras."""
    with pycolmap.Database.open(database) as store:
        return {
            image.name: image.camera_id
            for image in store.read_all_images()
            if store.exists_keypoints(image.image_id) and store.exists_descriptors(image.image_id)
        }


def _by_mask(names: list[str], masks: Path | None) -> list[tuple[list[str], Path | None]]:
    """The photographs with a mask, and those without: COLMAP skips one whose mask is missing."""
    if masks is None:
        return [(names, None)]
    masked = [name for name in names if (masks / mask_name(name)).is_file()]
    parts = [(masked, masks), ([name for name in names if name not in masked], None)]
    return [(part, folder) for part, folder in parts if part]


def _extract(places: tuple[Path, Path, Path | None], names: list[str], camera_id: int, config: SfmConfig) -> None:
    """Features of `names`, which share the camera `camera_id`, or a new one where that is -1."""
    database, photo_folder, masks = places
    reading = pycolmap.ImageReaderOptions()
    if masks is not None:
        reading.mask_path = masks
    reading.existing_camera_id = camera_id
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = config.threads
    options.max_image_size = config.max_image_size_px
    options.sift.max_num_features = config.max_num_features
    call_colmap(
        "finding features",
        pycolmap.extract_features,
        database,
        photo_folder,
        image_names=names,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reading,
        extraction_options=options,
        device=pycolmap.Device.cpu,
        cancellation_token=pycolmap.CancellationToken(),
    )


def match_pairs(database: Path, pairs: Pairs, config: SfmConfig, report: Report, poses: Poses | None = None) -> None:
    """Match the features of these pairs of names and verify the matches geometrically, by the
    `poses` of the photographs where they are known."""
    unmatched = _unmatched_pairs(database, pairs)
    num_done = len(pairs) - len(unmatched)
    report(SfmProgress(phase="matching", done=num_done, total=len(pairs)))
    if not unmatched:
        return

    def tell(num: int) -> None:
        report(SfmProgress(phase="matching", done=num_done + num, total=len(pairs)))

    match_quickly(database, unmatched, config, tell, poses)


def _unmatched_pairs(database: Path, pairs: Pairs) -> Pairs:
    with pycolmap.Database.open(database) as store:
        ids = {image.name: image.image_id for image in store.read_all_images()}
        return [pair for pair in pairs if not store.exists_two_view_geometry(*(ids[name] for name in pair))]


def _camera_of(database: Path, name: str) -> int:
    with pycolmap.Database.open(database) as store:
        image = store.read_image_with_name(name)
    return -1 if image is None else image.camera_id


def _chunks(items: list[Item], size: int) -> Iterator[list[Item]]:
    for start in range(0, len(items), size):
        yield items[start : start + size]
