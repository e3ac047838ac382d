"""Which photographs lie in a folder and in the folders below it; what else lies there, unread.

A photograph's name is its path below the folder, with '/'. Cameras start a folder when the last is
full, and a flight is a folder, so all of them are read; not those that hold what programs made of
photographs. Once per folder.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")
READ_KINDS = "JPEG, PNG or TIFF"
PHOTOGRAPHS_UNREAD = (
    *(".heic", ".heif", ".hif", ".avif", ".webp", ".jp2", ".jxl", ".bmp", ".gif", ".insp", ".dng", ".cr2", ".cr3", ".nef", ".nrw"),
    *(".arw", ".orf", ".rw2", ".raf", ".pef", ".srw", ".raw", ".3fr", ".iiq", ".gpr", ".jpe", ".jfif", ".exr", ".rjpeg", ".ppm"),
)
FILMS_UNREAD = (".mp4", ".mov", ".avi", ".mts", ".m2ts", ".m4v", ".mkv", ".webm", ".insv", ".360", ".lrv", ".lrf")
UNREAD_SUFFIXES = frozenset((*PHOTOGRAPHS_UNREAD, *FILMS_UNREAD))
"""Photographs and films that nothing here can read, or that COLMAP cannot."""
MASK_FOLDERS = ("masks", "mask")
_PRODUCT_FOLDER = re.compile(
    r"(masks?|sparse|dense|stereo|undistorted|depths?|depth_maps|normals?|thumb(nail)?s?|previews?|opensfm|openmvs|odm_\w+|entwine_pointcloud"
    r"|__macosx|.*\.files)",
    re.IGNORECASE,
)
"""Folders of masks and of what COLMAP, ODM, Metashape and others make of photographs."""
_RUN_FILES = ("manifest.json", "scene.safetensors")
"""Where one lies, a run of ours has written what is below."""
_CAMERA_FOLDER = re.compile(r"DCIM|\d{3}[0-9A-Z_]{5}|DJI_\d{8,14}_\d{3}.*", re.IGNORECASE)
MAX_NAMED = 5
MAX_DEPTH = 16


@dataclass(frozen=True, kw_only=True)
class FolderContent:
    """What a folder of photographs holds, in the order of names."""

    names: tuple[str, ...] = ()
    """Of its photographs, below it."""
    unread: Mapping[str, int] = field(default_factory=dict)
    """Suffix → number of files that hold photographs or films and cannot be read."""
    closed: Mapping[str, int] = field(default_factory=dict)
    """Folder below → number of pictures in it that are taken for no photographs."""

    @property
    def folders(self) -> dict[str, int]:
        """Folder → number of its photographs; '.' is the folder itself."""
        return dict(Counter(name.rpartition("/")[0] or "." for name in self.names))


def read_folder(folder: Path) -> FolderContent:
    """The photographs in `folder` and below it, links to folders followed once."""
    names: list[str] = []
    unread: Counter[str] = Counter()
    closed: dict[str, int] = {}
    for inner, files in _walk(folder, "", {os.path.realpath(folder)}, closed):
        for path in (folder / inner / file for file in files):
            suffix = path.suffix.lower()
            if suffix in SUFFIXES and path.is_file():
                names.append(f"{inner}/{path.name}" if inner else path.name)
            elif suffix in UNREAD_SUFFIXES and path.is_file():
                unread[suffix] += 1
    return FolderContent(names=tuple(sorted(names)), unread=dict(unread), closed=closed)


def photograph_names(folder: Path) -> tuple[str, ...]:
    """The sorted names of the photographs in `folder` and below it."""
    return read_folder(folder).names


def is_camera_folder(name: str) -> bool:
    """Whether cameras name folders so: 100MEDIA, DCIM, DJI_202511281530_001."""
    return _CAMERA_FOLDER.fullmatch(name) is not None


def _walk(folder: Path, inner: str, visited: set[str], closed: dict[str, int]) -> Iterator[tuple[str, list[str]]]:
    """Folder below and its files, one after another; counts pictures of those that are not read."""
    try:
        entries = sorted(os.scandir(folder / inner), key=lambda entry: entry.name)
    except OSError:
        return
    # Copies of macOS for other systems have a second file, "._name", with what those cannot store.
    files = [entry.name for entry in entries if not entry.name.startswith("._")]
    yield inner, files
    for entry in entries:
        below = f"{inner}/{entry.name}" if inner else entry.name
        if not entry.is_dir() or entry.name.startswith(".") or below.count("/") >= MAX_DEPTH:
            continue
        if _is_made(entry.name, Path(entry.path)):
            # Masks at the top are told of where it is known whether they are used.
            if (inner or entry.name.lower() not in MASK_FOLDERS) and (number := _num_pictures(Path(entry.path))):
                closed[below] = number
            continue
        place = os.path.realpath(entry.path)
        if place not in visited:
            visited.add(place)
            yield from _walk(folder, below, visited, closed)


def _is_made(name: str, path: Path) -> bool:
    return _PRODUCT_FOLDER.fullmatch(name) is not None or any((path / file).is_file() for file in _RUN_FILES)


def _num_pictures(folder: Path) -> int:
    return sum(file.lower().endswith(SUFFIXES) for _, _, files in os.walk(folder) for file in files)


def folders_warning(content: FolderContent, *, named: bool = True) -> tuple[str, ...]:
    """What is said of photographs that lie in several folders, or in folders taken for no
    photographs."""
    sentences = []
    if set(content.folders) - {"."}:
        counts = [f"{'the folder itself' if name == '.' else name} {count}" for name, count in sorted(content.folders.items())]
        where = f": {in_short(counts)}" if named else ""
        several = f"{len(counts)} folders" if len(counts) > 1 else "a folder below"
        sentences.append(f"{len(content.names)} photographs are read from {several}{where}.")
    if content.closed:
        counts = [f"{name}/ {count}" for name, count in sorted(content.closed.items())]
        pictures = sum(content.closed.values())
        where = f" ({in_short(counts)})" if named else ""
        sentences.append(f"{pictures} pictures in folders of masks, depths and what programs make of photographs are not read{where}.")
    return tuple(sentences)


def unread_warning(unread: Mapping[str, int]) -> tuple[str, ...]:
    """The warning about files that cannot be read, by their kinds; none where there are none."""
    if not unread:
        return ()
    return (f"{list_kinds(unread)} files are not read: {SAVED}.",)


SAVED = f"save photographs as {READ_KINDS}, and frames of films, to use them"


def list_kinds(unread: Mapping[str, int]) -> str:
    """Counts of files by their suffix, in words."""
    return ", ".join(f"{count} {suffix}" for suffix, count in sorted(unread.items()))


def in_short(parts: Sequence[str]) -> str:
    """The first of these, and how many more there are."""
    return ", ".join(parts[:MAX_NAMED]) + (f" and {len(parts) - MAX_NAMED} more" if len(parts) > MAX_NAMED else "")
