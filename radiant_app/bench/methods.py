"""Benchmark of joining: every method on the same device models, rasterizer, split and seams. Once per (layout, placement, seed).

    centralised     one model of all photographs, with the steps of all devices together; the reference of every seam
    crop            device models cut at the plan's borders
    paper           concatenate and retrain at the edges and at the cloud, ten epochs each
    ours            the default of `radiant run`
    ours edges      the same, the cloud only cuts
    even            ours on even counts of photographs
    photographs     all device models retrained on the photographs: what the paper calls its upper bound
    vastgaussian    its own cells, cameras and crop, its own models
    fed3dgs         its sequential server on our device models

CPU seconds and training pixels of a row exclude the devices' trainings, but include models that a
method trains itself. Models and rows are cached by cell and method in the output folder, so that an
interrupted benchmark resumes. Two budgets make methods comparable: every row states its training
pixels, and `max_gaussians` reduces every method's model to so many Gaussians.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.bench.method_cells import BenchScene, Cell, Layout, ModelCache, Trained, device_rows, load_bench_scene
from radiant_app.report.progress import tracked
from radiant_app.workers.evaluation import region_width
from radiant_core import __version__
from radiant_core.aggregate.balance import balance_teachers, exposure_balance
from radiant_core.aggregate.baselines.fed3dgs import Fed3dgsConfig, fed3dgs
from radiant_core.aggregate.baselines.vast_gaussian import vast_gaussian
from radiant_core.aggregate.config import AggregateConfig, aggregate_preset
from radiant_core.aggregate.crop_merge import crop_merge
from radiant_core.aggregate.ownership import claims_of_cells, claims_of_polygons
from radiant_core.aggregate.pooling import pool_teachers, render_pictures
from radiant_core.aggregate.retrain import Joined, retrain_on_synthetic_views
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.aggregate.virtual_cameras import virtual_cameras
from radiant_core.cameras import concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.bootstrap import paired_bootstrap
from radiant_core.evaluate.borders import DeviceBorders, EdgeBorders
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.evaluate.metric import Metric
from radiant_core.evaluate.seam_error import SeamMasks, seam_masks
from radiant_core.evaluate.seam_scores import SeamScores, seam_excess, seam_scores
from radiant_core.evaluate.shown_pixels import select_strongest
from radiant_core.io.records import load_splats, save_splats
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.config import train_preset
from radiant_core.train.densification import NoDensification
from radiant_core.train.trainer import FitOptions, fit_splats
from radiant_core.train.training_pixels import training_pixels
from radiant_viewer.charts.curve_chart import CurvePoint

NUM_EPOCHS_OF_PHOTOGRAPHS = 10
"""As many as the paper retrains on synthetic views."""
OPAQUE = 0.5
"""Pixels that the centralised model covers less have no ground."""


TWO_BY_TWO = Layout(num_edges=2, num_devices=2)


@dataclass(frozen=True, kw_only=True)
class MethodBench:
    """What to compare. `num_steps` of a device's training."""

    scene: Path
    out: Path
    layout: Layout = TWO_BY_TWO
    methods: tuple[str, ...] = ()
    """Names from the list above; empty for all."""
    num_placements: int = 1
    """Placements of the edges."""
    num_seeds: int = 1
    long_side_px: int = 384
    num_steps: int = 500
    max_gaussians: int | None = None
    """As many as any method's model may have: of a larger one those are left that show most to the training cameras, and nothing is
    fitted again. None: as many as a method makes."""

    def __post_init__(self) -> None:
        unknown = sorted(set(self.methods) - set(METHODS))
        if unknown:
            raise BadInput(f"method {unknown[0]!r} is unknown: use {', '.join(METHODS)}.")
        if self.max_gaussians is not None and self.max_gaussians < 1:
            raise BadInput(f"max_gaussians is {self.max_gaussians}, expected at least 1.")


@dataclass(frozen=True, kw_only=True)
class Made:
    """What a method made of a cell, and its work beside the device models."""

    splats: Splats
    cpu_s: float
    training_px: float


@dataclass(frozen=True, kw_only=True)
class MethodRow:
    """Figures of one method in one cell; psnr_db per held-out photograph."""

    scene: str
    cell: str
    method: str
    psnr_db: tuple[float, ...]
    num_gaussians: int
    cpu_s: float
    training_px: float
    band_db: float | None
    interior_db: float | None
    excess_db: float | None
    """(band − interior) minus that of the centralised model, pooled; None where too little of the seams is seen."""


def bench_methods(bench: MethodBench) -> tuple[list[MethodRow], list[Metric]]:
    """All rows, and per scene and method their means with the paired difference to the paper's preset."""
    scene = load_bench_scene(bench.scene, bench.long_side_px)
    train = replace(train_preset("draft"), long_side_px=bench.long_side_px, num_steps=bench.num_steps, max_num_splats=200_000)
    cache = ModelCache(folder=bench.out / "models")
    cells = [
        Cell(scene=scene, layout=bench.layout, placement=placement, seed=seed, train=train, cache=cache)
        for placement in range(bench.num_placements)
        for seed in range(bench.num_seeds)
    ]
    methods = tuple(name for name in METHODS if not bench.methods or name in bench.methods or name == "centralised")
    rows = []
    scored = _Scored()
    for cell, method in tracked([(cell, method) for cell in cells for method in methods], "bench methods"):
        rows.append(_row(bench, cell, method, scored))
    return rows, _metrics(scene.name, rows)


class _Scored:
    """The seam masks and the reference's scores of the cell at hand, made when a row needs them."""

    def __init__(self) -> None:
        self._of: dict[str, tuple[SeamMasks, SeamScores]] = {}

    def reference(self, cell: Cell) -> tuple[SeamMasks, SeamScores]:
        """Masks from the depth of the cell's centralised model, and its own scores."""
        if cell.name not in self._of:
            cameras = cell.scene.held_out_views.cameras
            views = list(render_views(cell.centralised.splats, cameras))
            depths = [np.where(view.alpha >= OPAQUE, view.depth, 0) for view in views]
            plan, edge_plans = cell.plan
            borders = [EdgeBorders(plan=plan), DeviceBorders(plan=plan, edge_plans=edge_plans)]
            masks = seam_masks(cameras, depths, borders, region_width(plan.sites))
            self._of = {cell.name: (masks, seam_scores([view.image for view in views], _photographs(cell.scene), masks))}
        return self._of[cell.name]


def _photographs(scene: BenchScene) -> list[NDArray[np.float64]]:
    return [image / 255 for image in scene.held_out_views.images]


def _row(bench: MethodBench, cell: Cell, method: str, scored: _Scored) -> MethodRow:
    joining = {"paper": "paper", "ours": "default", "ours edges": "default", "even": "default"}
    settings = {"train": asdict(cell.train), "join": asdict(aggregate_preset(joining[method])) if method in joining else None}
    key = content_key(__version__, {"cell": cell.name, "method": method, **settings})[:16]
    name = f"{cell.name}-{method.replace(' ', '_')}-{key}"
    most = bench.max_gaussians
    record = bench.out / "rows" / f"{name}{'' if most is None else f'-{most}'}.json"
    if record.is_file():
        fields = read_json(record)
        return MethodRow(**{**fields, "psnr_db": tuple(fields["psnr_db"])})
    made = _made(bench.out / "made" / name, cell, method)
    if most is not None:
        made = replace(made, splats=select_strongest(made.splats, cell.scene.views.cameras, most))
    masks, reference = scored.reference(cell)
    views = list(render_views(made.splats, cell.scene.held_out_views.cameras))
    photographs = _photographs(cell.scene)
    scores = seam_scores([view.image for view in views], photographs, masks)
    error, excess = scores.error(), seam_excess([scores], [reference])
    row = MethodRow(
        scene=cell.scene.name,
        cell=cell.name,
        method=method,
        psnr_db=tuple(psnr_db(view.image, photograph) for view, photograph in zip(views, photographs, strict=True)),
        num_gaussians=len(made.splats),
        cpu_s=made.cpu_s,
        training_px=made.training_px,
        band_db=error.seam_psnr_db,
        interior_db=error.interior_psnr_db,
        excess_db=excess.pooled_db,
    )
    record.parent.mkdir(parents=True, exist_ok=True)
    write_json(record, asdict(row))
    return row


def _made(path: Path, cell: Cell, method: str) -> Made:
    """What a method makes of a cell, kept in two files of that name."""
    model, record = path.with_suffix(".safetensors"), path.with_suffix(".json")
    if not (model.is_file() and record.is_file()):
        made = METHODS[method](cell)
        path.parent.mkdir(parents=True, exist_ok=True)
        save_splats(model, made.splats)
        write_json(record, {"cpu_s": made.cpu_s, "training_px": made.training_px})
    return Made(splats=load_splats(model), **read_json(record))


def _timed(work: Callable[[], tuple[Splats, float]], more: Sequence[Trained] = ()) -> Made:
    """The product of `work` with its CPU seconds and pixels, those of the models that it needed besides added."""
    begun_s = time.process_time()
    splats, pixels = work()
    cpu_s = time.process_time() - begun_s
    return Made(splats=splats, cpu_s=cpu_s + sum(m.cpu_s for m in more), training_px=pixels + sum(m.training_px for m in more))


def _centralised(cell: Cell) -> Made:
    model = cell.centralised
    return Made(splats=model.splats, cpu_s=model.cpu_s, training_px=model.training_px)


def _crop(cell: Cell) -> Made:
    models = [model.splats for edge in cell.devices for model in edge]
    claims = claims_of_polygons([strip for plan in cell.plan[1] for strip in plan.strips if len(strip)])
    if claims is None:
        raise BadInput(f"{cell.name}: no device has a strip to cut its model to.")

    def work() -> tuple[Splats, float]:
        owners = [claims(model.means[:, :2].astype(np.float64)) for model in models]
        return concatenate_splats(
            [model.select(owner == index) for index, (model, owner) in enumerate(zip(models, owners, strict=True))]
        ), 0

    return _timed(work)


def join_cell(cell: Cell, aggregate: AggregateConfig, plans: tuple[CloudPlan, tuple[EdgePlan, ...]], devices: list[list[Trained]]) -> Made:
    """Models of the devices (per edge, of those with cameras) joined at the edges and at the cloud as `aggregate` says."""
    cloud_plan, edge_plans = plans
    # Photographs are read here, not in the seconds of a joining that looks at none.
    _ = cell.scene.views

    def joined(teachers: list[Teacher], claims: Any) -> Joined:
        config = replace(cell.train, seed=cell.seed)
        return retrain_on_synthetic_views(teachers, config, aggregate, FitOptions(), claims)

    def work() -> tuple[Splats, float]:
        pixels, edges = 0.0, []
        for index, (models, plan) in enumerate(zip(devices, edge_plans, strict=True)):
            if not models:
                continue
            cameras = [cell.cameras_of(rows) for rows in device_rows(plan)]
            teachers = [Teacher(splats=model.splats, cameras=own) for model, own in zip(models, cameras, strict=True)]
            claims = claims_of_polygons([strip for strip in plan.strips if len(strip)])
            pools = aggregate.edges_pool and len(teachers) > 1
            if pools:
                teachers = balance_teachers(teachers, exposure_balance(teachers))
            edge = pool_teachers(teachers, aggregate, claims) if pools else joined(teachers, claims)
            rng = np.random.default_rng([cell.seed, index])
            virtual, near = virtual_cameras(concatenate_cameras(cameras), edge.splats.means, rng)
            shown = render_pictures(teachers, virtual, near, cell.train.long_side_px) if pools else {}
            edges.append((index, Teacher(splats=edge.splats, cameras=virtual, rendered=shown, pooled=pools)))
            pixels += _pixels(teachers, edge)
        rows = [index for index, _ in edges]
        sites, weights = cloud_plan.sites[rows], cloud_plan.weights[rows]
        teachers = [teacher for _, teacher in edges]
        if aggregate.cloud == "crop_merge":
            return crop_merge([t.splats for t in teachers], sites, weights, fill_blind_spots=aggregate.fill_blind_spots).splats, pixels
        cloud = joined(teachers, claims_of_cells(sites, weights))
        return cloud.splats, pixels + _pixels(teachers, cloud)

    return _timed(work)


def _pixels(teachers: Sequence[Teacher], joined: Joined) -> float:
    return joined.trained.num_steps * float(np.concatenate([t.cameras.sizes_wh.prod(axis=1) for t in teachers]).mean())


def _even(cell: Cell) -> Made:
    return join_cell(cell, aggregate_preset("default"), cell.even_plan, cell.device_models(cell.even_plan[1]))


def _on_photographs(cell: Cell) -> Made:
    models = concatenate_splats([model.splats for edge in cell.devices for model in edge])
    views = cell.scene.views
    num_steps = NUM_EPOCHS_OF_PHOTOGRAPHS * len(views)
    config = replace(cell.train, seed=cell.seed, num_steps=num_steps, density=NoDensification(), start_scale=1.0, settle_epochs=None)
    return _timed(lambda: (fit_splats(models, views, config).splats, training_pixels(views.cameras, config, num_steps)))


def _vast_gaussian(cell: Cell) -> Made:
    trained: list[Trained] = []

    def train(part: Any, seed: int) -> Splats:
        trained.append(cell.cache.trained_part(cell.scene, part, replace(cell.train, seed=seed)))
        return trained[-1].splats

    layout = cell.layout
    result = vast_gaussian(cell.scene.training, layout.num_edges, layout.num_devices, train, seed=cell.seed)
    return Made(splats=result.splats, cpu_s=sum(m.cpu_s for m in trained), training_px=sum(m.training_px for m in trained))


def _fed3dgs(cell: Cell) -> Made:
    models = [model.splats for edge in cell.devices for model in edge]
    cameras = [cell.cameras_of(rows) for plan in cell.plan[1] for rows in device_rows(plan)]

    def work() -> tuple[Splats, float]:
        result = fed3dgs(models, cameras, Fed3dgsConfig(seed=cell.seed), FitOptions())
        return result.splats, result.num_training_pixels

    return _timed(work)


def _by(aggregate: AggregateConfig) -> Callable[[Cell], Made]:
    return lambda cell: join_cell(cell, aggregate, cell.plan, cell.devices)


METHODS: Mapping[str, Callable[[Cell], Made]] = {
    "centralised": _centralised,
    "crop": _crop,
    "paper": _by(aggregate_preset("paper")),
    "ours": _by(aggregate_preset("default")),
    "ours edges": _by(replace(aggregate_preset("default"), cloud="crop_merge")),
    "even": _even,
    "photographs": _on_photographs,
    "vastgaussian": _vast_gaussian,
    "fed3dgs": _fed3dgs,
}


def methods_table(rows: Sequence[MethodRow]) -> str:
    """Scene by scene a line per method: means over cells of PSNR, Gaussians, CPU seconds, pixels and the seams' excess."""
    lines = ["| scene | method | PSNR dB | seam excess dB | Gaussians | CPU s | training Mpx |", "|---|---|---|---|---|---|---|"]
    for (scene, method), group in _grouped(rows).items():
        excess = [row.excess_db for row in group if row.excess_db is not None]
        seam = f"{np.mean(excess):+.2f}" if excess else "insufficient"
        psnr = float(np.mean([np.mean(row.psnr_db) for row in group]))
        means = {name: float(np.mean([getattr(row, name) for row in group])) for name in ("num_gaussians", "cpu_s", "training_px")}
        lines.append(
            f"| {scene} | {method} | {psnr:.2f} | {seam} | {means['num_gaussians']:,.0f} | {means['cpu_s']:.0f} |"
            f" {means['training_px'] / 1e6:.0f} |"
        )
    return "\n".join(lines)


def curves_of(rows: Sequence[MethodRow]) -> dict[str, list[CurvePoint]]:
    """The rows by method, for a picture of quality against CPU seconds; a tenth of a second at least, since the axis is logarithmic."""
    curves: dict[str, list[CurvePoint]] = {}
    for row in rows:
        point = CurvePoint(cpu_s=max(row.cpu_s, 0.1), num_gaussians=row.num_gaussians, psnr_db=float(np.mean(row.psnr_db)))
        curves.setdefault(row.method, []).append(point)
    return curves


def _grouped(rows: Sequence[MethodRow]) -> dict[tuple[str, str], list[MethodRow]]:
    groups: dict[tuple[str, str], list[MethodRow]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.method), []).append(row)
    return groups


def _metrics(scene: str, rows: Sequence[MethodRow]) -> list[Metric]:
    groups = {method: group for (of, method), group in _grouped(rows).items() if of == scene}
    metrics: list[Metric] = []
    for method, group in groups.items():
        key = f"methods.{scene}.{method.replace(' ', '_')}"
        psnr = float(np.mean([row.psnr_db for row in group]))
        metrics.append(Metric(key=f"{key}.psnr_db", value=psnr, unit="dB", direction="higher"))
        for name, unit in (("cpu_s", "s"), ("num_gaussians", "1"), ("training_px", "px")):
            value = float(np.mean([getattr(row, name) for row in group]))
            metrics.append(Metric(key=f"{key}.{name}", value=value, unit=unit, direction="info"))
        if "paper" in groups and method != "paper":
            difference = paired_bootstrap(np.array([row.psnr_db for row in group]), np.array([row.psnr_db for row in groups["paper"]]))
            figures = {"mean_db": difference.mean, "low_db": difference.low, "high_db": difference.high}
            metrics += [Metric(key=f"{key}.over_paper.{n}", value=v, unit="dB", direction="info") for n, v in figures.items()]
    return metrics
