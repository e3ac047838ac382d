"""Features and matches of `quick/` in a COLMAP database, verified by COLMAP. Once per scene.

Each photograph and each pair is a task of a pool of threads; this thread alone uses the database.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.photos.masks import mask_name
from radiant_core.numerics import FloatArray
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.colmap.epipolar import camera_rays, verify_by_poses
from radiant_core.sfm.colmap.pairs import Pairs
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.quick.descriptors import Descriptors, Matches, match_descriptors
from radiant_core.sfm.quick.features import Features, find_features
from radiant_core.sfm.quick.partners import NUM_PREVIEWED
from radiant_core.threads import in_order, single_opencv_thread

NUM_KEPT = 512
"""Photographs whose features stay in memory while pairs are matched, 0.6 MB each."""
TASKS_PER_THREAD = 8
"""So many are handed out at a time: what they read is read before."""
LEAST_TRIALS, MOST_TRIALS = 30, 1_000
"""Samples drawn to verify a pair. COLMAP's 100 to 10,000 found 3 more of 325 pairs of lewis, of 16
matches at most, in five times the time, two thirds of it on pairs with nothing in common."""
OnDone = Callable[[int], None]
Poses = Mapping[str, FloatArray]
"""Names → cam_from_world (4,4)."""


def extract_quickly(
    places: tuple[Path, Path, Path | None], names: list[str], camera_id: int, config: SfmConfig, on_done: Callable[[], None]
) -> None:
    """Write features of the photographs `names` into a database; `places`: that, the folder of
    photographs, a folder of masks. They share the camera `camera_id`, or a new one where it is −1.
    `on_done` is called after each."""
    database, photo_folder, masks = places
    ids = _import(database, photo_folder, names, camera_id)

    def find(name: str) -> Features:
        mask = None if masks is None else cv2.imread(str(masks / mask_name(name)), cv2.IMREAD_GRAYSCALE)
        return find_features(photo_folder / name, config.max_image_size_px, config.max_num_features, _checked(mask))

    with single_opencv_thread(), pycolmap.Database.open(database) as store:
        for name, features in zip(names, in_order(find, names, config.threads), strict=True):
            descriptors = pycolmap.FeatureDescriptors(type=pycolmap.FeatureExtractorType.SIFT, data=features.descriptors)
            store.write_keypoints(ids[name], features.keypoints)
            store.write_descriptors(ids[name], descriptors)
            on_done()


def _checked(mask: Any) -> NDArray[np.uint8] | None:
    return None if mask is None else np.asarray(mask, np.uint8)


def _import(database: Path, photo_folder: Path, names: list[str], camera_id: int) -> dict[str, int]:
    """Names → numbers of images, which are written into the database where they are not in it."""
    with pycolmap.Database.open(database) as store:
        images_by_name = {image.name: image for image in store.read_all_images()}
    missing = [name for name in names if name not in images_by_name]
    if missing:
        if camera_id < 0:
            camera_id = next((images_by_name[name].camera_id for name in names if name in images_by_name), -1)
        reading = pycolmap.ImageReaderOptions()
        reading.existing_camera_id = camera_id
        call_colmap(
            "reading photographs",
            pycolmap.import_images,
            database,
            photo_folder,
            camera_mode=pycolmap.CameraMode.SINGLE,
            image_names=missing,
            options=reading,
        )
    with pycolmap.Database.open(database) as store:
        ids = {image.name: image.image_id for image in store.read_all_images()}
    lost = [name for name in names if name not in ids]
    if lost:
        raise BadInput(f"COLMAP cannot read the photograph {lost[0]!r} ({len(lost)} in all): save it again as JPEG, or remove it.")
    return ids


class _Reader:
    """Points and descriptors of a database's photographs by name; the last ones stay in memory."""

    def __init__(self, store: pycolmap.Database, least_kept: int = 0) -> None:
        cache_size = max(NUM_KEPT, least_kept)
        self.ids = {image.name: image.image_id for image in store.read_all_images()}
        self.cameras = {image.name: store.read_camera(image.camera_id) for image in store.read_all_images()}
        self.descriptors = lru_cache(cache_size)(lambda name: _descriptors(store, self.ids[name]))
        self.points = lru_cache(cache_size)(lambda name: _points(store, self.ids[name]))


def _descriptors(store: pycolmap.Database, image_id: int) -> Descriptors:
    return np.asarray(store.read_descriptors(image_id).data, np.uint8).reshape(-1, 128)


def _points(store: pycolmap.Database, image_id: int) -> FloatArray:
    points = np.asarray(store.read_keypoints(image_id), np.float64)
    # COLMAP's own have a matrix in place of scale and angle.
    return np.ascontiguousarray(points[:, :2]) if len(points) else np.zeros((0, 2))


def preview_pairs(database: Path, pairs: Pairs, config: SfmConfig, on_done: OnDone) -> NDArray[np.int64]:
    """Matches (E,) between the largest features of each of E pairs of names."""
    scores: list[int] = []
    with pycolmap.Database.open(database) as store:
        reader = _Reader(store)
        previews = {name: reader.descriptors(name)[:NUM_PREVIEWED].copy() for name in {name for pair in pairs for name in pair}}
        for block in _blocks(pairs, 64 * config.threads):
            scores += in_order(lambda pair: len(match_descriptors(previews[pair[0]], previews[pair[1]])), block, config.threads)
            on_done(len(scores))
    return np.array(scores, np.int64)


def match_quickly(database: Path, pairs: Pairs, config: SfmConfig, on_done: OnDone, poses: Poses | None = None) -> None:
    """Match these pairs of names in full and verify them, by their `poses` where these are known;
    `on_done` gets how many are done."""
    options = _verification(config)
    num_done = 0
    with pycolmap.Database.open(database) as store:
        block_size = TASKS_PER_THREAD * config.threads
        reader = _Reader(store, 2 * block_size)

        def verify(pair: tuple[str, str]) -> tuple[Matches, Any]:
            first, second = pair
            matches = match_descriptors(reader.descriptors(first), reader.descriptors(second))
            geometry = None if poses is None else _by_poses(reader, pair, poses, matches)
            if geometry is None:
                sides = [(reader.cameras[name], reader.points(name)) for name in pair]
                geometry = pycolmap.estimate_two_view_geometry(*sides[0], *sides[1], matches, options)
            return matches, geometry

        for block in _blocks(pairs, block_size):
            for name in {name for pair in block for name in pair}:
                reader.descriptors(name)
                reader.points(name)
            for pair, (matches, geometry) in zip(block, in_order(verify, block, config.threads), strict=True):
                first, second = (reader.ids[name] for name in pair)
                store.write_matches(first, second, matches)
                store.write_two_view_geometry(first, second, geometry)
            num_done += len(block)
            on_done(num_done)


def _by_poses(reader: _Reader, pair: tuple[str, str], poses: Poses, matches: Matches) -> Any:
    first, second = pair
    focal_px = float(np.sqrt(np.prod([reader.cameras[name].mean_focal_length() for name in pair])))
    rays = [camera_rays(reader.cameras[name], reader.points(name)[matches[:, side]]) for side, name in enumerate(pair)]
    return verify_by_poses(poses[second] @ np.linalg.inv(poses[first]), (rays[0], rays[1]), matches, focal_px)


def _verification(config: SfmConfig) -> pycolmap.TwoViewGeometryOptions:
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = config.seed
    options.ransac.num_threads = 1
    if config.effort != "thorough":
        options.ransac.min_num_trials, options.ransac.max_num_trials = LEAST_TRIALS, MOST_TRIALS
    return options


def _blocks(pairs: Pairs, size: int) -> Iterator[Pairs]:
    for start in range(0, len(pairs), size):
        yield pairs[start : start + size]
