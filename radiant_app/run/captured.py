"""Locates photographs and their devices before planning (`--frames gps` or `known`). Once per run.

The source is a folder of photographs that the plan deals to devices, each of which fetches its own;
or one subfolder per device, named by its id: the photographs it took, which no other process opens.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Warned
from radiant_app.executors.local import run_task
from radiant_app.executors.protocol import NodeTask
from radiant_app.run.progress import Progress
from radiant_app.workers.folder_kinds import require_photographs
from radiant_app.workers.rasters import raster_of
from radiant_app.workers.tasks import PositionsTask
from radiant_core import __version__
from radiant_core.errors import BadInput, StageFailed
from radiant_core.evaluate.split import held_out_mask
from radiant_core.frames import MAX_REACH_M, enu_from_geodetic
from radiant_core.hierarchy.codec import save_task, task_key
from radiant_core.io.photos.copies import copies_warning, file_copies
from radiant_core.io.photos.folders import SUFFIXES, is_camera_folder, photograph_names
from radiant_core.io.run_store import content_key, read_json
from radiant_core.numerics import FloatArray
from radiant_core.plan.system import System
from radiant_core.sfm.given_poses import GivenPoses

MOST_TIMES = 4
"""With D devices the others of one that claims more keep at least D / (D + 3) of their steps."""
MAX_NAMED = 5
"""Photographs named in one warning."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Captured:
    """Names, positions and devices of P photographs."""

    names: tuple[str, ...]
    """File names, with frames by poses those of the poses."""
    owners: tuple[str | None, ...]
    """Device that holds the photograph; None where one folder holds all."""
    positions: FloatArray
    """(P,3) metres about `origin`, or in the unit of the poses; NaN if unknown."""
    origin: FloatArray | None
    """(3,) latitude, longitude, altitude; None for given poses."""
    cell_middles: dict[str, FloatArray] | None = None
    """Device → centres (K,2) m of its photographs' cells, if devices send rasters alone."""

    @property
    def placed(self) -> Any:
        """(P,) which photographs have a position."""
        return np.isfinite(self.positions).all(axis=1)

    @property
    def planned(self) -> Any:
        """Rows of the photographs that are planned and trained on."""
        return np.flatnonzero(self.placed & ~self.held_out)

    @property
    def held_out(self) -> Any:
        """(P,) which photographs are held out, by device and name."""
        return held_out_mask([name if owner is None else f"{owner}/{name}" for name, owner in zip(self.names, self.owners, strict=True)])


def device_folders(source: Path, system: System) -> dict[str, Path] | None:
    """The subfolders of `source` that are named by devices; None where it holds photographs."""
    if not source.is_dir():
        raise BadInput(f"{source} is no folder: give a folder of photographs, or one with a subfolder per device.")
    require_photographs(source)
    inner = {path.name: path for path in sorted(source.iterdir()) if path.is_dir() and not path.name.startswith(".")}
    ids = [device.id for device in system.devices]
    named = {name: path for name, path in inner.items() if name in ids}
    loose = [path.name for path in source.iterdir() if path.suffix.lower() in SUFFIXES]
    if not named:
        # A camera's own folders are no owner's: all photographs are one's.
        holding = [name for name, path in inner.items() if not is_camera_folder(name) and photograph_names(path)]
        if holding and not loose and "images" not in inner:
            raise BadInput(
                f"{source} has photographs in the folder {holding[0]!r}, which is no device of the system ({', '.join(ids)}): name folders "
                "by their devices, give the --system that has them, or put all photographs into one folder."
            )
        return None
    # A COLMAP model beside them gives poses (--frames known) and holds no photograph.
    strange = sorted(set(inner) - set(named) - {"sparse"})
    if strange or loose:
        unexpected = f"the folder {strange[0]!r}" if strange else f"the photograph {loose[0]!r}"
        raise BadInput(
            f"{source} has subfolders of devices ({', '.join(named)}) and {unexpected}: "
            f"give every device's photographs in a folder with its id, of {', '.join(ids)}."
        )
    return named


def locate_photographs(config: RunConfig, poses: GivenPoses | None, folders: dict[str, Path] | None, progress: Progress) -> Captured:
    """Locate the photographs before planning; BadInput if positions or poses are missing."""
    if poses is None and folders is not None and config.cell_m is not None:
        return _count_by_devices(config.cell_m, folders, progress)
    captured = _locate_by_poses(poses, folders, config.source, progress) if poses is not None else _locate_by_gps(config, folders, progress)
    _warn_of_unplaced(captured, progress)
    return captured


def _count_by_devices(cell_m: float, folders: dict[str, Path], progress: Progress) -> Captured:
    """Let every device count its training photographs in a raster; no name or position leaves."""
    owned = [(device, name) for device, folder in folders.items() for name in photograph_names(folder)]
    is_held_out = held_out_mask([f"{device}/{name}" for device, name in owned])
    places: dict[str, FloatArray] = {}
    for device, folder in folders.items():
        held_out = [name for (owner, name), out in zip(owned, is_held_out, strict=True) if owner == device and out]
        try:
            raster = raster_of(_positions_in(folder, f"positions/{device}", progress, cell_m, held_out), "gps")
        except (BadInput, StageFailed, OSError) as error:
            progress.listen(Warned(stage="plan", message=f"device {device} takes no part: {_reason(error)}"))
            continue
        if raster.num_unplaced:
            message = f"{raster.num_unplaced} of {raster.num_photographs} photographs of device {device} have no usable position."
            progress.listen(Warned(stage="plan", message=message))
        places[device] = raster.middles
    origin, by_device = place_rasters(places, progress)
    return Captured(
        names=tuple(name for _, name in owned),
        owners=tuple(device for device, _ in owned),
        positions=np.full((len(owned), 3), np.nan),
        origin=origin,
        cell_middles=by_device,
    )


def place_rasters(places: Mapping[str, FloatArray], progress: Progress) -> tuple[FloatArray, dict[str, FloatArray]]:
    """The origin (3,) of the cells (K,3) of all devices, and those of each in metres (K,2).

    The site is where most devices are, each counted once whatever it says that it has: their
    middles lie within `MAX_REACH_M` of one of them. Of as many devices here as there, the first by
    name decides, and a warning says so.
    """
    middles = {device: _middle(cells) for device, cells in places.items() if len(cells)}
    near = _largest_site(middles, progress)
    origin = _origin_of(np.array([middles[device] for device in near]).reshape(-1, 3))
    own_m = {device: enu_from_geodetic(cells, origin) for device, cells in places.items()}
    owners = [device for device, positions in own_m.items() for _ in positions]
    positions = np.concatenate([*own_m.values(), np.zeros((0, 3))])
    _leave_out_other_sites([f"those of {owner}" for owner in owners], positions, progress)
    here = np.isfinite(positions).all(axis=1)
    return origin, {device: positions[here & (np.array(owners) == device), :2] for device in places}


def weigh_claims(owners: Sequence[str], progress: Progress) -> Any:
    """The rows (P,) of planned photographs that count, by the device of each: of one device at most
    `MOST_TIMES` as many as the lower median of all, evenly drawn.

    Steps are shared by photographs, and how many a device has is what it says: without a limit one
    number takes the training of all others (`StepLaw`).
    """
    rows = {device: np.flatnonzero([owner == device for owner in owners]) for device in dict.fromkeys(owners)}
    counts = sorted(len(device_rows) for device_rows in rows.values())
    most = MOST_TIMES * counts[(len(counts) - 1) // 2] if counts else 0
    for device, device_rows in rows.items():
        if len(device_rows) > most:
            claim = f"device {device} has {len(device_rows):,} photographs, more than {MOST_TIMES} times as many as most devices"
            progress.listen(Warned(stage="plan", message=f"{claim}: steps are shared as if there were {most:,}."))
            rows[device] = device_rows[np.linspace(0, len(device_rows) - 1, most).round().astype(np.int64)]
    return np.sort(np.concatenate([*rows.values(), np.zeros(0, np.int64)]))


def _largest_site(middles: Mapping[str, FloatArray], progress: Progress) -> list[str]:
    """The devices about that one which has most others within reach."""
    sites: dict[str, list[str]] = {}
    for device, middle in middles.items():
        away_m = {other_device: np.linalg.norm(enu_from_geodetic(position[None], middle)[0]) for other_device, position in middles.items()}
        sites[device] = [other_device for other_device, distance_m in away_m.items() if distance_m <= MAX_REACH_M]
    if not sites:
        return []
    chosen = max(sites.values(), key=len)
    rivals = [site for site in sites.values() if len(site) == len(chosen) and not {*site} & {*chosen}]
    if rivals:
        both = f"{len(chosen)} of {len(middles)} devices are at the site of {chosen[0]} and as many at that of {rivals[0][0]}"
        message = f"{both}, too far apart for one run: that of {chosen[0]} is taken; run the other by itself, or leave out who is wrong."
        progress.listen(Warned(stage="plan", message=message))
    return chosen


def _origin_of(positions: FloatArray) -> FloatArray:
    """The median of positions (P,3), rounded to about ten metres: it is sent to all devices, and a
    median is one's position."""
    if not len(positions):
        raise BadInput(
            "no photograph has a GPS position with an altitude, which --frames gps needs: give poses with --frames known, or pool them "
            "(shared), where horizontal positions are enough."
        )
    middle = _middle(positions)
    return np.array([*np.round(middle[:2], 4), np.round(middle[2], -1)])


def _locate_by_gps(config: RunConfig, folders: dict[str, Path] | None, progress: Progress) -> Captured:
    """Positions from EXIF: one process per device folder, or one for the folder of all."""
    places = {None: photo_folder(config.source)} if folders is None else dict(folders)
    names: list[str] = []
    owners: list[str | None] = []
    geodetic: list[tuple[float, float, float] | None] = []
    for owner, place in places.items():
        try:
            lat_lon_alt_of = _positions_in(place, "positions" if owner is None else f"positions/{owner}", progress)["photographs"]
        except (BadInput, StageFailed, OSError) as error:
            if owner is None:
                raise
            progress.listen(Warned(stage="plan", message=f"device {owner} takes no part: {_reason(error)}"))
            continue
        names += lat_lon_alt_of
        owners += [owner] * len(lat_lon_alt_of)
        geodetic += lat_lon_alt_of.values()
    known_geodetic = np.array([place for place in geodetic if place is not None], np.float64).reshape(-1, 3)
    origin = _origin_of(known_geodetic)
    positions = np.full((len(names), 3), np.nan)
    positions[[place is not None for place in geodetic]] = enu_from_geodetic(known_geodetic, origin)
    labels = [name if owner is None else f"one of {owner}" for name, owner in zip(names, owners, strict=True)]
    _leave_out_other_sites(labels, positions, progress)
    return Captured(names=tuple(names), owners=tuple(owners), positions=positions, origin=origin)


def _positions_in(place: Path, stage: str, progress: Progress, cell_m: float | None = None, held_out: Sequence[str] = ()) -> dict[str, Any]:
    """The record of `run_positions` on the photographs in `place`, in a process of its own."""
    folder = progress.manifest.folder / stage
    folder.mkdir(parents=True, exist_ok=True)
    task = PositionsTask(source=str(place.resolve()), cell_m=cell_m, held_out=tuple(held_out), owned=stage != "positions")
    save_task(folder, task)
    # No other process may open them. Heads are cheap to read again; equal ones change no plan.
    photographs = {name: (place / name).stat() for name in photograph_names(place)}
    key = content_key(__version__, task_key(task), [(name, file.st_size, file.st_mtime_ns) for name, file in photographs.items()])
    run_task(NodeTask(kind="positions", stage=stage, folder=folder, key=key), progress.listen, progress.clock)
    return read_json(folder / ("positions.json" if cell_m is None else "raster.json"))


def _reason(error: BadInput | StageFailed | OSError) -> str:
    """Why a device takes no part; without the file that an error of the operating system names."""
    return (error.strerror or type(error).__name__) if isinstance(error, OSError) else str(error)


def _middle(lat_lon_alt: FloatArray) -> FloatArray:
    """The median (3,) of (P,3); longitudes from the first: a site may span the 180th meridian."""
    turned = lat_lon_alt.copy()
    turned[:, 1] = (lat_lon_alt[:, 1] - lat_lon_alt[0, 1] + 180) % 360 - 180
    middle = np.median(turned, axis=0)
    middle[1] = (middle[1] + lat_lon_alt[0, 1] + 180) % 360 - 180
    return middle


def _leave_out_other_sites(names: Sequence[str], positions: FloatArray, progress: Progress) -> None:
    """Set positions (P,3) m far from the origin to NaN in place: one run makes one scene."""
    away_m = np.linalg.norm(positions[:, :2], axis=1)
    far = np.flatnonzero(away_m > MAX_REACH_M)
    if len(far):
        distant = f"{len(far)} of {len(names)} photographs lie more than {MAX_REACH_M / 1e3:.0f} km from the middle of all"
        first = f"{names[far[0]]} first with {away_m[far[0]] / 1e3:,.0f} km"
        progress.listen(Warned(stage="plan", message=f"{distant}, {first}, and are left out: run another site by itself."))
        positions[far] = np.nan


def photo_folder(source: Path) -> Path:
    """Return the folder of photographs in a source: images/ if there is one."""
    return source / "images" if (source / "images").is_dir() else source


def _locate_by_poses(poses: GivenPoses, folders: dict[str, Path] | None, source: Path, progress: Progress) -> Captured:
    """Positions from given poses; with device folders each belongs to the device with its file."""
    names = poses.cameras.names
    if folders is None:
        copies = file_copies({name: poses.photos / name for name in names})
        for message in copies_warning(copies, len(names)):
            progress.listen(Warned(stage="plan", message=message))
        names = tuple(name for name in names if name not in copies)
        absent = [name for name in names if not (poses.photos / name).is_file()]
        owners: list[str | None] = [None] * len(names)
    else:
        owner_of: dict[str, str] = {}
        for device, name in [(device, name) for device, folder in folders.items() for name in names if (folder / name).is_file()]:
            if owner_of.setdefault(name, device) != device:
                raise BadInput(
                    f"devices {owner_of[name]} and {device} both have a photograph {name!r}, and the poses do not say whose they are: "
                    "rename one, there and in the poses."
                )
        absent = [name for name in names if name not in owner_of]
        owners = [owner_of.get(name) for name in names]
    if absent:
        raise BadInput(f"photograph {absent[0]!r} of the poses is not in {source} ({len(absent)} in all): fetch it or drop its pose.")
    return Captured(names=names, owners=tuple(owners), positions=poses.cameras.named(names).centers, origin=None)


def _warn_of_unplaced(captured: Captured, progress: Progress) -> None:
    lost = np.flatnonzero(~captured.placed)
    named = [captured.names[index] for index in lost if captured.owners[index] is None]
    if named:
        listed = ", ".join(named[:MAX_NAMED]) + (" …" if len(named) > MAX_NAMED else "")
        progress.listen(
            Warned(stage="plan", message=f"{len(named)} of {len(captured.names)} photographs have no usable position: {listed}.")
        )
    for owner, count in Counter(owner for index in lost if (owner := captured.owners[index]) is not None).items():
        message = f"{count} of {captured.owners.count(owner)} photographs of device {owner} have no usable position."
        progress.listen(Warned(stage="plan", message=message))
