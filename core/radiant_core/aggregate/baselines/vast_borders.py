"""Where VastGaussian's cells meet, so that its seams are looked for where it cuts. Once per mask.

Cells are rectangles, so the border of its own cell that is nearest to a place is straight across the nearest side that has a neighbour.
P positions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from radiant_core.aggregate.baselines.vast_gaussian import VastCell
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, checked_array


def cell_owners(points_xy: FloatArray, cells: Sequence[VastCell]) -> NDArray[np.int64]:
    """Index (P,) of the cell that owns each position (P,2) m. BadInput without cells or for positions that are not finite."""
    points_xy = checked_array("points_xy", points_xy, (None, 2))
    if not cells:
        raise BadInput("no cells own anything: pass those of `vast_cells`.")
    return np.argmax([cell.owns(points_xy) for cell in cells], axis=0)


def nearest_cell_border(points_xy: FloatArray, cells: Sequence[VastCell]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Distance (P,) m of positions (P,2) to the border of their own cell, and the two cells (P,2) that meet there, the lower index first.

    Infinite and -1 where there is one cell. Raises as `cell_owners`.
    """
    owners = cell_owners(points_xy, cells)
    regions = np.stack([cell.region for cell in cells])[owners]
    gaps = np.abs(points_xy[:, None] - regions).reshape(len(points_xy), 4)
    nearest = gaps.argmin(axis=1)
    distances = gaps[np.arange(len(gaps)), nearest]
    met = np.isfinite(distances)
    side, axis = np.divmod(nearest, 2)
    across = np.array(points_xy, np.float64)
    rows = np.flatnonzero(met)
    # A cell owns its low sides: the neighbour begins one step below them, and at a high side itself.
    edges = regions[rows, side[rows], axis[rows]]
    across[rows, axis[rows]] = np.where(side[rows] == 0, np.nextafter(edges, -np.inf), edges)
    pairs = np.sort(np.stack([owners, cell_owners(across, cells)], axis=1), axis=1)
    return distances, np.where(met[:, None], pairs, -1)
