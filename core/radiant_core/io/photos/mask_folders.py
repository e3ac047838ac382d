"""Which files in a folder of masks belong to which photographs, and which colour is left out.

A photograph a/b.jpg has its mask in one of the forms below, with any suffix of a picture; letters
count alike in either case. Where `transforms.json` lies beside the folder, its `mask_path` names
the masks that no form does. Once per source.

    a/b.jpg.png                 COLMAP
    a/b.png                     nerfstudio, Brush, Postshot, LichtFeld Studio
    a/b.mask.png, a/b_mask.png  Brush, Metashape
    a/b.jpg.mask.png            RealityScan

Black is left out by COLMAP, nerfstudio, Brush and Metashape. Postshot's "remove occluders" leaves
out white, its "remove background" black, and no file says which was meant.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from radiant_core.choices import MaskIgnores
from radiant_core.errors import BadInput, RadiantError
from radiant_core.io.photos.folders import MASK_FOLDERS, SUFFIXES, in_short
from radiant_core.io.run_store import read_bounded

FORMS = ("{name}", "{stem}", "{stem}.mask", "{stem}_mask", "{name}.mask")
"""Of a mask's name without its suffix, the most specific one first."""
MAX_TRANSFORMS_BYTES = 1 << 28


@dataclass(frozen=True, kw_only=True)
class MaskNames:
    """Photograph → its mask; paths below the folder of pictures that are no photograph's mask."""

    files: Mapping[str, Path]
    unmatched: tuple[str, ...]


def mask_folders(photo_folder: Path) -> tuple[Path, ...]:
    """Folders called masks or mask in the photographs' folder, or beside one called images."""
    places = (photo_folder, photo_folder.parent) if photo_folder.name == "images" else (photo_folder,)
    return tuple(path for place in places for path in sorted(place.iterdir()) if path.name.lower() in MASK_FOLDERS and path.is_dir())


def find_mask_folder(photo_folder: Path, names: Sequence[str]) -> tuple[Path | None, tuple[str, ...]]:
    """The folder beside photographs that holds masks of them, and what is said of others.

    Raises BadInput where two folders do.
    """
    fitting, notes = [], []
    for folder in mask_folders(photo_folder):
        matched = match_masks(folder, names)
        if matched.files:
            fitting.append(folder)
        elif matched.unmatched:
            notes.append(f"no picture in {folder.name}/ is named after a photograph ({in_short(matched.unmatched)}): {_expected(names)}.")
    if len(fitting) > 1:
        raise BadInput(f"{fitting[0]} and {fitting[1]} both hold masks of the photographs: name the one to use with --masks.")
    return (fitting[0] if fitting else None), tuple(notes)


def match_masks(folder: Path, names: Sequence[str]) -> MaskNames:
    """The masks in `folder` of the photographs of these names; BadInput where one fits two."""
    below = _pictures_below(folder)
    by_key: dict[str, list[str]] = {}
    for path in below:
        by_key.setdefault(path.rpartition(".")[0].casefold(), []).append(path)
    files: dict[str, Path] = {}
    photograph_of_mask: dict[str, str] = {}
    for form in FORMS:
        matched: dict[str, str] = {}
        for name in names:
            key = form.format(name=name, stem=_stem(name))
            paths = [] if name in files else [path for path in by_key.get(key.casefold(), ()) if path not in photograph_of_mask]
            if not paths:
                continue
            path = min(paths, key=lambda path: (path.rpartition(".")[0] != key, path))
            if path in matched:
                raise BadInput(
                    f"the mask {folder / path} could be that of {matched[path]} or of {name}: name it {name}.png for one of them."
                )
            matched[path] = name
        files |= {name: folder / path for path, name in matched.items()}
        photograph_of_mask |= matched
    listed = _named_by_transforms(folder, set(names) - files.keys())
    files |= listed
    used = {os.path.realpath(path) for path in files.values()}
    unmatched = tuple(path for path in below if os.path.realpath(folder / path) not in used)
    return MaskNames(files=files, unmatched=unmatched)


def unmatched_warning(matched: MaskNames, folder: Path, names: Sequence[str], *, named: bool = True) -> tuple[str, ...]:
    """What is said of pictures in a folder of masks that are no photograph's."""
    if not matched.unmatched:
        return ()
    where = f" in {folder.name}/" if named else ""
    listed = f" ({in_short(matched.unmatched)})" if named else ""
    sentence = f"{len(matched.unmatched)} pictures{where} are named after no photograph and are not used{listed}"
    return (f"{sentence}: {_expected(names)}." if named else f"{sentence}.",)


def question_of_colour(folder: Path, used_share: float, num_read: int) -> BadInput:
    """What is asked where masks leave less than half of their photographs."""
    return BadInput(
        f"black leaves {100 * used_share:.0f} % of the pixels of {num_read} masks in {folder}: in COLMAP, nerfstudio and Brush black is "
        "left out, by Postshot's 'remove occluders' white is: say --mask-ignores black or --mask-ignores white, or --mask-ignores nothing "
        "to use no masks."
    )


def ignored_reason(ignores: MaskIgnores | None) -> str:
    """Why a colour is left out, for a decision."""
    if ignores is None:
        return "as in COLMAP, nerfstudio and Brush, and it is less than half of all pixels"
    return f"--mask-ignores is {ignores}"


def _expected(names: Sequence[str]) -> str:
    name = names[0] if names else "photograph.jpg"
    return f"expected {name}.png or {_stem(name)}.png"


def _stem(name: str) -> str:
    folder, slash, file = name.rpartition("/")
    return f"{folder}{slash}{file.rpartition('.')[0] or file}"


def _pictures_below(folder: Path) -> list[str]:
    paths = (Path(inner) / file for inner, _, files in os.walk(folder) for file in files if not file.startswith("."))
    return sorted(path.relative_to(folder).as_posix() for path in paths if path.suffix.lower() in SUFFIXES)


def _named_by_transforms(folder: Path, names: set[str]) -> dict[str, Path]:
    """Masks in `folder` that transforms.json beside it gives photographs of these names; other
    readers report what is wrong with that file."""
    path = folder.parent / "transforms.json"
    if not names or not path.is_file():
        return {}
    try:
        frames = json.loads(read_bounded(path, MAX_TRANSFORMS_BYTES)).get("frames", [])
        pairs = [(frame["file_path"], frame["mask_path"]) for frame in frames if isinstance(frame, dict) and "mask_path" in frame]
    except (ValueError, AttributeError, KeyError, TypeError, RecursionError, RadiantError):
        return {}
    inside, listed = os.path.realpath(folder), {}
    for photograph, mask in pairs:
        place = Path(os.path.realpath(folder.parent / str(mask)))
        name = _ends_in(str(photograph), names)
        if name is not None and place.is_relative_to(inside) and place.is_file():
            listed[name] = place
    return listed


def _ends_in(path: str, names: set[str]) -> str | None:
    """The longest end of a path that is one of the names."""
    parts = path.replace("\\", "/").split("/")
    ends = ("/".join(parts[first:]) for first in range(len(parts)))
    return next((end for end in ends if end in names), None)
