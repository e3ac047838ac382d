"""Which alignment lies in a folder, and its reader. Once per source.

A file is known by its name and, where names are free, by its head. Of several alignments none is
taken: which of them is right nobody here can know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.io.poses import pix4d, polycam
from radiant_core.io.poses.bundler import MARK as BUNDLER_MARK
from radiant_core.io.poses.bundler import list_of, read_bundler
from radiant_core.io.poses.colmap_panoramas import read_colmap_panoramas
from radiant_core.io.poses.metashape import read_metashape
from radiant_core.io.poses.openmvg import read_openmvg
from radiant_core.io.poses.opensfm import read_opensfm
from radiant_core.io.poses.opf import parts_of, read_opf
from radiant_core.io.poses.pix4d import read_pix4d
from radiant_core.io.poses.polycam import read_polycam
from radiant_core.io.poses.pose_file import PoseFile, SizeOf
from radiant_core.io.poses.realityscan import is_header, read_realityscan
from radiant_core.io.poses.transforms import SPLITS, read_transforms

HEAD_BYTES = 4096
INNER_FOLDERS = {
    "": "",
    "opensfm": "reconstruction.json",
    "1_initial/params": pix4d.INTERNAL,
    **{f"keyframes/{name}": ".json" for name in polycam.FOLDERS},
}
"""Where programs leave an alignment below the folder of a project, and how it ends there: older
versions of ODM leave bundle files beside the same alignment."""
SPLIT_NAMES = tuple(f"transforms_{split}.json" for split in SPLITS)
Reader = Callable[[Path, SizeOf], PoseFile]


@dataclass(frozen=True)
class Format:
    """A format: what writes it, how a file is known (name in lower case, its head) and read."""

    program: str
    knows: Callable[[str, Callable[[], bytes]], bool]
    reader: Reader


FORMATS: tuple[Format, ...] = (
    Format("nerfstudio, instant-ngp or Blender", lambda name, head: name in ("transforms.json", *SPLIT_NAMES), read_transforms),
    Format("OpenSfM or ODM", lambda name, head: name == "reconstruction.json", read_opensfm),
    Format("openMVG", lambda name, head: name == "sfm_data.json", read_openmvg),
    Format("OPF", lambda name, head: name.endswith(".opf"), read_opf),
    Format("Pix4D", lambda name, head: name.endswith((pix4d.INTERNAL, pix4d.EXTERNAL)), read_pix4d),
    Format("Bundler", lambda name, head: name.endswith(".out") and head().startswith(BUNDLER_MARK.encode()), read_bundler),
    Format("Metashape", lambda name, head: name.endswith(".xml") and _is_metashape(head()), read_metashape),
    Format("RealityScan", lambda name, head: name.endswith(".csv") and _is_realityscan(head()), read_realityscan),
    Format("Polycam", lambda name, head: name.endswith(".json") and b'"t_00"' in head(), read_polycam),
)
READABLE = (
    "transforms.json (nerfstudio, instant-ngp, Blender), reconstruction.json (OpenSfM, ODM), cameras.xml (Metashape), RealityScan's CSV, "
    "calibrated_camera_parameters.txt (Pix4D), project.opf, sfm_data.json (openMVG), bundle.out (Bundler), Polycam's keyframes"
)
"""What is read, for messages."""


def format_of(path: Path) -> Format | None:
    """The format of a file; None of one that is no alignment."""
    return next((form for form in FORMATS if form.knows(path.name.lower(), lambda: _head(path))), None)


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
    """The files that are read of the alignment in `path`, as far as they are there."""
    form = format_of(path)
    program = "" if form is None else form.program
    parts: list[Path] = []
    if path.name in SPLIT_NAMES:
        parts = [path.with_name(name) for name in SPLIT_NAMES]
    elif program == "Polycam":
        parts = sorted(path.parent.glob("*.json"))
    elif program == "OpenSfM or ODM":
        parts = [path.with_name(name) for name in ("cameras.json", "tracks.csv", "reference_lla.json")]
    elif program == "Pix4D":
        parts = [pix4d.sibling(path, ending) for ending in (pix4d.EXTERNAL, pix4d.OFFSET, pix4d.SYSTEM)]
    elif program == "Bundler":
        parts = [list_file for list_file in (list_of(path),) if list_file is not None]
    elif program == "OPF":
        parts = [*parts_of(path).values()]
    return tuple(dict.fromkeys(file for file in (path, *parts) if file.is_file()))


def read_alignment(path: Path, size_of: SizeOf) -> PoseFile:
    """The alignment in a file, or in the folder of a COLMAP model of panoramas; BadInput where it
    is of no format that is read, or of a broken one."""
    if any((path / f"cameras{ending}").is_file() for ending in (".bin", ".txt")):
        return read_colmap_panoramas(path, size_of)
    if not path.exists():
        raise BadInput(f"{path} does not exist: expected a file with an alignment, {READABLE}, or the folder of a COLMAP model.")
    if not path.is_file():
        raise BadInput(f"{path} is no file with an alignment: expected {READABLE}, or the folder of a COLMAP model.")
    form = format_of(path)
    if form is None:
        raise BadInput(f"{path} is no alignment that is read here: expected {READABLE}, or the folder of a COLMAP model.")
    return form.reader(path, size_of)


def _files_in(folder: Path) -> Iterator[Path]:
    for inner, ending in INNER_FOLDERS.items():
        place = folder / inner
        paths = sorted(place.iterdir()) if place.is_dir() else []
        yield from (path for path in paths if path.is_file() and not path.name.startswith(".") and path.name.endswith(ending))


def photographs_beside(path: Path, folder: Path) -> Path:
    """The folder of an alignment's photographs: `folder`, or that of Polycam's cameras, which has
    them twice."""
    parent = path.absolute().parent
    if parent.name not in polycam.FOLDERS:
        return folder
    photo_folder = parent.with_name(parent.name.replace("cameras", "images"))
    return photo_folder if photo_folder.is_dir() else folder


def _first_of(path: Path) -> Path:
    """Of the files that are one alignment together, the one that is read."""
    together, parent = [path], path.absolute().parent
    if path.name in SPLIT_NAMES:
        together = [path.with_name(name) for name in SPLIT_NAMES]
    elif path.name.endswith((pix4d.INTERNAL, pix4d.EXTERNAL)):
        together = [pix4d.sibling(path, pix4d.INTERNAL), path]
    elif parent.name in polycam.FOLDERS and path.suffix == ".json":
        folders = [parent.with_name(name) for name in polycam.FOLDERS]
        together = [camera_path for folder in folders for camera_path in sorted(folder.glob("*.json"))]
    return next(part for part in (*together, path) if part.is_file())


def _is_metashape(head: bytes) -> bool:
    return b"<document" in head and b"<chunk" in head


def _is_realityscan(head: bytes) -> bool:
    return any(is_header(line) for line in head.decode("utf-8-sig", "replace").splitlines()[:3])


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except OSError:
        return b""
