"""How long the nodes that refine a scene may take, from what their own nodes took before. Once per
round.

    device   the time of its process beside training, and that of training × the share of its steps
             × how much larger the scene is than its model
    edge     the time of joining × how much larger the scene is than its model, and a training step
             for each photograph of its devices, whose renders weigh them in the first round; later
             ones may take as long, since a device can be late. The cloud: joining alone

Refining has no cost curve and needs none: each of its machines has just been measured. The rule is
that of trainings and joins (`time_left.py`): given up after `execution.deadline_factor` times as
long, never within a minute, and a warning at `OVERDUE_FACTOR` times.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from radiant_app.run.dealing import Dealer
from radiant_app.run.time_left import LEAST_S, OVERDUE_FACTOR
from radiant_core.aggregate.tree import Tree, refines_for
from radiant_core.hierarchy.codec import SUMMARY_NAME
from radiant_core.hierarchy.refining_plan import refining_steps
from radiant_core.io.run_store import read_json


@dataclass(frozen=True, kw_only=True)
class RefiningDeadlines:
    """`Deadlines` of the nodes that refine."""

    expected_s: Mapping[str, float]
    """Node id → seconds it should take; a node that is absent has no deadline."""
    deadline_factor: float
    """A node is given up after this many times as long; 0: never."""

    def overdue_reason(self, node_id: str, ran_s: float) -> str | None:
        """See `Deadlines`."""
        return self._reason_over(node_id, ran_s, OVERDUE_FACTOR)

    def timeout_reason(self, node_id: str, ran_s: float) -> str | None:
        """See `Deadlines`."""
        return self._reason_over(node_id, ran_s, self.deadline_factor) if self.deadline_factor else None

    def exclude_pause(self, node_ids: Collection[str], seconds: float) -> None:
        """See `Deadlines`: the times of these nodes predict nothing anyway."""

    def _reason_over(self, node_id: str, ran_s: float, factor: float) -> str | None:
        expected_s = self.expected_s.get(node_id)
        if expected_s is None or ran_s < max(LEAST_S, factor * expected_s):
            return None
        return f"it has run for {ran_s:.0f} s, where its own work before the scene was joined says {expected_s:.0f} s"


def expected_times(dealer: Dealer, tree: Tree, times: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Seconds that each node of a round should take by when their own nodes started and ended; one
    whose time is not known gets the median of its tier."""
    scene = _summary(dealer.run / "cloud")
    expected: dict[str, float] = {}
    for node in tree:
        refined = refines_for(node.id)
        process_s = times[refined]["ended_s"] - times[refined]["started_s"] if refined in times else 0.0
        if process_s <= 0:
            continue
        summary = _summary(dealer.run / refined)
        larger = max(1.0, scene.get("num_splats", 0) / max(1, summary.get("num_splats", 0)))
        trained_s = min(process_s, summary.get("train_s", 0.0)) if node.tier == "device" else 0.0
        num_steps = 0
        if trained_s:
            num_dealt = dealer.photographs.num_dealt(refined.rsplit("/", 1)[-1])
            num_steps = refining_steps(dealer.recipe.refining_epochs, num_dealt)
        beside_s = (process_s - trained_s) * (1.0 if node.tier == "device" else larger)
        beside_s += sum(_render_s(dealer, child, scene) for child in node.children) if node.tier == "edge" else 0.0
        expected[node.id] = beside_s + trained_s * larger * num_steps / max(1, summary.get("num_steps", 0))
    for node in tree:
        alike = [expected[sibling.id] for sibling in tree if sibling.tier == node.tier and sibling.id in expected]
        if alike:
            expected.setdefault(node.id, median(alike))
    return expected


def _render_s(dealer: Dealer, node: Tree, scene: Mapping[str, float]) -> float:
    """Seconds in which a device would render the scene and back at each of its photographs."""
    refined = refines_for(node.id)
    summary = _summary(dealer.run / refined)
    step_s = summary.get("train_s", 0.0) / max(1, summary.get("num_steps", 0))
    larger = max(1.0, scene.get("num_splats", 0) / max(1, summary.get("num_splats", 0)))
    return step_s * larger * dealer.photographs.num_dealt(refined.rsplit("/", 1)[-1])


def _summary(folder: Path) -> Mapping[str, float]:
    path = folder / SUMMARY_NAME
    return read_json(path) if path.is_file() else {}
