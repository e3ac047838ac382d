"""Ground control with marks in photographs that are placed. Once per scene."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.georef.control_points import ControlPoints
from radiant_core.numerics import FloatArray
from radiant_core.sfm.control.bundle import Bundle, Rows, Ties
from radiant_core.sfm.control.intersect import intersect_rays


@dataclass(frozen=True, kw_only=True, eq=False)
class Marked:
    """Ground control with marks in photographs that are placed."""

    names: tuple[str, ...]
    places_m: FloatArray
    is_check: NDArray[np.bool_]
    sigmas_m: FloatArray
    marks: Ties
    warnings: tuple[str, ...]

    def rows(self, *, check: bool) -> tuple[Rows, Ties]:
        """Points that are kept out, or not, and their marks with rows among them."""
        rows = np.flatnonzero(self.is_check == check)
        marks = self.marks.at(np.isin(self.marks.points, rows))
        return rows, replace(marks, points=np.searchsorted(rows, marks.points))


def marks_of(control: ControlPoints, bundle: Bundle) -> Marked:
    """What of a list can be used with a bundle; BadInput where no mark is in a placed
    photograph."""
    row_of = {name: row for row, name in enumerate(bundle.names)}
    placed = np.array([name in row_of for name in control.mark_images])
    if not placed.any():
        raise BadInput(
            f"none of the {len(placed)} marks of ground control is in a photograph that was placed ({control.mark_images[0]!r} first): "
            "the list names photographs by their file names."
        )
    lost = sorted({name for name, there in zip(control.mark_images, placed, strict=True) if not there})
    warnings = (f"marks of ground control in {len(lost)} photographs that are not placed are left out, {lost[0]!r} first.",) if lost else ()
    images = np.array([row_of.get(name, -1) for name in control.mark_images], np.int64)[placed]
    marks = Ties(images=images, points=control.mark_points[placed], pixels=control.mark_pixels[placed])
    is_fixed = np.isfinite(intersect_rays(bundle, marks, len(control.names))).all(axis=1)
    if not is_fixed.all():
        first = control.names[int(np.flatnonzero(~is_fixed)[0])]
        warnings += (
            f"{int((~is_fixed).sum())} points of ground control are marked in fewer than two photographs that lie apart, {first!r} first.",
        )
    rows = np.flatnonzero(is_fixed)
    used_marks = marks.at(np.isin(marks.points, rows))
    return Marked(
        names=tuple(control.names[row] for row in rows),
        places_m=control.places_m[rows],
        is_check=control.is_check[rows],
        sigmas_m=control.sigmas_m,
        marks=replace(used_marks, points=np.searchsorted(rows, used_marks.points)),
        warnings=warnings,
    )
