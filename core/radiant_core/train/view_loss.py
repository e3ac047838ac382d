"""The loss of a model in one view at a time, with its gradients. Once per view and step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from radiant_core.errors import BadInput, StageFailed
from radiant_core.render.backends import device_of, resolve_backend
from radiant_core.render.contract import Backend, RenderOutput, SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import SH_BASES
from radiant_core.train.config import TrainConfig
from radiant_core.train.native_loss import StatisticsCache, target_loss
from radiant_core.train.parts import Moment, Part
from radiant_core.train.views import TrainingViews

Watch = Callable[[Moment, RenderOutput], None]
"""Looks at a rendering before its backward pass."""
ImageLoss = Callable[[Tensor, Tensor], Tensor]
"""Render and photograph (H,W,3), 0 to 1, masked pixels alike in both → their loss, a scalar."""


class ViewLoss:
    """Renders a model at views and takes the gradients of the loss there."""

    def __init__(
        self, views: TrainingViews, config: TrainConfig, backend: Backend, statistics_bytes: int, loss: ImageLoss | None = None
    ) -> None:
        """`statistics_bytes`: memory for what the loss keeps of its targets. `loss` replaces the
        weighted L1 and SSIM."""
        self._full, self._config, self._statistics_bytes = views, config, statistics_bytes
        self._loss = loss
        self._backend: Backend = backend
        self._device = device_of(resolve_backend(backend))
        self.use_size(config.start_scale)

    def use_size(self, scale: float) -> None:
        """Compare views at that share of their size from now on."""
        self.scale = scale
        self._views = self._full if scale == 1 else self._full.scaled(scale)
        cameras = self._views.cameras
        self._viewmats, self._Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
        self._statistics = StatisticsCache(self._statistics_bytes, self._device)

    def backward(self, splats: SplatTensors, moment: Moment, parts: Sequence[Part], watch: Watch) -> tuple[float, Tensor | None]:
        """Add the gradients of the view of `moment` to those of `splats`.

        Args:
            splats: the model.
            moment: view, number and schedule of the step.
            parts: may change the model before it is rendered.
            watch: looks at the rendering before the backward pass.

        Returns:
            The loss, and which Gaussians (N,) the view shows; None where nothing has a gradient.

        Raises:
            StageFailed: the loss is not finite; no gradient was added.
        """
        config, view = self._config, moment.view
        target = self._statistics.get(view, lambda: _target(self._views, view, self._device))
        height, width = target.target.shape[:2]
        rendered = splats
        for part in parts:
            rendered = part.before_render(moment, rendered)
        output = rasterize(
            rendered,
            self._viewmats[view : view + 1],
            self._Ks[view : view + 1],
            width,
            height,
            sh_degree=sh_degree_at(moment, splats, config),
            background=_background(moment.step - 1, config),
            absgrad=any(part.wants_absgrad(moment) for part in parts),
            weights=any(part.wants_weights(moment) for part in parts),
            backend=self._backend,
        )
        image = output.images.view(height, width, 3)
        weights = _weights(self._views, view)
        try:
            image = match_masked(image, target.target, weights)
            if self._loss is None:
                loss = target_loss(image, target, weights, config.ssim_weight)
            else:
                loss = _checked(self._loss(image, target.target), image)
        except BadInput as error:
            raise StageFailed(str(error)) from error
        value = float(loss.detach())
        if not np.isfinite(value):
            raise StageFailed(f"the loss became {value}")
        if not loss.requires_grad:
            return value, None
        watch(moment, output)
        loss.backward()
        return value, output.visible


def _checked(loss: object, image: Tensor) -> Tensor:
    """A loss by a function of others; not BadInput, which the caller takes for a step to undo."""
    if not isinstance(loss, Tensor) or loss.ndim or (image.requires_grad and not loss.requires_grad):
        found = f"a tensor of shape {tuple(loss.shape)}" if isinstance(loss, Tensor) else type(loss).__name__
        found += " without a gradient" if isinstance(loss, Tensor) and not loss.ndim else ""
        raise TypeError(f"the loss function returned {found}, expected a scalar tensor computed by torch from the render.")
    return loss


def sh_degree_at(moment: Moment, splats: SplatTensors, config: TrainConfig) -> int:
    """Up to which degree harmonics are rendered at a moment."""
    allowed = int(moment.schedule_step // config.sh_degree_every) if config.sh_degree_every else config.sh_degree
    return min(config.sh_degree, SH_BASES.index(splats.shN.shape[1] + 1), allowed)


def view_of_step(step: int, num_views: int, seed: int) -> int:
    """View of step `step` (from 0): every view once per epoch, each epoch in a new order."""
    epoch, place = divmod(step, num_views)
    return _order_of_epoch(epoch, num_views, seed)[place]


@lru_cache(maxsize=4)
def _order_of_epoch(epoch: int, num_views: int, seed: int) -> list[int]:
    return np.random.default_rng((seed, epoch)).permutation(num_views).tolist()


def _background(step: int, config: TrainConfig) -> Tensor | None:
    """Linear colour (3,) behind the Gaussians at a step (from 0); None for black."""
    if config.background == "black":
        return None
    return torch.from_numpy(np.random.default_rng((config.seed, step, 1)).random(3, np.float32))


def _target(views: TrainingViews, view: int, device: str) -> Tensor:
    if device == "cpu":  # by numpy: see `render/finite.py`
        return torch.from_numpy(np.divide(views.images[view], np.float32(255)))
    # As bytes to the GPU, a quarter of the way's load.
    return torch.tensor(views.images[view], device=device).float() / 255


def match_masked(image: Tensor, target: Tensor, weights: Tensor | None) -> Tensor:
    """The image with the target's pixels at weight 0, else SSIM's window carries masked errors."""
    if weights is None or weights.all():
        return image
    return torch.where((weights > 0).to(image.device)[..., None], image, target.to(image))


def _weights(views: TrainingViews, view: int) -> Tensor | None:
    return None if views.weights is None else torch.from_numpy(views.weights[view].astype(np.float32) / 255)
