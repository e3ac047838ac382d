"""The paper's planning figures as pictures with their numbers: `radiant bench plan --plot FOLDER`.

    costs.png        training time and model size against images per device: real trainings on the sample town, and the fitted curves
    balance.png      even against balanced regions with the latency of each, planned with those curves on unequal devices
    convergence.png  max|T − T̄| / T̄ before each iteration of the paper's loops, and of the exact plan
    partitions.png   all methods' regions with the latency of each

Beside each stand its JSON and CSV; trainings that are measured already are not done again. PSNR of even and balanced is that of two
runs: `radiant run --plan-method even`, and `exact`.
"""

from __future__ import annotations

import csv
import io
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.bench.plan import camera_layout, unequal_system
from radiant_app.commands.demo import sample_scenes_folder
from radiant_app.report.progress import tracked
from radiant_app.run.sources import reconstruct_source
from radiant_app.workers.nodes import load_images
from radiant_core.errors import BadInput
from radiant_core.evaluate.metric import Metric
from radiant_core.io.run_store import read_json, write_atomic, write_json
from radiant_core.plan.comparators import Compared, compare
from radiant_core.plan.profiles.curve_fit import FittedCurve, fit_curve
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.system import Device, Edge, System
from radiant_core.render.contract import resolve_backend
from radiant_core.scene import SfmScene
from radiant_core.train.config import train_preset
from radiant_core.train.needs import Overrides, fit_to_backend

IMAGE_COUNTS, QUICK_COUNTS = (6, 12, 24, 36, 48, 60), (4, 8, 16)
STEPS_PER_IMAGE, LONG_SIDE_PX = 20, 160
SPEEDS = ((1.0, 0.5), (2.0, 1.0), (0.5, 0.7), (1.0, 1.5))
"""Of two devices of each edge, against this machine."""


def bench_plan_figures(folder: Path, quick: bool) -> list[Metric]:
    """All four figures in `folder`, made where it does not exist; BadInput where it is a file."""
    if folder.exists() and not folder.is_dir():
        raise BadInput(f"{folder} is a file: name a folder for the figures.")
    folder.mkdir(exist_ok=True)
    time_curve, size_curve, metrics = _costs(folder, quick)
    return [*metrics, *_balance(folder, time_curve, size_curve), *_methods(folder, quick)]


def _costs(folder: Path, quick: bool) -> tuple[FittedCurve, FittedCurve, list[Metric]]:
    from radiant_viewer.charts.line_chart import Line, Panel, line_picture
    from radiant_viewer.pictures.images import save_png

    counts = QUICK_COUNTS if quick else IMAGE_COUNTS
    path = folder / "costs.json"
    about = {"scene": "town", "long_side_px": LONG_SIDE_PX, "steps_per_image": STEPS_PER_IMAGE, "preset": "draft"}
    stored = read_json(path) if path.is_file() else {}
    rows: dict[str, Any] = stored["rows"] if isinstance(stored, dict) and stored.get("about") == about else {}
    missing = [count for count in counts if str(count) not in rows]
    if missing:
        with tempfile.TemporaryDirectory(prefix="radiant-bench-plan-") as work:
            scene, images = _town(Path(work))
            for count in tracked(missing, "bench plan, training"):
                rows[str(count)] = _trained(scene, images, count)
                write_json(path, {"about": about, "rows": rows})
    names = ("cpu_s", "model_bytes")
    _write_table(
        folder / "costs.csv",
        ["images", *names],
        [[count, *(rows[str(count)][name] for name in names)] for count in counts],
    )
    measured = {name: np.array([rows[str(count)][name] for count in counts]) for name in names}
    fits = {name: fit_curve(counts, values) for name, values in measured.items()}
    xs = np.arange(1.0, max(counts) + 1)
    panels = [
        Panel(
            lines=(
                Line(name="measured", x=np.array(counts, float), y=measured[name] / scale, dotted=True),
                Line(name="fitted", x=xs, y=fits[name].curve(xs) / scale),
            ),
            x_label="Images per device",
            y_label=label,
        )
        for name, scale, label in (("cpu_s", 1.0, "Training (CPU s)"), ("model_bytes", 1e6, "Model (MB)"))
    ]
    detail = f"Sample town, {LONG_SIDE_PX} px, preset draft, {STEPS_PER_IMAGE} steps per image; every dot is one training on this machine"
    save_png(folder / "costs.png", line_picture(panels, "Cost against images per device", detail))
    units = {"cpu_s": "s", "model_bytes": "bytes"}
    metrics = [
        Metric(key=f"plan.figures.{count}_images.{name}", value=float(value), unit=units[name], direction="info")
        for name, values in measured.items()
        for count, value in zip(counts, values.tolist(), strict=True)
    ]
    return fits["cpu_s"], fits["model_bytes"], metrics


def _town(work: Path) -> tuple[SfmScene, Path]:
    """The sample town with its known cameras, and the folder of its photographs."""
    town = sample_scenes_folder() / "town"
    project = work / "town"
    (project / "sparse").mkdir(parents=True)
    (project / "images").symlink_to(town / "images")
    for name in ("cameras.txt", "images.txt", "points3D.txt"):
        (project / "sparse" / name).write_bytes((town / "known" / name).read_bytes())
    result = reconstruct_source({"source": str(project), "sfm": {}}, work / "sfm", lambda _: None)
    return result.scene, result.undistorted_folder


def _trained(scene: SfmScene, images: Path, count: int) -> dict[str, float]:
    """CPU seconds and bytes of a model of the `count` images nearest to the western end, as a strip takes them."""
    from radiant_core.train.initialize import first_splats
    from radiant_core.train.needs import fit_to_scene
    from radiant_core.train.trainer import fit_splats
    from radiant_core.train.views import TrainingViews

    strip = scene.restricted_to(np.sort(np.argsort(scene.cameras.centers[:, 0], kind="stable")[:count]))
    overrides = Overrides(long_side_px=LONG_SIDE_PX, num_steps=STEPS_PER_IMAGE * count)
    config, _ = fit_to_backend(train_preset("draft"), resolve_backend("auto"), overrides)
    cameras = strip.cameras.scaled(config.long_side_px)
    views = TrainingViews(cameras=cameras, images=load_images(images, cameras))
    begun_s = time.process_time()
    config, _ = fit_to_scene(config, strip, views)
    initial, _ = first_splats(strip, views, config)
    splats = fit_splats(initial, views, config).splats
    return {"cpu_s": time.process_time() - begun_s, "model_bytes": float(sum(array.nbytes for array in splats.arrays().values()))}


def _balance(folder: Path, time_curve: FittedCurve, size_curve: FittedCurve) -> list[Metric]:
    positions = camera_layout("lawnmower", 400, np.random.default_rng(0))
    unequal = unequal_system(len(SPEEDS), np.random.default_rng(0))
    edges: list[Edge] = []
    for edge, speeds in zip(unequal.edges, SPEEDS, strict=True):
        device = replace(edge.devices[0], uplink_bytes_per_s=1e6, init_s=time_curve.curve.scaled(0.0), model_bytes=size_curve.curve)
        devices: list[Device] = [
            replace(device, id=f"{edge.id}-{n}", train_s=time_curve.curve.scaled(1 / speed)) for n, speed in enumerate(speeds)
        ]
        edges.append(replace(edge, devices=tuple(devices), aggregate_s=time_curve.curve.scaled(0.25)))
    system = place_edges(System(edges=tuple(edges)), positions, None, seed=0)
    rows = {row.method: row for row in compare(positions, system, max_iterations=1)}
    shown = [replace(rows["even"], method="even"), replace(rows["exact"], method="balanced")]
    saved = 100 * (1 - rows["exact"].makespan_s / rows["even"].makespan_s)
    title = f"Balanced regions are done {saved:.0f} % before even ones (predicted)"
    _draw_partitions(folder / "balance", positions, shown, system, title)
    return [Metric(key="plan.figures.balanced_saves_percent", value=saved, unit="%", direction="info")]


def _methods(folder: Path, quick: bool) -> list[Metric]:
    from radiant_viewer.charts.line_chart import Line, Panel, line_picture
    from radiant_viewer.pictures.images import save_png

    rng = np.random.default_rng(3)
    positions = camera_layout("clustered", 200 if quick else 1600, rng)
    system = place_edges(unequal_system(6, rng), positions, None, seed=0)
    rows = compare(positions, system)
    _draw_partitions(folder / "partitions", positions, list(rows), system, "Partitions with the latency of each region")
    shown = [row for row in rows if row.method.startswith("paper") or row.method == "exact"]
    lines = tuple(
        Line(name=f"{row.method}: ends at {row.history[-1]:.3f}", x=np.arange(len(row.history), dtype=float), y=np.array(row.history))
        for row in shown
    )
    panel = Panel(lines=lines, x_label="Iteration (exact has none)", y_label="max |T − T̄| / T̄")
    detail = f"{len(positions)} cameras in five clusters, 6 edges"
    save_png(folder / "convergence.png", line_picture([panel], "Convergence of ARP", detail))
    write_json(folder / "convergence.json", {row.method: list(row.history) for row in shown})
    table = zip_longest(*(row.history for row in shown), fillvalue="")
    _write_table(
        folder / "convergence.csv", ["iteration", *(row.method for row in shown)], [[n, *values] for n, values in enumerate(table)]
    )
    return [
        Metric(key=f"plan.figures.last_imbalance.{row.method}", value=row.history[-1], unit="1", direction="lower", tolerance=1e-6)
        for row in shown
    ]


def _draw_partitions(path: Path, positions: Any, rows: list[Compared], system: System, title: str) -> None:
    from radiant_viewer.charts.partition_chart import Partition, partitions_picture
    from radiant_viewer.pictures.images import save_png

    edge_ids = [edge.id for edge in system.edges]
    partitions = [
        Partition(name=row.method, edge_of_camera=row.edge_of_camera, edge_time_s=row.edge_time_s, note=f"{row.over_bound:.3g} × the bound")
        for row in rows
    ]
    save_png(path.with_suffix(".png"), partitions_picture(positions, partitions, edge_ids, title))
    record = {row.method: dict(zip(edge_ids, row.edge_time_s.tolist(), strict=True)) for row in rows}
    write_json(path.with_suffix(".json"), {"edge_time_s": record})
    seconds = [[name, *(row.edge_time_s[index] for row in rows)] for index, name in enumerate(edge_ids)]
    _write_table(path.with_suffix(".csv"), ["edge", *(f"{row.method}_s" for row in rows)], seconds)


def _write_table(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\r\n").writerows([header, *rows])
    write_atomic(path, text.getvalue().encode())
