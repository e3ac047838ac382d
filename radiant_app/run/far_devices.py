"""`FarDevices`: photographs of devices that are machines of others, known by number alone. Once per
run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from radiant_core.errors import BadInput
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.numerics import FloatArray
from radiant_core.plan.system import System

HELD_OUT_EVERY = 8
"""As of `radiant_core.evaluate.split.held_out_mask`."""


@dataclass(kw_only=True)
class FarDevices:
    """See `Photographs`; as seen by the cloud."""

    counts: Mapping[str, int]
    """Device → how many photographs it has."""
    origin: FloatArray | None = None
    kind: str = "own_field"

    @property
    def positions(self) -> FloatArray | None:
        """None: they are lost with their device."""
        return None

    def first_held_out(self, device: str) -> int:
        """Which of a device's photographs by name is the first to be held out.

        Position 0, 8, 16, … of all "device/name" in sorted order is held out; where a device's
        names begin in that order follows from the counts of those before it.
        """
        before = sum(count for name, count in self.counts.items() if f"{name}/" < f"{device}/")
        return -before % HELD_OUT_EVERY

    def num_held_out(self, device: str) -> int:
        """How many of its photographs a device holds out."""
        return len(range(self.first_held_out(device), self.counts[device], HELD_OUT_EVERY))

    def num_dealt(self, device: str) -> int:
        """The number of its photographs that a device does not hold out."""
        return self.counts[device] - self.num_held_out(device) if device in self.counts else 0

    def devices(self) -> Sequence[str]:
        """Those with photographs."""
        return sorted(device for device, count in self.counts.items() if count)

    def use_recipe(self, recipe: Recipe) -> None:
        """The photographs stay where they are, whatever the plan."""

    def fill(self, device: str, folder: Path, recipe: Recipe) -> tuple[Any, list[Path]]:
        """Devices are filled by their edges."""
        raise AssertionError(f"{device} is filled by its edge.")

    def fetched_files(self, device: str) -> list[Path]:
        """None."""
        return []


def require_names(system: System) -> None:
    """Raise BadInput for names that would hold out other photographs than a run on one machine."""
    if {device.id for device in system.devices} == {"train", "val"}:
        raise BadInput("two devices named train and val are taken for a set with its own split: name them otherwise.")
