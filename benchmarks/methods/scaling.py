"""`radiant bench together`: how soon devices that train as one model make a model of a given PSNR.

    t_n           seconds until the held-out PSNR is `target_db` with n equal devices, all at once,
                  over links of 1 Gbit/s (`group_latency.py`)
    efficiency    t_1 / (n t_n); t_1 is a plain training of all photographs on one device

Rates settle towards the end of a training, so that its state half-way says little: each number of
devices trains for so many views, then for more, until the target is reached; t_n is on the line
between the last two. Once per number of devices and length. Models and figures are kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.methods.cells import BenchScene, Cell, Layout, ModelCache, bench_settings, deal_cell, load_bench_scene
from benchmarks.methods.group_latency import Link, scene_times, work_of
from benchmarks.methods.together import grouped
from benchmarks.metric import Metric
from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.hierarchy.in_process import run_in_process
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.light.held_out import held_out_psnr_db
from radiant_core.splats import Splats

LAYOUTS: Mapping[int, Layout] = {
    1: Layout(num_edges=1, num_devices=1),
    2: Layout(num_edges=1, num_devices=2),
    4: Layout(num_edges=2, num_devices=2),
    8: Layout(num_edges=2, num_devices=4),
    16: Layout(num_edges=4, num_devices=4),
}
LINK = Link(bits_per_s=1e9)


@dataclass(frozen=True, kw_only=True)
class ScalingBench:
    """What to measure."""

    scene: Path
    out: Path
    devices: tuple[int, ...] = tuple(LAYOUTS)
    num_views: tuple[int, ...] = (600, 900, 1200, 1600, 2000)
    """Lengths of a training, in views of all devices, rising."""
    target_db: float = 27.5
    long_side_px: int = 384
    overlaps: bool = False

    def __post_init__(self) -> None:
        if unknown := [n for n in self.devices if n not in LAYOUTS]:
            raise BadInput(f"{unknown[0]} devices have no layout here: use {', '.join(map(str, LAYOUTS))}.")


@dataclass(frozen=True, kw_only=True)
class Reached:
    """A training of some length."""

    num_views: int
    psnr_db: float
    seconds: float


def bench_together(bench: ScalingBench) -> list[Metric]:
    """Per number of devices: the trainings, the seconds to the target and the efficiency, as far as
    the longest training reaches it."""
    scene, metrics = load_bench_scene(bench.scene, bench.long_side_px), list[Metric]()
    seconds: dict[int, float] = {}
    for devices in bench.devices:
        key, trainings = f"together.{scene.name}.devices_{devices}", list[Reached]()
        for num_views in bench.num_views:
            trainings.append(_train(bench, scene, devices, num_views))
            if trainings[-1].psnr_db >= bench.target_db:
                break
        for training in trainings:
            metrics.append(Metric(key=f"{key}.views_{training.num_views}.psnr_db", value=training.psnr_db, unit="dB", direction="info"))
            metrics.append(Metric(key=f"{key}.views_{training.num_views}.seconds", value=training.seconds, unit="s", direction="info"))
        if (reached_s := seconds_to(bench.target_db, trainings)) is not None:
            seconds[devices] = reached_s
            metrics.append(Metric(key=f"{key}.seconds_to_{bench.target_db:g}_db", value=reached_s, unit="s", direction="lower"))
            if 1 in seconds:
                efficiency = seconds[1] / (devices * reached_s)
                metrics.append(Metric(key=f"{key}.efficiency", value=efficiency, unit="1", direction="higher"))
    return metrics


def seconds_to(target_db: float, trainings: Sequence[Reached]) -> float | None:
    """Where the line between the last two trainings is at the target; of one that is at it at once,
    its own seconds; None where the last is below."""
    if not trainings or trainings[-1].psnr_db < target_db:
        return None
    last = trainings[-2:]
    if len(last) == 1 or last[0].psnr_db >= last[1].psnr_db:
        return last[-1].seconds
    return float(np.interp(target_db, [training.psnr_db for training in last], [training.seconds for training in last]))


def _train(bench: ScalingBench, scene: BenchScene, devices: int, num_views: int) -> Reached:
    settings = bench_settings(bench.long_side_px, max(1, round(num_views / devices)))
    cell = deal_cell(scene, ModelCache(folder=bench.out / "models"), settings, LAYOUTS[devices], speeds=(1.0,))
    key = content_key(__version__, cell.recipe, num_views, bench.overlaps, scene.training, scene.held_out.cameras)[:16]
    record = bench.out / "together" / f"{cell.name}-{num_views}-{key}.json"
    if record.is_file():
        return Reached(**read_json(record))
    splats, seconds = _model(cell, num_views) if devices == 1 else _group_model(cell, overlaps=bench.overlaps)
    psnr_db = float(np.mean(held_out_psnr_db(splats, scene.held_out_views, cell.recipe.backend)))
    reached = Reached(num_views=num_views, psnr_db=psnr_db, seconds=seconds)
    record.parent.mkdir(parents=True, exist_ok=True)
    write_json(record, vars(reached))
    return reached


def _model(cell: Cell, num_views: int) -> tuple[Splats, float]:
    model = cell.model_of(cell.scene.training, num_steps=num_views, max_epochs=None)
    return model.splats, float(model.summary["cpu_s"])


def _group_model(cell: Cell, *, overlaps: bool) -> tuple[Splats, float]:
    recipe = grouped(cell.recipe, "cloud", overlaps=overlaps)
    run = run_in_process(recipe, cell.scene.training, cell.scene.views)
    assert run.scene.splats is not None
    (time,) = scene_times(recipe.system, (), {root: work_of(group) for root, group in run.groups.items()}, [LINK])
    return run.scene.splats, time.scene_s
