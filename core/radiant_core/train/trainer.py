"""Fits Gaussians to views by Adam on the rendering loss (Kerbl 2023). The same loop trains devices and retrains edges.

Once per model; the loop body once per step: render one view, loss, backward, one Adam step over all Gaussians.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from radiant_core.errors import StageFailed
from radiant_core.render.contract import Backend, SplatTensors, rasterize
from radiant_core.splats import SH_BASES, Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.initialize import camera_extent
from radiant_core.train.losses import weighted_loss
from radiant_core.train.views import TrainingViews


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

    Raises StageFailed with the step when the loss stops being finite; BadInput from the renderer for inputs that are not.
    """
    splats = SplatTensors.from_splats(initial)
    optimizer, means_rate = _optimizer(splats, camera_extent(views.cameras), config, options.steps)
    viewmats = torch.tensor(views.cameras.cam_from_world, dtype=torch.float32)
    Ks = torch.tensor(views.cameras.Ks, dtype=torch.float32)
    losses: list[float] = []
    started = last_report = options.clock()
    reported = 0
    for step, view in enumerate(_view_order(len(views), config.num_steps, config.seed)):
        for group in optimizer.param_groups:
            if group["name"] == "means":
                group["lr"] = means_rate * 0.01 ** (step / config.num_steps)
        loss = _step(splats, optimizer, (viewmats[view : view + 1], Ks[view : view + 1]), _target(views, view), config, options.backend)
        if not np.isfinite(loss):
            raise StageFailed(f"training: the loss became {loss} at step {step + 1}: lower the learning rates or check the photographs.")
        losses.append(loss)
        now = options.clock()
        if now - last_report >= options.report_every_s or step + 1 == config.num_steps:
            options.report(TrainProgress(step=step + 1, num_steps=config.num_steps, loss=float(np.mean(losses[reported:]))))
            last_report, reported = now, len(losses)
    tenth = max(1, len(losses) // 10)
    return TrainResult(
        splats=splats.to_splats(),
        num_steps=config.num_steps,
        first_loss=float(np.mean(losses[:tenth])),
        last_loss=float(np.mean(losses[-tenth:])),
        seconds=options.clock() - started,
    )


def _optimizer(splats: SplatTensors, extent: float, config: TrainConfig, steps: Steps) -> tuple[torch.optim.Adam, float]:
    rates = {
        "means": config.means_lr * extent,
        "quats": config.quats_lr,
        "log_scales": config.scales_lr,
        "logit_opacities": config.opacities_lr,
        "sh0": config.sh0_lr,
        "shN": config.sh0_lr / 20,
    }
    groups = []
    for name, tensor in splats.tensors().items():
        rate = rates[name] * getattr(steps, name)
        if rate > 0 and tensor.numel():
            groups.append({"name": name, "params": [tensor.requires_grad_()], "lr": rate})
    return torch.optim.Adam(groups, eps=1e-15), rates["means"] * steps.means


def _step(
    splats: SplatTensors,
    optimizer: torch.optim.Adam,
    camera: tuple[Tensor, Tensor],
    target: tuple[Tensor, Tensor | None],
    config: TrainConfig,
    backend: Backend,
) -> float:
    image, weights = target
    height, width = image.shape[:2]
    output = rasterize(splats, *camera, width, height, sh_degree=min(config.sh_degree, _degree(splats)), backend=backend)
    loss = weighted_loss(output.images[0], image, weights, config.ssim_weight)
    if loss.requires_grad:
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
    return float(loss.detach())


def _degree(splats: SplatTensors) -> int:
    return SH_BASES.index(splats.shN.shape[1] + 1)


def _target(views: TrainingViews, view: int) -> tuple[Tensor, Tensor | None]:
    image = torch.from_numpy(views.images[view].astype(np.float32) / 255)
    if views.weights is None:
        return image, None
    return image, torch.from_numpy(views.weights[view].astype(np.float32) / 255)


def _view_order(num_views: int, num_steps: int, seed: int) -> Iterator[int]:
    """Every view once per epoch, each epoch in a new order."""
    rng = np.random.default_rng(seed)
    for start in range(0, num_steps, num_views):
        yield from (int(view) for view in rng.permutation(num_views)[: num_steps - start])
