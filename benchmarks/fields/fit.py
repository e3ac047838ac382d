"""Fitting a field to photographs: 2,048 rays a step, mean squared error, Adam. Once per step.

    loss = mean over rays and channels of (C − photograph)² + penalty of the field
    rate = 1e-2 · 0.1^{step / steps}, Adam 0.9, 0.99, ε 1e-15, as instant-ngp has them

A step's rays are rendered in parts and their gradients added. The same bits for the same seed on
one thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.fields.field import RadianceField
from benchmarks.fields.rays import PixelRays, Rays
from benchmarks.fields.render import RAYS_A_PART, Sampling, render_rays
from radiant_core.errors import BadInput, StageFailed
from radiant_core.train.results import TrainProgress


@dataclass(frozen=True, kw_only=True)
class FitFieldConfig:
    """How long and how fast a field learns."""

    num_steps: int = 1000
    rays_a_step: int = 2048
    rate: float = 1e-2
    """Adam's learning rate at the first step."""
    rate_end: float = 0.1
    """What is left of it at the last step."""
    sampling: Sampling = field(default_factory=Sampling)
    seed: int = 0
    """Of the field's first values, its rays and their samples."""

    def __post_init__(self) -> None:
        if min(self.num_steps, self.rays_a_step) < 1 or not (0 < self.rate < np.inf and 0 < self.rate_end <= 1):
            raise BadInput(f"a field was given {self}: expected counts of at least 1, rate above 0 and 0 < rate_end ≤ 1.")


@dataclass(frozen=True, kw_only=True)
class FitFieldOptions:
    """What else moves with a field, and who is told."""

    report: Callable[[TrainProgress], None] = lambda progress: None
    report_every_s: float = 1.0
    moved: Callable[[Rays], Rays] | None = None
    """Moves the rays of each step, where poses are refined."""
    extra_parameters: tuple[tuple[nn.Parameter, float], ...] = ()
    """Parameters that are fitted too, each with its own rate at the first step."""
    first_step: int = 0
    """Where rays go on: a later round of the same training draws others."""


PLAIN = FitFieldOptions()
"""The field alone, in silence."""


@dataclass(frozen=True, kw_only=True)
class FieldFit:
    """What a fit took."""

    num_steps: int
    num_rays: int
    cpu_s: float
    """Of this process."""
    losses: tuple[float, ...]
    """Mean squared error of each step."""


def fit_field(radiance: RadianceField, pixels: PixelRays, config: FitFieldConfig, options: FitFieldOptions = PLAIN) -> FieldFit:
    """Fit `radiance`, in place, to `pixels`. StageFailed when a loss is not finite."""
    begun_s, reported_s = time.process_time(), time.monotonic()
    radiance.train()
    field_parameters = [(parameter, config.rate) for parameter in radiance.parameters() if parameter.requires_grad]
    groups = [{"params": [parameter], "lr": rate} for parameter, rate in (*field_parameters, *options.extra_parameters)]
    first_rates = [group["lr"] for group in groups]
    adam = torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)
    losses: list[float] = []
    for step in range(config.num_steps):
        for group, rate in zip(adam.param_groups, first_rates, strict=True):
            group["lr"] = rate * config.rate_end ** (step / config.num_steps)
        adam.zero_grad(set_to_none=False)
        losses.append(_add_gradients(radiance, pixels, config, options, options.first_step + step))
        if not np.isfinite(losses[-1]):
            raise StageFailed(f"the loss of the field is {losses[-1]} at step {step}: its photographs or poses are not usable.")
        adam.step()
        if time.monotonic() - reported_s >= options.report_every_s or step + 1 == config.num_steps:
            reported_s = time.monotonic()
            options.report(TrainProgress(step=step + 1, num_steps=config.num_steps, loss=float(np.mean(losses[-20:]))))
    radiance.eval()
    return FieldFit(
        num_steps=config.num_steps,
        num_rays=config.num_steps * config.rays_a_step,
        cpu_s=time.process_time() - begun_s,
        losses=tuple(losses),
    )


def _add_gradients(radiance: RadianceField, pixels: PixelRays, config: FitFieldConfig, options: FitFieldOptions, step: int) -> float:
    """Render a step's rays part by part, add their gradients; the mean squared error."""
    rows = np.random.default_rng((config.seed, step)).integers(0, len(pixels), config.rays_a_step)
    generator = torch.Generator().manual_seed(int(np.random.default_rng((config.seed, step, 1)).integers(2**62)))
    # By view and row, so that the rays of a part read much the same entries of the grid.
    rays, colors = pixels.batch(np.sort(rows))
    device = next(radiance.parameters()).device
    rays, colors = rays.to(device), colors.to(device)
    rays = rays if options.moved is None else options.moved(rays)
    error = 0.0
    for start in range(0, len(rays), RAYS_A_PART):
        part = slice(start, start + RAYS_A_PART)
        part_rays = rays.select(part)
        rendered = render_rays(radiance, part_rays, config.sampling, generator)
        squared = (rendered.colors - colors[part]).square().sum() / (3 * len(rays))
        loss: Tensor = squared + rendered.penalty * (len(part_rays) / len(rays))
        # The moved rays' graph is shared by all parts of the step.
        loss.backward(retain_graph=options.moved is not None)
        error += float(squared.detach())
    return error
