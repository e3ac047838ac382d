"""Costs, partitions and convergence on the paper's systems, from trained models. Once per page.

    systems_costs.png        CPU seconds and bytes of real devices against their photographs, and
                             the fitted curves                                          (Fig. 2)
    systems_partitions.png   regions by every method with the time of each edge         (Fig. 10)
    systems_convergence.png  max|T − T̄| / T̄ before each iteration of the paper's loops  (Fig. 13)

The costs are those of `paper_latency.py`: fitted to the trainings and joins of two plans on each
system. Cameras are the scene's. The times of the edges are the planner's by these costs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.methods.arms import Arms
from benchmarks.methods.cells import Cell
from benchmarks.paper.latency import SYSTEMS, fitted_costs, measure_costs, system_cell
from benchmarks.paper.parts import Part
from benchmarks.splits import compare_all
from benchmarks.tracking import track_items
from radiant_core.plan.baselines import ComparedPlan
from radiant_core.plan.profiles.curve_fit import FittedCurve

if TYPE_CHECKING:
    from benchmarks.charts.line_chart import Panel
    from radiant_viewer.pictures.images import Image

COSTS = {"train_s": ("Training (CPU s at speed 1)", 1.0), "model_bytes": ("Sent model (MB)", 1e-6)}


def systems_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """Of the first seed; a quick one of the first system alone."""
    from benchmarks.charts.line_chart import line_picture

    names = [*SYSTEMS][:1] if quick else [*SYSTEMS]
    fits = {name: measure_costs(arms, name, seeds[0]) for name in track_items(names, "bench paper, systems")}
    cells = {name: system_cell(arms, fitted_costs(curves), name, seeds[0]) for name, curves in fits.items()}
    compared = {name: compare_all(_places(arms, cell), cell.recipe.system) for name, cell in cells.items()}
    detail = f"{arms.scene.name}, {arms.scene.long_side_px} px, preset draft of {arms.num_steps} steps"
    pictures = {
        "systems_costs.png": line_picture(_cost_panels(fits), "Cost of a device against its photographs", f"{detail}; a dot is a training"),
        "systems_convergence.png": line_picture(
            [_convergence_panel(SYSTEMS[name], rows) for name, rows in compared.items()], "Convergence of region planning", detail
        ),
    }
    for name, rows in compared.items():
        pictures[f"systems_partitions_{name.removeprefix('paper_')}.png"] = _partitions(arms, cells[name], SYSTEMS[name], rows)
    lines = ["| system | method | slowest edge s | max abs(T − mean) / mean | over the bound |", "|---|---|---|---|---|"]
    lines += [
        f"| {SYSTEMS[name]} | {row.method} | {row.makespan_s:.1f} | {row.history[-1]:.2f} | {row.over_bound:.2f} |"
        for name, rows in compared.items()
        for row in rows
    ]
    return Part(
        title="Costs, partitions and convergence on the paper's systems",
        text="\n".join([*lines, "", (__doc__ or "").split("\n\n")[2].strip()]),
        pictures=pictures,
        figures={
            "costs": {name: {kind: asdict(fit) for kind, fit in curves.items()} for name, curves in fits.items()},
            "convergence": {name: {row.method: list(row.history) for row in rows} for name, rows in compared.items()},
            "edge_time_s": {name: {row.method: row.edge_time_s.tolist() for row in rows} for name, rows in compared.items()},
        },
    )


def _places(arms: Arms, cell: Cell) -> np.ndarray:
    return cell.recipe.cloud_plan.places_of(arms.scene.training.cameras.centers[:, :2])


def _cost_panels(fits: Mapping[str, Mapping[str, FittedCurve]]) -> list[Panel]:
    from benchmarks.charts.line_chart import Line, Panel

    panels = []
    for kind, (label, unit) in COSTS.items():
        lines = []
        for style, (name, curves) in enumerate(fits.items()):
            counts, values = np.array(curves[kind].samples, float).T
            xs = np.linspace(counts.min(), counts.max(), 50)
            lines.append(Line(name=SYSTEMS[name], x=counts, y=values * unit, dotted=True, style=style))
            lines.append(Line(name=f"{SYSTEMS[name]}, fitted", x=xs, y=curves[kind].curve(xs) * unit, style=style))
        panels.append(Panel(lines=tuple(lines), x_label="Photographs per device", y_label=label))
    return panels


def _convergence_panel(system: str, rows: Sequence[ComparedPlan]) -> Panel:
    from benchmarks.charts.line_chart import Line, Panel

    lines = [
        Line(name=f"{row.method}: ends at {row.history[-1]:.3f}", x=np.arange(len(row.history), dtype=float), y=np.array(row.history))
        for row in rows
        if row.method.startswith("paper") or row.method == "exact"
    ]
    return Panel(lines=tuple(lines), x_label=f"{system}: iteration (exact has none)", y_label="max |T − T̄| / T̄")


def _partitions(arms: Arms, cell: Cell, system: str, rows: Sequence[ComparedPlan]) -> Image:
    from radiant_viewer.charts.partition_chart import Partition, partitions_picture

    partitions = [
        Partition(name=row.method, edge_of_camera=row.edge_of_camera, edge_time_s=row.edge_time_s, note=f"{row.over_bound:.3g} × the bound")
        for row in rows
    ]
    edges = [edge.id for edge in cell.recipe.system.edges]
    return partitions_picture(_places(arms, cell), partitions, edges, f"{arms.scene.name}, {system}: regions and their times")
