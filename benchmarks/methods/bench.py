"""Benchmark of joining: every method on the same device models, split and seams. Once per (layout,
placement, seed).

    centralised     one model of all photographs, with the steps of all devices and room for the
                    Gaussians of all; reference of the seams
    one device      one model of all photographs, with the steps and the room of one device,
                    nothing joined
    crop            device models cut at the plan's borders
    paper           concatenate and retrain at the edges and at the cloud, ten epochs each
    together        all devices train one model, step by step; `together overlapped`: with sums on
                    their way; `together per edge`: those of an edge
    ours            the default of `radiant run`; in a run's own cell, the run's settings
    ours once       all device models joined at once, as without edges, in five epochs or the run's
    paper once      the same by the paper's preset: one tier in place of two
    ours edges      as ours, the cloud only cuts
    even            ours on even counts of photographs
    fixed steps     ours where every device takes as many steps, whatever its photographs
    photographs     device models retrained on the photographs: the paper's upper bound
    vastgaussian    its own cells, cameras and crop, its own models
    fed3dgs         its sequential server on our device models
    …               radiance fields and F3DGS, when they are named (`rivals.py`)

Device models are trained, sent and joined by `radiant_core.hierarchy`: `ours` is what `radiant run`
writes. CPU seconds and training pixels of a row exclude the devices' trainings, but include models
that a method trains itself. Two budgets make methods comparable: every row states its training
pixels, and `max_gaussians` reduces every method's model to so many Gaussians.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.charts.curve_chart import CurvePoint
from benchmarks.hold_out import parts_of
from benchmarks.methods.arms import Arm, ArmModel, ArmRow, Arms, load_arms
from benchmarks.methods.cells import Cell, Layout, Train, bench_settings
from benchmarks.methods.comparing import comparisons
from benchmarks.methods.emulated_latency import NodeClock, NodeWork, joining_s
from benchmarks.methods.group_latency import LINKS, Link
from benchmarks.methods.rivals import FIELD_STEPS, RIVALS, FieldSettings, rival_arms
from benchmarks.methods.together import TOGETHER
from benchmarks.metric import Metric
from benchmarks.off_path import off_path_metrics
from benchmarks.options import HoldOut
from benchmarks.rivals.fed3dgs import Fed3dgsConfig, fed3dgs
from benchmarks.rivals.vast_gaussian import vast_gaussian
from benchmarks.tracking import track_items
from benchmarks.training_pixels import training_pixels
from radiant_core.aggregate.config import CLOUD_EPOCHS, aggregate_preset, with_joins
from radiant_core.aggregate.join import join_models
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.aggregate.tree import refines_for
from radiant_core.cameras import concatenate_cameras
from radiant_core.choices import CutBy, UploadFormat
from radiant_core.errors import BadInput, StageFailed
from radiant_core.evaluate.bootstrap import paired_bootstrap
from radiant_core.hierarchy.codec import passed_on, refinement_bytes, sent_bytes
from radiant_core.hierarchy.in_process import run_in_process
from radiant_core.hierarchy.messages import DeviceModel
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.plan.regions.claims import Claims, claims_of_polygons
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.results import TrainProgress
from radiant_core.train.trainer import FitOptions, fit_splats

NOTHING_SET: Mapping[str, Any] = {}
NUM_EPOCHS_OF_PHOTOGRAPHS = 10
"""As many as the paper retrains on synthetic views."""
TWO_BY_TWO = Layout(num_edges=2, num_devices=2)
COMPARED_TO = ("paper", "ours", "centralised")
"""Arms to which all others have paired differences, where they are there."""


@dataclass(frozen=True, kw_only=True)
class MethodBench:
    """What to compare. `num_steps` of a device's training, the mean of all devices."""

    scene: Path
    out: Path
    layout: Layout | None = TWO_BY_TWO
    """None: plan, settings and seed of the run `scene`; the training fields below do not count."""
    methods: tuple[str, ...] = ()
    """Names from the list above, or of `RIVALS`; empty for all but those."""
    num_placements: int = 1
    """Placements of the edges."""
    num_seeds: int = 1
    long_side_px: int = 384
    num_steps: int = 500
    upload: UploadFormat = "float16"
    """What devices and edges send."""
    cut_by: CutBy = "auto"
    """What regions and strips are cut by, as in a run."""
    hold_out: HoldOut = "interleaved"
    """What no model sees. both: every method makes one model without the split, and one without the
    line."""
    off_path: Path | None = None
    """Views that were never flown, as the generator writes them, at which models are scored too."""
    max_gaussians: int | None = None
    """Most Gaussians of any method's model: of a larger one those are left that show most to the
    training cameras, and nothing is fitted again. None: as many as a method makes."""

    field_steps: int = FIELD_STEPS
    """Steps of a radiance field."""

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.methods) - {*METHODS, *RIVALS}):
            raise BadInput(f"method {unknown[0]!r} is unknown: use {', '.join((*METHODS, *RIVALS))}.")
        if self.max_gaussians is not None and self.max_gaussians < 1:
            raise BadInput(f"max_gaussians is {self.max_gaussians}, expected at least 1.")


def bench_methods(bench: MethodBench) -> tuple[list[ArmRow], list[Metric]]:
    """All rows; per scene and method, means with the paired differences to `COMPARED_TO`."""
    settings = bench_settings(bench.long_side_px, bench.num_steps, bench.upload)
    of_parts = [load_arms(bench.scene, bench.out, bench.layout, settings, bench.cut_by, part) for part in parts_of(bench.hold_out)]
    if bench.off_path is not None:
        of_parts = [arms.seen_from(bench.off_path) for arms in of_parts]
    chosen = [arm for name, arm in METHODS.items() if not bench.methods or name in bench.methods or name == "centralised"]
    chosen += [arm for name, arm in rival_arms(FieldSettings(num_steps=bench.field_steps)).items() if name in bench.methods]
    jobs = track_items([(arms, cell, arm) for arms in of_parts for cell in _cells(arms, bench) for arm in chosen], "bench methods")
    rows = [arms.row(cell, arm, bench.max_gaussians) for arms, cell, arm in jobs]
    return rows, [metric for arms in of_parts for metric in _metrics(arms.scene.name, rows)]


def _cells(arms: Arms, bench: MethodBench) -> list[Cell]:
    if bench.layout is None:
        return [arms.first]
    spread = [(placement, seed) for placement in range(bench.num_placements) for seed in range(bench.num_seeds)]
    return [arms.first, *(arms.cell(bench.layout, seed, placement=placement) for placement, seed in spread[1:])]


def join(cell: Cell, recipe: Recipe, train: Train | None = None) -> ArmModel:
    """The scene of a run by this recipe, its devices' models from the cache or from `train`."""
    models, scene = cell.train_devices(recipe, train), cell.scene
    clock, begun_s = NodeClock(), time.process_time()
    run = run_in_process(
        recipe,
        scene.training,
        scene.views,
        clock.reporter_of,
        train=lambda task, views, reporter: models[reporter.stage.removeprefix("devices/")],
    )
    cpu_s, seconds = time.process_time() - begun_s, clock.seconds()
    if run.scene.splats is None:
        raise StageFailed(f"{cell.name}: every model was refused: {'; '.join(run.scene.refused.values())}")
    cameras_of_scene = scene.training.cameras
    summaries = [
        (run.edges[plan.edge_id].summary, cameras_of_scene.select(plan.camera_indices))
        for plan in recipe.edge_plans
        if plan.edge_id in run.edges
    ]
    summaries.append((run.scene.summary, concatenate_cameras([edge.cameras for edge in run.edges.values()])))
    pixels = [
        summary["num_steps"] * cameras.scaled(recipe.train.long_side_px).sizes_wh.prod(axis=1).mean()
        for summary, cameras in summaries
        if summary.get("num_steps")
    ]
    edges = [(f"edges/{name}", edge) for name, edge in run.edges.items()]
    joins = [NodeWork(stage=stage, cpu_s=seconds[stage], sent_bytes=sent_bytes(edge, recipe.upload)) for stage, edge in edges]
    refined = [
        NodeWork(stage=stage, cpu_s=seconds[stage], sent_bytes=refinement_bytes(refinement, run.scene.splats, recipe.upload))
        for stage, refinement in run.refinements.items()
    ]
    clouds = [NodeWork(stage=stage, cpu_s=spent_s) for stage, spent_s in seconds.items() if refines_for(stage) == "cloud"]
    nodes = (*_trainings(models, recipe), *joins, *refined, *comparisons(cell, recipe, run), *clouds)
    return ArmModel(splats=run.scene.splats, cpu_s=cpu_s, training_px=float(sum(pixels)), nodes=nodes)


def _trainings(models: Mapping[str, DeviceModel], recipe: Recipe) -> list[NodeWork]:
    return [
        NodeWork(stage=f"devices/{name}", cpu_s=float(model.summary["cpu_s"]), sent_bytes=sent_bytes(model, recipe.upload))
        for name, model in models.items()
    ]


def _receive_models(cell: Cell, recipe: Recipe) -> list[DeviceModel]:
    """The devices' models as their edges receive them."""
    return _as_received(cell.train_devices(recipe), recipe)


def _as_received(models: Mapping[str, DeviceModel], recipe: Recipe) -> list[DeviceModel]:
    arrived = [passed_on(model, recipe.upload) for model in models.values()]
    return [model for model in arrived if isinstance(model, DeviceModel)]


def _time_work(work: Callable[[], tuple[Splats, float]]) -> ArmModel:
    begun_s = time.process_time()
    splats, pixels = work()
    return ArmModel(splats=splats, cpu_s=time.process_time() - begun_s, training_px=pixels)


def _sum_trainings(splats: Splats, models: Sequence[DeviceModel]) -> ArmModel:
    cpu_s, training_px = (float(sum(model.summary[name] for model in models)) for name in ("cpu_s", "training_px"))
    return ArmModel(splats=splats, cpu_s=cpu_s, training_px=training_px)


def _make_centralised_model(cell: Cell, recipe: Recipe) -> ArmModel:
    del recipe
    return _sum_trainings(cell.centralised_model.splats, [cell.centralised_model])


def _make_model_of_one_device(cell: Cell, recipe: Recipe) -> ArmModel:
    del recipe
    num_steps = round(np.mean([int(model.summary["num_steps"]) for model in cell.devices.values()]))
    model = cell.model_of(cell.scene.training, num_steps=num_steps, max_epochs=None)
    return _sum_trainings(model.splats, [model])


def _claims(cell: Cell, recipe: Recipe) -> Claims:
    """Which device's strip a place lies in."""
    claims = claims_of_polygons([strip for plan in recipe.edge_plans for strip in plan.strips if len(strip)])
    if claims is None:
        raise BadInput(f"{cell.name}: no device has a strip to cut its model to.")
    return claims


def _crop(cell: Cell, recipe: Recipe) -> ArmModel:
    models = [model.splats for model in _receive_models(cell, recipe)]
    claims = _claims(cell, recipe)

    def work() -> tuple[Splats, float]:
        owners = [claims(model.means[:, :2].astype(np.float64)) for model in models]
        cut = [model.select(owner == index) for index, (model, owner) in enumerate(zip(models, owners, strict=True))]
        return concatenate_splats(cut), 0

    return _time_work(work)


def _on_photographs(cell: Cell, recipe: Recipe) -> ArmModel:
    models = concatenate_splats([model.splats for model in _receive_models(cell, recipe)])
    views = cell.scene.views
    num_steps = NUM_EPOCHS_OF_PHOTOGRAPHS * len(views)
    config = replace(recipe.train, num_steps=num_steps, density=NoDensification(), start_scale=1.0, settle_epochs=None)
    options = FitOptions(backend=recipe.backend)
    return _time_work(lambda: (fit_splats(models, views, config, options).splats, training_pixels(views.cameras, config, num_steps)))


def _vast_gaussian(cell: Cell, recipe: Recipe) -> ArmModel:
    trained: list[DeviceModel] = []

    def train(part: Any, seed: int) -> Splats:
        trained.append(cell.model_of(part, seed=seed))
        return trained[-1].splats

    layout = cell.layout
    result = vast_gaussian(cell.scene.training, layout.num_edges, layout.num_devices, train, seed=recipe.train.seed)
    return _sum_trainings(result.splats, trained)


def join_at_server(cell: Cell, recipe: Recipe) -> ArmModel:
    """The recipe's device models, taken in one after another by Fed3DGS."""
    trained = cell.train_devices(recipe)
    models = _as_received(trained, recipe)
    cameras = [model.cameras.scaled(recipe.train.long_side_px) for model in models]
    marks_s = [time.process_time()]

    def report(progress: TrainProgress) -> None:
        if progress.step == progress.num_steps:
            marks_s.append(time.process_time())

    config, options = Fed3dgsConfig(seed=recipe.train.seed), FitOptions(backend=recipe.backend, report=report)
    result = fed3dgs([model.splats for model in models], cameras, config, options)
    # What follows the last step for one client counts as the next one's; the last one has its own.
    marks_s = [*marks_s[: len(result.merged) - 1], time.process_time()]
    names = [list(trained)[client] for client in result.merged]
    spent_s = [0.0, *np.diff(marks_s)]
    merges = [NodeWork(stage=f"cloud/{name}", cpu_s=float(cpu_s)) for name, cpu_s in zip(names, spent_s, strict=True)]
    return ArmModel(
        splats=result.splats,
        cpu_s=marks_s[-1] - marks_s[0],
        training_px=result.num_training_pixels,
        nodes=(*_trainings(trained, recipe), *merges),
    )


def _join_at_once(cell: Cell, recipe: Recipe) -> ArmModel:
    models = _receive_models(cell, recipe)
    teachers = [Teacher(splats=model.splats, cameras=model.cameras) for model in models]
    claims = _claims(cell, recipe)
    cameras = concatenate_cameras([model.cameras for model in models]).scaled(recipe.train.long_side_px)

    def work() -> tuple[Splats, float]:
        # Nobody refines this one: it is fitted.
        rules = replace(recipe.aggregate.cloud, epochs=recipe.aggregate.cloud.epochs or CLOUD_EPOCHS)
        joined = join_models(teachers, recipe.train, rules, FitOptions(backend=recipe.backend), claims)
        return joined.splats, float(joined.trained.num_steps * cameras.sizes_wh.prod(axis=1).mean())

    return _time_work(work)


def _own_arm(name: str, make: Callable[[Cell, Recipe], ArmModel] = join, settings: Mapping[str, Any] = NOTHING_SET) -> Arm:
    return Arm(name=name, make=make, recipe=lambda cell: replace(cell.recipe, aggregate=with_joins(cell.recipe.aggregate, settings, {})))


def _paper_arm(name: str, make: Callable[[Cell, Recipe], ArmModel] = join, settings: Mapping[str, Any] = NOTHING_SET) -> Arm:
    aggregate = with_joins(aggregate_preset("paper"), settings, {})
    return Arm(name=name, make=make, recipe=lambda cell: replace(cell.recipe, aggregate=aggregate))


METHODS: Mapping[str, Arm] = {
    arm.name: arm
    for arm in (
        Arm(name="centralised", make=_make_centralised_model, settings="room for the Gaussians of all"),
        Arm(name="one device", make=_make_model_of_one_device),
        Arm(name="crop", make=_crop),
        _paper_arm("paper"),
        _own_arm("ours"),
        _own_arm("ours once", _join_at_once),
        _paper_arm("paper once", _join_at_once),
        _own_arm("ours edges", settings={"cloud.method": "crop_merge"}),
        Arm(name="even", make=join, recipe=lambda cell: cell.even),
        Arm(name="fixed steps", make=join, recipe=lambda cell: replace(cell.recipe, step_policy="fixed")),
        Arm(name="photographs", make=_on_photographs),
        Arm(name="vastgaussian", make=_vast_gaussian),
        Arm(name="fed3dgs", make=join_at_server),
        *TOGETHER,
    )
}


def epochs_arm(name: str, num_epochs: int) -> Arm:
    """`ours` or `paper` with so many epochs at both tiers; 0 is the plain cut for both."""
    if num_epochs == 0:
        return METHODS["crop"]
    changed = {"ours": _own_arm, "paper": _paper_arm}[name]
    return changed(f"{name} {num_epochs} epochs", settings={"cloud.epochs": num_epochs, "edge.epochs": num_epochs})


def methods_table(rows: Sequence[ArmRow]) -> str:
    """A line per scene and method: mean PSNR, the same after a correction of colours, FLIP, seams'
    excess, Gaussians, CPU seconds of all nodes, those until the scene is done if all work at once
    (`joining_s`), pixels, and seconds until the scene is done over links, trainings included
    (`group_latency.py`)."""
    lines = [
        "| scene | method | PSNR dB | corrected | FLIP | seam excess dB | Gaussians, or numbers | CPU s | at once s | training Mpx |"
        + "".join(f" scene s at {link} |" for link in LINKS),
        "|---|---|---|---|---|---|---|---|---|---|" + "---|" * len(LINKS),
    ]
    references = {row.cell: row for row in rows if row.arm == "centralised"}
    for (scene, method), group in _group_rows(rows).items():
        excess = [excess_db for row in group if (excess_db := seam_excess_db(row, references[row.cell])) is not None]
        seam = f"{np.mean(excess):+.2f}" if excess else "insufficient"
        names = ("mean_psnr_db", "num_gaussians", "num_parameters", "cpu_s", "training_px")
        means = {name: float(np.mean([getattr(row, name) for row in group])) for name in names}
        at_once = f"{np.mean([joining_s(row.nodes) for row in group]):.0f}" if all(row.nodes for row in group) else "–"
        flip = "–" if (mean := mean_of_all(group, "flip")) is None else f"{mean:.4f}"
        corrected = "–" if (mean := mean_of_all(group, "psnr_cc_db")) is None else f"{mean:.2f}"
        size = size_text(means["num_gaussians"], means["num_parameters"])
        lines.append(
            f"| {scene} | {method} | {means['mean_psnr_db']:.2f} | {corrected} | {flip} | {seam} | {size} |"
            f" {means['cpu_s']:.0f} | {at_once} | {means['training_px'] / 1e6:.0f} |"
            + "".join(f" {'–' if (mean := scene_s_at(group, link)) is None else format(mean, '.1f')} |" for link in LINKS)
        )
        lines += rounds_lines(method, group)
    return "\n".join(lines)


def mean_of_all(rows: Sequence[ArmRow], figure: Literal["flip", "psnr_cc_db"]) -> float | None:
    """A figure over all photographs of the rows; None where one of them has none."""
    values = [value for row in rows for value in getattr(row, figure) if value is not None]
    return float(np.mean(values)) if values and len(values) == sum(len(row.psnr_db) for row in rows) else None


def scene_s_at(rows: Sequence[ArmRow], link: Link) -> float | None:
    """Mean seconds until the scene is done over such links; None where a row does not say it."""
    seconds = [time.scene_s for row in rows for time in row.times if time.link == str(link)]
    return float(np.mean(seconds)) if seconds and len(seconds) == len(rows) else None


def size_text(num_gaussians: float, num_parameters: float) -> str:
    """Gaussians, or the numbers of a field."""
    return f"{num_gaussians:,.0f}" if num_gaussians else f"{num_parameters:,.0f} numbers"


def rounds_lines(method: str, rows: Sequence[ArmRow]) -> list[str]:
    """A line per round of federated learning: what all clients sent up in it, PSNR after it."""
    lines = []
    for number, round_of_rows in enumerate(zip(*(row.rounds for row in rows), strict=True), 1):
        sent_mb = float(np.mean([one.sent_bytes for one in round_of_rows])) / 1e6
        psnr_db = [one.psnr_db for one in round_of_rows if one.psnr_db is not None]
        psnr = f"{np.mean(psnr_db):.2f}" if psnr_db else "not scored"
        lines.append(f"| | {method}, round {number} | {psnr} | | | | {sent_mb:.1f} MB sent | | | |")
    return lines


def seam_excess_db(row: ArmRow, reference: ArmRow) -> float | None:
    """(band − interior) of an arm minus the centralised model's; None with too few seams seen."""
    gaps_db = [of.band_db - of.interior_db for of in (row, reference) if of.band_db is not None and of.interior_db is not None]
    return gaps_db[0] - gaps_db[1] if len(gaps_db) == 2 else None


def curves_of(rows: Sequence[ArmRow]) -> dict[str, list[CurvePoint]]:
    """The rows of Gaussians by method, at least 0.1 CPU seconds each: the axis is logarithmic."""
    curves: dict[str, list[CurvePoint]] = {}
    for row in (row for row in rows if row.num_gaussians):
        point = CurvePoint(cpu_s=max(row.cpu_s, 0.1), num_gaussians=row.num_gaussians, psnr_db=row.mean_psnr_db)
        name = row.arm if len({other_row.scene for other_row in rows}) == 1 else f"{row.scene}: {row.arm}"
        curves.setdefault(name, []).append(point)
    return curves


def _group_rows(rows: Sequence[ArmRow]) -> dict[tuple[str, str], list[ArmRow]]:
    groups: dict[tuple[str, str], list[ArmRow]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.arm), []).append(row)
    return groups


def _metrics(scene: str, rows: Sequence[ArmRow]) -> list[Metric]:
    groups = {method: group for (of, method), group in _group_rows(rows).items() if of == scene}
    metrics: list[Metric] = []
    for method, group in groups.items():
        key = f"methods.{scene}.{method.replace(' ', '_')}"
        psnr = float(np.mean([row.psnr_db for row in group]))
        metrics.append(Metric(key=f"{key}.psnr_db", value=psnr, unit="dB", direction="higher"))
        if (flip := mean_of_all(group, "flip")) is not None:
            metrics.append(Metric(key=f"{key}.flip", value=flip, unit="1", direction="lower"))
        if (corrected := mean_of_all(group, "psnr_cc_db")) is not None:
            metrics.append(Metric(key=f"{key}.psnr_cc_db", value=corrected, unit="dB", direction="higher"))
        for name, unit in (("cpu_s", "s"), ("num_gaussians", "1"), ("num_parameters", "1"), ("training_px", "px")):
            value = float(np.mean([getattr(row, name) for row in group]))
            metrics.append(Metric(key=f"{key}.{name}", value=value, unit=unit, direction="info"))
        if all(row.nodes for row in group):
            value = float(np.mean([joining_s(row.nodes) for row in group]))
            metrics.append(Metric(key=f"{key}.joining_s", value=value, unit="s, all nodes at once", direction="info"))
        for link in LINKS:
            if (value := scene_s_at(group, link)) is not None:
                name = str(link).replace(" ", "_").replace("/", "_per_")
                metrics.append(Metric(key=f"{key}.scene_s.{name}", value=value, unit="s, all nodes at once", direction="info"))
        if off_path := [row.off_path for row in group if row.off_path is not None]:
            metrics += off_path_metrics(key, off_path)
        for reference in (name for name in COMPARED_TO if name in groups and name != method):
            metrics += _differences(f"{key}.over_{reference}", group, groups[reference])
    return metrics


def _differences(key: str, rows: Sequence[ArmRow], others: Sequence[ArmRow]) -> list[Metric]:
    """Means over photographs and cells with their bounds of 95 %, `at_least` the one-sided one;
    with colours corrected under `cc`, where all rows have them."""
    metrics: list[Metric] = []
    for prefix, figure in (("", "psnr_db"), ("cc_", "psnr_cc_db")):
        figures_of_rows, reference = ([getattr(row, figure) for row in group] for group in (rows, others))
        if not all(map(len, (*figures_of_rows, *reference))):
            continue
        difference = paired_bootstrap(np.array(figures_of_rows), np.array(reference))
        figures = {"mean": difference.mean, "low": difference.low, "high": difference.high, "at_least": difference.at_least}
        metrics += [Metric(key=f"{key}.{prefix}{n}_db", value=v, unit="dB", direction="info") for n, v in figures.items()]
    return metrics
