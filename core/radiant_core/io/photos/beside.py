"""Projects, poses, masks and positions that lie beside photographs and are not used: one line.

Until such files are read, nobody should believe that they were. Once per folder.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from radiant_core.io.photos.folders import MASK_FOLDERS, SUFFIXES, UNREAD_SUFFIXES, in_short, read_folder

CONTROL_LIST = "gcp_list.txt"
OPENING = "beside the photographs there are"
_PROJECT_FILES = {
    "transforms.json": "poses of nerfstudio or instant-ngp",
    **dict.fromkeys(("transforms_train.json", "transforms_val.json", "transforms_test.json"), "poses of NeRF"),
    "poses_bounds.npy": "poses of LLFF",
    "cameras.json": "lenses of ODM",
    "images.json": "photographs of ODM",
    "img_list.txt": "photographs of ODM",
    "geo.txt": "positions",
    "image_geocoding.txt": "positions",
    CONTROL_LIST: "ground control",
    "ground_control_points.json": "ground control of OpenSfM",
    "exif_overrides.json": "positions of OpenSfM",
    "bundle.out": "poses of Bundler",
    "sfm_data.json": "poses of OpenMVG",
    "reconstruction.json": "poses of OpenSfM",
}
_PROJECT_SUFFIXES = {
    ".psx": "a project of Metashape",
    ".psz": "a project of Metashape",
    ".rcproj": "a project of RealityScan",
    ".rsproj": "a project of RealityScan",
    ".rcalign": "poses of RealityScan",
    ".p4d": "a project of Pix4D",
    ".bpf": "poses of Pix4D",
    ".nvm": "poses of VisualSfM",
    ".out": "poses of Bundler",
    ".srt": "positions of a film",
    ".mrk": "times of exposure",
    ".obs": "observations of satellites",
    ".nav": "observations of satellites",
    ".gpx": "tracks",
    ".xmp": "sidecars",
    ".opf": "a project in OPF",
}
_PROJECT_ENDINGS = {
    "calibrated_external_camera_parameters.txt": "poses of Pix4D",
    "calibrated_external_camera_parameters_wgs84.txt": "poses of Pix4D",
    "_pmatrix.txt": "poses of Pix4D",
}
"""Ends of names that begin with that of a project."""
_PROJECT_FOLDERS = {
    **dict.fromkeys(MASK_FOLDERS, "masks, which --masks takes"),
    "opensfm": "poses of OpenSfM",
    "odm_report": "a project of ODM",
    "odm_georeferencing": "a project of ODM",
    "odm_orthophoto": "a project of ODM",
}
_XML_HEAD_BYTES = 4096
_XML_KINDS = ((b"<document", b"<chunk", "poses of Metashape"), (b"<BlocksExchange", b"<", "poses of BlocksExchange"))


def beside_warning(
    folder: Path, masks: Path | None = None, *, control: str | None = None, named: bool = True, used: frozenset[Path] = frozenset()
) -> tuple[str, ...]:
    """One line about what lies in a folder of photographs, or beside one that is called images, and
    is not used; `masks`, files `used` and a list with the text `control` are. Kinds alone where
    names are private."""
    places = (folder, folder.parent) if folder.name == "images" else (folder,)
    there = [entry for place in places for entry in _projects_in(place, masks, control, used, above=place != folder)]
    if len(places) > 1:
        there += [
            (f"{count} {suffix}", "films or pictures that are not read") for suffix, count in sorted(unread_in(folder.parent).items())
        ]
    if not there:
        return ()
    names_or_kinds = [f"{name} ({kind})" for name, kind in there] if named else sorted({kind for _, kind in there})
    return (f"{OPENING} {in_short(names_or_kinds)}: they are not used.",)


def unread_in(folder: Path) -> dict[str, int]:
    """How many files of each kind directly in `folder` hold photographs or films that are not
    read."""
    suffixes = (path.suffix.lower() for path in folder.iterdir() if path.suffix.lower() in UNREAD_SUFFIXES and path.is_file())
    return dict(Counter(suffixes))


def _projects_in(folder: Path, masks: Path | None, control: str | None, used: frozenset[Path], *, above: bool) -> list[tuple[str, str]]:
    """Name and kind of each thing; `above`: photographs too, which only the folder below gives."""
    leftovers: list[tuple[str, str]] = []
    suffixes: Counter[str] = Counter()
    try:
        entries = sorted(folder.iterdir())
    except OSError:
        return []
    used_masks = None if masks is None else masks.resolve()
    for path in entries:
        name, suffix = path.name.lower(), path.suffix.lower()
        if path.is_dir():
            is_used_mask = path.resolve() == used_masks or (used_masks is not None and name in MASK_FOLDERS)
            is_used = is_used_mask or any(path in file.parents for file in used)
            leftovers += [] if is_used else _folder_kind(path, above=above)
        elif path in used or (control is not None and name == CONTROL_LIST and _has_text(path, control)):
            continue
        elif kind := _kind_of_file(name):
            leftovers.append((path.name, kind))
        elif suffix in _PROJECT_SUFFIXES or (above and suffix in SUFFIXES):
            suffixes[suffix] += 1
        elif suffix == ".xml" and (kind := _xml_kind(path)):
            leftovers.append((path.name, kind))
    return [
        *leftovers,
        *((f"{count} {suffix}", _PROJECT_SUFFIXES.get(suffix, "photographs")) for suffix, count in sorted(suffixes.items())),
    ]


def _kind_of_file(name: str) -> str:
    """What a file of this name, in lower case, is of; empty of another."""
    return _PROJECT_FILES.get(name) or next((kind for ending, kind in _PROJECT_ENDINGS.items() if name.endswith(ending)), "")


def _folder_kind(path: Path, *, above: bool) -> list[tuple[str, str]]:
    name = path.name.lower()
    if name in _PROJECT_FOLDERS:
        return [(f"{path.name}/", _PROJECT_FOLDERS[name])]
    if above and name not in ("images", "sparse") and (number := len(read_folder(path).names)):
        return [(f"{path.name}/", f"{number} photographs")]
    return []


def _has_text(path: Path, text: str) -> bool:
    try:
        data = path.read_bytes() if path.stat().st_size <= 2 * len(text.encode()) + 4 else b""
    except OSError:
        return False
    return text in (data.decode("utf-8-sig", "replace"), data.decode("utf-16", "replace"))


def _xml_kind(path: Path) -> str:
    try:
        with path.open("rb") as file:
            head = file.read(_XML_HEAD_BYTES)
    except OSError:
        return ""
    return next((kind for first, second, kind in _XML_KINDS if first in head and second in head), "")
