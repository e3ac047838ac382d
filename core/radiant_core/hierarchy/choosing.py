"""Which version of a scene is kept, refined, joined or cut, by photographs that were in no
training. Once per run.

    held_out_psnr_db   one version in the photographs that one machine holds out, there (`evaluate`)
    is_comparison      whether what a machine says can be compared
    choose_version     the version with the best mean over the photographs of all machines

Figures go up, pixels do not. What a node fitted was compared with its cut on pictures of the models
before (`aggregate/join.py`): that alone stands for land of which no photograph is held out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from radiant_core.choices import Version
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray

Scene = TypeVar("Scene")
REFINED: Version = "refined"
JOINED: Version = "joined"
CUT: Version = "cut"
BEST_DB = 60.0
"""No photograph weighs more than this good."""
LEAST_GAIN_DB = 0.05
"""By less no version takes the place of the usual one: a few photographs do not tell them apart."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The version that is kept, and the mean PSNR of each, the usual one first."""

    version: Version
    mean_db: Mapping[Version, float]
    num_photographs: int
    num_machines: int
    num_without: int
    """Machines that hold out no photograph."""

    @property
    def keeps_usual(self) -> bool:
        """Whether the version is kept that would be without a comparison."""
        return self.version == next(iter(self.mean_db))

    def decision(self, stage: str) -> Decision:
        """What is kept and by how much, as the report lists it."""
        kept_db = self.mean_db[self.version]
        others: dict[Version, float] = {name: db for name, db in self.mean_db.items() if name != self.version}
        next_best = max(others, key=others.__getitem__)
        figures = ", ".join(f"{name} {db:.2f} dB" for name, db in self.mean_db.items())
        effect = (
            "which report the score too" if self.keeps_usual else f"which report the score too, and favour the {self.version} one there"
        )
        without = ""
        if self.num_without:
            machines = f"{self.num_without} of {self.num_machines} machines hold out none"
            without = f"; {machines}: of their land at most pictures of the models were compared"
        return Decision(
            stage=stage,
            topic="refined, joined or cut",
            choice=f"the {self.version} scene is kept",
            figure=kept_db - self.mean_db[next_best],
            unit=f"dB over the {next_best} one",
            reason=f"{figures} in {self.num_photographs} photographs that no training used, {effect}{without}",
            changes_nothing=self.keeps_usual,
        )


def in_order(refined: Scene | None, joined: Scene | None, cut: Scene | None, *, only_faded: bool) -> dict[Version, Scene]:
    """The versions that there are, that which is kept without a comparison first: the refined one,
    else the joined one, but of models that `only_faded`, for devices that then fitted nothing, the
    cut one."""
    versions: list[tuple[Version, Scene | None]] = [(REFINED, refined), (JOINED, joined), (CUT, cut)]
    if only_faded and refined is None:
        versions.reverse()
    return {name: version for name, version in versions if version is not None}


def is_comparison(names: Sequence[Version], machine: Mapping[Version, Sequence[float]]) -> bool:
    """Whether a machine has a finite figure of every version in each of its photographs."""
    lengths = {len(figures) for figures in machine.values()}
    return {*machine} == {*names} and len(lengths) == 1 and all(np.isfinite(figures).all() for figures in machine.values())


def choose_version(names: Sequence[Version], figures_db: Sequence[Mapping[Version, Sequence[float]]]) -> Choice | None:
    """Keep the version with the best mean; the usual one where none is clearly better.

    Args:
        names: the versions, the usual one first.
        figures_db: what each machine says: version → PSNR of each of its photographs.

    Returns:
        The choice; None where there is one version or no photograph.

    Raises:
        BadInput: a machine's figures are no comparison of these (`is_comparison`).
    """
    if len(names) < 2 or not figures_db:
        return None
    for machine in figures_db:
        if not is_comparison(names, machine):
            compared = f"a machine compares {', '.join(machine) or 'nothing'}, expected {', '.join(names)}"
            raise BadInput(f"{compared} by finite figures of as many photographs each: ask it again.")
    pooled: dict[Version, FloatArray] = {
        name: np.concatenate([np.asarray(machine[name], float) for machine in figures_db]) for name in names
    }
    if not len(pooled[names[0]]):
        return None
    mean_db: dict[Version, float] = {name: float(np.clip(figures, 0.0, BEST_DB).mean()) for name, figures in pooled.items()}
    usual, best = names[0], max(mean_db, key=mean_db.__getitem__)
    return Choice(
        version=best if mean_db[best] - mean_db[usual] >= LEAST_GAIN_DB else usual,
        mean_db=mean_db,
        num_photographs=len(pooled[names[0]]),
        num_machines=len(figures_db),
        num_without=sum(not len(machine[names[0]]) for machine in figures_db),
    )
