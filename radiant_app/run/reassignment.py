"""Reassigns the photographs of a lost device, where one owner has all, to devices not yet started.

A device that has started keeps exactly its photographs, so that nothing is trained twice; `replan`
deals the rest. The new plan replaces plan.json and lies in replanned/ with the key of the plan it
was made from: a resumed run makes that plan again and continues with the new one. If no device can
take the photographs, the edge goes on without them, as reported. Runs once per lost device.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radiant_app.events import Decided, Listener, Warned
from radiant_app.run.dealing import Dealer
from radiant_app.run.source import Plan
from radiant_core.aggregate.tree import Tree
from radiant_core.decisions import Decision
from radiant_core.io.records import load_plan, save_plan
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.numerics import FloatArray
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.revision.replan import FleetChange, ReplanInfeasible, replan

FOLDER, RECORD = "replanned", "made_from.json"


@dataclass(kw_only=True)
class Reassignment:
    """Deals a lost device's photographs to devices of the tree that have not started."""

    dealer: Dealer
    positions: FloatArray
    """(C,2) m of the plan's photographs."""
    tree: Tree
    first_plan_key: str
    """`plan_key` of the plan before any reassignment."""
    listen: Listener

    def __call__(self, lost: Tree, begun: Collection[str]) -> None:
        """Reassign the photographs of `lost` while the nodes in `begun` run or are done."""
        # Scoring on a device, once the tree is done, has no photographs to reassign.
        if lost.tier != "device" or lost.id not in {node.id for node in self.tree}:
            return
        dealer, positions = self.dealer, self.positions
        waiting = {node.name for node in self.tree if node.tier == "device" and node.id not in {*begun, lost.id}}
        at_work = {device.id for device in dealer.recipe.system.devices} - waiting - {lost.name}
        fixed = np.zeros(len(positions), bool)
        for plan in dealer.recipe.edge_plans:
            for device in at_work & set(plan.device_ids):
                fixed[plan.cameras_of(device)] = True
        count = sum(len(plan.cameras_of(lost.name)) for plan in dealer.recipe.edge_plans if lost.name in plan.device_ids)
        message = f"{count} photographs of {lost.name} are in no model: every other device has begun or is full; --resume tries it again"
        if waiting and count:
            change = FleetChange(dead=frozenset({lost.name}), closed=frozenset(at_work))
            new = replan(dealer.recipe.cloud_plan, dealer.recipe.edge_plans, positions, dealer.recipe.system, change, captured=fixed)
            if not isinstance(new, ReplanInfeasible) and all(_has_cameras(new.edges, device) for device in waiting):
                self._keep(new.cloud, new.edges)
                takers = sorted({new.system.devices[index].id for index in new.device_after[new.moved].tolist()})
                self.listen(Decided(decision=_decision(lost.name, count, takers)))
                message = f"{count} photographs of {lost.name} go to {', '.join(takers)}, which had not begun"
        self.listen(Warned(stage=lost.id, message=message))

    def _keep(self, cloud: CloudPlan, edges: tuple[EdgePlan, ...]) -> None:
        folder = self.dealer.run / FOLDER
        folder.mkdir(exist_ok=True)
        save_plan(folder / "plan.json", cloud, edges)
        write_json(folder / RECORD, {"first_plan": self.first_plan_key})
        save_plan(self.dealer.run / "plan.json", cloud, edges)
        self.dealer.replace_plan(cloud, edges)


def plan_key(cloud: CloudPlan, edges: Sequence[EdgePlan]) -> str:
    """Return the hash of a plan."""
    return content_key(cloud, list(edges))


def load_replan(run: Path, plan: Plan) -> Plan:
    """The plan that an interrupted run reassigned from this one, or this one if there is none."""
    record = run / FOLDER / RECORD
    if not record.is_file() or read_json(record, ("first_plan",))["first_plan"] != plan_key(plan.cloud, plan.edges):
        return plan
    cloud, edges = load_plan(run / FOLDER / "plan.json")
    save_plan(run / "plan.json", cloud, edges)
    return replace(plan, cloud=cloud, edges=edges)


def _has_cameras(edges: Sequence[EdgePlan], device: str) -> bool:
    return any(len(plan.cameras_of(device)) for plan in edges if device in plan.device_ids)


def _decision(lost: str, count: int, takers: Sequence[str]) -> Decision:
    return Decision(
        stage="plan",
        topic="lost device",
        choice=f"{count} photographs of {lost} go to {', '.join(takers)}",
        figure=float(count),
        unit="photographs",
        reason="these devices had not begun; chosen for the earliest end, then for the fewest moves",
    )
