"""`Profile`: what a kind of machine was measured or estimated to cost, and for which training.

A plan from curves of another training, or far beyond the counts they were measured at, is wrong
without a sign of it; so devices keep their profiles, and `profile_warnings` reports such plans.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.plan.profiles.curve_fit import FittedCurve

ProfileKind = Literal["measured", "estimate"]
SAME_SIZE = 0.1
"""Images whose long sides differ by less than this share count as equally large."""


def same_size(one_px: int, other_px: int) -> bool:
    """Whether images with these long sides count as equally large."""
    small, large = sorted((one_px, other_px))
    return large <= (1 + SAME_SIZE) * small


@dataclass(frozen=True, kw_only=True)
class ProfileKey:
    """The training that curves hold for. Raises BadInput for numbers below 1 and empty names."""

    preset: str
    num_steps: int
    """Steps of a training, whatever its number of photographs: `StepLaw.cost` makes of it what a
    run takes."""
    long_side_px: int
    max_num_splats: int | None = None
    """Upper limit of Gaussians; None where it is not known or was not reached."""
    aggregate_preset: str = "default"
    """How edges join models."""

    def __post_init__(self) -> None:
        for name in ("num_steps", "long_side_px", "max_num_splats"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise BadInput(f"a profile's {name} is {value}, expected at least 1.")
        if not self.preset or not self.aggregate_preset:
            raise BadInput("a profile's preset is empty: name the preset it was measured with.")

    def matches_training(self, key: ProfileKey) -> bool:
        """Whether a device trains alike under both keys."""
        limits = {self.max_num_splats, key.max_num_splats} - {None}
        same_side = same_size(self.long_side_px, key.long_side_px)
        return (self.preset, self.num_steps) == (key.preset, key.num_steps) and same_side and len(limits) <= 1

    def __str__(self) -> str:
        limit = "" if self.max_num_splats is None else f", at most {self.max_num_splats:,} Gaussians"
        return f"preset {self.preset}, {self.num_steps:,} steps at {self.long_side_px} px{limit}"


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Cost curves of one machine. Raises BadInput where a figure is not positive, and for an
    estimate without a source."""

    name: str
    """As a system file calls it: a name of the library, or a curve file."""
    kind: ProfileKind
    machine: str
    source: str
    """Where the figures come from."""
    key: ProfileKey
    init_s: FittedCurve
    """G: seconds before the first step, the start of the process among them."""
    train_s: FittedCurve
    """F_n: seconds of `key.num_steps` steps."""
    model_bytes: FittedCurve
    """H: bytes of the model as float32."""
    aggregate_s: FittedCurve | None = None
    """F_m where several devices' models are joined, over the edge's cameras: all their views are
    retrained on, or drawn for the cloud."""
    aggregate_alone_s: FittedCurve | None = None
    """F_m where one device has all the edge's cameras, so that nothing is joined."""
    merge_s: FittedCurve | None = None
    """Joining the edges' models at the cloud, over the scene's cameras."""
    sfm_s: FittedCurve | None = None
    """Part of G where a device places its photographs itself: its structure from motion."""
    frames_s: float | None = None
    """Bringing two models into one frame, where GPS alone places them: a part of F_m for each
    device but the first. Renders of up to 14 views of each are compared, so that it hardly depends
    on how many photographs they have."""
    frames_alone_s: float | None = None
    """The same with no process beside it, as at the cloud: for each edge but the first."""
    memory_bytes: float | None = None
    """What training may hold there; None for unknown."""
    launch_s: float | None = None
    """Part of a step that neither pixels nor Gaussians change, on a GPU the launching of kernels;
    None: none is known."""
    latency_s: float | None = None
    """What a short message takes one way between two processes of this machine, half a round trip:
    the least that a step costs machines that train together; None: not measured."""
    add_s_per_byte: float | None = None
    """Seconds for each byte of gradients that are added up; None: not measured."""
    measured_steps: int | None = None
    """Steps that were run, where fewer than `key.num_steps`; `train_s` was scaled accordingly."""

    def __post_init__(self) -> None:
        if self.kind not in get_args(ProfileKind):
            raise BadInput(f"a profile's kind is {self.kind!r}, expected one of {', '.join(get_args(ProfileKind))}.")
        if not self.name or not self.machine or not self.source:
            raise BadInput("a profile says neither machine nor source where it is empty: name both.")
        if self.memory_bytes is not None and not (np.isfinite(self.memory_bytes) and self.memory_bytes > 0):
            raise BadInput(f"a profile's memory is {self.memory_bytes} bytes, expected a positive number.")
        for name in ("frames_s", "frames_alone_s", "launch_s", "latency_s", "add_s_per_byte"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise BadInput(f"a profile's {name} is {value}, expected a positive number of seconds.")
        if self.measured_steps is not None and not 1 <= self.measured_steps <= self.key.num_steps:
            raise BadInput(f"a profile's measured_steps is {self.measured_steps}, expected 1 to its {self.key.num_steps} steps.")

    @property
    def device_curves(self) -> tuple[FittedCurve, FittedCurve, FittedCurve]:
        """G, F and H."""
        return self.init_s, self.train_s, self.model_bytes
