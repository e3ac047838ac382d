"""Benchmark of the rasterizer: CPU milliseconds of forward, backward and steps beside errors.

Equal for all cases of a size: Gaussians, camera, SH degree 3, threads. Every round runs each case
once, so that a slow minute of the machine affects all of them; figures are medians over the rounds.
The peak rate of fused multiply-adds is measured in the same rounds. A pair is a pixel and a
Gaussian that reaches its 4 × 4 block. With several threads each round also runs on one: the gain
of the rasterizer is divided by that of the peak. Minutes; seconds with `quick` (S only).
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from benchmarks.metric import Direction, Metric
from benchmarks.raster.accuracy import image_gradient, num_pairs, render, tile_errors
from benchmarks.raster.drone_scene import SIZES, drone_scene
from benchmarks.tracking import track_items
from radiant_core import _native
from radiant_core.cameras import Cameras
from radiant_core.render.contract import SplatTensors
from radiant_core.splats import Splats, morton_order
from radiant_core.train.losses import weighted_loss
from radiant_core.train.native_loss import TargetStatistics, target_loss
from radiant_core.train.optimizer import SelectiveAdam

SOURCE = Path(__file__).resolve().parents[2]
NUM_ROUNDS = {"S": 15, "M": 9, "L": 5}
FMA_PER_PAIR = 17 + 31
"""Multiplications, additions and fused multiply-adds per pair, forward and backward."""
# Forward (raster_blend.h, blend_block): u 2, v 1, log₂ α 2, polynomial of 2ᶠ 5, weight 1,
# transmittance 1, sums of colour, depth and weight 5. Backward (raster_blend_backward.h,
# instance_moments): u 2, v 1, log₂ α 2, polynomial 5, 1 − α 1, Newton step of its inverse 2,
# transmittance 1, weight 1, c·g − B 3, B 1, h 1, hu and hv 2, nine sums 9. Not counted:
# comparisons, masks, rounding, scaling by 2ⁿ, culling, sorting, and all work per Gaussian.
_TIME_TOLERANCE = 0.3
"""Share by which a time may differ between runs on a machine that does other work."""
_ERROR_TOLERANCE = 0.7
"""Share by which an error may exceed an earlier one: other instruction sets change it 1.7-fold."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One model in one order, and the times and errors of its runs."""

    key: str
    splats: Splats
    cameras: Cameras
    forward_ms: list[float] = field(default_factory=list)
    both_ms: list[float] = field(default_factory=list)
    both_wall_ms: list[float] = field(default_factory=list)
    scaling: list[float] = field(default_factory=list)
    """Ratio of the wall times on one thread and on all, divided by that ratio of the peak."""
    step_ms: list[float] = field(default_factory=list)
    step_wall_ms: list[float] = field(default_factory=list)
    loss_error: list[float] = field(default_factory=list)
    """Error of the step's loss, relative to float64 PyTorch."""


def bench_raster(quick: bool, threads: int | None = None) -> list[Metric]:
    """`raster.<S|M|L>.<random|morton>.native.<…>`, `raster.peak_fma_per_s` (16 lanes, a thread)."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads or before)
    try:
        return [metric for size in (("S",) if quick else SIZES) for metric in _bench_size(size)] + [_peak_metric(5)]
    finally:
        torch.set_num_threads(before)


def build_description(threads: int | None = None) -> str:
    """Compiler, instruction set and threads in one line."""
    return f"{_native.compiler()}, {_native.instruction_sets()[0]}, threads: {threads or torch.get_num_threads()}"


def _bench_size(size: str) -> list[Metric]:
    splats, cameras = drone_scene(SIZES[size])
    threads = torch.get_num_threads()
    cases = [
        Case(key=f"raster.{size}.{order}.native", splats=model, cameras=cameras)
        for order, model in (("random", splats), ("morton", splats.select(morton_order(splats.means))))
    ]
    peaks = []
    for _ in track_items(range(NUM_ROUNDS[size]), f"bench raster {size}"):
        peaks.append(peak_fma_per_s())
        gain = 1.0 if threads == 1 else peak_fma_per_s(threads) / peaks[-1]
        for case in cases:
            _run(case, gain)
            _run_step(case)
    return [metric for case in cases for metric in _metrics(case, float(np.median(peaks)))]


def _run(case: Case, peak_gain: float) -> None:
    leaves = SplatTensors.from_splats(case.splats)
    weights = image_gradient(case.cameras)
    case.forward_ms.append(_time_work(lambda: render(leaves, case.cameras))[0])
    for leaf in leaves.tensors().values():
        leaf.requires_grad_()

    def both() -> None:
        for leaf in leaves.tensors().values():
            leaf.grad = None
        render(leaves, case.cameras).images.backward(weights)

    # The first pass allocates the gradients, which a training loop does once.
    both()
    cpu_ms, wall_ms = _time_work(both)
    case.both_ms.append(cpu_ms)
    case.both_wall_ms.append(wall_ms)
    threads = torch.get_num_threads()
    if threads > 1:
        torch.set_num_threads(1)
        case.scaling.append(_time_work(both)[1] / wall_ms / peak_gain)
        torch.set_num_threads(threads)


def _run_step(case: Case) -> None:
    """One training step of a device, from render to Adam. The target is a darker image."""
    leaves = SplatTensors.from_splats(case.splats)
    with torch.no_grad():
        target = TargetStatistics.of(render(leaves, case.cameras).images[0] * 0.9)
    optimizer = SelectiveAdam(leaves.tensors(), dict.fromkeys(leaves.tensors(), 1e-5))

    def step() -> torch.Tensor:
        output = render(leaves, case.cameras)
        loss = target_loss(output.images.view_as(target.target), target, None, 0.2)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step(output.visible)
        return loss

    step()
    cpu_ms, wall_ms = _time_work(step)
    case.step_ms.append(cpu_ms)
    case.step_wall_ms.append(wall_ms)
    with torch.no_grad():
        image = render(leaves, case.cameras).images[0].double()
        exact = float(weighted_loss(image, target.target.double(), None, 0.2))
    case.loss_error.append(abs(float(target_loss(image.float(), target, None, 0.2)) - exact) / exact)


def _time_work(work: Callable[[], object]) -> tuple[float, float]:
    """CPU and wall milliseconds."""
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    work()
    return (time.process_time() - cpu_s) * 1e3, (time.perf_counter() - wall_s) * 1e3


def peak_fma_per_s(threads: int = 1, rounds: int = 2_000_000) -> float:
    """16-lane multiply-adds per second: of CPU time with one thread, of wall time with several."""
    instruction_set = _native.instruction_sets()[0]
    if threads == 1:
        # The clock of this thread: OpenMP's go on spinning after a parallel operation of torch.
        start_s = time.thread_time()
        return _native.multiply_adds(instruction_set, rounds) / (time.thread_time() - start_s)
    with ThreadPoolExecutor(threads) as pool:
        # A short round starts the threads; uneven starts and ends do not matter in the long one.
        for factor in (0.1, 4):
            start_s = time.perf_counter()
            num_multiplied = sum(pool.map(lambda _, n=int(factor * rounds): _native.multiply_adds(instruction_set, n), range(threads)))
            seconds = time.perf_counter() - start_s
        return num_multiplied / seconds


def _peak_metric(rounds: int) -> Metric:
    peak = float(np.median([peak_fma_per_s() for _ in range(rounds)]))
    return Metric(key="raster.peak_fma_per_s", value=peak, unit="1/s", direction="info")


def _metrics(case: Case, peak: float) -> list[Metric]:
    both_ms, pairs = float(np.median(case.both_ms)), num_pairs(case.splats, case.cameras)
    errors = tile_errors(case.splats, case.cameras)
    rows: list[tuple[str, float, str, Direction, float]] = [
        ("fwd_cpu_ms", float(np.median(case.forward_ms)), "ms", "lower", _TIME_TOLERANCE),
        ("fwd_bwd_cpu_ms", both_ms, "ms", "lower", _TIME_TOLERANCE),
        ("fwd_bwd_wall_ms", float(np.median(case.both_wall_ms)), "ms", "info", 0),
        *([("thread_scaling", float(np.median(case.scaling)), "1", "higher", 0.1)] if case.scaling else []),
        ("step_cpu_ms", float(np.median(case.step_ms)), "ms", "lower", _TIME_TOLERANCE),
        ("step_wall_ms", float(np.median(case.step_wall_ms)), "ms", "info", 0),
        ("step_loss_rel_error", float(np.median(case.loss_error)), "1", "lower", _ERROR_TOLERANCE),
        ("image_max_error", errors.image_max, "1", "lower", _ERROR_TOLERANCE),
        ("image_rms_error", errors.image_rms, "1", "lower", _ERROR_TOLERANCE),
        ("image_max_error_undecided", errors.undecided_max, "1", "info", 0),
        ("grad_rel_error", errors.gradient, "1", "lower", _ERROR_TOLERANCE),
        ("peak_rss_bytes", float(peak_rss_bytes(case.splats, case.key)), "bytes", "lower", 0.1),
        ("pairs_per_s", pairs / both_ms * 1e3, "1/s", "higher", _TIME_TOLERANCE),
        ("fma_peak_fraction", pairs * FMA_PER_PAIR / 16 / (both_ms * 1e-3 * peak), "1", "higher", _TIME_TOLERANCE),
    ]
    return [
        Metric(key=f"{case.key}.{name}", value=value, unit=unit, direction=direction, tolerance=share * value)
        for name, value, unit, direction, share in rows
    ]


def peak_rss_bytes(splats: Splats, key: str) -> int:
    """Peak memory, less that of the imports, of a process that renders the model three times."""
    with TemporaryDirectory(prefix="radiant-bench-raster-") as folder:
        file = Path(folder) / "model.npz"
        np.savez(file, allow_pickle=False, **splats.arrays())
        command = [sys.executable, "-m", "benchmarks.raster.memory", str(file), key.split(".")[1], str(torch.get_num_threads())]
        return int(subprocess.run(command, cwd=SOURCE, capture_output=True, text=True, check=True).stdout)
