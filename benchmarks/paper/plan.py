"""The planning section of `radiant bench paper`: cost, convergence, and what methods make.

    costs.png        training time and model size against photographs, with the fitted curves
    convergence.png  max|T − T̄| / T̄ before each iteration of the paper's loops; the exact plan's
    partitions.png   all methods' regions with the latency of each

The first is trained on the scene of the page; the others are of synthetic cameras in five clusters
with six unequal edges.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.charts.line_chart import Line, Panel, line_picture
from benchmarks.methods.arms import Arms
from benchmarks.paper.parts import Part
from benchmarks.plan import camera_layout, unequal_system
from benchmarks.splits import compare_all
from benchmarks.tracking import track_items
from radiant_core.plan.profiles.curve_fit import fit_curve
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_viewer.charts.partition_chart import Partition, partitions_picture

SHARES, QUICK_SHARES = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0), (0.25, 0.5, 1.0)
"""Shares of the photographs to train on, from the western end."""
STEPS_PER_PHOTOGRAPH = 20


def plan_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """Costs measured on the scene; convergence and partitions of synthetic cameras."""
    cell = arms.cell(arms.layout, seeds[0])
    from_west = np.argsort(cell.scene.training.cameras.centers[:, 0], kind="stable")
    counts = sorted({max(2, round(share * len(from_west))) for share in (QUICK_SHARES if quick else SHARES)})
    models = [
        cell.model_of(cell.scene.training.restricted_to(np.sort(from_west[:count])), num_steps=STEPS_PER_PHOTOGRAPH * count)
        for count in track_items(counts, "bench paper, plan")
    ]
    costs = {
        "Training (CPU s)": [float(model.summary["cpu_s"]) for model in models],
        "Model (MB)": [model.splats.num_bytes / 1e6 for model in models],
    }
    positions = camera_layout("clustered", 200 if quick else 1600, np.random.default_rng(3))
    system = place_edges(unequal_system(6, np.random.default_rng(3)), positions, None, seed=0)
    compared = compare_all(positions, system)
    histories = {row.method: list(row.history) for row in compared if row.method.startswith("paper") or row.method == "exact"}
    partitions = [
        Partition(name=row.method, edge_of_camera=row.edge_of_camera, edge_time_s=row.edge_time_s, note=f"{row.over_bound:.3g} × the bound")
        for row in compared
    ]
    edge_ids = [edge.id for edge in system.edges]
    detail = f"{arms.scene.name}, {arms.scene.long_side_px} px, {STEPS_PER_PHOTOGRAPH} steps per photograph; every dot is one training"
    clusters = f"{len(positions)} cameras in five clusters, {len(edge_ids)} edges"
    pictures = {
        "costs.png": line_picture(_cost_panels(counts, costs), "Cost against photographs per device", detail),
        "convergence.png": line_picture([_convergence_panel(histories)], "Convergence of ARP", clusters),
        "partitions.png": partitions_picture(positions, partitions, edge_ids, "Partitions with the latency of each region"),
    }
    text = f"Costs are measured on {detail}. Convergence and partitions: {clusters}."
    figures = {
        "costs": {"photographs": counts, **costs},
        "convergence": histories,
        "edge_time_s": {row.method: dict(zip(edge_ids, row.edge_time_s.tolist(), strict=True)) for row in compared},
    }
    return Part(title="Planning", text=text, pictures=pictures, figures=figures)


def _cost_panels(counts: Sequence[int], costs: dict[str, list[float]]) -> list[Panel]:
    xs = np.arange(1.0, max(counts) + 1)
    return [
        Panel(
            lines=(
                Line(name="measured", x=np.array(counts, float), y=np.array(values), dotted=True),
                Line(name="fitted", x=xs, y=fit_curve(counts, values).curve(xs)),
            ),
            x_label="Photographs per device",
            y_label=label,
        )
        for label, values in costs.items()
    ]


def _convergence_panel(histories: dict[str, list[float]]) -> Panel:
    lines = [
        Line(name=f"{method}: ends at {values[-1]:.3f}", x=np.arange(len(values), dtype=float), y=np.array(values))
        for method, values in histories.items()
    ]
    return Panel(lines=tuple(lines), x_label="Iteration (exact has none)", y_label="max |T − T̄| / T̄")
