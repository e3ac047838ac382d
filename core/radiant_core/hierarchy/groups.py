"""`GroupTraining`: which machines train as one model, and how. Once per run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

from pydantic import Field

from radiant_core.choices import StepFormat
from radiant_core.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class Seat:
    """What a device gives to each step of a training that it shares with others."""

    parent: str
    """Node that it sends its gradients to."""
    num_views: Annotated[int, Field(ge=1)]
    first: Annotated[int, Field(ge=0)]
    """As which view of a step its first one counts."""
    masked: bool = False
    """As of a `Group`: its start brings a public key."""


@dataclass(frozen=True, kw_only=True)
class GroupTraining:
    """Devices that train as one model below a root, "cloud" or "edges/NAME", which has it."""

    root: str
    views: Mapping[str, Mapping[str, int]]
    """Edge → device → views that it gives to each step, in the order in which they are summed."""
    num_steps: int
    """Views that are shown in all, as steps of one machine."""
    overlaps: bool = False
    """As of a `Group`."""
    form: StepFormat = "blocks"
    masked: bool = False
    """As of a `Group`; then no step is taken without all devices of an edge (`masking.py`)."""

    def __post_init__(self) -> None:
        if self.root != "cloud" and [self.root] != [f"edges/{edge}" for edge in self.views]:
            raise BadInput(f"the group of {self.root} has edges {', '.join(self.views)}: only the cloud sums for several edges.")
        if not self.of_devices or min(self.of_devices.values()) < 1:
            raise BadInput(f"the group of {self.root} has a device without views: give each device one or more.")
        if self.masked and (alone := [edge for edge, devices in self.views.items() if len(devices) < 2]):
            raise BadInput(
                f"masks hide nothing of the one device of edge {alone[0]}: leave out --mask-gradients, or give it another device."
            )

    @property
    def fewest_masked(self) -> int:
        """Devices of the edge that sums the fewest."""
        return min(map(len, self.views.values()))

    @cached_property
    def of_devices(self) -> dict[str, int]:
        """Views of a step by device."""
        return {device: views for devices in self.views.values() for device, views in devices.items()}

    @property
    def views_per_step(self) -> int:
        """Those of all devices."""
        return sum(self.of_devices.values())

    @property
    def has_relays(self) -> bool:
        """Whether edges sum for a root above them."""
        return self.root == "cloud"

    @property
    def of_senders(self) -> dict[str, int]:
        """Views of a step by each sender to the root: edges, or the devices of its one edge."""
        return {edge: sum(devices.values()) for edge, devices in self.views.items()} if self.has_relays else self.of_devices

    def of_edge(self, edge: str) -> GroupTraining:
        """What an edge is told of the group: its devices alone."""
        return replace(self, views={edge: self.views[edge]})

    def seat_of(self, device: str) -> Seat:
        """What a device gives to each step, and where."""
        edge = next(edge for edge, devices in self.views.items() if device in devices)
        return Seat(parent=f"edges/{edge}", num_views=self.of_devices[device], first=self.first_view(device), masked=self.masked)

    def first_view(self, device: str) -> int:
        """As which view of a step the first of a device counts."""
        names = list(self.of_devices)
        return sum(self.of_devices[name] for name in names[: names.index(device)])
