"""The best model of a run by views that nothing is fitted to, rendered in its second half.

The last model is not always the best: a device with few photographs overfits them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_core.evaluate.image_error import psnr_db
from radiant_core.io.photos.masks import used_pixels
from radiant_core.render.contract import Backend, SplatTensors
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.thinning import LATEST
from radiant_core.train.mean_model import MeanModel
from radiant_core.train.parts import Part
from radiant_core.train.results import TrainResult
from radiant_core.train.views import TrainingViews

FIRST_LOOK, FIRST_THINNED = 0.5, LATEST
"""Shares of the run before which no model is the best: densification, or thinning, is still at
work."""


def first_look(config: TrainConfig) -> float:
    """The share of the run before which no model of a configuration is the best."""
    thin_to = getattr(config.density, "thin_to", 1.0)
    return FIRST_LOOK if thin_to in ("auto", 1.0) else FIRST_THINNED


def validation_psnr_db(splats: Splats, views: TrainingViews, backend: Backend) -> float:
    """Mean PSNR in dB of a model over views, of the pixels that count."""
    used = [None] * len(views) if views.weights is None else [used_pixels(weights) for weights in views.weights]
    triples = zip(render_views(splats, views.cameras, backend), views.images, used, strict=True)
    return float(np.mean([psnr_db(view.image, image / 255, used) for view, image, used in triples if used is None or used.any()]))


class BestModel(Part):
    """The best of `num_looks` models, one each at even shares of what is left of a run after growth
    and thinning, the last one the mean of the last steps; `looks` are steps and their PSNR in dB.
    """

    name = "best"

    def __init__(
        self, views: TrainingViews, num_looks: int, backend: Backend, first_look: float = FIRST_LOOK, mean: MeanModel | None = None
    ) -> None:
        """The first of `num_looks` comes after this share of the run; `mean`: a part before this
        one, None where the last model counts."""
        self._first_look, self._mean = first_look, mean
        self._views, self._num_looks = views, num_looks
        self._backend: Backend = backend
        self.looks: list[tuple[int, float]] = []
        self.splats: Splats | None = None
        self.step: int | None = None

    def is_due(self, progress: float) -> bool:
        """Whether the model is to be scored at this share of the run."""
        num_done = len(self.looks)
        return num_done < self._num_looks and progress >= 1 - (1 - self._first_look) * (1 - (num_done + 1) / self._num_looks)

    def after_step(self, step: int, progress: float, splats: SplatTensors) -> None:
        """Score the model where a look is due, and keep it if it is the best so far."""
        if not self.is_due(progress):
            return
        # A budget of time may end a run before this is seen: then its last look was of a model.
        model = (splats if self._mean is None or progress < 1 else self._mean.last(splats)).to_splats()
        figure = validation_psnr_db(model, self._views, self._backend)
        if not self.looks or figure > max(value for _, value in self.looks):
            self.splats, self.step = model, step
        self.looks.append((step, figure))

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """The best model so far; empty without one."""
        return {} if self.splats is None else {name: array.copy() for name, array in self.splats.arrays().items()}

    def state_numbers(self) -> dict[str, Any]:
        """Step of the best model, and all looks."""
        return {"step": self.step, "looks": [list(look) for look in self.looks]}

    def restore(self, arrays: dict[str, NDArray[Any]], numbers: Any, splats: SplatTensors) -> None:
        """Go on from the best model so far and all looks."""
        self.splats = Splats(**arrays, antialiased=splats.antialiased) if arrays else None
        self.step, self.looks = numbers["step"], [(int(step), float(psnr_db)) for step, psnr_db in numbers["looks"]]

    def finish(self, result: TrainResult) -> TrainResult:
        """The result with the best model in place of the last one."""
        best = result.splats if self.splats is None else self.splats
        return replace(result, splats=best, validation=tuple(self.looks), best_step=self.step)
