"""`Raster`: where a device's photographs stand, counted in cells. Once per device and plan.

    raster.json ── raster_of ──→ Raster ── middles ──→ a place per photograph, for the plan

All that others learn of a device's places before it trains. Parsed once, within the ranges of the
globe and of what one machine can hold; what is parsed is what is planned with.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from radiant_app.strangers import WRONG, UntrustedRecord, parse_record
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray

MAX_PHOTOGRAPHS = 100_000
"""Of one device: some 500 GB of them. A plan has a row for each."""
LOWEST_M, HIGHEST_M = -11_000.0, 40_000.0
"""Altitudes from the deepest trench to where balloons float."""
MOST_UNITS = 9e7
"""Farthest place in the frame of given poses, in whatever unit; planners take less than 1e8."""
Photographs = Annotated[int, Field(ge=0, le=MAX_PHOTOGRAPHS)]
Place = Annotated[float, Field(ge=-MOST_UNITS, le=MOST_UNITS)]
Cell = tuple[Place, Place, Annotated[int, Field(ge=1, le=MAX_PHOTOGRAPHS)]]


class Raster(UntrustedRecord):
    """Cells as [latitude, longitude, count], or [x, y, count] in the frame of given poses."""

    cells: Annotated[tuple[Cell, ...], Field(max_length=MAX_PHOTOGRAPHS)]
    altitude_m: Annotated[float, Field(ge=LOWEST_M, le=HIGHEST_M)] | None
    """None in the frame of given poses, and where no photograph has a place."""
    num_photographs: Photographs
    num_unplaced: Photographs

    @model_validator(mode="after")
    def _fits_together(self) -> Raster:
        if self.altitude_m is not None:
            self._require_globe()
        if self.num_placed > self.num_photographs or self.num_unplaced > self.num_photographs:
            raise ValueError(f"its cells hold {self.num_placed:,} and {self.num_unplaced:,} have no place, of {self.num_photographs:,}")
        return self

    def _require_globe(self) -> None:
        for latitude, longitude, _ in self.cells:
            if abs(latitude) > 90 or abs(longitude) > 180:
                raise ValueError(f"it has a cell at {latitude:g}°, {longitude:g}°, which is not on the globe")

    @property
    def num_placed(self) -> int:
        """Photographs that stand in cells."""
        return sum(count for _, _, count in self.cells)

    @property
    def record(self) -> dict[str, Any]:
        """What raster.json says, as JSON has it."""
        return self.model_dump(mode="json")

    @property
    def middles(self) -> FloatArray:
        """The middle (K,3) of its cell, deg, deg, m, for every photograph in one."""
        cells = np.array(self.cells, np.float64).reshape(-1, 3)
        middles = np.column_stack([cells[:, :2], np.full(len(cells), self.altitude_m or 0.0)])
        return np.repeat(middles, cells[:, 2].astype(np.int64), axis=0)


class _Count(UntrustedRecord):
    num_photographs: Photographs


def raster_of(record: Any, frames: str | None = None) -> Raster:
    """The raster in a record of JSON; BadInput where it is none, lies outside the globe, or with
    `frames` "gps" has places without an altitude."""
    raster = parse_record(Raster, record, "a raster")
    if frames == "gps" and raster.cells and raster.altitude_m is None:
        raise BadInput(f"a raster has places on the globe and no altitude: {WRONG}.")
    return raster


def count_of(record: Any) -> int:
    """The number of photographs in a record of JSON; BadInput where it is none."""
    return parse_record(_Count, record, "a count of photographs").num_photographs


def raster_problem(raster: Raster, num_photographs: int, num_dealt: int) -> str | None:
    """Why a raster cannot be of a device that counted so many photographs, of which it trains on
    `num_dealt`; None where it can."""
    if raster.num_photographs > num_photographs:
        return f"its raster has {raster.num_photographs:,} photographs, and it counted {num_photographs:,} before."
    if raster.num_placed > num_dealt:
        return f"its raster places {raster.num_placed:,} photographs, and it trains on {num_dealt:,} of those that it counted."
    return None
