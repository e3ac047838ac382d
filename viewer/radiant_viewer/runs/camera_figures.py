"""The figures of a scene's cameras as a table that can be sorted and filtered. Pure; once per plan.

psnr < 22 and region = north    a filter: all conditions hold; names: =, != and ~ (finds a part)
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.footprints import Footprints
from radiant_core.plan.plans import CloudPlan
from radiant_core.scene import SfmScene
from radiant_viewer.layers.camera_roles import CameraRoles
from radiant_viewer.runs.places import camera_heights, natural_key

_CONDITION = re.compile(r"\s*([a-z_]+)\s*(<=|>=|!=|<|>|=|~)\s*(.+?)\s*")


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraFigures:
    """columns: name → (C,) texts or float64, NaN for no figure; headings: name → text with unit."""

    columns: Mapping[str, NDArray[Any]]
    headings: Mapping[str, str]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def column(self, name: str) -> NDArray[Any]:
        """Return one column; BadInput for an unknown name."""
        if name not in self.columns:
            raise BadInput(f"cameras have no figure {name!r}: use one of {', '.join(self.columns)}.")
        return self.columns[name]


def camera_figures(
    scene: SfmScene,
    roles: CameraRoles,
    cloud_plan: CloudPlan,
    psnr_db: Mapping[str, float] | None = None,
    footprints: Footprints | None = None,
) -> CameraFigures:
    """Return all figures of the scene's C cameras that need no photograph."""
    cameras, unit = scene.cameras, scene.frame.unit
    count = len(cameras)
    centers = cameras.centers
    edges = roles.edge_of_camera
    heading, heights = camera_heights(scene)
    distance = np.full(count, np.nan)
    planned = edges >= 0
    distance[planned] = np.linalg.norm(cloud_plan.places_of(centers[planned, :2]) - cloud_plan.sites[edges[planned]], axis=1)
    columns: dict[str, NDArray[Any]] = {
        "name": np.array(cameras.names, dtype=str),
        "region": np.array([*roles.edge_ids, ""])[edges],
        "device": np.array([*roles.device_ids, ""])[roles.device_of_camera],
        "use": np.where(roles.held_out, "held out", "training"),
        "psnr": np.array([(psnr_db or {}).get(name, np.nan) for name in cameras.names], np.float64),
        "points": np.bincount(scene.observations[:, 1], minlength=count).astype(np.float64),
        "east": centers[:, 0],
        "north": centers[:, 1],
        "height": heights,
        "distance": distance,
    }
    headings = {
        "name": "Photograph",
        "region": "Region",
        "device": "Device",
        "use": "Use",
        "psnr": "PSNR (dB)",
        "points": "Points seen",
        "east": f"East ({unit})",
        "north": f"North ({unit})",
        "height": heading,
        "distance": f"To its edge ({unit})",
    }
    if footprints is not None:
        columns |= {"area": footprints.areas_m2, "footprints": count_overlaps(footprints)}
        headings |= {"area": f"Footprint ({unit}²)", "footprints": "Images that see its middle"}
    return CameraFigures(columns=columns, headings=headings)


def count_overlaps(footprints: Footprints) -> FloatArray:
    """Return how many other footprints contain each one's middle (P,), NaN where it has no area."""
    middles = footprints.polygons.mean(axis=1)
    sees = footprints.areas_m2 > 0
    counts = np.full(len(footprints), np.nan)
    counts[sees] = -1.0
    for polygon in footprints.polygons[sees]:
        near = np.flatnonzero(sees & ((middles >= polygon.min(axis=0)) & (middles <= polygon.max(axis=0))).all(axis=1))
        inside = np.ones(len(near), bool)
        for here, there in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            side, local = there - here, middles[near] - here
            inside &= side[0] * local[:, 1] - side[1] * local[:, 0] >= 0
        counts[near[inside]] += 1
    # Rounding may put the middle of a thin footprint outside of it.
    return np.where(sees, np.maximum(counts, 0), np.nan)


def sort_rows(figures: CameraFigures, name: str, *, descending: bool = False) -> NDArray[np.int64]:
    """Return the rows (C,) in the order of a column, stable; cameras without the figure come last
    in both directions."""
    values = figures.column(name)
    if values.dtype.kind == "f":
        unknown = np.isnan(values)
        keys = np.where(unknown, 0.0, -values if descending else values)
        return np.lexsort((keys, unknown))
    _, ranks = np.unique([natural_key(value) for value in values.tolist()], return_inverse=True)
    return np.lexsort((-ranks if descending else ranks, values == ""))


def filter_rows(figures: CameraFigures, text: str) -> NDArray[np.int64]:
    """Return the rows (K,) that meet all conditions of a filter; a lone word is searched in names.
    Raises BadInput with an example for a condition that cannot be parsed."""
    keep_mask = np.ones(len(figures), bool)
    for part in re.split(r"\s+and\s+|,", text.strip()) if text.strip() else []:
        match = _CONDITION.fullmatch(part)
        if match is not None:
            keep_mask &= _holds(figures, match[1], match[2], match[3])
        elif re.fullmatch(r"[^<>=~!]+", part):
            keep_mask &= np.char.find(np.char.lower(figures.column("name")), part.strip().lower()) >= 0
        else:
            raise BadInput(f"{part.strip()!r} is no condition: write for example psnr < 22 and region = north.")
    return np.flatnonzero(keep_mask)


def _holds(figures: CameraFigures, name: str, sign: str, wanted: str) -> NDArray[np.bool_]:
    values = figures.column(name)
    if values.dtype.kind != "f":
        if sign == "~":
            return np.char.find(np.char.lower(values), wanted.lower()) >= 0
        if sign not in ("=", "!="):
            raise BadInput(f"{name} is a name: compare it by =, != or ~, not by {sign}.")
        return (values == wanted) == (sign == "=")
    try:
        number = float(wanted)
    except ValueError:
        raise BadInput(f"{name} is a number and {wanted!r} is none: write for example {name} {sign} 20.") from None
    if sign == "~":
        raise BadInput(f"{name} is a number: compare it by <, <=, =, !=, >= or >.")
    compare = {"<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "=": np.equal, "!=": np.not_equal}
    # A camera without the figure meets no condition on it.
    return compare[sign](values, number) & ~np.isnan(values)
