"""Which photographs are equirectangular panoramas. Once per source.

A panorama says so in XMP (GPano:ProjectionType), as cameras and stitchers write it. One that does
not is a picture twice as wide as high, as others are too: whoever knows says it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from radiant_core.choices import Panoramas
from radiant_core.errors import BadInput, RadiantError
from radiant_core.io.photos.facts import read_exif_of
from radiant_core.io.photos.folders import in_short
from radiant_core.io.photos.listing import MAX_FILE_BYTES, photograph_size_wh

MAX_OFF = 0.01
"""By how much a panorama's width may differ from twice its height: rounding of a reduced one."""


@dataclass(frozen=True, kw_only=True)
class FoundPanoramas:
    """Panoramas among photographs, and what is said of others that may be some."""

    names: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def find_panoramas(photo_folder: Path, names: Sequence[str], choice: Panoramas | None) -> FoundPanoramas:
    """The panoramas among the photographs `names`: those that say so, or as `choice`, all or none.

    Raises BadInput where one shows a part of the sphere, is not twice as wide as high, or lies
    among photographs that are none.
    """
    if choice == "none" or not names:
        return FoundPanoramas()
    spheres = {name: _sphere_of(photo_folder / name) for name in names}
    chosen = tuple(name for name in names if choice == "all" or spheres[name])
    if not chosen:
        return FoundPanoramas(warnings=_may_be(photo_folder, names))
    if len(chosen) < len(names):
        raise BadInput(
            f"{len(chosen)} of {len(names)} photographs in {photo_folder} are panoramas ({in_short(chosen)}), which become faces, and the "
            "others are not: give them in two folders, or take all for plain photographs by --panoramas none."
        )
    parts = [name for name in chosen if spheres[name] == "part"]
    if parts:
        raise BadInput(
            f"{in_short(parts)} in {photo_folder} show a part of the sphere (GPano:CroppedArea…), which is not read here: stitch whole "
            "panoramas, or leave these out."
        )
    odd = [name for name in chosen if not _is_twice_as_wide(photo_folder / name)]
    if odd:
        raise BadInput(
            f"{in_short(odd)} in {photo_folder} are not twice as wide as high, as a whole equirectangular panorama is: stitch them so, or "
            "take all for plain photographs by --panoramas none."
        )
    return FoundPanoramas(names=chosen)


def _may_be(photo_folder: Path, names: Sequence[str]) -> tuple[str, ...]:
    """What is said of photographs that are all of a panorama's shape and say nothing."""
    if not all(_is_twice_as_wide(photo_folder / name) for name in names):
        return ()
    return (
        f"all {len(names)} photographs are twice as wide as high and do not say that they are panoramas: they are taken for plain "
        "photographs; --panoramas all cuts them into faces.",
    )


def _is_twice_as_wide(path: Path) -> bool:
    size_wh = photograph_size_wh(path)
    return size_wh is not None and abs(size_wh[0] / size_wh[1] - 2) <= 2 * MAX_OFF


def _sphere_of(path: Path) -> str:
    try:
        return read_exif_of(path, MAX_FILE_BYTES).sphere
    except (OSError, RadiantError):
        # What cannot be read is reported where photographs are listed.
        return ""
