"""`Photographs`: where a run's photographs are, which is all that `--frames` decides.

pooled.py      one owner reconstructs all of them and deals each device its share
on_devices.py  each device keeps and reconstructs its own; the plan uses positions alone
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
        """(C,2) m of the planned photographs; None where no other device can take them over."""
        ...

    def use_recipe(self, recipe: Recipe) -> None:
        """Deal by the plan of this recipe from now on."""
        ...

    def num_dealt(self, device: str) -> int:
        """The number of photographs a device trains on, the most cameras it may send."""
        ...

    def devices(self) -> Sequence[str]:
        """Devices that have photographs."""
        ...

    def fill(self, device: str, folder: Path, recipe: Recipe) -> tuple[Any, list[Path]]:
        """Fill a device's folder; returns its task and the files beside it that it may read."""
        ...

    def fetched_files(self, device: str) -> list[Path]:
        """Photographs outside its folder that the device itself copies into it."""
        ...
