"""F3DGS-style: federated averaging of Gaussians whose places are frozen, weighted by visibility.

Once, at the server: a scaffold of Gaussians, whose means no one moves. Per round and client k:
    1  local steps of Adam on all but the means: quats, scales, opacities, colours
       (1 − λ) L1 + λ (1 − SSIM), one photograph a step
    2  up: these attributes and v_k (N,), the steps that showed each Gaussian
then at the server, Gaussian by Gaussian
    θ = Σ_k v_k θ_k / Σ_k v_k,       the server's own where nobody saw it

What differs from the publication (Zhu 2026, arXiv 2604.01605), and why:
- The scaffold is first Gaussians from the points of structure from motion; theirs are merged clouds
  of laser scanners, which no drone of ours has.
- Quaternions are averaged after each is turned to the server's half of the sphere, and made 1 long.
- Learning rates are those of this project's training, without its schedule.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_core.errors import BadInput, StageFailed
from radiant_core.numerics import unit_quats
from radiant_core.render.backends import device_of, resolve_backend
from radiant_core.render.contract import SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.native_loss import StatisticsCache, target_loss
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.results import TrainProgress
from radiant_core.train.trainer import FitOptions
from radiant_core.train.view_loss import view_of_step
from radiant_core.train.views import TrainingViews

ATTRIBUTES = ("quats", "log_scales", "logit_opacities", "sh0", "shN")
"""What a client fits and sends; the means stay."""
BYTES_A_NUMBER = 4
SHN_RATE_SHARE = 1 / 20


@dataclass(frozen=True, kw_only=True)
class F3dgsConfig:
    """Rounds and the local steps of each."""

    num_rounds: int = 5
    num_steps: int = 100
    """Of a client in a round."""

    def __post_init__(self) -> None:
        if min(self.num_rounds, self.num_steps) < 1:
            raise BadInput(f"F3DGS was given {self}: expected at least one round and one step.")


@dataclass(frozen=True, kw_only=True, eq=False)
class F3dgsResult:
    """The server's model and what went up to it."""

    splats: Splats
    sent_bytes_a_round: int
    """Of all clients together, up."""
    num_rounds: int
    num_training_pixels: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Local:
    """What a client sends after a round."""

    splats: Splats
    visible_steps: NDArray[np.int64]
    """(N,) how many of its steps showed each Gaussian."""
    num_pixels: int


def f3dgs(
    scaffold: Splats,
    clients: Sequence[TrainingViews],
    train: TrainConfig,
    config: F3dgsConfig,
    options: FitOptions,
    after_round: Callable[[int, Splats], None] = lambda number, splats: None,
) -> F3dgsResult:
    """Fit the scaffold's attributes round by round; `after_round` sees the server's model.

    BadInput without a client or a Gaussian, StageFailed where a client's loss is not finite.
    """
    if not clients or not len(scaffold):
        raise BadInput(f"F3DGS was given {len(clients)} clients and {len(scaffold)} Gaussians: give at least one of each.")
    server, pixels = scaffold, 0
    for number in range(config.num_rounds):
        sent = [fit_attributes(server, views, train, config.num_steps, number, options) for views in clients]
        server = average_attributes(server, sent)
        pixels += sum(local.num_pixels for local in sent)
        after_round(number, server)
    sent_numbers = sum(np.asarray(getattr(server, name)).size for name in ATTRIBUTES) + len(server)
    return F3dgsResult(
        splats=server,
        sent_bytes_a_round=len(clients) * BYTES_A_NUMBER * sent_numbers,
        num_rounds=config.num_rounds,
        num_training_pixels=pixels,
    )


def fit_attributes(server: Splats, views: TrainingViews, train: TrainConfig, num_steps: int, number: int, options: FitOptions) -> Local:
    """A client's round: all attributes but the means, fitted to its photographs."""
    device = device_of(resolve_backend(options.backend))
    splats = SplatTensors.from_splats(server, device=device)
    rates = {
        "quats": train.quats_lr,
        "log_scales": train.scales_lr,
        "logit_opacities": train.opacities_lr,
        "sh0": train.sh0_lr,
        "shN": train.sh0_lr * SHN_RATE_SHARE,
    }
    named = {name: tensor for name, tensor in splats.tensors().items() if name in ATTRIBUTES and tensor.numel()}
    adam = SelectiveAdam(named, rates)
    poses, Ks = torch.tensor(views.cameras.cam_from_world), torch.tensor(views.cameras.Ks)
    statistics = StatisticsCache(options.statistics_bytes, device)
    visible, pixels = np.zeros(len(server), np.int64), 0
    for step in range(num_steps):
        view = view_of_step(number * num_steps + step, len(views), train.seed)
        target = statistics.get(view, lambda view=view: torch.from_numpy(views.images[view].astype(np.float32) / 255))
        height, width = target.target.shape[:2]
        one = slice(view, view + 1)
        output = rasterize(splats, poses[one], Ks[one], width, height, sh_degree=server.sh_degree, backend=options.backend)
        loss = target_loss(output.images.view(height, width, 3), target, None, train.ssim_weight)
        if not bool(torch.isfinite(loss)):
            raise StageFailed(f"a client's loss is {float(loss)} at step {step}: its photographs or the scaffold are not usable.")
        adam.zero_grad()
        loss.backward()
        adam.step(output.visible)
        visible += output.visible.cpu().numpy()
        pixels += height * width
        if step + 1 == num_steps:
            options.report(TrainProgress(step=num_steps, num_steps=num_steps, loss=float(loss.detach())))
    return Local(splats=splats.to_splats(), visible_steps=visible, num_pixels=pixels)


def average_attributes(server: Splats, sent: Sequence[Local]) -> Splats:
    """The clients' attributes weighted by visibility; the means, and what nobody saw, are the
    server's."""
    weights = np.stack([local.visible_steps for local in sent]).astype(np.float64)
    total = weights.sum(axis=0)
    has_weight = total > 0
    shares = weights / np.where(has_weight, total, 1)
    arrays = server.arrays()
    for name in ATTRIBUTES:
        old = arrays[name]
        rows = (-1,) + (1,) * (old.ndim - 1)
        values = [local.splats.arrays()[name].astype(np.float64) for local in sent]
        if name == "quats":
            values = [_turned_alike(unit_quats(value), unit_quats(old)) for value in values]
        mean = sum(share.reshape(rows) * value for share, value in zip(shares, values, strict=True))
        if name == "quats":
            mean = unit_quats(mean)
        arrays[name] = np.where(has_weight.reshape(rows), mean, old).astype(np.float32)
    return Splats(**arrays, antialiased=server.antialiased)


def _turned_alike(quats: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    """q or −q (N,4), the same rotation, whichever is nearer to the reference."""
    return np.where((quats * reference).sum(axis=1, keepdims=True) < 0, -quats, quats)
