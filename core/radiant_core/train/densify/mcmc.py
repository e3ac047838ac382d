"""Densification as sampling (Kheradmand et al., 3D Gaussian Splatting as MCMC, NeurIPS 2024).

Dead Gaussians (opacity ≤ 0.005) are moved onto live ones drawn by opacity, and the model grows by 5
% per 100 steps of the schedule up to a hard limit: a run of a twentieth of its steps grows by
1.05²⁰ in each of its fewer rounds. Where n Gaussians share one place, each gets (Eqn. 9)
    o' = 1 − (1 − o)^(1/n)
    σ' = σ · o / Σ_{i=1..n} Σ_{k=0..i−1} C(i−1, k) (−1)^k o'^{k+1} / √(k+1)
so that the picture stays nearly the same. Opacity and size cost a little, and centres of nearly
transparent Gaussians wander by their covariance. Edits once every `Mcmc.every` steps, wandering
every `WANDER_EVERY`, its variance as if it were every step.
"""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import comb

from radiant_core.render.contract import SplatTensors
from radiant_core.splats import morton_order
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.density import MIN_OPACITY, finish_density, rotate
from radiant_core.train.densify.policies import DensityCounts, Mcmc
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.parts import Moment, Part
from radiant_core.train.results import TrainResult

GROWTH_PER_STEP = 1.05**0.01
"""Per step of the schedule."""
MAX_COPIES = 51
"""More than so many Gaussians in one place count as so many."""
OPACITY_COST = 0.01
SCALE_COST = 0.01
WANDER_RATE = 5e5
WANDER_EVERY = 10
GATE_STEEPNESS = 100.0
"""Gaussians more opaque than `MIN_OPACITY` hardly wander: the gate is sigmoid(−100 (o − 0.005))."""


def share_place(
    logit_opacities: NDArray[np.floating], log_scales: NDArray[np.floating], num_copies: NDArray[np.integer]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Logit opacities (K,) and log scales (K,3) that each of n ≥ 1 Gaussians (K,) gets which share
    the place of one."""
    n = np.clip(num_copies, 1, MAX_COPIES)
    # Not opaque to the last bit, where neither logarithm nor the logit would exist.
    o = np.clip(1 / (1 + np.exp(-np.clip(logit_opacities.astype(np.float64), -60, 60))), 1e-12, 1 - 1e-7)
    shared = -np.expm1(np.log1p(-o) / n)
    factors = np.empty(len(n))
    for copies in np.unique(n):
        i, k = np.meshgrid(np.arange(1, copies + 1), np.arange(copies), indexing="ij")
        weights = np.where(k < i, comb(i - 1, k) * (-1.0) ** k / np.sqrt(k + 1), 0).sum(axis=0)
        chosen = n == copies
        factors[chosen] = (shared[chosen, None] ** (np.arange(copies) + 1) * weights).sum(axis=1)
    growth = np.log(np.maximum(o / np.maximum(factors, 1e-12), 1e-6))
    shared = np.clip(shared, MIN_OPACITY, 1 - 1e-7)
    return (np.log(shared) - np.log1p(-shared)).astype(np.float32), (log_scales + growth[:, None]).astype(np.float32)


class RelocatedDensity(Part):
    """Relocates, adds and perturbs the Gaussians of one training; `counts.num_cloned` are those
    added, `num_relocated` those moved."""

    name = "density"

    def __init__(self, policy: Mcmc, config: TrainConfig) -> None:
        self._policy, self._config = policy, config
        self.counts = DensityCounts()

    @torch.no_grad()
    def after_backward(self, splats: SplatTensors) -> None:
        """Add the gradients of mean opacity and mean size, each times 0.01."""
        if splats.logit_opacities.grad is not None:
            o = splats.logit_opacities.sigmoid()
            splats.logit_opacities.grad += OPACITY_COST / len(o) * o * (1 - o)
        if splats.log_scales.grad is not None:
            splats.log_scales.grad += SCALE_COST / splats.log_scales.numel() * splats.log_scales.clamp(max=30).exp()

    def after_update(self, moment: Moment, splats: SplatTensors, optimizer: SelectiveAdam) -> SplatTensors:
        """The model, relocated and grown where a round is due, perturbed where that is."""
        policy, step, schedule_step = self._policy, moment.step, moment.schedule_step
        rng = np.random.default_rng((self._config.seed, step))
        if policy.from_step < schedule_step < policy.until_step and step % policy.every == 0 and len(splats):
            # The schedule's mean advance between two rounds, by steps or by time.
            growth = GROWTH_PER_STEP ** (policy.every * max(1.0, schedule_step / step))
            splats = self._edit(splats, optimizer, rng, growth)
        if step % WANDER_EVERY == 0:
            wander(splats, WANDER_RATE * optimizer.rate("means") * math.sqrt(WANDER_EVERY), rng)
        return splats

    def finish(self, result: TrainResult) -> TrainResult:
        """The result with the counts, without the Gaussians that no pixel shows."""
        return finish_density(result, self.counts)

    def state_numbers(self) -> dict[str, Any]:
        """The counts; a round depends on the model alone."""
        return asdict(self.counts)

    def restore(self, arrays: dict[str, NDArray[Any]], numbers: Any, splats: SplatTensors) -> None:
        """Go on from the counts."""
        self.counts = DensityCounts(**numbers)

    def _edit(self, splats: SplatTensors, optimizer: SelectiveAdam, rng: np.random.Generator, growth: float) -> SplatTensors:
        tensors = {name: tensor.detach() for name, tensor in splats.tensors().items()}
        logits = tensors["logit_opacities"].cpu().numpy()
        alive = logits > math.log(MIN_OPACITY / (1 - MIN_OPACITY))
        if not alive.any():
            return splats
        num_dead = int((~alive).sum())
        num_added = max(0, round(min(self._config.max_num_splats, growth * len(logits))) - len(logits))
        self.counts += DensityCounts(num_cloned=num_added, num_relocated=num_dead)
        if num_dead + num_added == 0:
            return splats
        opacities = np.where(alive, 1 / (1 + np.exp(-logits.astype(np.float64))), 0)
        sampled_rows = rng.choice(len(logits), num_dead + num_added, p=opacities / opacities.sum())
        copies = 1 + np.bincount(sampled_rows, minlength=len(logits))
        shared = np.flatnonzero(copies > 1)
        new_logits, new_scales = logits.copy(), tensors["log_scales"].cpu().numpy().copy()
        new_logits[shared], new_scales[shared] = share_place(logits[shared], new_scales[shared], copies[shared])
        rows = np.concatenate([np.flatnonzero(alive), sampled_rows])
        order = morton_order(tensors["means"].cpu().numpy()[rows])
        rows, fresh = rows[order], (np.arange(len(rows)) >= int(alive.sum()))[order]
        device = splats.means.device
        index = torch.from_numpy(rows).to(device)
        changed = {"logit_opacities": new_logits[rows], "log_scales": new_scales[rows]}
        edited = replace(
            splats,
            **{name: torch.from_numpy(changed[name]).to(device) if name in changed else tensor[index] for name, tensor in tensors.items()},
        )
        # Those that now share a place are fresh too: their moments are of another opacity and size.
        optimizer.select_rows(edited.tensors(), index, torch.from_numpy(fresh | (copies[rows] > 1)).to(device))
        return edited


@torch.no_grad()
def wander(splats: SplatTensors, rate: float, rng: np.random.Generator) -> None:
    """Move the centres, in place, by Σ η gate(o) · rate with η ~ N(0, I) drawn anew for each
    Gaussian that may move at all."""
    logits = splats.logit_opacities.detach().cpu().numpy().astype(np.float64)
    opacities = 1 / (1 + np.exp(-np.clip(logits, -60, 60)))
    gates = 1 / (1 + np.exp(np.clip(GATE_STEEPNESS * (opacities - MIN_OPACITY), -60, 60)))
    moving = np.flatnonzero(gates > 1e-4)
    if not len(moving) or not rate > 0:
        return
    index = torch.from_numpy(moving).to(splats.means.device)
    quats, log_scales = (tensor.detach()[index].cpu().numpy().astype(np.float64) for tensor in (splats.quats, splats.log_scales))
    variances = np.exp(np.clip(2 * log_scales, -60, 60))
    noise = rotate(quats, variances * rotate(quats * [1, -1, -1, -1], rng.standard_normal((len(moving), 3))))
    steps = noise * (gates[moving] * rate)[:, None]
    # A centre never wanders farther than its own longest axis in one go.
    limits = np.sqrt(variances.max(axis=1))
    lengths = np.linalg.norm(steps, axis=1)
    steps *= np.minimum(1, limits / np.maximum(lengths, 1e-300))[:, None]
    splats.means[index] += torch.from_numpy(steps).to(splats.means)
