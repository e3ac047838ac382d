"""What a join may hold in memory, and what is said where that is too little: what it costs, and how
to have more. Once per join."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from radiant_core.decisions import Decision

if TYPE_CHECKING:
    from radiant_core.aggregate.join_memory import JoinMemory
    from radiant_core.hierarchy.reporter import Machine, Reporter

MACHINE_SHARE = 0.8
"""Of the free memory of its machine, what joining may take where the system file has no limit."""
CUT_AT_EDGE_COSTS = "On three sets edges that only cut cost 0.03 to 0.44 dB, with devices that refine (docs/experiments/aggregation.md)."
CUT_AT_CLOUD_COSTS = "On four sets edges' models that were only cut came out 0.4 to 0.6 dB lower (docs/benchmarks.md)."
UNREFINED_CUT_COSTS = "On four sets it came out 0.6 to 1.2 dB below the refined scene (docs/benchmarks.md)."
UNREFINED_COSTS = "On four sets refining gained 0.1 to 0.6 dB over the joined scene (docs/benchmarks.md)."
TILES_COST = "Tiles take longer; on two scenes they came out up to 0.18 dB lower, and within 0.03 dB where devices refine what is joined."
JOIN_AGAIN = "`radiant join RUN --out JOINED.ply` joins the models that lie in a run without a limit, and refines nothing"


@dataclass(frozen=True, kw_only=True)
class JoinLimit:
    """The most memory that a join may take."""

    num_bytes: float
    """Infinite: whatever it needs."""
    label: str
    """In words, for "where … allows … MB"."""
    lift: str
    """In words, how a next run has more."""


def limit_of_machine(machine: Machine, num_beside: int = 1) -> JoinLimit:
    """Where the system file says nothing: what the process holds already, and a share of what the
    machine has free, divided among joins that run `num_beside` at a time."""
    among = f", divided among {num_beside} edges at a time," if num_beside > 1 else ""
    return JoinLimit(
        num_bytes=machine.held_bytes() + MACHINE_SHARE * machine.free_bytes() / num_beside,
        label=f"{MACHINE_SHARE:.0%} of what this machine has free{among}",
        lift="free memory there before the next run",
    )


def ways_to_lift(lift: str, *, can_join_again: bool) -> str:
    """Beside a next run, joining the models that there are, unless GPS alone has placed them."""
    return f"{lift}; or {JOIN_AGAIN}" if can_join_again else lift


def report_join_memory(memory: JoinMemory, limit: JoinLimit, cut_costs: str, reporter: Reporter) -> None:
    """Decide and warn where a limit of memory divides a join into tiles, or makes it a cut."""
    if memory.fits and memory.num_tiles == 1:
        return
    if memory.fits:
        choice = f"models are joined in {memory.num_tiles} tiles, one after another"
    else:
        choice = "models are cut at their borders instead of retrained"
    decision = Decision(
        stage=reporter.stage,
        topic="memory",
        choice=choice,
        figure=limit.num_bytes / 1e6,
        unit="MB allowed",
        reason=f"that is predicted to take {memory.needed_bytes / 1e6:,.0f} MB",
        forced=True,
    )
    reporter.decide(decision)
    costs, wanted = (TILES_COST, "To join them at once") if memory.fits else (cut_costs, "To join them")
    allowed = f"where {limit.label} allows {limit.num_bytes / 1e6:,.0f} MB"
    reporter.warn(f"{choice}: {decision.reason}, {allowed}. {costs} {wanted} {limit.lift}.")
