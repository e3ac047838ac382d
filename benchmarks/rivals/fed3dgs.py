"""Fed3DGS (Suzuki 2024): a server takes in one client after another and trains opacities alone.

Per client, with G the global model, L the client's, ε the median squared distance of a Gaussian of
L to its nearest neighbour in L:
    1  G' = Gaussians of G in the client's frusta: |ndc| ≤ 1.3, 0 < z < far
    2  targets: V renders of L at the client's cameras and V of G at cameras known before,
       drawn as ∝ how many of L they see
    3  opacity ≤ 0.005 for all of L, and for those of G' with one of L within ε
    4  5 epochs, Adam 0.05, on the opacities of L and G':  0.8 L1 + 0.2 (1 − SSIM), and
       1e-2 · mean H(o) from the second epoch on
    5  those of L and G' with opacity ≤ 0.005 are dropped
    H(o) = −o ln o − (1 − o) ln(1 − o)

Once per client; one picture a step. What differs from the publication, and why:
- It refuses a client that shares fewer than 20 image names with the server, and so every disjoint
  set of photographs, the paper's setting. Here G' must have `min_overlap` of the client's size: a
  client that does not overlap yet waits for the others; one that never does is refused and named.
- 5 epochs of its 100 to 200 images are 1,000 to 2,000 steps. An opacity of 0.005 needs some 150
  steps of Adam to be seen again, which 5 epochs of a dozen images do not give: there are at least
  `min_num_steps`, and the entropy joins in after a fifth of them.
- Far is `far_factor` times the median depth of the client's own Gaussians in its frusta.
- G outside the frusta is drawn but fixed, so that the renders of G that are targets can be met.
- Its appearance model (hash grid and image vectors → MLP → change of harmonics) is left out: the
  models that render the targets are free of exposures already, and a picture that was never taken
  has no image vector: here nothing is fitted to held-out photographs before they are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import KDTree
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from radiant_core.aggregate.synthetic_views import synthetic_views
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.render.backends import device_of, resolve_backend
from radiant_core.render.contract import Backend, SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import Splats, concatenate_splats
from radiant_core.train.native_loss import StatisticsCache, target_loss
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.results import TrainProgress
from radiant_core.train.trainer import FitOptions
from radiant_core.train.view_loss import view_of_step
from radiant_core.train.views import TrainingViews


@dataclass(frozen=True, kw_only=True)
class Fed3dgsConfig:
    """The server's numbers; the defaults are the published ones where there are any."""

    num_epochs: int = 5
    """How often each target is shown."""
    min_num_steps: int = 1_000
    """At least so many steps per client: 5 epochs of the smallest published client."""
    max_num_steps: int | None = None
    """At most so many steps per client, for comparisons at equal work; None for no limit."""
    opacities_lr: float = 0.05
    """Learning rate of the opacity logits."""
    ssim_weight: float = 0.2
    """λ of (1 − λ) L1 + λ (1 − SSIM)."""
    entropy_weight: float = 1e-2
    """Weight of the mean entropy of the trained opacities."""
    min_opacity: float = 0.005
    """Opacities begin at most here, and what does not rise above it is dropped."""
    ndc_limit: float = 1.3
    """A frustum reaches this far beyond the middle of the image, whose edge is 1."""
    far_factor: float = 5.0
    """Where frusta end, in median depths of the client's Gaussians."""
    min_overlap: float = 0.01
    """A client with fewer global Gaussians in its frusta, as a share of its own, has no overlap."""
    seed: int = 0
    """Seed of the drawn cameras and of the order of targets."""

    def __post_init__(self) -> None:
        counts = (self.num_epochs, self.min_num_steps, 1 if self.max_num_steps is None else self.max_num_steps)
        positive = (self.opacities_lr, self.ndc_limit, self.far_factor, self.min_overlap)
        if min(counts) < 1 or not all(0 < value < np.inf for value in positive):
            raise BadInput(f"Fed3DGS was given {self}: expected counts of at least 1, and rate, limits and overlap above 0.")
        if not (0 <= self.ssim_weight <= 1 and 0 <= self.entropy_weight < np.inf and 0 < self.min_opacity < 0.5):
            raise BadInput(f"Fed3DGS was given {self}: expected 0 ≤ ssim_weight ≤ 1, entropy_weight ≥ 0, 0 < min_opacity < 0.5.")

    def num_steps(self, num_views: int) -> int:
        """Steps for one client with so many targets."""
        steps = max(self.num_epochs * num_views, self.min_num_steps)
        return steps if self.max_num_steps is None else min(steps, self.max_num_steps)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fed3dgsResult:
    """The global model and what it took."""

    splats: Splats
    num_steps: int = 0
    num_training_pixels: int = 0
    """Σ over the steps of the pixels of their picture."""
    num_dropped: int = 0
    """Gaussians whose opacity did not rise."""
    merged: tuple[int, ...] = ()
    """Clients, by place in the input, in the order in which they were taken in."""
    refused: tuple[int, ...] = ()
    """Clients that never overlapped with the others."""


def fed3dgs(models: Sequence[Splats], cameras: Sequence[Cameras], config: Fed3dgsConfig, options: FitOptions) -> Fed3dgsResult:
    """Merge clients in order, each with its `cameras` (training size); one without overlap waits.

    BadInput when the counts differ, there is none, and for a client without Gaussians or cameras.
    """
    if len(models) != len(cameras) or not models:
        raise BadInput(f"{len(models)} models with {len(cameras)} sets of cameras: give one set per client, at least one.")
    for index, (model, client_cameras) in enumerate(zip(models, cameras, strict=True)):
        _require_client(model, client_cameras, f"client {index}")
    result, merged_cameras = Fed3dgsResult(splats=models[0], merged=(0,)), [cameras[0]]
    waiting = list(range(1, len(models)))
    while ready := [index for index in waiting if overlaps(result.splats, models[index], cameras[index], config)]:
        index = ready[0]
        waiting.remove(index)
        merged = fed3dgs_merge(result.splats, models[index], cameras[index], _number_cameras(merged_cameras), config, options)
        result = replace(
            merged,
            num_steps=result.num_steps + merged.num_steps,
            num_training_pixels=result.num_training_pixels + merged.num_training_pixels,
            num_dropped=result.num_dropped + merged.num_dropped,
            merged=(*result.merged, index),
        )
        merged_cameras.append(cameras[index])
    return replace(result, refused=tuple(waiting))


def fed3dgs_merge(
    global_model: Splats | None,
    local: Splats,
    local_cameras: Cameras,
    other_cameras: Cameras,
    config: Fed3dgsConfig,
    options: FitOptions,
) -> Fed3dgsResult:
    """Take one client into the global model, which the first one is; `other_cameras`: those before.

    BadInput for a client without Gaussians, cameras or overlap; StageFailed where a gradient is not
    finite.
    """
    _require_client(local, local_cameras, "the client")
    if global_model is None or not len(global_model):
        return Fed3dgsResult(splats=local)
    if not overlaps(global_model, local, local_cameras, config):
        raise BadInput("the client has no overlap with the global model: merge its neighbours first, or leave it out.")
    in_sight = _in_frusta(global_model, local_cameras, _far_m(local, local_cameras, config), config)
    views = _targets(global_model, local, local_cameras, other_cameras, config, options.backend)
    merged = concatenate_splats([global_model, local])
    trained = np.concatenate([in_sight, np.ones(len(local), bool)])
    faded = np.concatenate([in_sight & _near_local(global_model, local), np.ones(len(local), bool)])
    limit = np.float32(np.log(config.min_opacity / (1 - config.min_opacity)))
    logits = np.where(faded, np.minimum(merged.logit_opacities, limit), merged.logit_opacities)
    num_steps = config.num_steps(len(views))
    fitted = _fit_opacities(replace(merged, logit_opacities=logits), trained, views, config, num_steps, options)
    keep_mask = ~trained | (fitted.logit_opacities > limit)
    sizes = views.cameras.sizes_wh.prod(axis=1)
    return Fed3dgsResult(
        splats=fitted.select(keep_mask),
        num_steps=num_steps,
        num_training_pixels=sum(int(sizes[view_of_step(step, len(views), config.seed)]) for step in range(num_steps)),
        num_dropped=int((~keep_mask).sum()),
    )


def overlaps(global_model: Splats, local: Splats, local_cameras: Cameras, config: Fed3dgsConfig) -> bool:
    """Whether enough of the global model lies in the client's frusta for the two to be merged."""
    in_sight = _in_frusta(global_model, local_cameras, _far_m(local, local_cameras, config), config)
    return int(in_sight.sum()) >= max(1, config.min_overlap * len(local))


def _require_client(model: Splats, cameras: Cameras, name: str) -> None:
    if not len(model) or not len(cameras):
        raise BadInput(f"{name} has {len(model)} Gaussians and {len(cameras)} cameras: leave it out, or give at least one of either.")


def _in_frusta(model: Splats, cameras: Cameras, far_m: float, config: Fed3dgsConfig) -> NDArray[np.bool_]:
    """Which Gaussians (N,) have their centre in a frustum widened to the limit of ndc."""
    in_frusta = np.zeros(len(model), bool)
    for depths, ndc in (_project(model, cameras, index) for index in range(len(cameras))):
        in_frusta |= (depths > 0) & (depths < far_m) & (np.abs(ndc) <= config.ndc_limit).all(axis=1)
    return in_frusta


def _far_m(local: Splats, cameras: Cameras, config: Fed3dgsConfig) -> float:
    """Depth at which the client's frusta end; infinite where its cameras see no Gaussian of it."""
    depths = [z[(z > 0) & (np.abs(ndc) <= 1).all(axis=1)] for z, ndc in (_project(local, cameras, i) for i in range(len(cameras)))]
    in_front = np.concatenate(depths)
    return config.far_factor * float(np.median(in_front)) if len(in_front) else np.inf


def _project(model: Splats, cameras: Cameras, index: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Depths (N,) m and places (N,2) in the image of one camera, -1 to 1 from edge to edge."""
    pose, K = cameras.cam_from_world[index], cameras.Ks[index]
    in_camera = model.means.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    pixels = (in_camera @ K.T)[:, :2] / np.where(in_camera[:, 2] > 0, in_camera[:, 2], 1.0)[:, None]
    return in_camera[:, 2], 2 * pixels / cameras.sizes_wh[index] - 1


def _near_local(global_model: Splats, local: Splats) -> NDArray[np.bool_]:
    """Which global Gaussians (N,) have a local one within √ε; none for a lone local one."""
    if len(local) < 2:
        return np.zeros(len(global_model), bool)
    tree = KDTree(local.means.astype(np.float64))
    radius_m = float(np.sqrt(np.median(tree.query(local.means, k=2)[0][:, 1] ** 2)))
    return tree.query(global_model.means)[0] <= radius_m


def _targets(
    global_model: Splats, local: Splats, local_cameras: Cameras, other_cameras: Cameras, config: Fed3dgsConfig, backend: Backend
) -> TrainingViews:
    """V renders of the client and V of the global model at cameras drawn, with repeats, by how much
    of `local` they see; the client's alone where they see nothing of it."""
    rendered_locally = synthetic_views(local, local_cameras, backend)
    counts = np.array([other_cameras.select([index]).any_sees(local.means).sum() for index in range(len(other_cameras))], np.float64)
    if not counts.sum():
        return replace(rendered_locally, weights=None)
    rng = np.random.default_rng((config.seed, len(other_cameras)))
    rows = np.sort(rng.choice(len(counts), size=len(local_cameras), p=counts / counts.sum()))
    unique, first = np.unique(rows, return_inverse=True)
    rendered = synthetic_views(global_model, other_cameras.select(unique), backend)
    images = (*rendered_locally.images, *(rendered.images[index] for index in first))
    return TrainingViews(cameras=_number_cameras([local_cameras, *(other_cameras.select([index]) for index in rows)]), images=images)


def _number_cameras(parts: Sequence[Cameras]) -> Cameras:
    """All cameras of `parts` under numbers: a photograph may be shared, a camera drawn twice."""
    return Cameras(
        names=tuple(f"{number:06d}" for number in range(sum(map(len, parts)))),
        Ks=np.concatenate([part.Ks for part in parts]),
        cam_from_world=np.concatenate([part.cam_from_world for part in parts]),
        sizes_wh=np.concatenate([part.sizes_wh for part in parts]),
    )


def _fit_opacities(
    merged: Splats, trained: NDArray[np.bool_], views: TrainingViews, config: Fed3dgsConfig, num_steps: int, options: FitOptions
) -> Splats:
    """`merged` (N) with the opacities of the `trained` ones (N,) fitted to `views`."""
    device = device_of(resolve_backend(options.backend))
    splats = SplatTensors.from_splats(merged, device=device)
    rows = torch.from_numpy(trained).to(splats.means.device)
    optimizer = SelectiveAdam({"logit_opacities": splats.logit_opacities}, {"logit_opacities": config.opacities_lr})
    poses, Ks = torch.tensor(views.cameras.cam_from_world), torch.tensor(views.cameras.Ks)
    statistics = StatisticsCache(options.statistics_bytes, device)
    losses: list[float] = []
    reported_s = options.clock()
    for step in range(num_steps):
        view = view_of_step(step, len(views), config.seed)
        target = statistics.get(view, lambda view=view: torch.from_numpy(views.images[view].astype(np.float32) / 255))
        height, width = target.target.shape[:2]
        one = slice(view, view + 1)
        output = rasterize(splats, poses[one], Ks[one], width, height, sh_degree=merged.sh_degree, backend=options.backend)
        loss = target_loss(output.images.view(height, width, 3), target, None, config.ssim_weight)
        losses.append(float(loss.detach()))
        if config.entropy_weight and step * config.num_epochs >= num_steps:
            loss = loss + config.entropy_weight * _mean_entropy(splats.logit_opacities[rows])
        optimizer.zero_grad()
        loss.backward()
        # All that are trained, seen or not, as Adam without a mask moves them; the others stay.
        optimizer.step(rows)
        if options.clock() - reported_s >= options.report_every_s or step + 1 == num_steps:
            options.report(TrainProgress(step=step + 1, num_steps=num_steps, loss=float(np.mean(losses))))
            reported_s, losses = options.clock(), []
    return splats.to_splats()


def _mean_entropy(logits: Tensor) -> Tensor:
    """Mean of −o ln o − (1 − o) ln(1 − o) for o = sigmoid(logits)."""
    return binary_cross_entropy_with_logits(logits, torch.sigmoid(logits))
