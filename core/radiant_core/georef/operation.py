"""The operation by which PROJ moves places between WGS84 and a system, chosen for one place. Once
per system and site.

PROJ knows several for most pairs of systems, each with an area and an accuracy by EPSG. The best
of those whose grids are installed is used, for all of a site alike, and never one that skips a
shift of datum. Where the best of all lacks its grids, `Operation` says so: `only_best` of PROJ
does not, it takes the next one in silence (PROJ 9.5.1, EPSG:27700 without OSTN15: 1 to 5 m). Nor
does it say that a grid with an @ before its name, optional in PROJ strings and WKT, is not there:
it shifts nothing then (+nadgrids=@OSTN15_NTv2_OSGBtoETRS.gsb: 110 m).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from radiant_core.errors import BadInput

GEODETIC_3D = "EPSG:4979"
HALF_SIDE_DEG = 0.001
"""Of the area around a place that PROJ is asked for."""
COARSE_M = 5.0
"""What GPS of photographs is good to: an operation that is no better is told of."""
NO_SHIFT = "null"
"""PROJ's name of a grid that shifts nothing, which is asked for where it stands."""
_SUFFIX = re.compile(r"\.(?:tif|gsb|gtx)$", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class Operation:
    """What is used, and what would be better."""

    pipeline: str
    """PROJ's, from longitude, latitude and height; empty where nothing can be used."""
    accuracy_m: float | None
    """What EPSG says of it; None where nobody says."""
    missing: tuple[str, ...] = ()
    """Grids that the best operation lacks."""
    best_accuracy_m: float | None = None
    """What EPSG says of that one."""


@lru_cache(maxsize=64)
def operation_at(definition: str, lat_deg: float, lon_deg: float) -> Operation:
    """The operation from WGS84 to the system of a definition that PROJ reads, at a place."""
    from pyproj import CRS
    from pyproj.exceptions import ProjError
    from pyproj.transformer import AreaOfInterest, TransformerGroup

    low_lat, high_lat = max(lat_deg - HALF_SIDE_DEG, -90.0), min(lat_deg + HALF_SIDE_DEG, 90.0)
    low_lon, high_lon = max(lon_deg - HALF_SIDE_DEG, -180.0), min(lon_deg + HALF_SIDE_DEG, 180.0)
    area = AreaOfInterest(low_lon, low_lat, high_lon, high_lat)
    system = CRS.from_user_input(definition)
    with warnings.catch_warnings():
        # It warns of one grid, by its internal name; `shortfall` says it of all.
        warnings.simplefilter("ignore", UserWarning)
        try:
            group = TransformerGroup(GEODETIC_3D, system, always_xy=True, area_of_interest=area, allow_ballpark=False)
        except ProjError:
            return Operation(pipeline="", accuracy_m=None)
    used = group.transformers[0] if group.transformers else None
    skipped, has_others = _optional_grids(used)
    if used is not None and skipped:
        # Named by the system itself, so that nothing else is as good.
        return Operation(pipeline=used.definition if has_others else "", accuracy_m=None, missing=skipped)
    better = None if group.best_available or not group.unavailable_operations else group.unavailable_operations[0]
    return Operation(
        pipeline="" if used is None else used.definition,
        accuracy_m=None if used is None else _finite_accuracy(used.accuracy),
        missing=() if better is None else tuple(grid.short_name for grid in better.grids if not grid.available),
        best_accuracy_m=None if better is None else _finite_accuracy(better.accuracy),
    )


def _optional_grids(transformer: Any) -> tuple[tuple[str, ...], bool]:
    """Optional grids of a transformer that are not installed, and whether any other one is."""
    grids = [grid for step in (transformer.operations or ()) for grid in step.grids] if transformer is not None else []
    named = {grid.short_name.removeprefix("@"): bool(grid.available) for grid in grids}
    named.pop(NO_SHIFT, None)
    return tuple(name for name, is_there in named.items() if not is_there), any(named.values())


def shortfall(operation: Operation, title: str) -> str | None:
    """One sentence on the grids that are missing and what their lack costs; None where the best
    operation is used, or none can be."""
    if not operation.pipeline or not operation.missing:
        return None
    used = "with an accuracy that nobody states" if operation.accuracy_m is None else f"to about {operation.accuracy_m:g} m"
    best = "" if operation.best_accuracy_m is None else f" instead of {operation.best_accuracy_m:g} m"
    are = "is" if len(operation.missing) == 1 else "are"
    return (
        f"{title} is computed here {used}{best} (EPSG's figures, single places may be off by several times as much): "
        f"{_grids(operation.missing)} {are} not installed, {how_to_get(operation.missing)}."
    )


def coarseness(operation: Operation, title: str) -> str | None:
    """One sentence where even the best operation is worse than GPS; None where it is not, or nobody
    says."""
    if operation.missing or operation.accuracy_m is None or operation.accuracy_m <= COARSE_M:
        return None
    return (
        f"{title} is computed here to about {operation.accuracy_m:g} m (EPSG's figure): PROJ knows no better operation from WGS84, with "
        "or without grids."
    )


def require_usable(operation: Operation, title: str, *, has_vertical: bool) -> None:
    """Raise BadInput, with the grids that are missing, where no operation can be used."""
    if operation.pipeline:
        return
    if not operation.missing and has_vertical:
        raise BadInput(
            f"PROJ knows no operation between heights over the WGS84 ellipsoid and those of {title} here, with or without grids: name the "
            "system without its vertical datum, or with another one."
        )
    if not operation.missing:
        raise BadInput(f"PROJ knows no way from WGS84 to {title} that keeps the datum here: name the system by its EPSG code.")
    alternative = ", or name the system without its vertical datum" if has_vertical else ""
    are = "is" if len(operation.missing) == 1 else "are"
    raise BadInput(f"{title} needs {_grids(operation.missing)}, which {are} not installed: {how_to_get(operation.missing)}{alternative}.")


def how_to_get(grids: Sequence[str]) -> str:
    """The commands that fetch grids, as a part of a sentence."""
    # Older names of grids, as PROJ strings have them, are parts of those of today.
    commands = " and ".join(f"`pyproj sync --file {_SUFFIX.sub('', name)}`" for name in grids)
    return f"get {'it' if len(grids) == 1 else 'them'} with {commands}"


def _grids(names: Sequence[str]) -> str:
    return f"the grid {names[0]}" if len(names) == 1 else f"the grids {', '.join(names[:-1])} and {names[-1]}"


def _finite_accuracy(accuracy: float) -> float | None:
    return float(accuracy) if accuracy >= 0 else None
