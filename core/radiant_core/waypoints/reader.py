"""Waypoints from a flight planner's file (CSV, GeoJSON, KML) or from GPS of photographs taken.

A file is read once, whole; 256 MiB, which a million waypoints in any of the three formats stay
under, is its limit. Of photographs only what stands before or behind their pixels is read.
"""

from __future__ import annotations

import codecs
import io
import math
import os
import stat
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.choices import HeightFrom
from radiant_core.errors import BadInput
from radiant_core.garbage import without_garbage_search
from radiant_core.io.photos.beside import beside_warning
from radiant_core.io.photos.copies import copies_warning, file_copies
from radiant_core.io.photos.folders import folders_warning, read_folder, unread_warning
from radiant_core.io.photos.jpeg import ExifFacts
from radiant_core.io.photos.listing import doubts_warning, photograph_heads
from radiant_core.io.run_store import open_without_waiting
from radiant_core.plan.borders.footprints import is_flat_angle, is_usual_aspect
from radiant_core.plan.heights import HEIGHT_KINDS, height_codes
from radiant_core.plan.waypoints import NO_ALTITUDES, Waypoints, clean_waypoints
from radiant_core.waypoints.csv_reader import csv_rows
from radiant_core.waypoints.geojson_reader import geojson_rows
from radiant_core.waypoints.kml_reader import kml_rows
from radiant_core.waypoints.rows import WaypointRows

MAX_FILE_BYTES = 256 * 2**20
WAYPOINT_SUFFIXES = (".csv", ".geojson", ".json", ".kml")
_MAX_NAMED = 5
_ENCODINGS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


@dataclass(frozen=True, kw_only=True)
class PhotographedWith:
    """The camera of most photographs, as EXIF says."""

    size_wh: tuple[int, int]
    """px as taken."""
    field_of_view_deg: float | None
    """Across the image; None where EXIF has no focal length for 36 × 24 mm."""


@dataclass(frozen=True, kw_only=True)
class FoundWaypoints:
    """What was read, and one sentence per kind of thing that was mended or left out."""

    waypoints: Waypoints
    warnings: tuple[str, ...]
    without_gps: tuple[str, ...] = ()
    """Photographs whose EXIF and XMP have no position, in order."""
    shortfall: str | None = None
    """Which grids the file's coordinate system lacks, as among the warnings."""
    taken_with: PhotographedWith | None = None
    """None for a file, and where most photographs do not say it."""


def read_waypoints(path: Path) -> FoundWaypoints:
    """The waypoints of a .csv, .geojson, .json or .kml file, in its order.

    Raises BadInput naming the file for any other suffix, a missing, empty or larger file, text
    neither UTF-8 nor UTF-16, broken syntax, no waypoint, or positions that `Waypoints` refuses.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in WAYPOINT_SUFFIXES:
        unzip = " (a KMZ is a zipped KML: unzip it)" if suffix == ".kmz" else ""
        raise BadInput(f"{path} is no waypoint file: its name must end in {', '.join(WAYPOINT_SUFFIXES)}{unzip}.")
    text = _text(path)
    try:
        with without_garbage_search():
            rows = _rows(text, suffix)
        if not rows.names:
            contents = f" but {_list_kinds(rows)}" if rows.ignored else ""
            raise BadInput(f"it holds no waypoint{contents}: give at least one point.")
        waypoints, warnings = clean_waypoints(rows.names, rows.lat_lon_alt, rows.height_codes, rows.heading_pitch_deg)
        warnings = (*rows.notes, *warnings)
    except BadInput as error:
        raise BadInput(f"cannot use {path}: {error}") from error
    if rows.ignored:
        warnings = (*warnings, f"{_list_kinds(rows)} ignored: only points and vertices of lines are waypoints.")
    if rows.shortfall is not None:
        warnings = (*warnings, rows.shortfall)
    return FoundWaypoints(waypoints=waypoints, warnings=warnings, shortfall=rows.shortfall)


def exif_waypoints(folder: Path, on_photo: Callable[[int, int], None] | None = None) -> FoundWaypoints:
    """The GPS positions of the photographs in `folder` and below, by name.

    `on_photo(done, total)` is called after each. Photographs at one position all stay, copies of a
    file do not. Raises BadInput when it is no folder, when it holds no photograph, or when none has
    a position.
    """
    heads = photograph_heads(folder, on_photo)
    copies = file_copies({name: folder / name for name in heads})
    copied = copies_warning(copies, len(heads))
    names = [name for name in heads if name not in copies]
    positions = {name: place for name in names if (place := heads[name].lat_lon_alt) is not None}
    without = tuple(name for name in names if name not in positions)
    doubts = doubts_warning({name: heads[name].position_doubt for name in names}, len(names))
    if not positions:
        why = "".join(f" {doubt}" for doubt in doubts)
        raise BadInput(
            f"none of the {len(names)} photographs in {folder} has a GPS position in EXIF or XMP: give a file of waypoints.{why}"
        )
    geodetic = np.array(list(positions.values()), np.float64)
    low = np.isnan(geodetic[:, 2])
    # For the plan alone, which heights hardly move: none is flown at.
    geodetic[low, 2] = 0.0 if low.all() else np.median(geodetic[~low, 2])
    kinds: list[HeightFrom] = ["sea" if heads[name].altitude_from_sea else "absolute" for name in positions]
    codes = np.where(low, HEIGHT_KINDS.index("unknown"), height_codes(kinds)).astype(np.uint8)
    try:
        waypoints = Waypoints(names=tuple(positions), lat_lon_alt=geodetic, counts_from=codes)
    except BadInput as error:
        raise BadInput(f"cannot use the positions of the photographs in {folder}: {error}") from error
    return FoundWaypoints(
        waypoints=waypoints,
        warnings=(
            *_folder_warnings(folder),
            *copied,
            *doubts,
            *_gps_warnings(without, len(names)),
            *_altitude_warnings(low),
        ),
        without_gps=without,
        taken_with=_taken_with([heads[name] for name in positions]),
    )


def _taken_with(heads: Sequence[ExifFacts]) -> PhotographedWith | None:
    """The size of more than half of the photographs, None without one, and their field of view,
    where more than half of all have it."""
    size_wh, count = Counter(head.taken_wh for head in heads).most_common(1)[0]
    if size_wh is None or 2 * count <= len(heads) or not is_usual_aspect(size_wh[1] / size_wh[0]):
        return None
    angle_deg, count = Counter(_angle_deg(head) for head in heads if head.taken_wh == size_wh).most_common(1)[0]
    return PhotographedWith(size_wh=size_wh, field_of_view_deg=angle_deg if 2 * count > len(heads) else None)


def _angle_deg(head: ExifFacts) -> float | None:
    """The angle across a photograph; None without a focal length, or for one of no camera."""
    if head.focal_35mm is None or head.taken_wh is None:
        return None
    # Equal diagonals, as of lenses in structure from motion.
    focal_px = head.focal_35mm * head.digital_zoom / math.hypot(36, 24) * math.hypot(*head.taken_wh)
    angle_deg = math.degrees(2 * math.atan(head.taken_wh[0] / 2 / focal_px)) if focal_px > 0 else math.nan
    return angle_deg if is_flat_angle(angle_deg) else None


def _folder_warnings(folder: Path) -> tuple[str, ...]:
    content = read_folder(folder)
    return (*folders_warning(content), *unread_warning(content.unread), *beside_warning(folder))


def _text(path: Path) -> str:
    try:
        with open(path, "rb", opener=open_without_waiting) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise BadInput(f"{path} is not a file: give a waypoint file or a folder of photographs.")
            if status.st_size > MAX_FILE_BYTES:
                raise BadInput(f"{path} has {status.st_size} bytes, expected at most {MAX_FILE_BYTES}: split it into several flights.")
            data = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise BadInput(f"cannot read {path}: {error.strerror or error}: check the path.") from error
    if not data.strip():
        raise BadInput(f"{path} is empty: give a file with at least one waypoint.")
    encoding = next((encoding for mark, encoding in _ENCODINGS if data.startswith(mark)), "utf-8")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise BadInput(f"{path}: byte {error.start} is not {encoding[:6].upper()} text: save the file as UTF-8.") from error


def _rows(text: str, suffix: str) -> WaypointRows:
    if suffix == ".kml":
        return kml_rows(text)
    if suffix == ".csv":
        return csv_rows(io.StringIO(text, newline=""))
    return geojson_rows(text)


def _list_kinds(rows: WaypointRows) -> str:
    return ", ".join(f"{count} × {kind}" for kind, count in rows.ignored.items())


def _gps_warnings(without: tuple[str, ...], num_photographs: int) -> tuple[str, ...]:
    if not without:
        return ()
    more = f" and {len(without) - _MAX_NAMED} more" if len(without) > _MAX_NAMED else ""
    named = f"{', '.join(without[:_MAX_NAMED])}{more}"
    return (f"{len(without)} of {num_photographs} photographs without GPS in EXIF or XMP are not planned: {named}.",)


def _altitude_warnings(low: NDArray[np.bool_]) -> tuple[str, ...]:
    """The warning about the photographs whose GPS has no altitude, those of `low` (P,)."""
    if not low.any():
        return ()
    if low.all():
        return (f"None of {len(low)} photographs with GPS has an altitude: {NO_ALTITUDES}.",)
    return (f"{low.sum()} of {len(low)} photographs have GPS without altitude: planned by their horizontal positions, without a height.",)
