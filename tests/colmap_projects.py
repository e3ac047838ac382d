"""COLMAP projects of the hamlet for tests: its known model, changed, beside photographs without
GPS."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.records import ColmapImage, ColmapModel
from radiant_core.io.colmap.text import write_model
from radiant_core.numerics import FloatArray

HAMLET = Path(__file__).parents[1] / "sample_scenes" / "hamlet"
UTM = np.array([465_300.0, 5_246_350.0, 430.0])


def hamlet_model() -> ColmapModel:
    return read_model(HAMLET / "known")


def write_photographs(folder: Path, names: Iterable[str] | None = None, named: Callable[[str], str] = str) -> Path:
    """The hamlet's photographs without EXIF, under the names that `named` makes of theirs."""
    for name in names or [image.name for image in hamlet_model().images]:
        pixels = cv2.imread(str(HAMLET / "images" / name))
        assert pixels is not None
        (folder / named(name)).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / named(name)), pixels, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return folder


def write_project(folder: Path, model: ColmapModel, named: Callable[[str], str] = str) -> Path:
    """images/ and sparse/0 of a project."""
    write_photographs(folder / "images", named=named)
    write_model(folder / "sparse" / "0", model)
    return folder


def moved(model: ColmapModel, offset: FloatArray) -> ColmapModel:
    """The model with `offset` (3,) added to all that is in it."""
    images = tuple(replace(image, translation=image.translation - image.cam_from_world[:3, :3] @ offset) for image in model.images)
    return replace(model, images=images, points=replace(model.points, xyz=model.points.xyz + offset))


def unseen(model: ColmapModel) -> ColmapModel:
    """The model without its tracks."""
    images = tuple(replace(image, points2d=np.zeros((0, 2)), point3d_ids=np.zeros(0, np.int64)) for image in model.images)
    return replace(model, images=images, points=replace(model.points, tracks=np.zeros((0, 3), np.int64)))


def pointless(model: ColmapModel) -> ColmapModel:
    """The model without its points."""
    points = unseen(model).points
    none = {name: getattr(points, name)[:0] for name in ("ids", "xyz", "colors", "errors_px")}
    return replace(unseen(model), points=replace(points, **none))


def renamed(model: ColmapModel, name_of: Callable[[str], str]) -> ColmapModel:
    return replace(model, images=tuple(replace(image, name=name_of(image.name)) for image in model.images))


def center_of(image: ColmapImage) -> FloatArray:
    return -image.cam_from_world[:3, :3].T @ image.translation


def quiet(progress: object) -> None:
    """A report that says nothing."""
