"""`StepGradients`: what the views of one holder of photographs, or of all, add to a step.

    holder    Σ over its views of ∂loss/∂x, of the rows that they show
    edge      Σ over its holders, in their order
    root      Σ over edges, in their order; Adam steps by its mean over the views

Once per step. Every sum is taken in float32 over rows in a fixed order, so that it has the same
bits wherever it is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_core import _native
from radiant_core.render.contract import TENSORS, SplatTensors


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Which columns of a table of gradients belong to which tensor: `shapes` of a row by tensor, in
    the order of `TENSORS`; after them one column of growth, which density control gathers."""

    shapes: Mapping[str, tuple[int, ...]]
    with_radii: bool = False
    """Whether radii on screen travel as well."""

    @staticmethod
    def of(splats: SplatTensors, names: Sequence[str], *, with_radii: bool = False) -> Layout:
        """That of the tensors `names` of a model."""
        shapes = {name: tuple(splats.tensors()[name].shape[1:]) for name in TENSORS if name in names}
        return Layout(shapes=shapes, with_radii=with_radii)

    @cached_property
    def columns(self) -> dict[str, slice]:
        """The columns of each tensor."""
        ends = np.cumsum([int(np.prod(shape)) for shape in self.shapes.values()]).tolist()
        return {name: slice(start, end) for name, start, end in zip(self.shapes, [0, *ends[:-1]], ends, strict=True)}

    @property
    def growth(self) -> int:
        """The column of growth."""
        return sum(int(np.prod(shape)) for shape in self.shapes.values())

    @property
    def num_columns(self) -> int:
        """All columns."""
        return self.growth + 1


@dataclass(frozen=True, kw_only=True, eq=False)
class StepGradients:
    """Sums over `num_views` views: rows (R,) int64, ascending, of the Gaussians that any shows;
    values (R,K) float32 by a `Layout`; view_counts (R,) uint16, in how many of the views; radii_px
    (R,) float32, the largest, or None; loss, the sum."""

    num_views: int
    loss: float
    rows: NDArray[np.int64]
    values: NDArray[np.float32]
    view_counts: NDArray[np.uint16]
    radii_px: NDArray[np.float32] | None = None

    @staticmethod
    def nothing(layout: Layout) -> StepGradients:
        """Of no view."""
        return StepGradients(
            num_views=0,
            loss=0.0,
            rows=np.zeros(0, np.int64),
            values=np.zeros((0, layout.num_columns), np.float32),
            view_counts=np.zeros(0, np.uint16),
            radii_px=np.zeros(0, np.float32) if layout.with_radii else None,
        )

    @property
    def is_finite(self) -> bool:
        """Whether loss and all values are."""
        radii_fit = self.radii_px is None or bool(np.isfinite(self.radii_px).all())
        return bool(np.isfinite(self.loss)) and radii_fit and _native.find_not_finite(torch.from_numpy(self.values), None) == [0]


def sum_gradients(parts: Sequence[StepGradients], num_splats: int, layout: Layout) -> StepGradients:
    """The sum of what several send of a model of `num_splats` Gaussians, in their order."""
    parts = [part for part in parts if part.num_views]
    if not parts:
        return StepGradients.nothing(layout)
    if len(parts) == 1:
        return parts[0]
    row_mask = np.zeros(num_splats, bool)
    for part in parts:
        row_mask[part.rows] = True
    rows = np.flatnonzero(row_mask)
    place = np.empty(num_splats, np.int64)
    place[rows] = np.arange(len(rows))
    values = np.zeros((len(rows), layout.num_columns), np.float32)
    view_counts = np.zeros(len(rows), np.uint16)
    radii = np.zeros(len(rows), np.float32) if layout.with_radii else None
    for part in parts:
        at = place[part.rows]
        _native.add_rows(values, at, part.values)
        view_counts[at] += part.view_counts
        if radii is not None and part.radii_px is not None:
            radii[at] = np.maximum(radii[at], part.radii_px)
    return StepGradients(
        num_views=sum(part.num_views for part in parts),
        loss=sum(part.loss for part in parts),
        rows=rows,
        values=values,
        view_counts=view_counts,
        radii_px=radii,
    )
