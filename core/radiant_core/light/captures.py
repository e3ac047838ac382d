"""In which order photographs were taken and how they were exposed, by their EXIF. Once per set.

Of the time only the rank is kept. These facts stay beside the photographs (`CAPTURES_NAME`): no
task, model or message holds them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.io.photos.listing import photograph_exposures
from radiant_core.io.run_store import read_json, write_json
from radiant_core.numerics import FloatArray

CAPTURES_NAME = "captures.json"
"""File beside the photographs of their owner: rank and log₂ exposure of each by its name."""

Captures = Mapping[str, tuple[int, float | None]]
"""Name → rank in time, and log₂(t ISO / N²) or None."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shots:
    """What is known of V photographs without their pixels: cameras, ranks (V,) in time, and
    log2_exposures (V,), NaN where EXIF says none."""

    cameras: Cameras
    ranks: FloatArray
    log2_exposures: FloatArray

    def __len__(self) -> int:
        return len(self.cameras)


def read_captures(folder: Path, names: Sequence[str]) -> dict[str, tuple[int, float | None]]:
    """Ranks and exposures of photographs in `folder`, from their heads. Where any has no time the
    ranks are those of the sorted names, as cameras number what they take."""
    facts = {name: photograph_exposures(folder / name) for name in names if (folder / name).is_file()}
    timed = all(time_s is not None for time_s, _ in facts.values())
    order = sorted(facts, key=lambda name: (facts[name][0] or 0.0 if timed else 0.0, name))
    return {name: (rank, facts[name][1]) for rank, name in enumerate(order)}


def save_captures(folder: Path, captures: Captures) -> str:
    """Write them to `folder`; returns the name of the file."""
    write_json(folder / CAPTURES_NAME, {"photographs": {name: list(facts) for name, facts in captures.items()}})
    return CAPTURES_NAME


def load_captures(folder: Path) -> dict[str, tuple[int, float | None]]:
    """What `save_captures` wrote; empty where there is no such file. BadInput for something
    else."""
    if not (folder / CAPTURES_NAME).is_file():
        return {}
    photographs = read_json(folder / CAPTURES_NAME, ("photographs",))["photographs"]
    try:
        return {str(name): (int(rank), None if exposure is None else float(exposure)) for name, (rank, exposure) in photographs.items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise BadInput(f"{folder / CAPTURES_NAME} does not hold a rank and an exposure per photograph: remove it.") from error


def complete_captures(captures: Captures, names: Sequence[str]) -> Captures:
    """The captures of all `names`; where one is missing, all have the rank of their name among
    them."""
    if all(name in captures for name in names):
        return captures
    exposures = {name: captures[name][1] if name in captures else None for name in names}
    return {name: (rank, exposures[name]) for rank, name in enumerate(sorted(names))}


def shots_of(cameras: Cameras, captures: Captures) -> Shots:
    """What is known of photographs (V) whose names are in complete captures."""
    exposures = [captures[name][1] for name in cameras.names]
    log2_exposures = np.array([np.nan if value is None else value for value in exposures], np.float64)
    ranks = np.array([captures[name][0] for name in cameras.names], np.float64)
    return Shots(cameras=cameras, ranks=ranks, log2_exposures=np.where(np.isfinite(log2_exposures), log2_exposures, np.nan))
