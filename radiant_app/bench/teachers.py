"""Benchmark of early teachers: seconds from the end of an edge's last device to the end of the edge, views rendered early or late.

On the photographs of a finished run, one edge with three devices and two processes: the third device trains while a core is idle, in
which the teachers of the first two can run. Equal for both: photographs, plan, seeds, settings of the run, processes; the edges' models
must be equal to the bit. Runs are interleaved (late, early, late, …), medians of three; `quick`: one run of each with 30 steps.

The simulated figures are for separate machines, where nobody shares cores: from this run's measured times, with devices that end when
the plan says but for one that takes twice as long,
latency = start + Σ (reading of views rendered before the last arrival, rendering of the others) + retraining.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from radiant_app.bench.upload import EdgeOfRun, edges_of_run
from radiant_app.commands.steps import training_part
from radiant_app.executors.local import LocalExecutor
from radiant_app.report.progress import tracked
from radiant_app.run.dealing import SharedDealer
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.aggregate.tree import tree_of_plan
from radiant_core.errors import StageFailed
from radiant_core.evaluate.metric import Metric
from radiant_core.io.records import load_scene
from radiant_core.io.run_store import file_sha256, read_json
from radiant_core.train.config import TrainConfig

Order = Literal["late", "early"]
NUM_RUNS = 3
NUM_DEVICES = 3
STRAGGLER = 2.0
"""How many times its planned time the slowest device takes in the simulated figures: a plan makes all devices end together."""
_QUICK_STEPS = 30


@dataclass(frozen=True, kw_only=True)
class _Timed:
    """One run: seconds from the last device's end to the edge's end, from the first start to there, and the edge's model."""

    latency_s: float
    total_s: float
    early_views: float
    retrain_s: float
    edge_s: float
    model_sha256: str


@dataclass(frozen=True, kw_only=True)
class ViewTimes:
    """Seconds per view to render, and to read it where it was rendered before."""

    render_s: float
    read_s: float


def bench_teachers(run: Path, quick: bool) -> list[Metric]:
    """`teachers.<run>.<late|early>.<latency_s|total_s|early_views|simulated_latency_s>`.

    Raises BadInput when `run` is no finished run, StageFailed when early and late give different models.
    """
    edges = edges_of_run(run)
    order: list[Order] = ["late", "early"] * (1 if quick else NUM_RUNS)
    runs: dict[Order, list[_Timed]] = {"late": [], "early": []}
    dealer = _dealer(run, edges[0], quick)
    for name in tracked(order, "bench teachers"):
        with TemporaryDirectory(prefix="radiant-bench-teachers-") as folder:
            runs[name].append(_timed(replace(dealer, run=Path(folder), ledger=[]), name))
    hashes = {one.model_sha256 for done in runs.values() for one in done}
    if len(hashes) != 1:
        raise StageFailed("early and late teachers gave edges of different bits: the time of one is not that of the other.")
    views = _view_times(edges[0])
    plan = dealer.edge_plans[0]
    counts = [len(plan.cameras_of(device)) for device in plan.device_ids]
    everyone = [*runs["late"], *runs["early"]]
    start_s, retrain_s = _start_s(everyone, counts, views), float(np.median([one.retrain_s for one in everyone]))
    arrivals_s = plan.device_time_s * np.where(np.arange(len(counts)) == np.argmax(plan.device_time_s), STRAGGLER, 1.0)
    metrics = []
    for name, done in runs.items():
        simulated_s = simulated_latency_s(arrivals_s, counts, views, start_s, name == "early") + retrain_s
        metrics += _order_metrics(f"teachers.{run.name}.{name}", done, simulated_s)
    return metrics


def simulated_latency_s(arrival_s: ArrayLike, counts: Sequence[int], views: ViewTimes, start_s: float, early: bool) -> float:
    """Seconds from the last arrival to the begin of retraining on an edge's own machine, devices with `counts` views each.

    A process takes `start_s` to begin; teachers run one after the other and are stopped by the last arrival.
    """
    arrivals_s = np.asarray(arrival_s, np.float64)
    last_s = float(arrivals_s.max())
    free_s, num_early = 0.0, 0
    for device in np.argsort(arrivals_s, kind="stable") if early else ():
        begin_s = max(free_s, float(arrivals_s[device])) + start_s
        free_s = begin_s + counts[device] * views.render_s
        num_early += int(np.clip((last_s - begin_s) / views.render_s, 0, counts[device]))
    return start_s + num_early * views.read_s + (sum(counts) - num_early) * views.render_s


def _dealer(run: Path, edge: EdgeOfRun, quick: bool) -> SharedDealer:
    """One edge with equal devices on the training photographs of `run`; its folder is to be replaced."""
    from radiant_app.files.system_file import even_system
    from radiant_core.plan.devices.device_split import split_edges
    from radiant_core.plan.plans import CloudPlan
    from radiant_core.plan.regions.edge_sites import place_edges
    from radiant_core.plan.regions.region_plan import plan_regions

    scene = training_part(load_scene(run / "sfm" / "scene.safetensors"))
    positions = scene.cameras.centers[:, :2]
    system = place_edges(even_system(1, NUM_DEVICES), positions, None, 0)
    cloud_plan = plan_regions(positions, system, method="exact")
    assert isinstance(cloud_plan, CloudPlan), "devices without a memory limit hold every plan"
    train, aggregate = TrainConfig(**edge.task["train"]), AggregateConfig(**edge.task["aggregate"])
    return SharedDealer(
        system=system,
        run=run,
        images=run / "sfm" / read_json(run / "sfm" / "result.json", ("images",))["images"],
        scene=scene,
        cloud_plan=cloud_plan,
        edge_plans=split_edges(positions, cloud_plan, system),
        train=replace(train, num_steps=_QUICK_STEPS) if quick else train,
        aggregate=replace(aggregate, num_epochs=1) if quick else aggregate,
        backend=edge.task["backend"],
    )


def _timed(dealer: SharedDealer, order: Order) -> _Timed:
    tree = tree_of_plan(dealer.cloud_plan, dealer.edge_plans, teachers=order == "early")
    times = LocalExecutor(num_workers=2).fold(tree, dealer.prepare, lambda event: None)
    edge_id = next(node.id for node in tree if node.tier == "edge")
    devices_end_s = max(times[node.id].ended_s for node in tree if node.tier == "device")
    notes = read_json(dealer.run / edge_id / "notes.json", ("decisions",))["decisions"]
    return _Timed(
        latency_s=times[edge_id].ended_s - devices_end_s,
        total_s=times[edge_id].ended_s,
        early_views=sum(note["figure"] for note in notes if note["topic"] == "teachers"),
        retrain_s=read_json(dealer.run / edge_id / "summary.json", ("train_s",))["train_s"],
        edge_s=times[edge_id].ended_s - times[edge_id].started_s,
        model_sha256=file_sha256(dealer.run / edge_id / "model.safetensors"),
    )


def _view_times(edge: EdgeOfRun) -> ViewTimes:
    from radiant_core.aggregate.synthetic_views import views_in_bytes
    from radiant_core.io.view_file import load_view, save_view

    model, cameras = edge.models[0], edge.cameras[0]
    with TemporaryDirectory(prefix="radiant-bench-views-") as folder:
        path = Path(folder) / "view.safetensors"
        begun_s = time.perf_counter()
        views = list(views_in_bytes(model, cameras))
        rendered_s = time.perf_counter()
        read_s = 0.0
        for image, weight in views:
            save_view(path, image, weight)
            start_s = time.perf_counter()
            load_view(path, image.shape[1], image.shape[0])
            read_s += time.perf_counter() - start_s
    return ViewTimes(render_s=(rendered_s - begun_s) / len(views), read_s=read_s / len(views))


def _start_s(runs: Sequence[_Timed], counts: Sequence[int], views: ViewTimes) -> float:
    """What an edge's process took beside views and retraining: starting, reading, writing; at least 0."""
    all_views = sum(counts)
    rests = [one.edge_s - one.retrain_s - one.early_views * views.read_s - (all_views - one.early_views) * views.render_s for one in runs]
    return max(0.0, float(np.median(rests)))


def _order_metrics(key: str, runs: Sequence[_Timed], simulated_s: float) -> list[Metric]:
    def metric(name: str, value: float, unit: str, direction: Literal["lower", "info"]) -> Metric:
        return Metric(key=f"{key}.{name}", value=value, unit=unit, direction=direction, tolerance=0.3 * value)

    figures = [("latency_s", [one.latency_s for one in runs]), ("total_s", [one.total_s for one in runs])]
    return [
        *(metric(name, float(np.median(values)), "s", "lower") for name, values in figures),
        metric("early_views", float(np.median([one.early_views for one in runs])), "1", "info"),
        metric("retrain_s", float(np.median([one.retrain_s for one in runs])), "s", "info"),
        metric("simulated_latency_s", simulated_s, "s", "lower"),
    ]
