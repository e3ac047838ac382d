"""Which alignment lies in a folder, and its reader. Once per source.

A file is known by its name and, where names are free, by its head. Of several alignments none is
taken: which of them is right nobody here can know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.io.poses.pose_file import PoseFile, SizeOf
from radiant_core.io.poses.transforms import SPLITS, read_transforms

HEAD_BYTES = 4096
INNER_FOLDERS = ("", "opensfm")
"""Where programs leave an alignment, below the folder of a project."""
Reader = Callable[[Path, SizeOf], PoseFile]


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format: what writes it, how a file is known (name in lower case, its head) and read."""

    program: str
    knows: Callable[[str, Callable[[], bytes]], bool]
    read: Reader


FORMATS: tuple[Format, ...] = (
    Format(
        program="nerfstudio, instant-ngp or Blender",
        knows=lambda name, head: name in ("transforms.json", *(f"transforms_{split}.json" for split in SPLITS)),
        read=read_transforms,
    ),
)
READ = "transforms.json (nerfstudio, instant-ngp, Blender)"
"""What is read, for messages."""


def format_of(path: Path) -> Format | None:
    """The format of a file; None of one that is no alignment."""
    return next((each for each in FORMATS if each.knows(path.name.lower(), lambda: _head(path))), None)


def find_alignments(folder: Path) -> tuple[Path, ...]:
    """The alignments in a folder of photographs or of a project, one path for each."""
    return tuple(dict.fromkeys(_first_of(path) for path in _files_in(folder) if format_of(path) is not None))


def the_alignment(folder: Path) -> Path | None:
    """The one alignment in a folder; None where there is none, BadInput where there are several."""
    paths = find_alignments(folder)
    if len(paths) > 1:
        listed = ", ".join(path.relative_to(folder).as_posix() for path in paths)
        raise BadInput(f"{folder} holds {len(paths)} alignments ({listed}): name the one to use with --poses, or --poses none for none.")
    return paths[0] if paths else None


def alignment_files(path: Path) -> tuple[Path, ...]:
    """The files that are read of the alignment in `path`."""
    if path.name in (f"transforms_{split}.json" for split in SPLITS):
        return tuple(each for each in (path.with_name(f"transforms_{split}.json") for split in SPLITS) if each.is_file())
    return (path,)


def read_alignment(path: Path, size_of: SizeOf) -> PoseFile:
    """The alignment in a file; BadInput where it is of no format that is read, or of a broken
    one."""
    if not path.is_file():
        raise BadInput(f"{path} is no file with an alignment: expected {READ}, or the folder of a COLMAP model.")
    form = format_of(path)
    if form is None:
        raise BadInput(f"{path} is no alignment that is read here: expected {READ}, or the folder of a COLMAP model.")
    return form.read(path, size_of)


def _files_in(folder: Path) -> Iterator[Path]:
    for inner in INNER_FOLDERS:
        place = folder / inner
        if place.is_dir():
            yield from (path for path in sorted(place.iterdir()) if path.is_file() and not path.name.startswith("."))


def _first_of(path: Path) -> Path:
    """Of the files that are one alignment together, the one that is read."""
    split = next((split for split in SPLITS if path.name == f"transforms_{split}.json"), None)
    if split is None:
        return path
    return next(each for each in (path.with_name(f"transforms_{split}.json") for split in SPLITS) if each.is_file())


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except OSError:
        return b""
