"""`Decision`: one thing that was skipped or chosen, and the figure that decided it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Decision:
    """What was decided in which stage, and why."""

    stage: str
    """Stage or node that decided, for example "sfm" or "devices/north-1"."""
    topic: str
    """What was at stake, for example "matching" or "resolution"."""
    choice: str
    """What was chosen, in words."""
    figure: float | None
    """The measured figure that decided, None where a user forced the choice without one."""
    unit: str
    """Unit of the figure."""
    reason: str
    """Why this figure leads to this choice, one sentence."""
    row: str = ""
    """Row of measured cases that led to it (`regimes.py`, docs/experiments/regimes.md); empty where
    none did."""
    otherwise: str = ""
    """The option that forces the other choice; empty where there is none."""
    otherwise_db: float | None = None
    """What the other choice gained over this one in trials; None where it was not tried."""
    forced: bool = False
    """Whether the user asked for this choice."""
    changes_nothing: bool = False
    """Whether all stays as it was, such as "0 of 3 photographs are left out": the report lists it,
    the terminal does not."""
