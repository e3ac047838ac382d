"""The paper's Table II from one scene: twelve methods, each really trained and joined. Once a page.

    centralised        GP-NeRF, 3DGS and Switch-NeRF: one machine, all photographs
    cloud              Drone-NeRF, Mega-NeRF and VastGaussian: split in the cloud, all photographs
    cloud and devices  FedNeRF and Fed3DGS: the devices of System 1, even counts of photographs
    hierarchical       Even and Radiant on Systems 1 and 2 (`paper_latency.py` fits their costs)

and below, outside the paper, F3DGS. Methods marked "-style" are ours by the published rule.

    measured    PSNR, SSIM, FLIP and LPIPS on held-out photographs; CPU seconds of all nodes; sizes
    bytes sent  photographs' files where a machine needs them all, else models as they are sent up
    emulated    when the scene is done (`emulated_latency.py`), where devices and links take part
    by rule     scalability and privacy, as the paper's Table II says of each

With several seeds a row has the means over them, and beside it how far it is from Radiant on
System 1, with the 95 % bounds of a bootstrap over seeds and photographs. A row that exists is not
made again, and `table2.md` is written anew after each: what is not made yet stands there as not
made.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.methods.arms import Arm, ArmRow, Arms
from benchmarks.methods.bench import METHODS, join_at_server, size_text
from benchmarks.methods.cells import Cell
from benchmarks.methods.emulated_latency import emulate_server, emulate_tree
from benchmarks.methods.rivals import FieldSettings, rival_arms
from benchmarks.paper.latency import SERVER, Costs, fitted_costs, measure_costs, plan_arms, system_cell
from benchmarks.paper.parts import Part
from benchmarks.paper.published import published_table
from benchmarks.tracking import track_items
from radiant_core.evaluate.bootstrap import paired_bootstrap
from radiant_core.evaluate.image_error import NO_FLIP_REASON, NO_LPIPS_REASON, flip
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.run_store import read_json, write_atomic, write_json

Played = Literal["no", "server", "tree"]
"""How devices and links take part in a method's latency."""
FILE = "table2.md"
COMPARED = "Radiant, system 1"
"""The row that every other is compared with."""


@dataclass(frozen=True, kw_only=True)
class Method:
    """A row of the table."""

    name: str
    architecture: str
    arm: Arm
    system: str | None = None
    """The paper's system whose devices it runs on; None: the page's layout."""
    played: Played = "no"
    photographs_sent: bool
    """Whether all photographs travel to one place."""
    scalability: bool
    privacy: bool
    """Both as the paper's Table II marks the method."""
    rounds_sent: bool = False
    """Whether what is sent up is that of its rounds."""


@dataclass(frozen=True, kw_only=True)
class Figures:
    """What stands in a row of one seed, means over held-out photographs."""

    method: str
    seed: int
    architecture: str
    cell: str
    arm: str
    psnr_db: float
    ssim: float
    lpips: float | None
    flip: float | None
    cpu_s: float
    sent_bytes: int
    num_gaussians: int
    num_parameters: int
    scene_s: float | None
    """Emulated: when the scene is done; None for one machine."""
    scalability: bool
    privacy: bool
    psnr_of_each_db: tuple[float, ...]
    """Of every held-out photograph."""


FiguresByMethod = dict[str, list[Figures]]
"""Method → its figures, a seed each, as far as they are made."""


def table_methods(field_steps: int) -> list[Method]:
    """The twelve rows in the paper's order, and F3DGS."""
    rivals = rival_arms(FieldSettings(num_steps=field_steps))
    server = Arm(name=SERVER, make=join_at_server, recipe=lambda cell: cell.planned("even"))
    plans = {arm.name: arm for arm in plan_arms(quick=True)}
    central, cloud, federated, tiers = "centralised", "cloud", "cloud and devices", "hierarchical"
    pooled: dict[str, Any] = {"photographs_sent": True, "privacy": False}
    devices: dict[str, Any] = {"photographs_sent": False, "scalability": True, "system": "paper_1"}
    rows = [
        Method(name="GP-NeRF-style", architecture=central, arm=rivals["gp-nerf"], scalability=False, **pooled),
        Method(name="3DGS", architecture=central, arm=METHODS["centralised"], scalability=False, **pooled),
        Method(name="Switch-NeRF-style", architecture=central, arm=rivals["switch-nerf"], scalability=False, **pooled),
        Method(name="Drone-NeRF-style", architecture=cloud, arm=rivals["drone-nerf"], scalability=True, **pooled),
        Method(name="Mega-NeRF-style", architecture=cloud, arm=rivals["mega-nerf"], scalability=True, **pooled),
        Method(name="VastGaussian", architecture=cloud, arm=METHODS["vastgaussian"], scalability=False, **pooled),
        Method(name="FedNeRF-style", architecture=federated, arm=rivals["fednerf"], rounds_sent=True, privacy=False, **devices),
        Method(name="Fed3DGS", architecture=federated, arm=server, played="server", privacy=False, **devices),
    ]
    for label, plan in (("Even", "even plan"), ("Radiant", "exact plan")):
        for number in (1, 2):
            alike = {**devices, "system": f"paper_{number}", "played": "tree", "privacy": True}
            rows.append(Method(name=f"{label}, system {number}", architecture=tiers, arm=plans[plan], **alike))
    rows.append(Method(name="F3DGS-style", architecture=federated, arm=rivals["f3dgs"], rounds_sent=True, privacy=False, **devices))
    return rows


def table_part(arms: Arms, seeds: Sequence[int], quick: bool) -> Part:
    """The table: all rows of the first seed, then Gaussians of the others, their fields last."""
    del quick
    methods = table_methods(arms.field_steps)

    @cache
    def cell_of(system: str | None, seed: int) -> Cell:
        if system is None:
            return arms.cell(arms.layout, seed)
        return system_cell(arms, _costs(arms, system, seed), system, seed)

    figures_of: FiguresByMethod = {}
    _write(arms, methods, figures_of)
    jobs = [(seed, method) for seed in seeds for method in methods]
    jobs.sort(key=lambda job: job[0] != seeds[0] and (1 if job[1].arm.of_gaussians else 2))
    for seed, method in track_items(jobs, "bench paper, table 2"):
        figures_of.setdefault(method.name, []).append(row_figures(arms, cell_of(method.system, seed), method, seed))
        _write(arms, methods, figures_of)
    return Part(
        title="Table II from this scene",
        text="\n".join(table_lines(arms, methods, figures_of)),
        figures={"table": [asdict(figures) for of_seeds in figures_of.values() for figures in of_seeds]},
    )


def row_figures(arms: Arms, cell: Cell, method: Method, seed: int) -> Figures:
    """A method's row: made, scored, and kept beside the model."""
    row, recipe = arms.row(cell, method.arm), method.arm.recipe(cell)
    lpips, flipped = _perceptual(arms, cell, method.arm)
    return Figures(
        method=method.name,
        seed=seed,
        architecture=method.architecture,
        cell=row.cell,
        arm=row.arm,
        psnr_db=row.mean_psnr_db,
        ssim=row.mean_ssim,
        lpips=lpips,
        flip=flipped,
        cpu_s=float(sum(work.cpu_s for work in row.nodes)) if row.nodes else row.cpu_s,
        sent_bytes=_sent_bytes(arms, method, row),
        num_gaussians=row.num_gaussians,
        num_parameters=row.num_parameters,
        scene_s=_scene_s(method.played, recipe, row),
        scalability=method.scalability,
        privacy=method.privacy,
        psnr_of_each_db=row.psnr_db,
    )


def _costs(arms: Arms, system: str, seed: int) -> Costs:
    return fitted_costs(measure_costs(arms, system, seed))


def _perceptual(arms: Arms, cell: Cell, arm: Arm) -> tuple[float | None, float | None]:
    """LPIPS, where its weights are given, and FLIP, where its package is here; kept by the row."""
    record = arms.model_file(cell, arm).with_suffix(".perceptual.json")
    figures: dict[str, Any] = read_json(record) if record.is_file() else {}
    network = arms.lpips.network if arms.lpips is not None else None
    if "flip" in figures and (network is None or network in figures):
        return (figures[network] if network else None), figures["flip"]
    pairs = list(zip(arms.images(cell, arm), arms.photographs, strict=True))
    figures["flip"] = _mean([flip(np.clip(image, 0, 1), photograph) for image, photograph in pairs])
    if arms.lpips is not None:
        figures[arms.lpips.network] = _mean([arms.lpips(np.clip(image, 0, 1), photograph) for image, photograph in pairs])
    write_json(record, figures)
    return (figures[network] if network else None), figures["flip"]


def _mean(values: Sequence[float | None]) -> float | None:
    numbers = [value for value in values if value is not None]
    return float(np.mean(numbers)) if len(numbers) == len(values) else None


def _sent_bytes(arms: Arms, method: Method, row: ArmRow) -> int:
    if method.photographs_sent:
        return sum((arms.scene.images / name).stat().st_size for name in arms.scene.training.cameras.names)
    if method.rounds_sent:
        return sum(one.sent_bytes for one in row.rounds)
    return sum(work.sent_bytes for work in row.nodes)


def _scene_s(played: Played, recipe: Recipe, row: ArmRow) -> float | None:
    if played == "no":
        return None
    return (emulate_server if played == "server" else emulate_tree)(recipe.system, row.nodes).scene_s


def table_lines(arms: Arms, methods: Sequence[Method], figures_of: Mapping[str, Sequence[Figures]]) -> list[str]:
    """The table, what its columns are, and what the paper prints for other scenes."""
    lines = [
        f"| architecture | method | PSNR dB | − {COMPARED}: dB, 95 % bounds | SSIM | LPIPS | FLIP | CPU s, measured | MB sent |"
        " Gaussians, or parameters | scene done s, emulated | scalability | privacy |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for method in methods:
        cells = _cells(figures_of[method.name], figures_of.get(COMPARED, [])) if method.name in figures_of else ["not made yet", *["–"] * 8]
        marks = ["yes" if mark else "no" for mark in (method.scalability, method.privacy)]
        lines.append(f"| {method.architecture} | {method.name} | {' | '.join([*cells, *marks])} |")
    lines += ["", *_notes(arms, figures_of), "", *published_table()]
    return lines


def _cells(figures: Sequence[Figures], compared: Sequence[Figures]) -> list[str]:
    lpips, flipped, scene_s = (_mean([getattr(one, name) for one in figures]) for name in ("lpips", "flip", "scene_s"))
    return [
        f"{np.mean([one.psnr_db for one in figures]):.2f}",
        "–" if figures == compared else _difference(figures, compared),
        f"{np.mean([one.ssim for one in figures]):.3f}",
        *("–" if value is None else f"{value:.3f}" for value in (lpips, flipped)),
        f"{np.mean([one.cpu_s for one in figures]):.0f}",
        f"{np.mean([one.sent_bytes for one in figures]) / 1e6:.1f}",
        size_text(*(round(np.mean([getattr(one, name) for one in figures])) for name in ("num_gaussians", "num_parameters"))),
        "–" if scene_s is None else f"{scene_s:.1f}",
    ]


def _difference(figures: Sequence[Figures], compared: Sequence[Figures]) -> str:
    """In the seeds that both have; they hold out the same photographs."""
    seeds = min(len(figures), len(compared))
    if not seeds or len(figures[0].psnr_of_each_db) < 2:
        return "–"
    psnr_db, compared_db = (np.array([one.psnr_of_each_db for one in rows[:seeds]]) for rows in (figures, compared))
    difference = paired_bootstrap(psnr_db, compared_db)
    return f"{difference.mean:+.2f} ({difference.low:+.2f} to {difference.high:+.2f})"


def _notes(arms: Arms, figures_of: Mapping[str, Sequence[Figures]]) -> list[str]:
    seeds = sorted({one.seed for figures in figures_of.values() for one in figures})
    notes = [
        "Measured on this machine and scene: quality, CPU seconds, bytes, sizes. Emulated: when the scene is done on the system's machines",
        "and links; methods on one machine have none, their CPU seconds are the time of one core. Scalability and privacy are what the",
        "paper's Table II says. `-style`: the published rule on one small field or on Gaussians; each module says what differs.",
        f"Radiance fields took {arms.field_steps:,} steps of 2,048 rays in all.",
    ]
    if seeds:
        resampled = "held-out photographs" if len(seeds) == 1 else "seeds and held-out photographs"
        notes.append(f"Means over seeds ({', '.join(map(str, seeds))}); bounds by a bootstrap over {resampled}.")
        if fewer := [name for name, figures in figures_of.items() if len(figures) < len(seeds)]:
            notes.append(f"Not of all seeds yet: {', '.join(f'{name} ({len(figures_of[name])})' for name in fewer)}.")
    if arms.lpips is None:
        notes.append(NO_LPIPS_REASON)
    if any(one.flip is None for figures in figures_of.values() for one in figures):
        notes.append(NO_FLIP_REASON)
    return [*notes, "The paper's own figures, of other scenes, sizes and machines, are below and compare with nothing above:"]


def _write(arms: Arms, methods: Sequence[Method], figures_of: Mapping[str, Sequence[Figures]]) -> None:
    arms.out.mkdir(parents=True, exist_ok=True)
    text = "\n".join([f"# Table II from {arms.scene.name}", "", *table_lines(arms, methods, figures_of), ""])
    write_atomic(Path(arms.out) / FILE, text.encode())
