"""Half as many Gaussians that look alike from twice as far: groups of neighbours become one each.
Once per cell and level.

Gaussian i covers A_i, the area of its ellipsoid, and has the mass w_i = α_i A_i. A group becomes

    w = Σ w_i                                           mass
    μ = Σ w_i μ_i / w                                   mean
    S = Σ w_i (S_i + (μ_i − μ)(μ_i − μ)ᵀ) / w           covariance
    α = w / A(S)                                        harmonics as the mean

(Kerbl et al., A Hierarchical 3D Gaussian Representation, 2024, sec. 4.1). Where α would exceed
`MAX_OPACITY`, as for a third of the pairs of a town, S grows until it does not: what is opaque
keeps the area that it covers, which is worth 0.4 to 1.9 dB. Groups grow by the pairs
whose joining is seen least: Ward's criterion for their areas and unlike colours f,

    cost = w_i w_j / (w_i + w_j) · (‖μ_i − μ_j‖² + (r_i − r_j)²) / (r_i² + r_j²)
           · (c₀ + ‖f_i − f_j‖²)

with r² = tr S. In a round those pairs are joined that are the cheapest of both their members, and
of these the cheapest share: all of them at once joined the large ones of the sample town's rim too
early, at a cost of 10 dB. Deterministic, and a function of the given Gaussians alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from scipy.special import logit  # pyright: ignore[reportMissingTypeStubs]

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array, rotmats_from_quats
from radiant_core.splats import SH_C0, Splats

MAX_OPACITY, MIN_OPACITY = 1 - 2.0**-9, 2.0**-20
"""The ends of what is stored of a group: both logits are finite, and in 8 bits they are 1 and 0."""
NUM_NEIGHBOURS = 6
PLAIN_COLOR = 0.02
"""c₀ above: what joining costs where colours are equal."""
SHARE_PER_ROUND = 0.4
MAX_ROUNDS = 100
THINNEST = 1e-6
"""Least standard deviation of a group as a share of its greatest: rounding makes thinner ones
imaginary."""
_AREA_POWER = 1.6
"""Knud Thomsen's formula for the area of an ellipsoid, within 1.2 %."""


@dataclass(eq=False)
class _Growing:
    """Groups while they grow, by their first member: masses (N,), means (N,3), square radii (N,),
    colours (N,3); group (N,) of each Gaussian; edges (E,2) of groups and their costs (E,)."""

    masses: FloatArray
    means: FloatArray
    squares: FloatArray
    colors: FloatArray
    group: NDArray[np.int64]
    edges: NDArray[np.int64]
    costs: FloatArray


def halve(splats: Splats) -> Splats:
    """About N/2 Gaussians for N, in the order of the first members of their groups; more where
    groups have no neighbours left. Raises BadInput as `merge_groups`."""
    return halve_within(splats, np.zeros(len(splats), np.int64))[0]


def halve_within(splats: Splats, cells: NDArray[np.int64]) -> tuple[Splats, NDArray[np.int64]]:
    """As `halve`, where only Gaussians of the same of `cells` (N,) are joined, the cheapest of all
    cells first; also the cell of each. A cell of large ones that nobody can join unseen, as at a
    scene's rim, keeps more of them."""
    cells = check_array("cells", cells, (len(splats),), np.int64)
    groups = group_neighbours(splats, -(-len(splats) // 2), cells)
    group_cells = np.zeros(int(groups.max(initial=-1)) + 1, np.int64)
    group_cells[groups] = cells
    return merge_groups(splats, groups), group_cells


def merge_groups(splats: Splats, groups: NDArray[np.int64]) -> Splats:
    """One Gaussian per group for N with groups (N,), which are numbered from 0 without gaps.

    Computed in float64 about each group's mean. A group of one keeps its bits. Raises BadInput for
    other numbers, and when a result leaves float32.
    """
    groups = check_array("groups", groups, (len(splats),), np.int64)
    sizes = np.bincount(groups) if len(groups) and groups.min() >= 0 else np.zeros(0, np.int64)
    if len(groups) and not (len(sizes) and sizes.min() > 0):
        raise BadInput(f"the groups are not numbered from 0 to {len(sizes) - 1} without gaps: number them so.")
    lone = np.flatnonzero(sizes[groups] == 1)
    joined = np.flatnonzero(sizes[groups] > 1)
    numbers = np.flatnonzero(sizes > 1)
    place = np.zeros(len(sizes), np.int64)
    place[numbers] = np.arange(len(numbers))
    merged = _merged(splats.select(joined), place[groups[joined]], len(numbers))
    result = {}
    for name, array in splats.arrays().items():
        result[name] = np.empty((len(sizes), *array.shape[1:]), np.float32)
        result[name][groups[lone]] = array[lone]
        result[name][numbers] = merged[name]
    return replace(splats, **result)


def group_neighbours(splats: Splats, target: int, cells: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
    """Groups (N,) of neighbours, numbered by their first members: `target` of them, or more where
    none has a neighbour left, of its cell (N,) if they are given."""
    count = len(splats)
    if count <= max(target, 1):
        return np.arange(count)
    growing = _start(splats, np.zeros(count, np.int64) if cells is None else cells)
    remaining = count
    for _ in range(MAX_ROUNDS):
        pairs = _cheapest_pairs(growing)
        wanted = max(int(SHARE_PER_ROUND * len(pairs)), min(len(pairs), 16))
        pairs = pairs[: min(wanted, remaining - target)]
        if not len(pairs):
            break
        _join(growing, pairs)
        remaining -= len(pairs)
    return np.unique(growing.group, return_inverse=True)[1].ravel()


def ellipsoid_areas(scales: FloatArray) -> FloatArray:
    """Surface areas (N,) of ellipsoids of half axes (N,3), within 1.2 %."""
    # The largest axis is taken out: powers of 1e20 m would overflow where the area does not.
    largest = np.maximum(scales.max(axis=1, initial=0.0), np.finfo(np.float64).tiny)
    a, b, c = ((scales / largest[:, None]) ** _AREA_POWER).T
    return 4 * np.pi * largest**2 * ((a * b + a * c + b * c) / 3) ** (1 / _AREA_POWER)


def covariances(splats: Splats) -> FloatArray:
    """Covariances (N,3,3) m² of N Gaussians, float64."""
    axes = rotmats_from_quats(splats.quats) * np.exp(splats.log_scales.astype(np.float64))[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def masses_of(splats: Splats) -> FloatArray:
    """Opacity times area (N,) m²."""
    return splats.opacities * ellipsoid_areas(np.exp(splats.log_scales.astype(np.float64)))


def _merged(splats: Splats, groups: NDArray[np.int64], count: int) -> dict[str, FloatArray]:
    # Those that are as good as transparent still have a place among themselves.
    weights = np.maximum(masses_of(splats), 1e-30)
    totals = np.bincount(groups, weights, count)
    shares = weights / totals[groups]
    first = np.zeros(count, np.int64)
    first[groups[::-1]] = np.arange(len(groups))[::-1]
    exact = splats.means.astype(np.float64)
    # Offsets from a member: sums of positions far from the origin would lose their digits.
    means = exact[first] + _sums(shares[:, None] * (exact - exact[first][groups]), groups, count)
    offsets = exact - means[groups]
    spread = covariances(splats) + offsets[:, :, None] * offsets[:, None, :]
    scales, quats = _axes(_sums(shares[:, None] * spread.reshape(-1, 9), groups, count).reshape(-1, 3, 3))
    opacities = totals / ellipsoid_areas(scales)
    scales *= np.sqrt(np.maximum(opacities / MAX_OPACITY, 1.0))[:, None]
    opacities = np.clip(opacities, MIN_OPACITY, MAX_OPACITY)
    harmonics = {
        name: _sums(shares[:, None] * array.reshape(len(splats), int(np.prod(array.shape[1:]))), groups, count).reshape(
            count, *array.shape[1:]
        )
        for name, array in (("sh0", splats.sh0), ("shN", splats.shN))
    }
    return {"means": means, "quats": quats, "log_scales": np.log(scales), "logit_opacities": logit(opacities), **harmonics}


def _axes(spread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Standard deviations (G,3) and rotations (G,4) wxyz of covariances (G,3,3)."""
    squares, vectors = np.linalg.eigh(spread)
    squares = np.maximum(squares, np.maximum(squares[:, 2:] * THINNEST**2, np.finfo(np.float32).tiny))
    vectors[:, :, 0] *= np.sign(np.linalg.det(vectors))[:, None]
    quats = Rotation.from_matrix(vectors).as_quat(canonical=True, scalar_first=True) if len(vectors) else np.zeros((0, 4))
    return np.sqrt(squares), quats


def _sums(rows: FloatArray, groups: NDArray[np.int64], count: int) -> FloatArray:
    """Sums (G,F) of rows (N,F) by group."""
    sums = np.zeros((count, rows.shape[1]))
    for column in range(rows.shape[1]):
        sums[:, column] = np.bincount(groups, rows[:, column], count)
    return sums


def _start(splats: Splats, cells: NDArray[np.int64]) -> _Growing:
    means = splats.means.astype(np.float64)
    scales = np.exp(splats.log_scales.astype(np.float64))
    count, near = len(splats), min(NUM_NEIGHBOURS, len(splats) - 1)
    neighbours = KDTree(means).query(means, near + 1)[1]
    edges = np.sort(np.column_stack([np.repeat(np.arange(count), near + 1), neighbours.ravel()]), axis=1)
    # As one number each: `unique` of rows takes ten times as long.
    edges = edges[(edges[:, 0] != edges[:, 1]) & (cells[edges[:, 0]] == cells[edges[:, 1]])]
    edges = np.column_stack(np.divmod(np.unique(edges @ [count, 1]), count))
    growing = _Growing(
        masses=np.maximum(masses_of(splats), 1e-30),
        means=means,
        squares=(scales**2).sum(axis=1),
        colors=SH_C0 * splats.sh0[:, 0].astype(np.float64),
        group=np.arange(count),
        edges=edges,
        costs=np.zeros(len(edges)),
    )
    growing.costs = _costs(growing, edges)
    return growing


def _costs(growing: _Growing, edges: NDArray[np.int64]) -> FloatArray:
    i, j = edges.T
    masses, squares = growing.masses, growing.squares
    apart = ((growing.means[i] - growing.means[j]) ** 2).sum(axis=1) + (np.sqrt(squares[i]) - np.sqrt(squares[j])) ** 2
    unlike = ((growing.colors[i] - growing.colors[j]) ** 2).sum(axis=1)
    sizes = np.maximum(squares[i] + squares[j], np.finfo(np.float64).tiny)
    return masses[i] / (masses[i] + masses[j]) * masses[j] * (apart / sizes) * (PLAIN_COLOR + unlike)


def _cheapest_pairs(growing: _Growing) -> NDArray[np.int64]:
    """Pairs (P,2) of groups that are each other's cheapest, the cheapest first, none twice."""
    i, j = growing.edges.T
    least = np.full(len(growing.group), np.inf)
    np.minimum.at(least, i, growing.costs)
    np.minimum.at(least, j, growing.costs)
    mutual = np.flatnonzero((growing.costs <= least[i]) & (growing.costs <= least[j]))
    mutual = mutual[np.argsort(growing.costs[mutual], kind="stable")]
    pairs = growing.edges[mutual]
    # Where costs are equal a group may be in several pairs: the first one is kept.
    cheapest = np.full(len(growing.group), len(pairs))
    np.minimum.at(cheapest, pairs.ravel(), np.repeat(np.arange(len(pairs)), 2))
    numbers = np.arange(len(pairs))
    return pairs[(cheapest[pairs[:, 0]] == numbers) & (cheapest[pairs[:, 1]] == numbers)]


def _join(growing: _Growing, pairs: NDArray[np.int64]) -> None:
    i, j = pairs.T
    total = growing.masses[i] + growing.masses[j]
    share = growing.masses[j] / total
    offset = growing.means[j] - growing.means[i]
    growing.squares[i] = (1 - share) * growing.squares[i] + share * growing.squares[j] + share * (1 - share) * (offset**2).sum(axis=1)
    growing.means[i] += share[:, None] * offset
    growing.colors[i] += share[:, None] * (growing.colors[j] - growing.colors[i])
    growing.masses[i] = total
    into = np.arange(len(growing.group))
    into[j] = i
    growing.group = into[growing.group]
    touched = np.zeros(len(growing.group), bool)
    touched[pairs.ravel()] = True
    moved = touched[growing.edges].any(axis=1)
    edges = np.sort(into[growing.edges], axis=1)
    growing.costs[moved] = _costs(growing, edges[moved])
    between_groups = edges[:, 0] != edges[:, 1]
    growing.edges, growing.costs = edges[between_groups], growing.costs[between_groups]
