"""Images whose place in a model is not to be believed. Once per model.

A stray is an image that sees almost no point, or few points and its GPS is far from where the model
puts it, or one that no chain of images with common points leads to from most others, so that
nothing fixes where it is (the global mapper claims every image and leaves such).

An image may also be contradicted by its own matches, which miss the epipolar lines of its pose
(`epipolar.py`). A few wrong matches suffice to place an image anywhere, and hundreds of points then
follow from it: an image of lewis lay 58 % of the extent off with 416 points. But 60 % of its
verified matches missed their epipolar lines; of the right images 4 % at most did, one of 34 points
30 % (docs/experiments/sfm.md). Images of one rig stand and fall as one frame.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from radiant_core.geometry.align import robust_sim3
from radiant_core.io.photos.listing import Photograph
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.epipolar import MAX_EPIPOLAR_PX, MIN_MATCHES, camera_rays, epipolar_errors
from radiant_core.sfm.colmap.pairs import gps_positions

IntArray = NDArray[np.int64]
MIN_POINTS = 15
FEW_POINTS = 60
GPS_FACTOR = 5.0
LEAST_AGREEMENT, SURE_AGREEMENT = 0.5, 0.6
"""Below the one a place is contradicted, below the other it is found anew: a photograph at the end
of a street lay 67 % of the extent off with 53 %, the right ones beside it had 65 % or more."""


def remove(model: pycolmap.Reconstruction, image_ids: list[int]) -> None:
    """Take the frames of images out of the model; points that hang on them alone go with them."""
    for frame_id in dict.fromkeys(model.image(image_id).frame_id for image_id in image_ids):
        model.deregister_frame(frame_id)


def without_strays(model: pycolmap.Reconstruction | None, photographs: tuple[Photograph, ...], seed: int) -> pycolmap.Reconstruction | None:
    """The model without its strays; None with fewer than two images or too few points left."""
    if model is None:
        return None
    # A removed image takes points along, on which others may have hung.
    while strays := _badly_seen(model, photographs, seed) or _unconnected(model):
        remove(model, strays)
    return model if model.num_reg_images() >= 2 and model.num_points3D() >= MIN_POINTS else None


def _badly_seen(model: pycolmap.Reconstruction, photographs: tuple[Photograph, ...], seed: int) -> list[int]:
    ids = sorted(model.reg_image_ids())
    frame_rows = _frame_rows(model, ids)
    num_points = np.bincount(frame_rows, [model.image(image_id).num_points3D for image_id in ids])[frame_rows]
    far = _far_from_gps(model, ids, photographs, seed)
    stray = (num_points < MIN_POINTS) | (far & (num_points < FEW_POINTS))
    return [ids[index] for index in np.flatnonzero(stray)]


def _frame_rows(model: pycolmap.Reconstruction, ids: list[int]) -> IntArray:
    """The frame (N,) of each image, counted from 0 in the order of the images."""
    rows: dict[int, int] = {}
    return np.array([rows.setdefault(model.image(image_id).frame_id, len(rows)) for image_id in ids], np.int64)


def _far_from_gps(model: pycolmap.Reconstruction, ids: list[int], photographs: tuple[Photograph, ...], seed: int) -> np.ndarray:
    """Which images (N,) lie farther from GPS than five times a robust fit's median residual."""
    positions_m, _ = gps_positions(photographs)
    row_of = {photo.name: row for row, photo in enumerate(photographs)}
    target = positions_m[[row_of[model.image(image_id).name] for image_id in ids]]
    centers = np.array([model.image(image_id).projection_center() for image_id in ids]).reshape(-1, 3)
    has_gps = np.isfinite(target).all(axis=1)
    far = np.zeros(len(ids), bool)
    fit = robust_sim3(centers[has_gps], target[has_gps], seed)
    if fit.target_from_source is not None:
        far[has_gps] = fit.residuals > GPS_FACTOR * np.median(fit.residuals)
    return far


def _unconnected(model: pycolmap.Reconstruction) -> list[int]:
    """Images outside the largest set in which each frame hangs on another by 15 common points or
    more."""
    ids = sorted(model.reg_image_ids())
    frame_rows = _frame_rows(model, ids)
    row_of = dict(zip(ids, frame_rows.tolist(), strict=True))
    seen_by = [(row, row_of[element.image_id]) for row, point in enumerate(model.points3D.values()) for element in point.track.elements]
    rows, columns = np.array(seen_by, np.int64).reshape(-1, 2).T
    num_frames = int(frame_rows.max(initial=-1)) + 1
    visibility = csr_array((np.ones(len(rows), np.int32), (rows, columns)), shape=(model.num_points3D(), num_frames))
    _, part = connected_components((visibility.T @ visibility) >= MIN_POINTS, directed=False)
    part = part[frame_rows]
    largest = np.bincount(part).argmax() if ids else 0
    return [image_id for image_id, number in zip(ids, part, strict=True) if number != largest]


def contradicted(model: pycolmap.Reconstruction, database: Path, least: float = LEAST_AGREEMENT) -> list[int]:
    """Images of whose frame's verified matches a smaller share than `least` agrees with the model,
    the worst first; each frame is judged without those before it."""
    pairs, num_matches, num_agreeing = agreeing_matches(model, database)
    members: dict[int, list[int]] = {}
    for image_id in sorted(model.reg_image_ids()):
        members.setdefault(model.image(image_id).frame_id, []).append(image_id)
    first = {image_id: images[0] for images in members.values() for image_id in images}
    pairs = np.array([[first[int(image_id)] for image_id in pair] for pair in pairs], np.int64).reshape(-1, 2)
    contradicting: list[int] = []
    while len(pairs):
        ids, ends = np.unique(pairs, return_inverse=True)
        ends = ends.reshape(pairs.shape)
        all_of, agreeing_of = (np.bincount(ends.ravel(), np.repeat(number, 2)) for number in (num_matches, num_agreeing))
        shares = agreeing_of / all_of
        if shares.min() >= least:
            break
        worst = int(ids[shares.argmin()])
        contradicting += members[model.image(worst).frame_id]
        others = (pairs != worst).all(axis=1)
        pairs, num_matches, num_agreeing = pairs[others], num_matches[others], num_agreeing[others]
    return contradicting


def agreeing_matches(model: pycolmap.Reconstruction, database: Path) -> tuple[IntArray, IntArray, IntArray]:
    """Pairs (E,2) of numbers of images of the model, their verified matches (E,), and how many of
    those lie within 4 px of the epipolar lines of the model's poses (E,)."""
    placed = {model.image(image_id).name: model.image(image_id) for image_id in model.reg_image_ids()}
    rows: list[tuple[int, int, int, int]] = []
    with pycolmap.Database.open(database) as store:
        images = {image.image_id: placed[image.name] for image in store.read_all_images() if image.name in placed}
        rays = {
            number: camera_rays(model.camera(image.camera_id), np.asarray(store.read_keypoints(number), np.float64))
            for number, image in images.items()
        }
        numbers, geometries = store.read_two_view_geometries()
        for number, geometry in zip(numbers, geometries, strict=True):
            first, second = pycolmap.pair_id_to_image_pair(number)
            matches = np.asarray(geometry.inlier_matches, np.int64)
            if first not in images or second not in images or len(matches) < MIN_MATCHES:
                continue
            sides = images[first], images[second]
            poses = [np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]]) for image in sides]
            focal = np.sqrt(np.prod([model.camera(image.camera_id).mean_focal_length() for image in sides]))
            relative = poses[1] @ np.linalg.inv(poses[0])
            errors = epipolar_errors(relative, rays[first][matches[:, 0]], rays[second][matches[:, 1]]) * focal
            # Where an error is not a number, nothing is contradicted.
            rows.append((sides[0].image_id, sides[1].image_id, len(matches), int((~(errors > MAX_EPIPOLAR_PX)).sum())))
    table = np.array(rows, np.int64).reshape(-1, 4)
    return table[:, :2], table[:, 2], table[:, 3]
