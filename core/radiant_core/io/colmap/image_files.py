"""Which file is the photograph that a model names otherwise. Once per reading.

Programs name images by whole paths, with another separator, letter case or ending than the files
have. A name that is no file is taken for the one file whose path ends like it, or that it ends
like, compared
    as they are written;   without regard to letter case, or how letters with marks are coded;
    without the ending either
in this order. Where that is none or more than one, or two names would share a file, nothing is
taken for it.
"""

from __future__ import annotations

import unicodedata
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_records
from radiant_core.io.colmap.records import ColmapModel, check_model, is_image_name
from radiant_core.io.photos.folders import photograph_names

Parts = tuple[str, ...]
MAX_ENDING = 5
"""Letters of a file's ending: .jpeg, .tiff."""


@dataclass(frozen=True, kw_only=True)
class ImageFiles:
    """The files of a model's images in a folder."""

    files: dict[str, str]
    """Name in the model → path in the folder, of every image that has a file."""
    folder: Path
    num_names: int

    @property
    def renamed(self) -> dict[str, str]:
        """Those that are named otherwise."""
        return {name: file for name, file in self.files.items() if name != file}

    def notes(self) -> tuple[str, ...]:
        """What is said of names that differ, with an example; nothing where none does."""
        count = self.count()
        first = next(iter(self.renamed.items()), None)
        return () if first is None else (f"{count[0].removesuffix('.')}, such as {first[0]!r} for {first[1]!r}.",)

    def count(self) -> tuple[str, ...]:
        """The same without a name."""
        if not self.renamed:
            return ()
        return (f"{len(self.renamed)} of {self.num_names} images have another name in the model than their file in {self.folder.name}.",)


def read_with_files(model_folder: Path, folder: Path, *, required: bool = True) -> tuple[ColmapModel, ImageFiles]:
    """The model, its images named by their files in `folder`, and those. Raises as `read_model`,
    and as `require_files` where every image is `required`."""
    cameras, images, points = read_records(model_folder)
    names = [image.name for image in images]
    matched = match_images(names, folder)
    if required:
        require_files(matched, names)
    images = [replace(image, name=matched.files.get(image.name, image.name)) for image in images]
    return check_model(cameras, images, points, str(model_folder)), matched


def match_images(names: Sequence[str], folder: Path) -> ImageFiles:
    """The files in `folder` of images of these names."""
    files = {name: name for name in names if _is_plain(name) and (folder / name).is_file()}
    lost = [name for name in names if name not in files]
    if lost and folder.is_dir():
        matched_paths = set(files.values())
        free = [path for path in photograph_names(folder) if path not in matched_paths and is_image_name(path)]
        files |= _match(lost, free)
    return ImageFiles(files={name: files[name] for name in names if name in files}, folder=folder, num_names=len(names))


def require_files(images: ImageFiles, names: Sequence[str]) -> None:
    """Raise BadInput, with an example of either side, where an image of the model has no file."""
    lost = [name for name in names if name not in images.files]
    if not lost:
        return
    used = set(images.files.values())
    there = photograph_names(images.folder)
    unused = next((path for path in there if path not in used), None)
    content = (
        f"which holds {len(there)} photographs" + ("" if unused is None else f", such as {unused!r}")
        if there
        else "which holds no photograph"
    )
    raise BadInput(
        f"image {lost[0]!r} of the model is not in {images.folder} ({len(lost)} of {len(names)} in all), {content}: give the folder of the "
        "model's images, or make the names alike."
    )


def photographs_without_pose(images: ImageFiles) -> tuple[str, ...]:
    """The paths of the photographs in the folder that the model has no image of."""
    used = set(images.files.values())
    return tuple(path for path in photograph_names(images.folder) if path not in used)


def unposed_count(unposed: Sequence[str], images: ImageFiles) -> tuple[str, ...]:
    """What is said of them; nothing where there are none."""
    if not unposed:
        return ()
    total = len(unposed) + len(images.files)
    return (f"{len(unposed)} of {total} photographs in {images.folder.name} have no pose in the model and are left out.",)


def _is_plain(name: str) -> bool:
    """Whether a name is written as paths in a folder are: "./a.jpg" is a file and not its path."""
    return is_image_name(name) and PurePosixPath(name).as_posix() == name


def _match(names: Collection[str], paths: Collection[str]) -> dict[str, str]:
    spellings: tuple[Callable[[Parts], Parts], ...] = (_as_written, _without_case, _without_ending)
    matched: dict[str, str] = {}
    for spell in spellings:
        matched_paths = set(matched.values())
        by_last: dict[str, list[tuple[Parts, str]]] = defaultdict(list)
        for path in paths:
            if path not in matched_paths:
                by_last[(parts := spell(PurePosixPath(path).parts))[-1]].append((parts, path))
        tried = {name: spell(parts) for name in names if name not in matched and (parts := _parts(name))}
        ends = {name: _alike(parts, by_last[parts[-1]]) for name, parts in tried.items()}
        num_claims = Counter(path for fits in ends.values() for path in fits)
        matched |= {name: fits[0] for name, fits in ends.items() if len(fits) == 1 and num_claims[fits[0]] == 1}
    return matched


def _alike(parts: Parts, candidates: Sequence[tuple[Parts, str]]) -> list[str]:
    """The candidates that are these parts, or else those of which one ends like the other."""
    equal = [path for ending, path in candidates if ending == parts]
    return equal or [path for ending, path in candidates if parts[-len(ending) :] == ending[-len(parts) :]]


def _parts(name: str) -> Parts:
    """The folders and the file of a name, whatever system wrote it."""
    return tuple(part for part in name.replace("\\", "/").split("/") if part not in ("", ".", ".."))


def _as_written(parts: Parts) -> Parts:
    return parts


def _without_case(parts: Parts) -> Parts:
    # macOS writes ü as u and a mark, others as one letter.
    return tuple(unicodedata.normalize("NFC", part).casefold() for part in parts)


def _without_ending(parts: Parts) -> Parts:
    folders, last = _without_case(parts[:-1]), PurePosixPath(parts[-1].casefold())
    ending = last.suffix[1:]
    # In "frame.0001" the number is no ending.
    return (*folders, last.stem if ending.isalnum() and not ending.isdigit() and len(ending) <= MAX_ENDING else last.name)
