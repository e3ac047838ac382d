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
    forced: bool = False
    """Whether the user asked for this choice."""
    changes_nothing: bool = False
    """Whether all stays as it was ("0 of 3 are left out"): listed in the report alone."""
