"""End-to-end latency with the quality beside it, on the paper's two systems. Once per page.

    every plan     with our joining; the plan `paper` with the paper's joining too
    Fed3DGS        its clients have as many photographs each, its server takes them in one by one

Edges, devices, speeds and uplinks are those of `benchmarks/systems`. The costs there are of GPUs
and of thousands of photographs; here they are fitted to trainings and joins of this scene: those of
the even plan and of a plan for times in proportion to photographs.

    simulated   by the planner's costs, which are of our joining, until the last edge's model is at
                the cloud
    emulated    by the CPU seconds and bytes of the real nodes, each node's on this machine ÷ speed
                of its machine, bytes over its uplink (`emulated_latency.py`)
    measured    CPU seconds of all nodes on this machine; quality on held-out photographs

Not in these times: structure from motion, loading of photographs and the start of processes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.methods.arms import Arm, ArmRow, Arms
from benchmarks.methods.bench import join, join_at_server
from benchmarks.methods.cells import Cell
from benchmarks.methods.emulated_latency import emulate_server, emulate_tree
from benchmarks.paper.parts import Part
from benchmarks.simulate import fleet_of, simulate
from benchmarks.splits import ALL_METHODS, AnyMethod
from benchmarks.tracking import track_items
from radiant_app.files.system_file import load_system
from radiant_core.aggregate.config import aggregate_preset
from radiant_core.errors import BadInput
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.curve_fit import FittedCurve, fit_curve
from radiant_core.plan.system import Device, Edge, System

if TYPE_CHECKING:
    from benchmarks.charts.end_to_end_chart import MethodLatency
    from radiant_viewer.pictures.images import Image

SYSTEMS = {"paper_1": "System 1", "paper_2": "System 2"}
"""Names on the page by files of `benchmarks/systems`; a quick run has the first."""
QUICK_PLANS: tuple[AnyMethod, ...] = ("exact", "even")
SERVER = "Fed3DGS"
PHASES = ("devices train and send", "edges join and send", "the cloud joins", "refined and compared")


@dataclass(frozen=True, kw_only=True)
class Costs:
    """Seconds and bytes at speed 1 against photographs; alone_s: of an edge with one device."""

    train_s: CostCurve
    model_bytes: CostCurve
    aggregate_s: CostCurve
    alone_s: CostCurve | None = None

    def of(self, system: System) -> System:
        """The system with these costs instead of its own."""
        return replace(system, edges=tuple(self._of_edge(edge) for edge in system.edges))

    def _of_edge(self, edge: Edge) -> Edge:
        slower = 1 / (edge.speed or 1.0)
        alone = None if self.alone_s is None else self.alone_s.scaled(slower)
        devices = tuple(self._of_device(device) for device in edge.devices)
        return replace(edge, aggregate_s=self.aggregate_s.scaled(slower), aggregate_alone_s=alone, devices=devices)

    def _of_device(self, device: Device) -> Device:
        slower = 1 / (device.speed or 1.0)
        return replace(device, init_s=CostCurve(), train_s=self.train_s.scaled(slower), model_bytes=self.model_bytes)


IN_PROPORTION = Costs(train_s=CostCurve(linear=1.0), model_bytes=CostCurve(), aggregate_s=CostCurve())
"""Of the plan that is trained before anything is known."""


@dataclass(frozen=True, kw_only=True)
class LatencyRow:
    """A method on a system; times in s, None where nothing was simulated."""

    system: str
    method: str
    seed: int
    photographs: tuple[int, ...]
    """Of each device."""
    simulated_imbalance: float | None
    """max |T − T̄| / T̄ of the edges' times."""
    simulated_edges_s: float | None
    """When the last edge's model is at the cloud."""
    emulated_imbalance: float | None
    emulated_devices_s: float
    emulated_edges_s: float | None
    emulated_joined_s: float
    """When the scene is joined."""
    emulated_scene_s: float
    """When the scene is done: end to end."""
    measured_cpu_s: float
    """Of all nodes, on this machine."""
    psnr_db: float
    ssim: float
    num_gaussians: int


def latency_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """Every method on both systems; a quick one on the first, with two plans."""
    names = [*SYSTEMS][:1] if quick else [*SYSTEMS]
    wanted = [(name, seed) for name in names for seed in seeds]
    costs = {key: measure_costs(arms, *key) for key in track_items(wanted, "bench paper, costs of the systems")}
    cells = {key: system_cell(arms, fitted_costs(fits), *key) for key, fits in costs.items()}
    tried = [(key, cell, arm) for key, cell in cells.items() for arm in (plan_arms(quick) if quick else _all_arms())]
    results: list[tuple[ArmRow, LatencyRow]] = []
    missing: list[str] = []
    for (system, _), cell, arm in track_items(tried, "bench paper, latency"):
        try:
            recipe = arm.recipe(cell)
        except BadInput as problem:
            missing.append(f"{arm.name} on {system}: {problem}")
            continue
        row = arms.row(cell, arm)
        # The costs are of our joining.
        results.append((row, _latency(system, recipe, row, simulated=recipe.aggregate == cell.recipe.aggregate)))
    rows = [row for _, row in results]
    lines = [(__doc__ or "").split("\n\n", 1)[1].strip("\n"), ""]
    for system in names:
        lines += [*_table(system, [row for row in rows if row.system == system]), ""]
    lines += [*(f"Left out: {text}" for text in missing), *_fit_lines(costs)]
    fits_of = {f"{system}-s{seed}": {name: asdict(fit) for name, fit in fits.items()} for (system, seed), fits in costs.items()}
    return Part(
        title="End-to-end latency",
        text="\n".join(lines),
        pictures={"latency.png": _picture(arms, names, rows)},
        figures={"rows": [asdict(row) for row, _ in results], "latency": [asdict(row) for row in rows], "costs": fits_of},
    )


def plan_arms(quick: bool) -> list[Arm]:
    """Our joining by every plan, by the exact and the even one alone where `quick`."""
    plans = QUICK_PLANS if quick else ALL_METHODS
    return [Arm(name=f"{plan} plan", make=join, recipe=lambda cell, plan=plan: cell.planned(plan)) for plan in plans]


def _all_arms() -> list[Arm]:
    paper = Arm(
        name="paper plan and joining", make=join, recipe=lambda cell: replace(cell.planned("paper"), aggregate=aggregate_preset("paper"))
    )
    return [*plan_arms(quick=False), paper, Arm(name=SERVER, make=join_at_server, recipe=lambda cell: cell.planned("even"))]


def system_cell(arms: Arms, costs: Costs, name: str, seed: int) -> Cell:
    """The scene on one of the paper's systems, with these costs."""
    system = load_system(Path(__file__).parents[1] / "systems" / f"{name}.toml")
    return arms.system_cell(costs.of(system), name, seed)


def measure_costs(arms: Arms, name: str, seed: int) -> dict[str, FittedCurve]:
    """Curves at speed 1, fitted to the nodes of two plans that need to know none."""
    cell = system_cell(arms, IN_PROPORTION, name, seed)
    samples: dict[str, list[tuple[int, float]]] = {"train_s": [], "model_bytes": [], "aggregate_s": [], "alone_s": []}
    for arm in plan_arms(quick=True):
        recipe, works = arm.recipe(cell), {work.stage: work for work in arms.row(cell, arm).nodes}
        for plan in recipe.edge_plans:
            counts = [len(plan.cameras_of(device)) for device in plan.device_ids]
            for device, count in zip(plan.device_ids, counts, strict=True):
                if count:
                    work = works[f"devices/{device}"]
                    samples["train_s"].append((count, work.cpu_s))
                    samples["model_bytes"].append((count, work.sent_bytes))
            if any(counts):
                kind = "aggregate_s" if np.count_nonzero(counts) > 1 else "alone_s"
                samples[kind].append((sum(counts), works[f"edges/{plan.edge_id}"].cpu_s))
    return {kind: fit_curve(*zip(*pairs, strict=True), may_fall=True) for kind, pairs in samples.items() if pairs}


def fitted_costs(fits: dict[str, FittedCurve]) -> Costs:
    """The curves as costs; joining that was not measured costs nothing."""
    curves = {kind: fit.curve for kind, fit in fits.items()}
    return Costs(
        train_s=curves["train_s"],
        model_bytes=curves["model_bytes"],
        aggregate_s=curves.get("aggregate_s", CostCurve()),
        alone_s=curves.get("alone_s"),
    )


def _latency(system: str, recipe: Recipe, row: ArmRow, *, simulated: bool) -> LatencyRow:
    quotas = [len(recipe.cameras_of(device.id)) for device in recipe.system.devices]
    serves = row.arm == SERVER
    played = (emulate_server if serves else emulate_tree)(recipe.system, row.nodes)
    planned = simulate(fleet_of(recipe.system, quotas)) if simulated and not serves else None
    return LatencyRow(
        system=system,
        method=row.arm,
        seed=row.seed,
        photographs=tuple(quotas),
        simulated_imbalance=None if planned is None else imbalance(planned.edge_done_s.tolist()),
        simulated_edges_s=None if planned is None else planned.makespan_s,
        emulated_imbalance=imbalance(played.edge_s) if played.edge_s else None,
        emulated_devices_s=played.devices_s,
        emulated_edges_s=max(played.edge_s, default=None),
        emulated_joined_s=played.joined_s,
        emulated_scene_s=played.scene_s,
        measured_cpu_s=sum(work.cpu_s for work in row.nodes),
        psnr_db=row.mean_psnr_db,
        ssim=row.mean_ssim,
        num_gaussians=row.num_gaussians,
    )


def imbalance(times_s: Sequence[float]) -> float:
    """max |T − T̄| / T̄ of the edges' times, as the paper draws it; an idle edge counts with 0."""
    mean_s = float(np.mean(times_s))
    return float(np.abs(np.array(times_s) - mean_s).max()) / mean_s


def _table(system: str, rows: Sequence[LatencyRow]) -> list[str]:
    """Means over seeds; with several of them, their range beside the end-to-end time."""
    lines = [
        f"| {SYSTEMS[system]} | photographs per device | imbalance, simulated | edges done s, simulated | imbalance, emulated |"
        " edges done s, emulated | joined s, emulated | scene done s, emulated | all nodes CPU s, measured | PSNR dB | SSIM | Gaussians |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    groups = _by_method(rows)
    for method, rows_of_method in groups.items():
        times = [_text(rows_of_method, "simulated_imbalance", 2), _text(rows_of_method, "simulated_edges_s", 1)]
        times += [_text(rows_of_method, "emulated_imbalance", 2), _text(rows_of_method, "emulated_edges_s", 1)]
        times += [_text(rows_of_method, "emulated_joined_s", 1), _text(rows_of_method, "emulated_scene_s", 1)]
        if len(rows_of_method) > 1:
            ends_s = [row.emulated_scene_s for row in rows_of_method]
            times[-1] += f" ({min(ends_s):.1f} to {max(ends_s):.1f})"
        quality = [_text(rows_of_method, "psnr_db", 2), _text(rows_of_method, "ssim", 3), f"{_mean(rows_of_method, 'num_gaussians'):,.0f}"]
        dealt = " ".join(map(str, rows_of_method[0].photographs))
        lines.append(f"| {' | '.join([method, dealt, *times, _text(rows_of_method, 'measured_cpu_s', 0), *quality])} |")
    return [*lines, "", *_sooner(groups)]


def _sooner(groups: dict[str, list[LatencyRow]]) -> list[str]:
    """What the exact plan saves over each other method, end to end, with the quality beside it."""
    if "exact plan" not in groups:
        return []
    exact, sentences = groups["exact plan"], []
    for method, rows_of_method in groups.items():
        if method == "exact plan":
            continue
        share = 1 - _mean(exact, "emulated_scene_s") / _mean(rows_of_method, "emulated_scene_s")
        later = f"{abs(share):.0%} {'sooner' if share >= 0 else 'later'} than {method}"
        sentences.append(f"{later} (PSNR {_mean(exact, 'psnr_db') - _mean(rows_of_method, 'psnr_db'):+.2f} dB)")
    return [f"As emulated, the scene of the exact plan is done {'; '.join(sentences)}."] if sentences else []


def _by_method(rows: Sequence[LatencyRow]) -> dict[str, list[LatencyRow]]:
    groups: dict[str, list[LatencyRow]] = {}
    for row in rows:
        groups.setdefault(row.method, []).append(row)
    return groups


def _mean(rows: Sequence[LatencyRow], figure: str) -> float:
    return float(np.mean([getattr(row, figure) for row in rows]))


def _text(rows: Sequence[LatencyRow], figure: str, digits: int) -> str:
    return "–" if any(getattr(row, figure) is None for row in rows) else f"{_mean(rows, figure):.{digits}f}"


def _fit_lines(costs: dict[tuple[str, int], dict[str, FittedCurve]]) -> list[str]:
    """How far the planner's costs are from the samples that they were fitted to."""
    errors = [
        f"{system}, seed {seed}: " + ", ".join(f"{kind} {fit.rmse or 0:.0%} of {len(fit.samples)}" for kind, fit in fits.items())
        for (system, seed), fits in costs.items()
    ]
    return ["Root mean square of the costs' relative errors at their samples: " + "; ".join(errors) + "."]


def _picture(arms: Arms, systems: Sequence[str], rows: Sequence[LatencyRow]) -> Image:
    from benchmarks.charts.end_to_end_chart import SystemLatency, end_to_end_picture

    panels = [
        SystemLatency(
            name=SYSTEMS[system],
            methods=tuple(
                _method_latency(method, rows_of_method)
                for method, rows_of_method in _by_method([row for row in rows if row.system == system]).items()
            ),
        )
        for system in systems
    ]
    size = f"{arms.scene.name}, {arms.scene.long_side_px} px, preset draft of {arms.num_steps} steps"
    detail = f"{size}; measured CPU seconds ÷ speed, bytes over uplinks; beside each bar held-out PSNR"
    return end_to_end_picture(panels, PHASES, "simulated, until the edges are done", "End-to-end latency, emulated", detail)


def _method_latency(method: str, rows: Sequence[LatencyRow]) -> MethodLatency:
    from benchmarks.charts.end_to_end_chart import MethodLatency

    devices_s, joined_s, scene_s = (_mean(rows, f"emulated_{node}_s") for node in ("devices", "joined", "scene"))
    edges_s = devices_s if rows[0].emulated_edges_s is None else _mean(rows, "emulated_edges_s")
    simulated_s = None if rows[0].simulated_edges_s is None else _mean(rows, "simulated_edges_s")
    note = f"{_mean(rows, 'psnr_db'):.2f} dB"
    return MethodLatency(name=method, ends_s=(devices_s, edges_s, joined_s, scene_s), simulated_s=simulated_s, note=note)
