"""`Photographs`: where a run's photographs are. It is all that `--frames` decides; plan, tree, dealing and joining are the same.

pooled.py      one owner has all of them, places them at once and deals each device its own
on_devices.py  each device places and keeps its own; positions alone are planned with
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from radiant_core.hierarchy.recipe import Recipe
from radiant_core.numerics import FloatArray


class Photographs(Protocol):
    """The photographs of a run, as they are dealt to devices."""

    kind: str
    """Which worker runs a device: "device" or "field"."""

    @property
    def positions(self) -> FloatArray | None:
        """(C,2) m of the planned photographs where another device can take them over; None where they are lost with theirs."""
        ...

    def follow(self, recipe: Recipe) -> None:
        """Deal by the plan of this recipe from now on."""
        ...

    def num_dealt(self, device: str) -> int:
        """How many photographs a device trains on: it sends no more cameras."""
        ...

    def devices(self) -> Sequence[str]:
        """Devices that have photographs."""
        ...

    def fill(self, device: str, folder: Path, recipe: Recipe) -> tuple[Any, list[Path]]:
        """The task of a device, and the files laid into its folder that the device may read besides."""
        ...

    def fetched(self, device: str) -> list[Path]:
        """Photographs outside of its folder that a device copies into it by itself."""
        ...
