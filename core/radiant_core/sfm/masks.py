"""Masks in structure from motion: checked, kept from features, undistorted. Once per scene.

work/masks.given/a/b.jpg.png      of the photographs as they were taken; gone at the end
work/masks/a/b.jpg.png            of the scene's photographs, the result
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.decisions import Decision
from radiant_core.io.photos.listing import Photograph
from radiant_core.io.photos.masks import alpha_mask, find_masks, load_mask, mask_name, pixel_weights, save_mask, used_pixels
from radiant_core.scene import SfmScene
from radiant_core.sfm.colmap.calls import call_colmap, pycolmap
from radiant_core.sfm.colmap.plain_fisheyes import bend_plain_fisheyes

ORIGINAL, UNDISTORTING, FINAL = "masks.given", "masks.part", "masks"


def take_masks(folder: Path | None, photographs: Sequence[Photograph], work_folder: Path) -> Path | None:
    """Copy the masks of `photographs`, or else their alpha channels, checked, to where COLMAP looks
    for them; None without any. Raises BadInput as `load_mask`."""
    original = work_folder / ORIGINAL
    shutil.rmtree(original, ignore_errors=True)
    paths = {} if folder is None else find_masks(folder, [photo.name for photo in photographs])
    for photo in photographs:
        path = paths.get(photo.name)
        used = alpha_mask(photo.path) if path is None else load_mask(path, photo.size_wh)
        if used is not None:
            save_mask(original / mask_name(photo.name), used)
    return original if original.is_dir() else None


def keep_masks(original: Path | None, work_folder: Path) -> Path | None:
    """The taken masks as the scene's, whose photographs stay as they were taken."""
    if original is None:
        return None
    shutil.rmtree(work_folder / FINAL, ignore_errors=True)
    return original.rename(work_folder / FINAL)


def undistort_masks(original: Path | None, model_folder: Path, work_folder: Path, num_threads: int) -> Path | None:
    """The masks without lens distortion; a pixel that half or more of is used stays used."""
    if original is None:
        return None
    part, renamed = work_folder / UNDISTORTING, work_folder / UNDISTORTING / "model"
    shutil.rmtree(part, ignore_errors=True)
    renamed.mkdir(parents=True)
    model = pycolmap.Reconstruction(model_folder)
    bend_plain_fisheyes(model)
    names = [image.name for image in model.images.values()]
    for image in model.images.values():
        image.name = mask_name(image.name)
    model.write_binary(renamed)
    masked = [mask_name(name) for name in names if (original / mask_name(name)).is_file()]
    if masked:
        call_colmap("undistorting masks", pycolmap.undistort_images, part, renamed, original, image_names=masked, num_threads=num_threads)
    shutil.rmtree(work_folder / FINAL, ignore_errors=True)
    for name in masked:
        image = cv2.imread(str(part / "images" / name), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        save_mask(work_folder / FINAL / name, used_pixels(np.asarray(image, np.uint8)))
    for folder in (part, original):
        shutil.rmtree(folder)
    return work_folder / FINAL


def without_masked_points(scene: SfmScene, masks: Path | None) -> SfmScene:
    """The scene without observations in ignored pixels and without points that have no other."""
    weights = pixel_weights(masks, scene.cameras)
    if weights is None:
        return scene
    rows, pixels = scene.observed_pixels(scene.cameras)
    views = scene.observations[rows, 1]
    ignored = np.zeros(len(scene.observations), bool)
    for view in np.unique(views):
        in_view = views == view
        columns, lines = pixels[in_view].T
        ignored[rows[in_view]] = ~used_pixels(weights[view])[lines, columns]
    observed = SfmScene(
        cameras=scene.cameras, points=scene.points, colors=scene.colors, observations=scene.observations[~ignored], frame=scene.frame
    )
    return observed.restricted_to(np.arange(len(scene.cameras)))


def masks_decision(scene: SfmScene, masks: Path | None) -> tuple[Decision, ...]:
    """What the masks leave out, in the photographs of the scene; nothing without masks."""
    weights = pixel_weights(masks, scene.cameras)
    if masks is None or weights is None:
        return ()
    masked = sum((masks / mask_name(name)).is_file() for name in scene.cameras.names)
    return (
        Decision(
            stage="sfm",
            topic="masks",
            choice=f"{masked} of {len(scene.cameras)} photographs are used in part",
            figure=100 * (1 - _used_share(weights)),
            unit="% of all pixels ignored",
            reason="masks or alpha channels exclude the rest",
            forced=True,
        ),
    )


def _used_share(weights: Sequence[NDArray[np.uint8]]) -> float:
    return float(np.average([used_pixels(mask).mean() for mask in weights], weights=[mask.size for mask in weights]))
