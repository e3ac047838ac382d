"""The figures of an edited plan: makespan, bound, loads, and the certificate. Once per edit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_core.plan.system import System
from radiant_viewer.layers.region_layer import duration_text


@dataclass(frozen=True, kw_only=True)
class LoadRow:
    """One edge, or a device of the edge above: cameras, seconds, share of the makespan (0 to 1)."""

    name: str
    edge: str
    is_edge: bool
    num_cameras: int
    time_s: float | None
    """None for devices during a drag."""
    share: float
    note: str = ""
    """Constraints on it, and how many cameras it can hold."""


def load_rows(cloud: CloudPlan, edges: Sequence[EdgePlan], system: System, constraints: PlanConstraints) -> tuple[LoadRow, ...]:
    """Return each edge with its devices below, which have no numbers until cameras are dealt."""
    makespan_s = cloud.makespan_s or 1.0
    pins = {edge: list(constraints.pinned.values()).count(edge) for edge in set(constraints.pinned.values())}
    dealt = {plan.edge_id: plan for plan in edges if plan.dealt}
    rows: list[LoadRow] = []
    counts = cloud.counts
    for index, edge in enumerate(system.edges):
        notes = [
            *(["locked"] if edge.id in constraints.locked else []),
            *(["border dragged"] if edge.id in constraints.fixed_weights_m2 else []),
            *([f"{pins[edge.id]} pinned"] if edge.id in pins else []),
        ]
        time_s = float(cloud.edge_time_s[index])
        rows.append(
            LoadRow(
                name=edge.id,
                edge=edge.id,
                is_edge=True,
                num_cameras=int(counts[index]),
                time_s=time_s,
                share=time_s / makespan_s,
                note=", ".join(notes),
            )
        )
        plan = dealt.get(edge.id)
        for place, device in enumerate(edge.devices):
            spent_s = None if plan is None else float(plan.device_time_s[place])
            rows.append(
                LoadRow(
                    name=device.id,
                    edge=edge.id,
                    is_edge=False,
                    num_cameras=0 if plan is None else int((plan.device_of_camera == place).sum()),
                    time_s=spent_s,
                    share=(spent_s or 0.0) / makespan_s,
                    note="" if device.max_cameras is None else f"holds {device.max_cameras}",
                )
            )
    return tuple(rows)


@dataclass(frozen=True, kw_only=True)
class ComparedRow:
    """One figure of two plans, as texts."""

    name: str
    value: str
    compared: str


def compare_figures(base: CloudPlan, compared: CloudPlan) -> tuple[ComparedRow, ...]:
    """Return makespan, ratio to the bound, cameras and time per edge, greatest change first."""
    rows = [
        ComparedRow(name="makespan", value=duration_text(base.makespan_s), compared=duration_text(compared.makespan_s)),
        ComparedRow(name="over the bound", value=_over_bound(base), compared=_over_bound(compared)),
    ]
    dealt = [dict(zip(plan.edge_ids, plan.counts.tolist(), strict=True)) for plan in (base, compared)]
    ids = sorted({*base.edge_ids, *compared.edge_ids}, key=lambda edge: (-abs(dealt[0].get(edge, 0) - dealt[1].get(edge, 0)), edge))
    return (*rows, *(ComparedRow(name=edge, value=_load_of(base, edge), compared=_load_of(compared, edge)) for edge in ids))


def _over_bound(cloud: CloudPlan) -> str:
    return f"{cloud.makespan_s / cloud.lower_bound_s:.3f} ×" if cloud.lower_bound_s > 0 else "unknown"


def _load_of(cloud: CloudPlan, edge: str) -> str:
    if edge not in cloud.edge_ids:
        return "not there"
    index = cloud.edge_ids.index(edge)
    return f"{int(cloud.counts[index]):,} in {duration_text(float(cloud.edge_time_s[index]))}"


def headline(cloud: CloudPlan) -> str:
    """Return makespan, bound and their ratio in one line."""
    bound_s = cloud.lower_bound_s
    over = f", {cloud.makespan_s / bound_s:.3f} × bound {duration_text(bound_s)}" if bound_s > 0 else ""
    return f"Makespan {duration_text(cloud.makespan_s)}{over}"


def certificate_text(cloud: CloudPlan) -> str:
    """Return the proven quality of the plan, one sentence."""
    outside = cloud.num_outside
    verb, place = ("lie", "in") if cloud.looks is None else ("look", "into")
    lie = (
        f"{outside} camera{f's {verb}' if outside != 1 else f' {verb}s'} outside the drawn region"
        if outside
        else f"every camera {verb}s {place} its own cell"
    )
    if cloud.status == "optimal":
        return f"Certified optimal: no plan of these machines is faster; {lie}."
    if cloud.status == "slack":
        return f"Least distance within {cloud.slack:g} times the bound, certified; {lie}." if cloud.slack else f"Certified; {lie}."
    if cloud.status == "constrained":
        free = next((text for text in cloud.constrained if text.startswith("the certificate")), "")
        return f"Best around what is fixed; {lie}{f'; {free}' if free else ''}."
    return f"Not certified as optimal ({cloud.method}, {cloud.status}); {lie}."
