"""Where the edges stand: given in metres or latitude and longitude, or placed among the cameras.

Placing starts with k-means++ (Arthur, Vassilvitskii 2007: the next site is a camera drawn with
probability ∝ its squared distance to the sites so far) and goes on with a few rounds of Lloyd's;
given positions take part but stay. Runs once per plan.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.plan.system import Edge, System

MAX_COORDINATE_M = 1e8
"""Coordinates may be UTM-sized, not of another planet."""
FAR_M = 100e3
"""A site is no wider: an edge beyond has its place from another system file."""
EARTH_M = 6.371e6
_LLOYD_ROUNDS = 10
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def place_edges(system: System, positions: ArrayLike, origin_lat_lon_alt: ArrayLike | None, seed: int) -> System:
    """The system with every edge at a position in metres, for cameras (C,2) m about an origin (3,)
    [deg, deg, m]; seeded ones lie inside the cameras' bounding box. Raises BadInput for latitude
    and longitude without an origin (None), for no cameras, and for positions beyond 1e8 m."""
    positions = check_array("positions", positions, (None, 2))
    if not len(positions):
        raise BadInput("no camera positions were given to place the edges among: give at least one.")
    located = [_locate(edge, origin_lat_lon_alt) for edge in system.edges]
    fixed = [edge.position for edge in located if edge.position is not None]
    require_within_reach(positions, np.array(fixed).reshape(-1, 2))
    num_free = len(located) - len(fixed)
    free = iter(_seeded_positions(positions, np.array(fixed).reshape(-1, 2), num_free, seed))
    edges = [edge if edge.position is not None else _move_to(edge, next(free)) for edge in located]
    return replace(system, edges=tuple(edges))


def distant_edges(system: System, origin_lat_lon_alt: ArrayLike | None) -> tuple[str, ...]:
    """A sentence for each edge whose latitude and longitude are `FAR_M` or more over the globe from
    the origin (3,) [deg, deg, m] of the cameras; none without an origin (None)."""
    if origin_lat_lon_alt is None:
        return ()
    away = {edge.id: _over_globe_m(edge.lat_lon_deg, origin_lat_lon_alt) for edge in system.edges if edge.lat_lon_deg is not None}
    return tuple(
        f"Edge {name!r} stands {away_m / 1000:,.0f} km from the photographs: change lat_lon_deg in its system file, or leave it out to "
        "have it placed among them."
        for name, away_m in away.items()
        if away_m >= FAR_M
    )


def _over_globe_m(lat_lon_deg: ArrayLike, other_lat_lon_deg: ArrayLike) -> float:
    """Metres along the great circle between two places, good to half a percent."""
    (lat, lon), (other_lat, other_lon) = (np.radians(np.asarray(place, float)[:2]) for place in (lat_lon_deg, other_lat_lon_deg))
    half = np.sin((lat - other_lat) / 2) ** 2 + np.cos(lat) * np.cos(other_lat) * np.sin((lon - other_lon) / 2) ** 2
    return float(2 * EARTH_M * np.arcsin(min(1.0, np.sqrt(half))))


def require_within_reach(*positions: FloatArray) -> None:
    """Raise BadInput for a position (…,2) of a camera or edge beyond `MAX_COORDINATE_M`."""
    farthest_m = max((float(np.abs(some).max()) for some in positions if len(some)), default=0.0)
    if farthest_m > MAX_COORDINATE_M:
        raise BadInput(f"a camera or edge is {farthest_m:.3g} m from the origin, expected at most {MAX_COORDINATE_M:g} m.")


def separate_sites(sites: FloatArray, extent_m: float) -> FloatArray:
    """Sites (E,2) m of which no two share a spot: those within 1e-6 extents of an earlier one step
    aside by about 1e-3 extents, so that there is a border; the nearest cameras stay the same."""
    sites = sites.copy()
    for index in range(1, len(sites)):
        spot, turn = sites[index].copy(), index
        while np.hypot(*(sites[:index] - sites[index]).T).min() <= 1e-6 * extent_m:
            angle = _GOLDEN_ANGLE * turn
            sites[index] = spot + 1e-3 * extent_m * np.sqrt(turn) * np.array([np.cos(angle), np.sin(angle)])
            turn += 1
    return sites


def _locate(edge: Edge, origin_lat_lon_alt: ArrayLike | None) -> Edge:
    if edge.position is not None or edge.lat_lon_deg is None:
        return edge
    if origin_lat_lon_alt is None:
        raise BadInput(
            f"edge {edge.id!r} stands at latitude and longitude {edge.lat_lon_deg}, but the scene has no GPS: give the edge "
            "position_m, or neither to have it placed."
        )
    origin = check_array("origin_lat_lon_alt", origin_lat_lon_alt, (3,))
    return _move_to(edge, enu_from_geodetic([[*edge.lat_lon_deg, origin[2]]], origin)[0])


def _move_to(edge: Edge, position: FloatArray) -> Edge:
    return replace(edge, position=(float(position[0]), float(position[1])))


def _seeded_positions(positions: FloatArray, fixed: FloatArray, num_free: int, seed: int) -> FloatArray:
    """Positions (num_free,2) m of the edges that may stand anywhere, beside `fixed` (G,2) m."""
    rng = np.random.default_rng(seed)
    sites = fixed
    for _ in range(num_free):
        sites = np.vstack([sites, _next_seed(positions, sites, rng)])
    for _ in range(_LLOYD_ROUNDS if num_free else 0):
        cell = assign(positions, sites, np.zeros(len(sites)))
        counts = np.bincount(cell, minlength=len(sites))
        sums = np.stack([np.bincount(cell, weights=axis, minlength=len(sites)) for axis in positions.T], axis=1)
        moves = (counts > 0) & (np.arange(len(sites)) >= len(fixed))
        sites = np.where(moves[:, None], sums / np.maximum(counts, 1)[:, None], sites)
    # A mean of equal coordinates may leave the box by a rounding error.
    return np.clip(sites[len(fixed) :], positions.min(axis=0), positions.max(axis=0))


def _next_seed(positions: FloatArray, sites: FloatArray, rng: np.random.Generator) -> FloatArray:
    if not len(sites):
        return positions[rng.integers(len(positions))]
    nearest = sites[assign(positions, sites, np.zeros(len(sites)))]
    squared = np.sum((positions - nearest) ** 2, axis=1)
    if not squared.any():  # more edges than distinct cameras
        return positions[rng.integers(len(positions))]
    return positions[rng.choice(len(positions), p=squared / squared.sum())]
