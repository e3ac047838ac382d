"""The models and folders of pictures of a COLMAP project: which are used, and what is left. Once
per reading.

COLMAP's mapper writes sparse/0, sparse/1, … for the parts that it could not join, in no order of
size. The model with the most images is used, then with the most points; images/ holds its pictures,
or else the largest of images_2, images_4, …, which programs make smaller copies in. All else that
lies where programs put models and pictures is named.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from radiant_core.io.colmap.model import STEMS, formats_of

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
OTHER_MODELS = (".", "distorted", "dense", "undistorted", "colmap", "model")
"""Where else programs leave models: those of COLMAP's and of others' folders. Below one another at
most `MAX_DEPTH`."""
OTHER_PICTURES = ("images", "input")
MAX_DEPTH = 3
_SMALLEST = {"images": 73, "points3D": 51}
"""Bytes of the smallest record in binary."""


@dataclass(frozen=True, kw_only=True)
class ModelPlace:
    """A folder with files of a model; counts are 0 where a file is missing, cut or unreadable."""

    folder: Path
    num_images: int
    num_points: int


def find_models(project: Path) -> tuple[ModelPlace, ...]:
    """The models in sparse/ of a project, the one to use first."""
    places = [*(project / "sparse").glob("*"), project / "sparse"]
    deeper = [path for path in sorted((project / "sparse").glob("*/*")) if path.is_dir()]
    models = [_place(folder) for folder in (*sorted(places[:-1], key=_by_number), places[-1], *deeper) if _has_cameras(folder)]
    # Stable: of equals the first, sparse/0 before sparse itself.
    return tuple(sorted(models, key=lambda model: (-model.num_images, -model.num_points)))


def picture_folder(project: Path) -> Path | None:
    """images/ of a project, or else the largest of images_2, images_4, …; None without any."""
    if (project / "images").is_dir():
        return project / "images"
    reduced = [path for path in project.glob("images_*") if path.is_dir() and path.name[7:].isdigit()]
    return min(reduced, key=lambda path: int(path.name[7:]), default=None)


def notes_on_project(project: Path, *, for_poses: bool = False) -> tuple[str, ...]:
    """What a project holds that is not used, one sentence for each kind; names no photograph.
    `for_poses`: its model is used wherever the photographs are."""
    models, pictures = find_models(project), picture_folder(project)
    used = models[0].folder if models and (for_poses or pictures is not None) else None
    return (*_model_notes(project, models, used), *_format_notes(project, used), *_picture_notes(project, pictures, used))


def _model_notes(project: Path, models: tuple[ModelPlace, ...], used: Path | None) -> Iterator[str]:
    others = [*models[used is not None :], *_other_models(project)]
    if not others:
        return
    listed = ", ".join(f"{_name(model.folder, project)} ({_counted(model)})" for model in others)
    if used is not None:
        first = models[0]
        equal = any((model.num_images, model.num_points) == (first.num_images, first.num_points) for model in models[1:])
        why = "the first of those with the most" if equal else "which has the most"
        why = f", {why}" if len(models) > 1 else ""
        yield f"the model {_name(used, project)} is used ({_counted(first)}){why}; not used: {listed}."
    else:
        yield f"not used: the COLMAP model in {listed}: put its photographs into images/ and it into sparse/ to use its poses."


def _format_notes(project: Path, used: Path | None) -> Iterator[str]:
    if used is not None and len(suffixes := formats_of(used)) > 1:
        counts = [f"{_count(used / f'images{suffix}', 'images')} images in {suffix}" for suffix in suffixes]
        yield f"{_name(used, project)} holds a model twice ({', '.join(counts)}): the {suffixes[0]} files are used, the others are not."


def _picture_notes(project: Path, pictures: Path | None, used: Path | None) -> Iterator[str]:
    if used is None or pictures is None:
        return
    if pictures.name != "images":
        yield f"there is no folder images in {project.name}: the photographs are taken from {pictures.name}."
    others = [path for name in OTHER_PICTURES for path in sorted(project.glob(f"{name}*")) if path.is_dir() and path != pictures]
    counted = {path.name: sum(1 for _ in pictures_in(path)) for path in others}
    listed = ", ".join(f"{name} ({count} photographs)" for name, count in counted.items() if count)
    if listed:
        yield f"the photographs are those in {pictures.name}; not used: {listed}."


def pictures_in(folder: Path) -> Iterator[Path]:
    """The pictures in a folder and below it, by their suffix."""
    for root, inner, names in os.walk(folder):
        inner.sort()
        for name in sorted(names):
            if Path(name).suffix.lower() in PICTURE_SUFFIXES:
                yield Path(root) / name


def _other_models(project: Path) -> Iterator[ModelPlace]:
    aside = [path.name for path in sorted(project.glob("sparse?*")) if path.is_dir()]
    for name in (*OTHER_MODELS, *aside):
        for root, inner, names in os.walk(project / name):
            depth = len(Path(root).relative_to(project / name).parts)
            # A run keeps models of its own.
            inner[:] = [] if name == "." or depth >= MAX_DEPTH or "result.json" in names else sorted(inner)
            if _has_cameras(Path(root)):
                yield _place(Path(root))


def _has_cameras(folder: Path) -> bool:
    return any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt"))


def _by_number(folder: Path) -> tuple[int, str]:
    return (int(folder.name) if folder.name.isdecimal() else 1 << 30, folder.name)


def _name(folder: Path, project: Path) -> str:
    return folder.relative_to(project).as_posix()


def _counted(model: ModelPlace) -> str:
    return f"{model.num_images} images, {model.num_points} points" if model.num_images else "no images that can be read"


def _place(folder: Path) -> ModelPlace:
    suffix = next(iter(formats_of(folder)), None)
    if suffix is None:
        return ModelPlace(folder=folder, num_images=0, num_points=0)
    num_images, num_points = (_count(folder / f"{stem}{suffix}", stem) for stem in STEMS[1:])
    return ModelPlace(folder=folder, num_images=num_images, num_points=num_points)


def _count(path: Path, stem: str) -> int:
    """Records of a file by its head (binary) or its lines (text): nothing is parsed."""
    with path.open("rb") as file:
        if path.suffix == ".bin":
            head = file.read(8)
            (count,) = struct.unpack("<Q", head) if len(head) == 8 else (0,)
            return count if count * _SMALLEST[stem] <= path.stat().st_size else 0
        lines = iter(file)
        count = 0
        for line in lines:
            if line.strip() and not line.lstrip().startswith(b"#"):
                count += 1
                if stem == "images":
                    next(lines, None)
        return count
