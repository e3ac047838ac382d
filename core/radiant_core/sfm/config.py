"""The configuration of structure from motion, its progress reports and its result."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

from radiant_core.choices import Effort, Matching
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.georef.given_frame import GivenFrame
from radiant_core.scene import SfmScene

Mapper = Literal["auto", "incremental", "global"]
"""auto: incremental, then global where over a tenth is unregistered; others: that one alone."""


@dataclass(frozen=True, kw_only=True)
class SfmConfig:
    """Settings of structure from motion; raises BadInput for a value out of range."""

    max_image_size_px: int = 1600
    """Long side in pixels to which photographs are reduced for finding features."""
    max_num_features: int = 6144
    """Features kept per photograph, roughly."""
    num_neighbors: int = 30
    """With GPS, each photograph is matched with this many nearest ones."""
    matching: Matching = "auto"
    """Which pairs are matched: auto, spatial (GPS neighbours) or exhaustive (all)."""
    num_partners: int = 14
    """With `effort` auto each photograph is matched in full with so many candidates that have most
    in common in a preview; 0: with all."""
    effort: Effort = "auto"
    """Which steps are shortened: auto or thorough."""
    mapper: Mapper = "auto"
    """Which mapper estimates the poses: auto, incremental or global."""
    num_threads: int = 0
    """Threads, 0 for all cores."""
    seed: int = 0
    """Seed of every random choice; with several threads results differ in the last digits."""
    memory_bytes: float | None = None
    """What it may hold: fewer threads, then smaller photographs, while finding features; fewer
    features to map. None without a limit."""

    def __post_init__(self) -> None:
        if self.memory_bytes is not None and not 0 < self.memory_bytes < math.inf:
            raise BadInput(f"sfm.memory_bytes is {self.memory_bytes!r}, expected a positive number of bytes.")
        for name, least in (
            ("max_image_size_px", 64),
            ("max_num_features", 64),
            ("num_neighbors", 1),
            ("num_partners", 0),
            ("num_threads", 0),
            ("seed", 0),
        ):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise BadInput(f"sfm.{name} is {value!r}, expected a whole number of at least {least}.")
        for name, choices in (("matching", get_args(Matching)), ("effort", get_args(Effort)), ("mapper", get_args(Mapper))):
            if getattr(self, name) not in choices:
                raise BadInput(f"sfm.{name} is {getattr(self, name)!r}, expected one of {', '.join(choices)}.")

    @property
    def threads(self) -> int:
        """The number of threads to start, at least one."""
        return self.num_threads or os.cpu_count() or 1


Phase = Literal[
    "watching films", "taking frames", "cutting panoramas",
    "checking photographs", "features", "pairs", "matching", "mapping", "triangulating", "refining", "undistorting",
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SfmProgress:
    """How far one phase is; `done` of `total` photographs, or pairs while matching."""

    phase: Phase
    done: int
    total: int
    step: int = 0
    """Number of the phase among those of the job, from 1; 0 where they were not counted."""
    num_steps: int = 0
    left_s: float | None = None
    """Seconds left of the whole job, all phases to come included; None without an estimate."""


Report = Callable[[SfmProgress], None]


def with_preview(phases: tuple[Phase, ...], config: SfmConfig) -> tuple[Phase, ...]:
    """The phases of a job, with that of choosing pairs unless `effort` is thorough."""
    at = phases.index("matching")
    return (*phases[:at], "pairs", *phases[at:]) if config.effort == "auto" else phases


def number_phases(report: Report, phases: Sequence[Phase]) -> Report:
    """A report that numbers the job's `phases`; a phase that comes twice has its number twice."""
    return lambda progress: report(replace(progress, step=phases.index(progress.phase) + 1, num_steps=len(phases)))


@dataclass(frozen=True, kw_only=True, eq=False)
class SfmResult:
    """The scene, where its undistorted photographs are, which are not in it, and the decisions."""

    scene: SfmScene
    undistorted_folder: Path
    unregistered: tuple[str, ...]
    """Usable photographs without a pose in the scene."""
    decisions: tuple[Decision, ...]
    warnings: tuple[str, ...]
    unnamed_warnings: tuple[str, ...] = ()
    """Of `reconstruct`: the same with numbers for names, for receivers that must not learn them."""
    masks_folder: Path | None = None
    """Masks of the undistorted photographs (`radiant_core.io.photos.masks`); None without any."""
    given_frame: GivenFrame | None = None
    """The way back to the frame of the model that the scene was made from; None of photographs."""
    survey: dict[str, Any] | None = None
    """What was adjusted to, and how well it fits (`control.place.survey_record`); None without."""
    positions: dict[str, Any] | None = None
    """How many GPS positions place the scene, and which do not (`world_frame.position_count`)."""
    doubts: tuple[str, ...] = ()
    """Those of the warnings after which place, scale or up of the scene may be wrong."""
