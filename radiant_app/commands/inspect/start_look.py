"""What was dropped on the start window, and what is done with it. Once per choice of a folder.

    photographs, a film, an alignment, a COLMAP project, Mill 19   →  radiant run
    waypoints of a flight before capture                           →  radiant plan
    a run, a training, a scene, a plan, a model                    →  radiant inspect

The same functions decide as for the command line: `sources.detect_source`, `read_waypoints`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from radiant_app.commands.inspect.window import plan_file_of
from radiant_app.workers.folder_kinds import kind_of
from radiant_app.workers.sources import SourceKind, detect_source, notes_on_source
from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.io.colmap.model import image_centers
from radiant_core.io.model_reader import model_kind
from radiant_core.io.photos.beside import beside_warning
from radiant_core.io.photos.copies import file_copies
from radiant_core.io.photos.folders import folders_warning, read_folder, unread_warning
from radiant_core.io.photos.listing import doubts_warning, photograph_heads, photograph_size_wh
from radiant_core.io.poses.recognise import format_of, read_alignment
from radiant_core.numerics import FloatArray
from radiant_core.waypoints.reader import WAYPOINT_SUFFIXES, read_waypoints
from radiant_viewer.runs.run_view import is_planned

Next = Literal["run", "plan", "open"]
Report = Callable[[int, int], None]
FROM_GPS, FROM_FLIGHT = "GPS of the photographs", "waypoints of the flight"


@dataclass(frozen=True, kw_only=True, eq=False)
class SourceSummary:
    """What a path is. places (P,2): east and north, of what `places_are`, metres unless `unit` says
    otherwise; empty where nothing says where photographs were taken."""

    path: Path
    title: str
    next: Next
    num_photographs: int = 0
    """0 where that is not known before the run, as of a film."""
    places: FloatArray
    places_are: str = ""
    unit: str = "m"
    is_placed: bool = False
    """Whether poses lie beside the photographs and are used."""
    notes: tuple[str, ...] = ()
    """What is left out or doubtful, one sentence each."""

    @property
    def num_trained(self) -> int:
        """Photographs that are trained on: every eighth is held out."""
        return self.num_photographs - -(-self.num_photographs // 8)


def look_at(path: Path, report: Report = lambda num_done, total: None) -> SourceSummary:
    """What `path` is; BadInput, with what would do, for anything that nothing is done with."""
    if not path.exists():
        raise BadInput(f"there is neither a folder nor a file {path}: choose another.")
    if path.is_file():
        return _file(path)
    # Before what photographs beside a manifest would make of it.
    if (opened := _opened_folder(path)) is not None:
        return opened
    kind, images, posed = detect_source(path)
    if kind == "film":
        return _summary_of(path, "a folder of films, of which the run takes the sharpest frames")
    if kind == "mill19":
        num_views = sum(1 for file in (path / "train" / "metadata").iterdir() if file.is_file())
        return replace(_summary_of(path, "a Mill 19 folder: photographs with poses"), num_photographs=num_views, is_placed=True)
    return _photographs(path, images, kind, posed, report)


def _file(path: Path) -> SourceSummary:
    if model_kind(path) is not None:
        return _summary_of(path, "a model", next_step="open")
    if plan_file_of(path) is not None and _is_plan(path):
        return _summary_of(path, "a plan", next_step="open")
    if path.suffix.lower() in WAYPOINT_SUFFIXES:
        waypoints = read_waypoints(path)
        places = waypoints.waypoints.positions_m[:, :2]
        title = f"{len(places):,} waypoints before capture, {_extent(places)}: a plan deals them to machines"
        return SourceSummary(
            path=path,
            title=title,
            next="plan",
            num_photographs=len(places),
            places=places,
            places_are=FROM_FLIGHT,
            notes=waypoints.warnings,
        )
    if path.suffix.lower() == ".toml":
        from radiant_app.files.job_file import is_job_file, load_run_file

        if is_job_file(path):
            raise BadInput(f"{path} is a job file of several scenes: type 'radiant run {path} --out FOLDER'.")
        return replace(look_at(Path(load_run_file(path)["source"])), path=path, title=f"a run file, {path.name}")
    detect_source(path)
    return _summary_of(path, "a film, of which the run takes the sharpest frames")


def _opened_folder(path: Path) -> SourceSummary | None:
    kind = kind_of(path)
    if plan_file_of(path) is not None:
        return _summary_of(path, "the folder of a plan", next_step="open")
    if kind is None or (kind.name.startswith("a COLMAP model") and not is_planned(path)):
        return None
    if kind.name.startswith("an export"):
        raise BadInput(f"{path} is {kind.name}: {kind.use}.")
    return _summary_of(path, kind.name, next_step="open")


def _photographs(path: Path, images: Path, kind: SourceKind, posed: Path | None, report: Report) -> SourceSummary:
    heads = photograph_heads(images, report)
    copies = file_copies({name: images / name for name in heads})
    names = [name for name in heads if name not in copies]
    gps = [place for name in names if (place := heads[name].lat_lon_alt) is not None]
    places, places_are, unit = _gps_places(gps), FROM_GPS, "m"
    subject = f"{len(names):,} photographs"
    if kind == "colmap" and posed is not None:
        subject = f"a COLMAP project with {len(names):,} photographs"
    elif kind == "alignment" and posed is not None and (form := format_of(posed)) is not None:
        subject = f"{len(names):,} photographs and their alignment by {form.program} ({posed.name}), which is used"
    if not len(places) and posed is not None:
        places, places_are, unit = _posed_places(kind, posed, images), "poses of the alignment", "units"
    where = "none with GPS" if not len(places) else f"{len(gps):,} with GPS, {_extent(places)}" if gps else "places by the alignment"
    size = photograph_size_wh(images / names[0]) if names else None
    pixels = "" if size is None else f", {size[0]:,} × {size[1]:,} px"
    notes = (
        *notes_on_source(path),
        *folders_warning(content := read_folder(images)),
        *unread_warning(content.unread),
        *doubts_warning({name: heads[name].position_doubt for name in names}, len(names)),
        *([f"{len(copies)} files are copies of others and left out."] if copies else []),
        *(beside_warning(images) if kind == "photographs" else ()),
    )
    title = f"{subject}{pixels}; {where}"
    return SourceSummary(
        path=path,
        title=title,
        next="run",
        num_photographs=len(names),
        places=places,
        places_are=places_are,
        unit=unit,
        is_placed=posed is not None,
        notes=notes,
    )


def _gps_places(gps: list[tuple[float, float, float]]) -> FloatArray:
    if not gps:
        return np.zeros((0, 2))
    geodetic = np.nan_to_num(np.array(gps, np.float64))
    return enu_from_geodetic(geodetic, np.median(geodetic, axis=0))[:, :2]


def _posed_places(kind: SourceKind, posed: Path, images: Path) -> FloatArray:
    """Where cameras stand (P,2), in the first two axes of the alignment."""
    if kind == "colmap":
        return image_centers(posed)[:, :2]
    file = read_alignment(posed, lambda name: photograph_size_wh(images / name) if (images / name).is_file() else None)
    poses = np.array([view.cam_from_world for view in file.views]).reshape(-1, 4, 4)
    return np.asarray(-np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])[:, :2])


def _summary_of(path: Path, title: str, *, next_step: Next = "run") -> SourceSummary:
    return SourceSummary(path=path, title=title, next=next_step, places=np.zeros((0, 2)))


def _extent(places: FloatArray) -> str:
    across, along = np.ptp(places, axis=0) if len(places) else (0.0, 0.0)
    return f"over {across:,.0f} × {along:,.0f} m"


def _is_plan(path: Path) -> bool:
    from radiant_core.io.records import load_plan_file

    try:
        load_plan_file(path)
    except BadInput:
        return False
    return True
