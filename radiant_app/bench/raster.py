"""Benchmark of the rasterizer: CPU milliseconds of forward and of forward + backward, the error against float64 beside them.

Equal for all cases of a size: Gaussians, camera, SH degree 3, threads. One run of each case after another, then the next round, so that a
slow minute of the machine hits all of them; medians of the rounds. The peak of fused multiply-adds is measured in the same rounds.
A pair is a pixel and a Gaussian that reaches its 4 × 4 block. Seconds with `quick` (S only), a minute or two without.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from torch import Tensor

from radiant_app.bench.drone_scene import SIZES, drone_scene, morton_order
from radiant_app.progress import tracked
from radiant_core import _native
from radiant_core.cameras import Cameras
from radiant_core.evaluate.metric import Direction, Metric
from radiant_core.render.contract import Backend, RenderOutput, SplatTensors, rasterize
from radiant_core.splats import Splats

NUM_ROUNDS = {"S": 15, "M": 9, "L": 5}
NUM_TILES = 64
TILE_PX = 16
SEED = 1
"""Which tiles the error is measured on; raised with each version of the project."""
_TIME_TOLERANCE = 0.3
"""Share by which a time may differ from run to run on a machine that does other work too."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One model in one order and what its runs took."""

    key: str
    splats: Splats
    cameras: Cameras
    forward_ms: list[float] = field(default_factory=list)
    both_ms: list[float] = field(default_factory=list)
    both_wall_ms: list[float] = field(default_factory=list)


def bench_raster(quick: bool, threads: int | None = None) -> list[Metric]:
    """`raster.<S|M|L>.<random|morton>.native.<…>` and `raster.peak_fma_per_s` (16 lanes, per thread)."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads or before)
    try:
        return [metric for size in (("S",) if quick else SIZES) for metric in _bench_size(size)] + [_peak_metric(5)]
    finally:
        torch.set_num_threads(before)


def build_description(threads: int | None = None) -> str:
    """Compiler, instruction set and threads in one line, to stand over the figures."""
    return f"{_native.compiler()}, {_native.instruction_sets()[0]}, threads: {threads or torch.get_num_threads()}"


def _bench_size(size: str) -> list[Metric]:
    splats, cameras = drone_scene(SIZES[size])
    cases = [
        Case(key=f"raster.{size}.{order}.native", splats=model, cameras=cameras)
        for order, model in (("random", splats), ("morton", morton_order(splats)))
    ]
    peaks = []
    for _ in tracked(range(NUM_ROUNDS[size]), f"bench raster {size}"):
        peaks.append(peak_fma_per_s())
        for case in cases:
            _run(case)
    return [metric for case in cases for metric in _metrics(case, float(np.median(peaks)))]


def _run(case: Case) -> None:
    leaves = SplatTensors.from_splats(case.splats)
    weights = _weights(case.cameras)
    case.forward_ms.append(_timed(lambda: render(leaves, case.cameras))[0])
    for leaf in leaves.tensors().values():
        leaf.requires_grad_()

    def both() -> None:
        for leaf in leaves.tensors().values():
            leaf.grad = None
        render(leaves, case.cameras).images.backward(weights)

    # The first pass touches fresh memory for the gradients, which a training loop does once.
    both()
    cpu_ms, wall_ms = _timed(both)
    case.both_ms.append(cpu_ms)
    case.both_wall_ms.append(wall_ms)


def _timed(work: Callable[[], object]) -> tuple[float, float]:
    """CPU and wall milliseconds."""
    cpu_s, wall_s = time.process_time(), time.perf_counter()
    work()
    return (time.process_time() - cpu_s) * 1e3, (time.perf_counter() - wall_s) * 1e3


def render(leaves: SplatTensors, cameras: Cameras, backend: Backend = "auto") -> RenderOutput:
    """The one view of the scene, degree 3, black background."""
    width, height = (int(side) for side in cameras.sizes_wh[0])
    viewmats, Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
    return rasterize(leaves, viewmats, Ks, width, height, sh_degree=3, backend=backend)


def _weights(cameras: Cameras) -> Tensor:
    """∂loss/∂image (1,H,W,3), fixed random numbers of the size a mean over pixels has."""
    width, height = (int(side) for side in cameras.sizes_wh[0])
    return torch.rand(1, height, width, 3, generator=torch.Generator().manual_seed(0)) / (width * height)


def peak_fma_per_s(rounds: int = 2_000_000) -> float:
    """Fused multiply-adds of 16 lanes per CPU second of one thread, by a loop that does nothing else."""
    start_s = time.process_time()
    done = _native.multiply_adds(_native.instruction_sets()[0], rounds)
    return done / (time.process_time() - start_s)


def _peak_metric(rounds: int) -> Metric:
    peak = float(np.median([peak_fma_per_s() for _ in range(rounds)]))
    return Metric(key="raster.peak_fma_per_s", value=peak, unit="1/s", direction="info")


def _metrics(case: Case, peak: float) -> list[Metric]:
    both_ms, pairs = float(np.median(case.both_ms)), num_pairs(case.splats, case.cameras)
    image_error, gradient_error, undecided = tile_errors(case.splats, case.cameras)
    rows: list[tuple[str, float, str, Direction, float]] = [
        ("fwd_cpu_ms", float(np.median(case.forward_ms)), "ms", "lower", _TIME_TOLERANCE),
        ("fwd_bwd_cpu_ms", both_ms, "ms", "lower", _TIME_TOLERANCE),
        ("fwd_bwd_wall_ms", float(np.median(case.both_wall_ms)), "ms", "info", 0),
        ("image_max_error", image_error, "1", "lower", 0.5),
        ("image_max_error_undecided", undecided, "1", "info", 0),
        ("grad_rel_error", gradient_error, "1", "lower", 0.5),
        ("peak_rss_bytes", float(peak_rss_bytes(case.splats, case.key)), "bytes", "lower", 0.1),
        ("pairs_per_s", pairs / both_ms * 1e3, "1/s", "higher", _TIME_TOLERANCE),
        ("fma_per_pair", both_ms * 1e-3 * peak * 16 / pairs, "1", "lower", _TIME_TOLERANCE),
    ]
    return [
        Metric(key=f"{case.key}.{name}", value=value, unit=unit, direction=direction, tolerance=share * value)
        for name, value, unit, direction, share in rows
    ]


def num_pairs(splats: Splats, cameras: Cameras) -> int:
    """Pixel–Gaussian pairs that forward and backward each go through."""
    from radiant_core.render.native_backend import count_pairs

    width, height = (int(side) for side in cameras.sizes_wh[0])
    return count_pairs(SplatTensors.from_splats(splats), cameras.cam_from_world[0], cameras.Ks[0], width, height)


def tile_errors(splats: Splats, cameras: Cameras, backend: Backend = "auto") -> tuple[float, float, float]:
    """Largest image error and ‖g − g64‖ / ‖g64‖ of the worst tensor on 64 random tiles, and the largest error of undecided pixels.

    Only Gaussians whose box touches those tiles take part; to the tiles' pixels that is the whole model. A pixel is undecided where a
    change of ln opacity by 1e-4 up and down makes it jump, which a second difference shows: some pair stands at α_min or at the cut.
    """
    keep = _random_tiles(cameras)
    with torch.no_grad():
        chosen = splats.select(_touching(render(SplatTensors.from_splats(splats), cameras), keep))
    exact = SplatTensors.from_splats(chosen, torch.float64)
    low, middle, high = (render(_shifted(exact, shift), cameras, "reference").images for shift in (-1e-4, 0.0, 1e-4))
    jumps = (low - 2 * middle + high).abs().amax(-1)[0] > 1e-6
    decided = keep & ~jumps
    leaves = SplatTensors.from_splats(chosen)
    images = []
    renderings: tuple[tuple[SplatTensors, Backend], ...] = ((leaves, backend), (exact, "reference"))
    for tensors, name in renderings:
        for leaf in tensors.tensors().values():
            leaf.requires_grad_()
        output = render(tensors, cameras, name)
        output.images.backward((_weights(cameras) * decided[None, ..., None]).to(output.images))
        images.append(output.images.detach().double())
    error = (images[0] - images[1]).abs().amax(-1)[0]
    gradients = [
        float((leaf.grad.double() - true.grad).norm() / true.grad.norm())
        for leaf, true in zip(leaves.tensors().values(), exact.tensors().values(), strict=True)
        if leaf.grad is not None and true.grad is not None
    ]
    return float(error[decided].max()), max(gradients), float((error * (keep & jumps)).max())


def _shifted(tensors: SplatTensors, shift: float) -> SplatTensors:
    return SplatTensors(**{**tensors.tensors(), "logit_opacities": tensors.logit_opacities + shift})


def _random_tiles(cameras: Cameras) -> Tensor:
    """Mask (H,W) of 64 tiles of 16 × 16 px."""
    width, height = (int(side) for side in cameras.sizes_wh[0])
    rows, columns = -(-height // TILE_PX), -(-width // TILE_PX)
    tiles = torch.zeros(rows * columns, dtype=torch.bool)
    tiles[torch.randperm(rows * columns, generator=torch.Generator().manual_seed(SEED))[:NUM_TILES]] = True
    return tiles.reshape(rows, columns).repeat_interleave(TILE_PX, 0).repeat_interleave(TILE_PX, 1)[:height, :width]


def _touching(output: RenderOutput, keep: Tensor) -> np.ndarray:
    """Mask (N,) of Gaussians whose box of half side `radii_px`, a pixel wider, covers a kept pixel."""
    height, width = keep.shape
    counts = torch.zeros(height + 1, width + 1, dtype=torch.int64)
    counts[1:, 1:] = keep.long().cumsum(0).cumsum(1)
    means, radii = output.means2d[0], output.radii_px[0, :, None] + 1
    limit = torch.tensor([width, height])
    low, high = ((means + sign * radii).floor().clamp_min(0).minimum(limit).long() for sign in (-1, 1))
    total = counts[high[:, 1], high[:, 0]] - counts[low[:, 1], high[:, 0]] - counts[high[:, 1], low[:, 0]] + counts[low[:, 1], low[:, 0]]
    return ((total > 0) & (output.radii_px[0] > 0)).numpy()


def peak_rss_bytes(splats: Splats, key: str) -> int:
    """Memory above what the imports take, model included, of a fresh process that renders forward and backward three times."""
    with TemporaryDirectory(prefix="radiant-bench-raster-") as folder:
        file = Path(folder) / "model.npz"
        np.savez(file, allow_pickle=False, **splats.arrays())
        command = [sys.executable, "-m", "radiant_app.bench.raster_memory", str(file), key.split(".")[1], str(torch.get_num_threads())]
        return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
