"""The main job whole: CPU seconds and memory of each of its processes, and inside a training step.

    radiant bench job --scene PHOTOS --out OUT          the sample town without --scene
    radiant bench job --quick --out OUT                 the hamlet: the gate of `make bench`

One `radiant run` on this machine alone, with the defaults. A process counts its CPU seconds from
its start to its seal, libraries included. Then steps of the same training are taken in this
process, and the calls that they consist of are timed. `over_arithmetic` is the job's CPU seconds
over those of a fixed piece of arithmetic, taken before and after it: a slower machine changes both,
a slower build one.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from benchmarks.metric import Metric
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import RunConfig, TrainOptions
from radiant_app.workers.sources import images_folder_of, load_scene_of
from radiant_core import _native
from radiant_core.evaluate.split import held_out_mask
from radiant_core.render import native_backend
from radiant_core.train import native_loss, optimizer
from radiant_core.train.checkpoint import CheckpointFolder
from radiant_core.train.config import train_preset
from radiant_core.train.densify.density import AdaptiveDensity
from radiant_core.train.initialize import first_splats
from radiant_core.train.needs import Overrides, fit_to_backend, fit_to_cameras
from radiant_core.train.photographs import load_training_views
from radiant_core.train.trainer import FitOptions, Training

QUICK_STEPS, STEPS = 150, 600
"""Steps taken for the parts of a step; a quick run has as many."""
CALLS = {
    "training_loss": "loss",
    "target_statistics": "loss",
    "adam_step": "adam",
}
"""Part of a step by native function; those of a rendering are timed by `_TimedView`."""
TOLERANCE = 0.15
"""Share by which the job may take longer over the arithmetic than before and be no slower build."""
ARITHMETIC_ROUNDS = 5


def bench_job(scene: Path | None, out: Path, quick: bool) -> list[Metric]:
    """`job.<name>.<stage>.cpu_s`, `.peak_bytes`, `.psnr`, `.gaussians`, `.step.<part>_ms` and
    `.over_arithmetic`; OUT/run is the run."""
    photographs = scene or sample_scenes_folder() / ("hamlet" if quick else "town") / "images"
    name = photographs.parent.name if photographs.name == "images" else photographs.name
    train = TrainOptions(preset="draft", num_steps=QUICK_STEPS, long_side_px=256) if quick else TrainOptions()
    before_s, started_s = arithmetic_s(), time.monotonic()
    result = run(RunConfig(source=photographs, out=out / "run", train=train))
    wall_s, after_s = time.monotonic() - started_s, arithmetic_s()
    figures = result.metrics
    total_s = sum(figures["cpu_s"].values())
    key = f"job.{name}"
    metrics = [
        *(Metric(key=f"{key}.{node}.cpu_s", value=cpu_s, unit="s", direction="lower") for node, cpu_s in figures["cpu_s"].items()),
        *(
            Metric(key=f"{key}.{stage}.peak_bytes", value=peak, unit="bytes", direction="lower")
            for stage, peak in figures["peak_bytes"].items()
        ),
        Metric(key=f"{key}.wall_s", value=wall_s, unit="s", direction="lower"),
        Metric(key=f"{key}.cpu_s", value=total_s, unit="s", direction="lower"),
        Metric(key=f"{key}.psnr", value=figures["psnr_db"], unit="dB", direction="info"),
        Metric(key=f"{key}.gaussians", value=figures["num_gaussians"], unit="1", direction="info"),
    ]
    ratio = total_s / min(before_s, after_s)
    metrics.append(Metric(key=f"{key}.over_arithmetic", value=ratio, unit="1", direction="lower", tolerance=TOLERANCE * ratio))
    return [*metrics, *_step_metrics(key, out, train, QUICK_STEPS if quick else STEPS)]


def arithmetic_s() -> float:
    """CPU seconds of one thread for sorting, products of matrices and exponentials: the least of
    several rounds."""
    rng, seconds = np.random.default_rng(0), list[float]()
    table, numbers = rng.random((700, 700), np.float32), rng.random(1_000_000, np.float32)
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        for _ in range(ARITHMETIC_ROUNDS):
            begun_s = time.thread_time()
            product = torch.from_numpy(table)
            for _ in range(4):
                product = torch.tanh(product @ product)
            np.sort(numbers)
            np.exp(numbers)
            seconds.append(time.thread_time() - begun_s)
    finally:
        torch.set_num_threads(before)
    return min(seconds)


def _step_metrics(key: str, out: Path, options: TrainOptions, num_steps: int) -> list[Metric]:
    """Milliseconds of CPU by part of a step, of the photographs of OUT/run on one thread."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        parts, steps = _time_steps(out, options, num_steps)
    finally:
        torch.set_num_threads(before)
    once = {part: parts.pop(part) for part in ("decoding", "first_gaussians", "checkpoint")}
    parts["python_and_torch"] = parts.pop("step") - sum(parts.values())
    return [
        *(
            Metric(key=f"{key}.step.{part}_ms", value=1e3 * seconds / steps, unit="ms", direction="lower")
            for part, seconds in parts.items()
        ),
        *(Metric(key=f"{key}.training.{part}_s", value=seconds, unit="s", direction="lower") for part, seconds in once.items()),
    ]


def _time_steps(out: Path, options: TrainOptions, num_steps: int) -> tuple[dict[str, float], int]:
    parts: dict[str, float] = defaultdict(float)
    scene, images = load_scene_of(out / "run" / "sfm"), images_folder_of(out / "run" / "sfm")
    scene = scene.restricted_to(np.flatnonzero(~held_out_mask(scene.cameras.names)))
    overrides = Overrides(num_steps=num_steps, long_side_px=options.long_side_px)
    config, _ = fit_to_backend(train_preset(options.preset), "native", overrides)
    config, _ = fit_to_cameras(replace(config, fill_in=True, light="none"), scene.cameras)
    with _timed(parts, "decoding"):
        views = load_training_views(images, scene.cameras.scaled(config.long_side_px))
    with _timed(parts, "first_gaussians"):
        initial, _ = first_splats(scene, views, config)
    training = Training(initial, views, config, FitOptions(backend="native"))
    with _watched(parts):
        for _ in range(num_steps):
            with _timed(parts, "step"):
                training.take_step()
    with _timed(parts, "checkpoint"):
        CheckpointFolder(out / "checkpoint", "bench", every_s=1e9, warn=lambda message: None).save(training.step, training.state)
    return parts, num_steps


@contextmanager
def _timed(parts: dict[str, float], part: str) -> Iterator[None]:
    begun_s = time.thread_time()
    try:
        yield
    finally:
        parts[part] += time.thread_time() - begun_s


class _TimedView:
    """A `_native.RenderedView` whose calls are timed."""

    def __init__(self, parts: dict[str, float]) -> None:
        self._parts, self._view = parts, _native.RenderedView()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._view, name)

    def forward(self, *arguments: Any) -> None:
        """Project, list and blend."""
        with _timed(self._parts, "rendering"):
            self._view.forward(*arguments)

    def blend_backward(self, *arguments: Any) -> None:
        """From pictures to footprints."""
        with _timed(self._parts, "blending_backward"):
            self._view.blend_backward(*arguments)

    def project_backward(self, *arguments: Any) -> None:
        """From footprints to Gaussians."""
        with _timed(self._parts, "projection_backward"):
            self._view.project_backward(*arguments)


@contextmanager
def _watched(parts: dict[str, float]) -> Iterator[None]:
    """Have the native calls of a training timed, and density control."""

    def timed(part: str, function: Any) -> Any:
        def call(*arguments: Any, **named: Any) -> Any:
            with _timed(parts, part):
                return function(*arguments, **named)

        return call

    calls = {name: timed(part, getattr(_native, name)) for name, part in CALLS.items()}
    proxy = SimpleNamespace(**{**vars(_native), **calls, "RenderedView": lambda: _TimedView(parts)})
    modules, free_views = (native_backend, native_loss, optimizer), native_backend._FREE_VIEWS
    after_update = AdaptiveDensity.after_update
    try:
        for module in modules:
            setattr(module, "_native", proxy)  # noqa: B010 the module's name for it
        # Of the views that earlier renderings left in the pool no call would be timed.
        setattr(native_backend, "_FREE_VIEWS", type(free_views)(most=2))  # noqa: B010
        setattr(AdaptiveDensity, "after_update", timed("density", after_update))  # noqa: B010
        yield
    finally:
        for module in modules:
            setattr(module, "_native", _native)  # noqa: B010
        setattr(native_backend, "_FREE_VIEWS", free_views)  # noqa: B010
        setattr(AdaptiveDensity, "after_update", after_update)  # noqa: B010
