"""`RunConfig`: what one run was asked to do. Written into the run's manifest, so that `--resume` knows it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from radiant_core.aggregate.config import AggregatePreset
from radiant_core.errors import BadInput
from radiant_core.train.config import Preset
from radiant_core.train.needs import Overrides

PlanMethod = Literal["exact", "paper", "voronoi", "even"]


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """One run from photographs to a scene."""

    source: Path
    """Folder of photographs, a COLMAP project (images/ and sparse/), or a Mill 19 folder."""
    out: Path
    """The run's folder; made by the run."""
    system: Path | None = None
    """TOML of edges and devices; None: two edges with two equal devices each."""
    emulated: bool = False
    """Run devices and edges at the speeds and behind the uplinks of `system`, in wall time."""
    train_preset: Preset = "default"
    """How well to train, see `radiant_core.train.config.Preset`."""
    overrides: Overrides = Overrides()
    """Sizes and steps asked for by number."""
    aggregate_preset: AggregatePreset = "default"
    """How edges join models."""
    plan_method: PlanMethod = "exact"
    """exact: least makespan; paper: the paper's Alg. 1; voronoi: nearest edge; even: equal counts."""
    matching: Literal["auto", "spatial", "exhaustive"] = "auto"
    """Which photographs are compared: neighbours by GPS, or all with all."""
    seed: int = 0
    """Seed of every random choice."""
    max_workers: int = 0
    """Processes at a time; 0: one per core."""

    @property
    def num_workers(self) -> int:
        """Processes at a time."""
        return self.max_workers or os.cpu_count() or 1

    def __post_init__(self) -> None:
        if self.max_workers < 0:
            raise BadInput(f"max_workers is {self.max_workers}, expected 0 (one per core) or more.")
        if self.emulated and (self.system is None or self.max_workers):
            raise BadInput("an emulated run needs a system file and runs all its devices at once: leave the number of workers out.")
        if not 0 <= self.seed < 2**31:
            raise BadInput(f"seed is {self.seed}, expected 0 to {2**31 - 1}.")
        for path in (self.source, self.out):
            if not _is_text(path):
                raise BadInput(f"the path {str(path)!r} is not valid UTF-8, which some libraries cannot open: rename the folder.")


def _is_text(path: Path) -> bool:
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True
