"""A model as chunks of the same land at falling detail: level k has about N/2ᵏ Gaussians. Once
per export.

    region ─ cells of at most `chunk_count` Gaussians (a chunk: one file a level)
               └ cells of at most `leaf_side_m` or `leaf_count` (a leaf: a reader chooses its level)

Gaussians are joined within a leaf, the cheapest of a chunk first: a chunk is a function of the
Gaussians in it, so that a scene that changed in one place keeps the bytes of all chunks elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.lod.cells import FAR, Cell, LodRegion, divide, ellipsoid_box, regions_of_splats
from radiant_core.lod.merging import covariances, halve_within
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats, morton_order

MAX_LEVELS = 8
COARSEST_COUNT = 30_000
"""A model gets levels until the coarsest has at most so many Gaussians: some 400 kB as SOG, which
is there within a second."""
DEVIATIONS = 2.0
"""Ellipsoids are boxed at so many standard deviations: 86 % of what they show in the plane."""


Fit = Callable[[Splats, Splats, int, Callable[[float], None]], Splats]
"""From the finest level, a coarser one, how often it was halved, and a report of the share done."""


@dataclass(frozen=True, kw_only=True)
class LodLimits:
    """How a model is divided."""

    num_levels: int | None = None
    """1 to 8; None: until the coarsest has at most `COARSEST_COUNT` Gaussians."""
    chunk_count: int = 512 * 1024
    """Most Gaussians of a chunk at the finest level."""
    leaf_side_m: float = 16.0
    """A wider leaf is halved, if it has more Gaussians than `leaf_count`."""
    leaf_count: int = 8 * 1024
    """Fewer Gaussians than this are not parted for their extent."""
    fit: Fit | None = None
    """What makes a coarser level nearer, such as `fitting.fit_level`; None: it stays as merged."""

    def __post_init__(self) -> None:
        if self.num_levels is not None and not 1 <= self.num_levels <= MAX_LEVELS:
            raise BadInput(f"{self.num_levels} levels of detail were asked for, expected 1 to {MAX_LEVELS}.")
        if not (self.chunk_count >= 1 and self.leaf_count >= 1 and self.leaf_side_m > 0):
            raise BadInput(f"chunks are limited by {self}, expected counts of at least 1 and a side above 0 m.")

    def levels_of(self, count: int) -> int:
        """Number of levels for so many Gaussians."""
        return self.num_levels or int(np.clip(1 + np.ceil(np.log2(max(count, 1) / COARSEST_COUNT)), 1, MAX_LEVELS))


@dataclass(frozen=True, kw_only=True, eq=False)
class Leaf:
    """The box (2,3) m of a leaf over all its levels, and its Gaussians in each level's file, (L,2)
    rows of offset and count."""

    box: FloatArray
    spans: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Chunk:
    """Chunk `number` of a region: a model per level, its leaves in the order of the files, and the
    nested pairs of their numbers."""

    region: int
    number: int
    levels: tuple[Splats, ...]
    leaves: tuple[Leaf, ...]
    tree: LeafTree


LeafTree = int | tuple["LeafTree", "LeafTree"]
"""A leaf's number in its chunk, or two halves."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LodLayout:
    """Which Gaussians go where: far ones (F,), and per region its tree of chunks."""

    far: NDArray[np.int64]
    regions: tuple[Cell, ...]
    num_levels: int
    limits: LodLimits

    @property
    def num_chunks(self) -> int:
        """Chunks of all regions."""
        return sum(1 for region in self.regions for chunk in region.leaves() if len(chunk.rows))


def lay_out(splats: Splats, regions: Sequence[LodRegion], limits: LodLimits) -> LodLayout:
    """Divide a model of at least one Gaussian into chunks; where all is far, all is near."""
    number = regions_of_splats(splats, regions)
    if (number == FAR).all():
        number = np.zeros(len(splats), np.int64)
    means = splats.means.astype(np.float64)
    trees = [
        divide(means, np.flatnonzero(number == region), lambda rows: len(rows) <= limits.chunk_count) for region in range(len(regions))
    ]
    near = int((number != FAR).sum())
    return LodLayout(far=np.flatnonzero(number == FAR), regions=tuple(trees), num_levels=limits.levels_of(near), limits=limits)


def chunks_of(splats: Splats, layout: LodLayout, report: Callable[[int, int], None] = lambda num_done, total: None) -> Iterator[Chunk]:
    """The chunks of a model, one in memory at a time; `report` is called with the Gaussians done
    and all of them."""
    num_done = len(layout.far)
    report(num_done, len(splats))
    for region, tree in enumerate(layout.regions):
        for number, cell in enumerate(tree.leaves()):
            if len(cell.rows):
                share_done = partial(_report_share, report, num_done, len(cell.rows), len(splats))
                yield _chunk(splats.select(cell.rows), region, number, layout, share_done)
                num_done += len(cell.rows)
                report(num_done, len(splats))


def _report_share(report: Callable[[int, int], None], before: int, count: int, total: int, share: float) -> None:
    report(before + int(share * count), total)


def far_field(splats: Splats, layout: LodLayout) -> Splats:
    """The far Gaussians along a Z curve."""
    far = splats.select(layout.far)
    return far.select(morton_order(far.means))


def _chunk(splats: Splats, region: int, number: int, layout: LodLayout, report: Callable[[float], None]) -> Chunk:
    limits, means = layout.limits, splats.means.astype(np.float64)

    def ends(rows: NDArray[np.int64]) -> bool:
        return len(rows) <= limits.leaf_count or float(np.ptp(means[rows], axis=0).max()) <= limits.leaf_side_m

    tree = divide(means, np.arange(len(splats)), ends)
    leaf = np.zeros(len(splats), np.int64)
    for place, cell in enumerate(tree.leaves()):
        leaf[cell.rows] = place
    levels, counts = _thinned(splats, leaf, layout.num_levels)
    spans = np.stack([np.cumsum(counts, axis=0) - counts, counts], axis=2)
    levels = _fitted(levels, limits.fit, report) if limits.fit else levels
    return Chunk(
        region=region,
        number=number,
        levels=levels,
        leaves=tuple(Leaf(box=_box(levels, leaf_spans), spans=leaf_spans) for leaf_spans in spans),
        tree=_numbered(tree, iter(range(len(counts)))),
    )


def _fitted(levels: tuple[Splats, ...], fit: Fit, report: Callable[[float], None]) -> tuple[Splats, ...]:
    ends = np.cumsum([len(level) for level in levels[1:]])

    def fit_one(halvings: int) -> Splats:
        level = levels[halvings]
        return fit(levels[0], level, halvings, lambda share: report(float((ends[halvings - 1] - (1 - share) * len(level)) / ends[-1])))

    return (levels[0], *map(fit_one, range(1, len(levels))))


def _thinned(splats: Splats, leaf: NDArray[np.int64], num_levels: int) -> tuple[tuple[Splats, ...], NDArray[np.int64]]:
    """The levels, each leaf by leaf along a Z curve, and how many of each leaf (L,K) they have."""
    levels, num_leaves = [_by_leaf(splats, leaf)], int(leaf.max()) + 1
    for _ in range(num_levels - 1):
        levels.append(_by_leaf(*halve_within(*levels[-1])))
    return tuple(level for level, _ in levels), np.stack([np.bincount(leaves, minlength=num_leaves) for _, leaves in levels], axis=1)


def _by_leaf(splats: Splats, leaf: NDArray[np.int64]) -> tuple[Splats, NDArray[np.int64]]:
    order = np.argsort(leaf, kind="stable")
    ends = np.cumsum(np.bincount(leaf))
    order = np.concatenate([rows[morton_order(splats.means[rows])] for rows in np.split(order, ends[:-1])])
    return splats.select(order), leaf[order]


def _box(levels: Sequence[Splats], spans: NDArray[np.int64]) -> FloatArray:
    parts = [level.select(np.arange(start, start + count)) for level, (start, count) in zip(levels, spans, strict=True)]
    boxes = np.stack([ellipsoid_box(level.means.astype(np.float64), covariances(level), DEVIATIONS) for level in parts])
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def _numbered(cell: Cell, numbers: Iterator[int]) -> LeafTree:
    if not cell.halves:
        return next(numbers)
    first, second = (_numbered(half, numbers) for half in cell.halves)
    return first, second
