"""Which photographs are matched with which: GPS neighbours, or all pairs without GPS. Per scene."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.spatial import KDTree

from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.io.photos.listing import Photograph
from radiant_core.numerics import FloatArray
from radiant_core.panoramas import frame_of
from radiant_core.sfm.config import SfmConfig

MIN_GPS_SHARE = 0.9
Pairs = list[tuple[str, str]]


def gps_positions(photographs: tuple[Photograph, ...]) -> tuple[FloatArray, FloatArray]:
    """Metres east, north, up (N,3) about the median position, and that origin (3,) [deg, deg, m].
    NaN without GPS, and where GPS has no altitude the height alone; the origin's is 0 where no
    photograph has one."""
    geodetic = _geodetic(photographs)
    has_gps = np.isfinite(geodetic[:, 0])
    high = np.isfinite(geodetic[:, 2])
    origin = np.zeros(3)
    if has_gps.any():
        origin[:2] = np.median(geodetic[has_gps, :2], axis=0)
        origin[2] = np.median(geodetic[high, 2]) if high.any() else 0.0
    return gps_about(photographs, origin), origin


def gps_about(photographs: tuple[Photograph, ...], origin: FloatArray) -> FloatArray:
    """Metres east, north, up (N,3) about an origin (3,) [deg, deg, m], NaN as in
    `gps_positions`."""
    geodetic = _geodetic(photographs)
    has_gps, high = np.isfinite(geodetic[:, 0]), np.isfinite(geodetic[:, 2])
    positions_m = np.full((len(photographs), 3), np.nan)
    level = np.where(high[has_gps], geodetic[has_gps, 2], origin[2])
    positions_m[has_gps] = enu_from_geodetic(np.column_stack([geodetic[has_gps, :2], level]), origin)
    positions_m[~high, 2] = np.nan
    return positions_m


def _geodetic(photographs: tuple[Photograph, ...]) -> FloatArray:
    return np.array([photo.lat_lon_alt or (np.nan,) * 3 for photo in photographs], np.float64).reshape(-1, 3)


def choose_pairs(photographs: tuple[Photograph, ...], config: SfmConfig) -> tuple[Pairs, Decision]:
    """The pairs to match and why; BadInput when spatial matching is requested without any GPS."""
    names = [photo.name for photo in photographs]
    share = float(np.mean([photo.lat_lon_alt is not None for photo in photographs]))
    if config.matching == "spatial" and share == 0:
        raise BadInput("sfm.matching is 'spatial' and no photograph has a GPS position: use 'auto' or 'exhaustive'.")
    spatial = config.matching == "spatial" or (config.matching == "auto" and share >= MIN_GPS_SHARE)
    if spatial:
        pairs = neighbor_pairs(names, gps_positions(photographs)[0], config.num_neighbors)
        reason = f"each photograph is matched with its {config.num_neighbors} nearest by GPS"
    else:
        pairs = [pair for pair in combinations(names, 2) if frame_of(pair[0]) != frame_of(pair[1])]
        reason = f"under {MIN_GPS_SHARE:.0%} have a GPS position, so every pair is matched"
    forced = config.matching != "auto"
    decision = Decision(
        stage="sfm",
        topic="matching",
        choice=f"{'spatial' if spatial else 'exhaustive'}, {len(pairs)} pairs",
        figure=100 * share,
        unit="% with GPS",
        reason="asked for" if forced else reason,
        forced=forced,
    )
    return pairs, decision


def neighbor_pairs(names: list[str], positions_m: FloatArray, num_neighbors: int) -> Pairs:
    """Each name with its nearest others by horizontal distance, as GPS heights are worst, and those
    without a position (NaN) with every other; sorted, each pair once. Faces of panoramas go with
    all faces of the nearest others, and not with those of their own."""
    members: dict[str, list[int]] = {}
    for index, name in enumerate(names):
        members.setdefault(frame_of(name), []).append(index)
    if len(members) == len(names):
        return [(names[a], names[b]) for a, b in _nearest_pairs(positions_m, num_neighbors)]
    frames = list(members.values())
    nearest = _nearest_pairs(positions_m[[frame[0] for frame in frames]], num_neighbors)
    numbered = {(min(a, b), max(a, b)) for first, second in nearest for a in frames[first] for b in frames[second]}
    return [(names[a], names[b]) for a, b in sorted(numbered)]


def _nearest_pairs(positions_m: FloatArray, num_neighbors: int) -> list[tuple[int, int]]:
    rows = np.flatnonzero(np.isfinite(positions_m[:, 0]))
    pairs: set[tuple[int, int]] = set()
    if len(rows) > 1:
        flat = positions_m[rows, :2]
        nearest = np.asarray(KDTree(flat).query(flat, k=min(num_neighbors + 1, len(rows)))[1])
        first, second = np.repeat(rows, nearest.shape[1]), rows[nearest.ravel()]
        pairs = {(min(a, b), max(a, b)) for a, b in zip(first.tolist(), second.tolist(), strict=True) if a != b}
    count = len(positions_m)
    for index in np.setdiff1d(np.arange(count), rows).tolist():
        pairs |= {(min(index, partner), max(index, partner)) for partner in range(count) if partner != index}
    return sorted(pairs)


def pairs_with(names: list[str], chosen: tuple[str, ...], earlier_pairs: Pairs) -> Pairs:
    """Every pair with one of `chosen` in it that is not among `earlier_pairs` yet."""
    matched = {frozenset(pair) for pair in earlier_pairs}
    wanted = set(chosen)
    return [
        pair
        for pair in combinations(names, 2)
        if not wanted.isdisjoint(pair) and frozenset(pair) not in matched and frame_of(pair[0]) != frame_of(pair[1])
    ]
