"""`radiant bench paper`: the paper's figures and tables from our own data. Once per scene.

    plan      costs of training, convergence and partitions (`paper_plan.py`)
    balance   even against balanced regions with the time of each device (`paper_balance.py`)
    latency   plans, joining and Fed3DGS on the paper's two systems, emulated (`paper_latency.py`)
    table2    the paper's main table: twelve methods, radiance fields among them (`paper_table.py`)
    systems   costs, partitions and convergence on the same systems (`paper_systems.py`)
    others    main, fed3dgs, border, regions, fusion, epochs: joined models (`paper_parts.py`)

Everything is written to one folder: `paper.md` with its pictures, `paper.json` with all figures,
and in `models/` and `joined/` what a later call reuses. The page is rewritten after every section.
No figure of the paper itself is on it: scenes, sizes and machines differ.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.methods.arms import Arms, load_arms
from benchmarks.methods.cells import Layout, bench_settings
from benchmarks.methods.rivals import FIELD_STEPS
from benchmarks.metric import Metric
from benchmarks.paper.balance import balance_part
from benchmarks.paper.latency import latency_part
from benchmarks.paper.parts import Part, border_part, epochs_part, fed3dgs_part, fusion_part, main_part, regions_part
from benchmarks.paper.plan import plan_part
from benchmarks.paper.systems import systems_part
from benchmarks.paper.table import table_part
from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.evaluate.lpips import Lpips
from radiant_core.io.run_store import write_atomic, write_json

PARTS: Mapping[str, Callable[[Arms, Sequence[int], bool], Part]] = {
    "border": border_part,
    "balance": balance_part,
    "latency": latency_part,
    "systems": systems_part,
    "regions": regions_part,
    "fusion": fusion_part,
    "epochs": epochs_part,
    "plan": plan_part,
    "main": main_part,
    "fed3dgs": fed3dgs_part,
    "table2": table_part,
}
"""In order of making, few models first; `fed3dgs` repeats the main table with one more row."""
BY_NAME = ("table2",)
"""Made only when named: its radiance fields take an hour."""
PAGE_ORDER = ("table2", "main", "regions", "epochs", "fusion", "balance", "latency", "systems", "border", "plan")
LAYOUT, QUICK_LAYOUT = Layout(num_edges=2, num_devices=2), Layout(num_edges=2, num_devices=1)


@dataclass(frozen=True, kw_only=True)
class PaperBench:
    """What to make. `num_steps` of a device's training; `parts`: sections, empty for all but those
    of `BY_NAME`."""

    scene: Path
    out: Path
    parts: tuple[str, ...] = ()
    num_seeds: int = 1
    long_side_px: int = 384
    num_steps: int = 500
    quick: bool = False
    """Fewer layouts, epochs and trainings, no Fed3DGS."""
    field_steps: int = FIELD_STEPS
    """Of a radiance field."""
    lpips: Lpips | None = None
    """Scores LPIPS in Table II."""

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.parts) - set(PARTS)):
            raise BadInput(f"section {unknown[0]!r} of the paper's figures is unknown: use {', '.join(PARTS)}.")


def bench_paper(bench: PaperBench) -> list[Metric]:
    """Page, pictures and JSON in `bench.out`; metrics `paper.<scene>.<part>.<cell>.<arm>.…`."""
    layout = QUICK_LAYOUT if bench.quick else LAYOUT
    arms = load_arms(bench.scene, bench.out, layout, bench_settings(bench.long_side_px, bench.num_steps))
    arms = replace(arms, field_steps=bench.field_steps, lpips=bench.lpips)
    bench.out.mkdir(parents=True, exist_ok=True)
    seeds = range(bench.num_seeds)
    parts: dict[str, Part] = {}
    for name, make in PARTS.items():
        if name not in (bench.parts or {*PARTS} - {*BY_NAME}):
            continue
        parts["main" if name == "fed3dgs" else name] = make(arms, seeds, bench.quick)
        _write(bench, arms, parts)
    return [metric for name, part in parts.items() for metric in _metrics(arms.scene.name, name, part)]


def _write(bench: PaperBench, arms: Arms, parts: Mapping[str, Part]) -> None:
    from radiant_viewer.pictures.images import save_png

    lines = [f"# The paper's figures on our own data: {arms.scene.name}", "", *_facts(bench, arms), ""]
    for name in PAGE_ORDER:
        if name not in parts:
            continue
        part = parts[name]
        lines += [f"## {part.title}", "", part.text, ""]
        for file, image in part.pictures.items():
            save_png(bench.out / file, image)
            lines += [f"![{part.title}]({file})", ""]
    write_atomic(bench.out / "paper.md", "\n".join(lines).encode())
    figures = {name: {"title": part.title, "figures": part.figures} for name, part in parts.items()}
    about = {"version": __version__, "scene": arms.scene.name, "long_side_px": bench.long_side_px, "num_steps": bench.num_steps}
    write_json(bench.out / "paper.json", {**about, "num_seeds": bench.num_seeds, "quick": bench.quick, "parts": figures})


def _facts(bench: PaperBench, arms: Arms) -> list[str]:
    trained, held_out = len(arms.scene.training.cameras), len(arms.scene.held_out.cameras)
    seeds = "1 seed" if bench.num_seeds == 1 else f"{bench.num_seeds} seeds"
    devices = "1 device each" if arms.layout.num_devices == 1 else f"{arms.layout.num_devices} devices each, of speeds 1 and 0.6"
    return [
        f"Scene {arms.scene.name}: {trained} photographs to train on, {held_out} held out of everything (every eighth by name).",
        f"{bench.long_side_px} px, {bench.num_steps} steps per device (preset draft), {seeds}. Unless said otherwise",
        f"{arms.layout.num_edges} edges with {devices}. PSNR and SSIM are means over held-out photographs, seconds are CPU",
        "seconds on this machine. All of it was measured here: the paper's own figures, of other scenes and machines, are not here.",
    ]


def _metrics(scene: str, part: str, result: Part) -> list[Metric]:
    named: dict[str, Any] = result.figures if isinstance(result.figures, dict) else {}
    rows: list[dict[str, Any]] = result.figures if isinstance(result.figures, list) else named.get("rows", [])
    metrics: list[Metric] = []
    for row in rows:
        key = f"paper.{scene}.{part}.{row['cell']}.{row['arm'].replace(' ', '_')}"
        metrics += [
            Metric(key=f"{key}.psnr_db", value=float(np.mean(row["psnr_db"])), unit="dB", direction="higher"),
            Metric(key=f"{key}.ssim", value=float(np.mean(row["ssim"])), unit="1", direction="higher"),
            Metric(key=f"{key}.cpu_s", value=row["cpu_s"], unit="s", direction="info"),
            Metric(key=f"{key}.training_px", value=row["training_px"], unit="px", direction="info"),
            Metric(key=f"{key}.num_gaussians", value=row["num_gaussians"], unit="1", direction="info"),
        ]
        if row["band_db"] is not None:
            metrics.append(Metric(key=f"{key}.band_db", value=row["band_db"], unit="dB", direction="higher"))
    for row in named.get("table", []):
        key = f"paper.{scene}.table2.s{row['seed']}.{row['method'].replace(', ', '_').replace(' ', '_')}"
        metrics.append(Metric(key=f"{key}.psnr_db", value=row["psnr_db"], unit="dB", direction="higher"))
        for name, unit in (("cpu_s", "s"), ("sent_bytes", "B")):
            metrics.append(Metric(key=f"{key}.{name}", value=row[name], unit=unit, direction="info"))
    if part == "balance":
        for kind, value in named["saved_percent"].items():
            metrics.append(Metric(key=f"paper.{scene}.balance.saves_{kind}_percent", value=value, unit="%", direction="info"))
    if part == "latency":
        for row in named["latency"]:
            key = f"paper.{scene}.latency.{row['system']}-s{row['seed']}.{row['method'].replace(' ', '_')}"
            times = {"simulated_edges_s": row["simulated_edges_s"], "emulated_scene_s": row["emulated_scene_s"]}
            metrics += [Metric(key=f"{key}.{kind}", value=s, unit="s", direction="info") for kind, s in times.items() if s is not None]
    return metrics
