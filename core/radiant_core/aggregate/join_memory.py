"""How models are joined within a limit of memory: retrained on views as large as fit, or cut at their borders. Once per edge.

    needs(s) = 0.39 GB + N (7 b + 500) + 4 Σ_v p_v(s) + 136 max_v p_v(s)      bytes, and what the loss keeps: up to 36 Σ_v p_v(s)

N Gaussians of b bytes each, p_v(s) pixels of view v with a long side of s; as `cloud_choice`, and 36 more for the loss of a view whose
statistics are not kept. The largest s up to the asked one is taken at which that fits, and what is left is the loss's. Views below a
quarter of their size would teach little of what is seen: then models are cut, which takes a few copies of them.
Within 50 and 35 % of what 20,000 Gaussians need, and 50 % of 150,000, `tests/stress/test_cloud_memory.py` holds the peak below the limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from radiant_core.aggregate.cloud_choice import (
    STATISTICS_BYTES_PER_PX,
    STEP_BYTES_PER_PX,
    VIEW_BYTES_PER_PX,
    models_bytes,
    pixels_of,
)
from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.splats import Splats
from radiant_core.train.native_loss import STATISTICS_BUDGET_BYTES

LEAST_SHARE = 0.25
"""Of the asked long side."""


@dataclass(frozen=True, kw_only=True)
class JoinPlan:
    """How a limit of memory is spent."""

    long_side_px: int | None
    """Of the views that are retrained on; None: models are cut at their borders."""
    statistics_bytes: int
    """Budget of the kept statistics of the loss."""
    needed_bytes: float
    """What the model above says for the two; where models are cut, for retraining on the smallest views."""


def join_plan(models: Sequence[Splats], cameras: Sequence[Cameras], long_side_px: int, memory_bytes: float) -> JoinPlan:
    """How models at their cameras, asked for views of `long_side_px`, are joined within `memory_bytes`."""
    least_px = max(1, round(LEAST_SHARE * long_side_px))
    step = STEP_BYTES_PER_PX + STATISTICS_BYTES_PER_PX

    def needed(side_px: int) -> tuple[float, int]:
        pixels = pixels_of(cameras, side_px)
        total = sum(pixels)
        return models_bytes(models) + VIEW_BYTES_PER_PX * total + step * max(pixels, default=0), total

    low, high = least_px, long_side_px + 1
    if needed(low)[0] > memory_bytes:
        return JoinPlan(long_side_px=None, statistics_bytes=0, needed_bytes=needed(low)[0])
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if needed(middle)[0] <= memory_bytes else (low, middle)
    bytes_before, pixels = needed(low)
    statistics = int(min(STATISTICS_BYTES_PER_PX * pixels, STATISTICS_BUDGET_BYTES, memory_bytes - bytes_before))
    return JoinPlan(long_side_px=low, statistics_bytes=statistics, needed_bytes=bytes_before + statistics)


def join_memory_decision(stage: str, plan: JoinPlan, asked_px: int, memory_bytes: float) -> Decision:
    """What a limit of memory made of joining."""
    if plan.long_side_px is None:
        choice = "models are cut at their borders, nothing is retrained"
        reason = f"retraining on views of a quarter of their size is predicted to take {plan.needed_bytes / 1e6:,.0f} MB"
    else:
        smaller = "" if plan.long_side_px == asked_px else f" instead of {asked_px:,} px"
        choice = f"views of {plan.long_side_px:,} px{smaller}, {plan.statistics_bytes / 1e6:,.0f} MB for what the loss keeps of them"
        reason = f"retraining on them is predicted to take {plan.needed_bytes / 1e6:,.0f} MB"
    return Decision(stage=stage, topic="memory", choice=choice, figure=memory_bytes / 1e6, unit="MB allowed", reason=reason, forced=True)
