"""Fits Gaussians to views by Adam on the rendering loss (Kerbl 2023). The same loop trains devices and retrains edges.

Once per model; the loop body once per step: render one view, loss, backward, one Adam step over the
Gaussians it saw, or over all (`config.adam`), and density control where its schedule says so (`density.py`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from radiant_core.errors import StageFailed
from radiant_core.render.contract import Backend, SplatTensors, device_of, rasterize, resolve_backend
from radiant_core.splats import SH_BASES, Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.density import AdaptiveDensity, DensityCounts
from radiant_core.train.initialize import camera_extent
from radiant_core.train.native_loss import StatisticsCache, TargetStatistics, target_loss
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.views import TrainingViews

STEPS_BETWEEN_LIMITS = 50
"""How often sizes are held below their limit; it follows centres that move slowly."""


@dataclass(frozen=True, kw_only=True)
class Steps:
    """What may move and how fast, as factors of the configuration's learning rates; 0 keeps a tensor as it is."""

    means: float = 1.0
    quats: float = 1.0
    log_scales: float = 1.0
    logit_opacities: float = 1.0
    sh0: float = 1.0
    shN: float = 1.0


@dataclass(frozen=True, kw_only=True)
class TrainProgress:
    """Told to the caller now and then."""

    step: int
    num_steps: int
    loss: float
    """Mean loss since the last report."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainResult:
    """A fitted model and what it took."""

    splats: Splats
    num_steps: int
    first_loss: float
    """Mean loss of the first tenth of the steps."""
    last_loss: float
    """Mean loss of the last tenth."""
    seconds: float
    density: DensityCounts = field(default_factory=DensityCounts)
    """What density control did; zeros without it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FitOptions:
    """How `fit_splats` reports and renders; apart from the learning rates."""

    steps: Steps = Steps()
    backend: Backend = "auto"
    report: Callable[[TrainProgress], None] = lambda progress: None
    report_every_s: float = 1.0
    clock: Callable[[], float] = time.monotonic


def fit_splats(initial: Splats, views: TrainingViews, config: TrainConfig, options: FitOptions = FitOptions()) -> TrainResult:
    """Fit a copy of `initial` to `views` in `config.num_steps` steps.

    Raises StageFailed with the step when the loss stops being finite, or naming the tensor when a gradient does; BadInput from the
    renderer for inputs that are not.
    """
    splats = SplatTensors.from_splats(initial, device=device_of(resolve_backend(options.backend)))
    extent = camera_extent(views.cameras)
    optimizer, means_rate = _optimizer(splats, extent, config, options.steps)
    density = AdaptiveDensity(config, extent, splats) if config.densify == "adc" else None
    viewmats, Ks = torch.tensor(views.cameras.cam_from_world), torch.tensor(views.cameras.Ks)
    statistics = StatisticsCache()
    losses: list[float] = []
    started = last_report = options.clock()
    reported = 0
    for step, view in enumerate(_view_order(len(views), config.num_steps, config.seed)):
        optimizer.set_rate("means", means_rate * config.means_lr_end ** (step / config.num_steps))
        target = statistics.get(view, partial(_target, views, view)), _weights(views, view)
        if step % STEPS_BETWEEN_LIMITS == 0:
            _limit_scales(splats, views, config)
        camera = viewmats[view : view + 1], Ks[view : view + 1]
        loss = _Step(number=step + 1, config=config, backend=options.backend, density=density).take(splats, optimizer, camera, target)
        if not np.isfinite(loss):
            raise StageFailed(f"training: the loss became {loss} at step {step + 1}: lower the learning rates or check the photographs.")
        losses.append(loss)
        if density is not None:
            splats = density.after_step(step + 1, splats, optimizer)
        now = options.clock()
        if now - last_report >= options.report_every_s or step + 1 == config.num_steps:
            options.report(TrainProgress(step=step + 1, num_steps=config.num_steps, loss=float(np.mean(losses[reported:]))))
            last_report, reported = now, len(losses)
    _limit_scales(splats, views, config)
    tenth = max(1, len(losses) // 10)
    return TrainResult(
        splats=splats.to_splats(),
        num_steps=config.num_steps,
        first_loss=float(np.mean(losses[:tenth])),
        last_loss=float(np.mean(losses[-tenth:])),
        seconds=options.clock() - started,
        density=DensityCounts() if density is None else density.counts,
    )


def _optimizer(splats: SplatTensors, extent: float, config: TrainConfig, steps: Steps) -> tuple[SelectiveAdam, float]:
    rates = {
        "means": config.means_lr * extent,
        "quats": config.quats_lr,
        "log_scales": config.scales_lr,
        "logit_opacities": config.opacities_lr,
        "sh0": config.sh0_lr,
        "shN": config.sh0_lr / 20,
    }
    moving = {name: rates[name] * getattr(steps, name) for name, tensor in splats.tensors().items() if tensor.numel()}
    moving = {name: rate for name, rate in moving.items() if rate > 0}
    tensors = {name: tensor for name, tensor in splats.tensors().items() if name in moving}
    return SelectiveAdam(tensors, moving), rates["means"] * steps.means


@dataclass(frozen=True, kw_only=True, eq=False)
class _Step:
    """One step of a run; `number` counts from 1."""

    number: int
    config: TrainConfig
    backend: Backend
    density: AdaptiveDensity | None

    def take(
        self, splats: SplatTensors, optimizer: SelectiveAdam, camera: tuple[Tensor, Tensor], target: tuple[TargetStatistics, Tensor | None]
    ) -> float:
        statistics, weights = target
        height, width = statistics.target.shape[:2]
        output = rasterize(splats, *camera, width, height, sh_degree=self._sh_degree(splats), backend=self.backend)
        loss = target_loss(output.images.view(height, width, 3), statistics, weights, self.config.ssim_weight)
        if loss.requires_grad:
            if self.density is not None:
                self.density.watch(self.number, output, (width, height))
            optimizer.zero_grad()
            loss.backward()
            optimizer.step(output.visible if self.config.adam == "visible" else None)
        return float(loss.detach())

    def _sh_degree(self, splats: SplatTensors) -> int:
        every = self.config.sh_degree_every
        allowed = self.number // self.config.scaled_steps(every) if every else self.config.sh_degree
        return min(self.config.sh_degree, SH_BASES.index(splats.shN.shape[1] + 1), allowed)


def _limit_scales(splats: SplatTensors, views: TrainingViews, config: TrainConfig) -> None:
    if config.max_scale_per_distance is None:
        return
    distances, _ = KDTree(views.cameras.centers).query(splats.means.detach().cpu().numpy().astype(np.float64))
    limits = np.log(np.maximum(config.max_scale_per_distance * distances, np.finfo(np.float32).tiny))
    with torch.no_grad():
        splats.log_scales.clamp_(max=torch.from_numpy(limits).to(splats.log_scales)[:, None])


def _target(views: TrainingViews, view: int) -> Tensor:
    return torch.from_numpy(views.images[view].astype(np.float32) / 255)


def _weights(views: TrainingViews, view: int) -> Tensor | None:
    return None if views.weights is None else torch.from_numpy(views.weights[view].astype(np.float32) / 255)


def _view_order(num_views: int, num_steps: int, seed: int) -> Iterator[int]:
    """Every view once per epoch, each epoch in a new order."""
    rng = np.random.default_rng(seed)
    for start in range(0, num_steps, num_views):
        yield from (int(view) for view in rng.permutation(num_views)[: num_steps - start])
