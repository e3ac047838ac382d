"""Cameras dealt with given counts at the least Σ ‖camera − edge‖², and their power diagram.

    minimise Σ_c ‖x_c − P_e(c)‖²   with exactly counts[e] cameras at edge e

The dual of this transport problem is the power diagram's weights (Aurenhammer, Hoffmann, Aronov,
Algorithmica 1998). The native module solves it on ever finer boxes of cameras: damped Newton on the
smoothed dual (Kitagawa, Mérigot, Thibert, JEMS 2019) over a tree of cameras, a ridge where cells
share no camera, the last cameras by cheapest chains (Ahuja, Magnanti, Orlin, Network Flows, 1993,
ch. 9), which end in the exact optimum whatever Newton left. The certificate over all cameras
follows. Once per plan.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from radiant_core._native import deal_to_cells
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array

Indices = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Dealt:
    """Where the cameras went. edge_of_position (C,): −1 where cameras went to several edges; parts
    (S,3): those as (position, edge, cameras); weights (E,) m²: every camera lies in its power cell
    up to `violation_m2`; 0 for edges without cameras."""

    edge_of_position: Indices
    parts: Indices
    weights: FloatArray
    violation_m2: float
    num_rounds: int
    """How often cameras were counted."""
    num_paths: int
    """Chains of single moves that finished it."""


def deal_with_counts(
    positions: FloatArray, sites: FloatArray, counts: Indices, *, multiplicities: ArrayLike | None = None, weights: FloatArray | None = None
) -> Dealt:
    """Deal cameras at positions (C,2) m to distinct sites (E,2) m with exactly counts (E,).
    multiplicities (C,): cameras at each position, a count raster; weights (E,) m²: of a similar
    plan, to start from. Use coordinates about a local origin. Raises BadInput unless the counts are
    not negative and sum to the cameras."""
    counts = check_array("counts", counts, (len(sites),), np.int64)
    camera_counts = None if multiplicities is None else check_array("multiplicities", multiplicities, (len(positions),), np.int64)
    num_cameras = len(positions) if camera_counts is None else int(camera_counts.sum())
    if counts.min(initial=0) < 0 or (camera_counts is not None and camera_counts.min(initial=0) < 0) or counts.sum() != num_cameras:
        raise BadInput(f"counts sum to {counts.sum()} for {num_cameras} cameras: give counts of at least 0 that sum to the cameras.")
    used = np.flatnonzero(counts)
    out_weights = np.zeros(len(sites))
    if not len(used):
        return Dealt(
            edge_of_position=np.full(len(positions), -1, np.int64),
            parts=np.zeros((0, 3), np.int64),
            weights=out_weights,
            violation_m2=0.0,
            num_rounds=0,
            num_paths=0,
        )
    start = np.zeros(len(used)) if weights is None else np.ascontiguousarray(weights[used])
    cells, parts, dual_weights, violation_m2, rounds, paths = deal_to_cells(
        np.ascontiguousarray(positions),
        camera_counts,
        np.ascontiguousarray(sites[used]),
        counts[used],
        start - start.mean(),
        weights is not None,
    )
    out_weights[used] = dual_weights - dual_weights.mean()
    edge_of_position = np.where(cells >= 0, used[cells], -1)
    parts = np.stack([parts[:, 0], used[parts[:, 1]], parts[:, 2]], axis=1)
    return Dealt(
        edge_of_position=edge_of_position, parts=parts, weights=out_weights, violation_m2=violation_m2, num_rounds=rounds, num_paths=paths
    )


def violations(squared_m2: FloatArray, weights: FloatArray, edge_of_camera: Indices) -> FloatArray:
    """How far each camera is from its own cell, m² (C,): own − min_e of squared_m2[c, e] − w[e]."""
    power = squared_m2 - weights
    return power[np.arange(len(squared_m2)), edge_of_camera] - power.min(axis=1)
