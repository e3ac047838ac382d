"""What slack buys: makespan, distances and border length. Once per plan, on request."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import System

SLACKS = (1.0, 1.02, 1.05, 1.1, 1.2, 1.5, 2.0)


@dataclass(frozen=True, kw_only=True)
class SlackPoint:
    """One plan of the curve."""

    slack: float
    makespan_s: float
    mean_distance_m: float
    """From a camera to its edge."""
    rms_distance_m: float
    """The root of the mean square, which no plan within the slack makes smaller."""
    border_m: float
    """Length of all borders between regions, each once."""
    certified: bool


def slack_curve(
    positions: ArrayLike, system: System, slacks: Sequence[float] = SLACKS, *, progress: Callable[[float], None] = lambda _: None
) -> tuple[SlackPoint, ...]:
    """The exact plan of cameras (C,2) m per slack. Raises as `plan_regions`, or if none fits."""
    positions = check_array("positions", positions, (None, 2))
    points: list[SlackPoint] = []
    for index, slack in enumerate(slacks):
        progress(index / len(slacks))
        plan = plan_regions(positions, system, slack=slack)
        if not isinstance(plan, CloudPlan):
            raise BadInput(f"there is no slack curve: {plan.reason}")
        squared_m2 = np.sum((positions - plan.sites[plan.edge_of_camera]) ** 2, axis=1)
        points.append(
            SlackPoint(
                slack=slack,
                makespan_s=plan.makespan_s,
                mean_distance_m=float(np.sqrt(squared_m2).mean()),
                rms_distance_m=float(np.sqrt(squared_m2.mean())),
                border_m=border_length_m(plan.borders),
                certified=plan.certified,
            )
        )
    return tuple(points)


def border_length_m(borders: Sequence[FloatArray]) -> float:
    """Border length of cells (V,2) m that fill a rectangle: half of what is not its outline."""
    filled = [border for border in borders if len(border)]
    if len(filled) < 2:
        return 0.0
    corners: FloatArray = np.concatenate(filled)
    perimeter_m = sum(float(np.hypot(*(np.roll(border, -1, axis=0) - border).T).sum()) for border in filled)
    return max(0.0, (perimeter_m - 2 * float(np.ptp(corners, axis=0).sum())) / 2)
