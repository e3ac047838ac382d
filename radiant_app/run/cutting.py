"""Whether regions and strips are cut where cameras stand or where they look. Once per plan.

Over land that is photographed from above both are nearly the same place. Oblique cameras look at
ground that others stand over: strips cut where they stand then say nothing about what their devices
see (`plan/looks.py`), and the joined model is worse (docs/experiments/aggregation.md, "Kinds of
scenes").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from radiant_core.choices import CutBy, PlanMethod
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.looks import camera_looks, strip_agreement
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.regions.region_plan import PlanInfeasible, plan_regions
from radiant_core.plan.system import System
from radiant_core.scene import SfmScene

LEAST_RISE = 0.1
"""Least rise of κ for which regions are cut where cameras look: it rose by 0.22 and 0.37 on the two
scenes that gain from it, by 0.05 on the one that loses."""
MOST_STANDING = 0.2
"""Most κ where cameras stand for which they are cut where they look: it is 0.01 and 0.10 on the two
scenes that gain from it. Where strips fit better, nothing is known to be gained."""
CHOICES = {
    "positions": "regions and strips are cut where cameras stand",
    "looks": "regions and strips are cut where cameras look",
}
MEANING = "how far the camera that sees a point and the strip that it lies in are of one device"

RULE = f"where they look is used from {LEAST_RISE:g} more on, if κ is at most {MOST_STANDING:g} where they stand"

Planned = tuple[CloudPlan, tuple[EdgePlan, ...]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Cut:
    """What a plan is cut by."""

    looks: FloatArray | None
    """(C,2) where cameras look, in the scene's unit; None: the plan is cut where they stand."""
    decision: Decision

    def places_of(self, positions: FloatArray) -> FloatArray:
        """The places (C,2) to plan, of cameras that stand at `positions` (C,2)."""
        return positions if self.looks is None else self.looks

    def mark(self, plan: CloudPlan) -> CloudPlan:
        """The plan of these places with what it was cut by."""
        return plan if self.looks is None else replace(plan, looks=self.looks)


def plan_places(
    places: FloatArray, system: System, method: PlanMethod = "exact", paper: PaperConfig | None = None
) -> Planned | PlanInfeasible:
    """Regions and strips of places (C,2), by the edges of a system that are placed."""
    plan = plan_regions(places, system, method=method, paper=paper)
    return plan if isinstance(plan, PlanInfeasible) else (plan, split_edges(places, plan, system))


def choose_cut(scene: SfmScene | None, wanted: CutBy, method: PlanMethod, make: Callable[[FloatArray], Planned | PlanInfeasible]) -> Cut:
    """Choose by κ what the regions of the scene's cameras are cut by, or do what is wanted.

    Args:
        scene: the planned cameras and their points; None where only positions are known.
        wanted: `auto` measures, for the exact method alone.
        method: how regions are made.
        make: places (C,2) of the cameras → their plan, if there is one.

    Raises:
        BadInput: `looks` is wanted and no camera of the scene observes a point.
    """
    if scene is None or not len(scene.observations):
        if wanted == "looks":
            raise BadInput("plan.cut_by is looks, and no sparse points say where cameras look: use auto or positions.")
        return _stand(wanted, "no sparse points say where cameras look")
    if wanted == "auto" and method != "exact":
        return _stand(wanted, f"method {method} is planned by positions, to compare with; plan.cut_by=looks changes that")
    looks = camera_looks(scene)
    kappas = [_agreement(scene, make(places)) for places in (scene.cameras.centers[:, :2], looks)]
    stand, look = kappas
    takes = wanted == "looks" or (wanted == "auto" and looks_pay(stand, look))
    rise = None if stand is None or look is None else look - stand
    measured = "κ is not known" if rise is None else f"κ is {stand:.2f} where they stand and {look:.2f} where they look"
    decision = replace(
        _decision("looks" if takes else "positions", f"{measured}, {MEANING}; {RULE}"),
        figure=rise,
        unit="" if rise is None else "more of κ where cameras look",
        forced=wanted != "auto",
        changes_nothing=not takes and wanted == "auto",
    )
    return Cut(looks=looks if takes else None, decision=decision)


def leave_whole() -> Cut:
    """No cut, where one device has all photographs."""
    return _stand("auto", "one device has all photographs, so that nothing is cut")


def looks_pay(stand: float | None, look: float | None) -> bool:
    """Whether κ of a plan that is cut where cameras stand and of one where they look are those of a
    scene that gains from the latter; None: κ cannot be told."""
    return stand is not None and look is not None and stand <= MOST_STANDING and look - stand >= LEAST_RISE


def follow_cut(looks: FloatArray | None) -> Cut:
    """What a plan is cut by that goes on from another one, whose cameras look at (C,2) or, None,
    was cut where they stand."""
    decision = _decision("positions" if looks is None else "looks", "as the plan that it goes on from")
    return Cut(looks=looks, decision=replace(decision, changes_nothing=looks is None))


def _agreement(scene: SfmScene, plan: Planned | PlanInfeasible) -> float | None:
    return None if isinstance(plan, PlanInfeasible) else strip_agreement(scene, *plan)


def _stand(wanted: CutBy, reason: str) -> Cut:
    forced = wanted != "auto"
    return Cut(looks=None, decision=replace(_decision("positions", reason), forced=forced, changes_nothing=not forced))


def _decision(choice: str, reason: str) -> Decision:
    return Decision(stage="plan", topic="what regions are cut by", choice=CHOICES[choice], figure=None, unit="", reason=reason)
