"""Fits Gaussians to views by Adam on the rendering loss (Kerbl 2023). The same loop trains devices and retrains edges.

Once per model; the loop body once per step: render one view, loss, backward, one Adam step over the Gaussians it saw, or over all
(`config.adam`), and the policy of densification where its schedule says so. Every schedule follows `Training.progress`, the share of
the steps or of the time that is spent. All that changes from step to step is in `Training.state`, so that a run can be stopped after
any step and go on elsewhere with the same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from radiant_core.errors import BadInput, StageFailed
from radiant_core.render.contract import Backend, SplatTensors
from radiant_core.render.rasterize import device_of, rasterize, resolve_backend
from radiant_core.splats import SH_BASES, Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.density import DensityCounts
from radiant_core.train.exposure import Exposures
from radiant_core.train.held import HeldRows
from radiant_core.train.initialize import camera_extent
from radiant_core.train.native_loss import STATISTICS_BUDGET_BYTES, StatisticsCache, target_loss
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.policy import density_policy
from radiant_core.train.shapes import ShapeCounts, limit_shapes, without_dead
from radiant_core.train.validation import BestModel
from radiant_core.train.views import TrainingViews

STEPS_BETWEEN_LIMITS = 50
"""How often sizes are held below their limit; it follows centres that move slowly."""
MIN_STEADY_STEPS = 700
"""A run of fewer steps keeps its rates to the end, however few its photographs."""
MIN_SETTLED_SHARE = 0.1
"""The rates of no run fall below this share; longer ones were not measured."""
MAX_FAILURES = 20
"""Steps in a row that may end in something not finite before training gives up."""


@dataclass(frozen=True, kw_only=True)
class Steps:
    """What may move and how fast, as factors of the configuration's learning rates; 0 keeps a tensor as it is."""

    means: float = 1.0
    quats: float = 1.0
    log_scales: float = 1.0
    logit_opacities: float = 1.0
    sh0: float = 1.0
    shN: float = 1.0
    end: float = 1.0
    """Share of these rates to which they fall over the run, exponentially, in a long one by `settled` as well; the centres' fall by
    `means_lr_end` alone."""


@dataclass(frozen=True, kw_only=True)
class TrainProgress:
    """Told to the caller now and then."""

    step: int
    num_steps: int
    """Estimated from the steps so far where time is the budget."""
    loss: float
    """Mean loss since the last report."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainState:
    """All that changes in a run from step to step: arrays by name, and numbers that JSON holds."""

    arrays: dict[str, NDArray[Any]]
    numbers: dict[str, Any]


class Checkpoints(Protocol):
    """Where a run keeps its state against an interruption."""

    def load(self) -> TrainState | None:
        """The last state that was saved whole; None where there is none."""
        ...

    def offer(self, step: int, state: Callable[[], TrainState]) -> None:
        """Called after each step: save `state()` where one is due."""
        ...


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
    shapes: ShapeCounts = field(default_factory=ShapeCounts)
    """What was held at a limit of shape in the end, and what was left out since no pixel shows it."""
    num_rolled_back: int = 0
    """Steps that ended in something not finite and were not taken."""
    validation: tuple[tuple[int, float], ...] = ()
    """Step and mean PSNR in dB of the validation views, each time they were looked at."""
    best_step: int | None = None
    """Step of the model that is returned, the best by validation; None: the last one."""
    max_exposure: float = 0.0
    """Largest change of a channel's gain by an exposure that was learnt, as a share; 0 without them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FitOptions:
    """How `fit_splats` reports and renders; apart from the learning rates."""

    steps: Steps = Steps()
    backend: Backend = "auto"
    report: Callable[[TrainProgress], None] = lambda progress: None
    report_every_s: float = 1.0
    clock: Callable[[], float] = time.monotonic
    validation: TrainingViews | None = None
    """Views that only choose which model is returned; None returns the last one."""
    checkpoints: Checkpoints | None = None
    statistics_bytes: int = STATISTICS_BUDGET_BYTES
    """Memory for what the loss keeps of its targets."""
    held: NDArray[np.bool_] | None = None
    """Gaussians (N,) that are rendered and keep their bits; only without densification."""


def fit_splats(initial: Splats, views: TrainingViews, config: TrainConfig, options: FitOptions = FitOptions()) -> TrainResult:
    """Fit a copy of `initial` to `views` in `config.num_steps` steps or `config.budget_s` seconds, what ends first.

    Raises StageFailed when steps in a row end in something not finite, with the reason; BadInput from the renderer for inputs that are not.
    """
    training = Training(initial, views, config, options)
    if options.checkpoints is not None and (state := options.checkpoints.load()) is not None:
        training.restore(state)
    while not training.is_done:
        training.take_step()
        if options.checkpoints is not None:
            options.checkpoints.offer(training.step, training.state)
    return training.result()


class Training:
    """One run of training, step by step."""

    def __init__(self, initial: Splats, views: TrainingViews, config: TrainConfig, options: FitOptions) -> None:
        self._config, self._options = config, options
        self._full, self._views = views, views
        self._device = device_of(resolve_backend(options.backend))
        self._extent = camera_extent(views.cameras)
        self._splats = SplatTensors.from_splats(initial, device=self._device)
        self._optimizer, self._rates = self._new_optimizer()
        self._density = density_policy(config, self._extent, self._splats)
        if options.held is not None and config.densify != "none":
            raise BadInput(f"Gaussians are held while densify is {config.densify!r}: rows change places then, set densify to 'none'.")
        self._held = None if options.held is None else HeldRows(self._splats, options.held)
        self._exposures = Exposures(len(views), config.exposure_lr, self._device) if config.exposure == "affine" else None
        self._best = None if options.validation is None else BestModel(options.validation, config.num_looks)
        self._losses: list[float] = []
        self._num_rolled_back = self._failures_in_a_row = 0
        self._spent_s = 0.0
        self._begun_s = self._reported_s = options.clock()
        self._num_reported = 0
        self.step = 0
        self._use_size(config.start_scale if config.start_scale < 1 else 1.0)

    @property
    def seconds(self) -> float:
        """How long this run has taken, interruptions left out."""
        return self._spent_s + self._options.clock() - self._begun_s

    @property
    def progress(self) -> float:
        """The share of the steps, or of the time where that is larger, that is spent."""
        share = self.step / self._config.num_steps
        return share if self._config.budget_s is None else max(share, self.seconds / self._config.budget_s)

    @property
    def is_done(self) -> bool:
        """Whether steps or time are spent."""
        return self.progress >= 1

    def take_step(self) -> None:
        """Take the next step; one that ends in something not finite leaves the model as it was and is counted."""
        config, progress = self._config, self.progress
        if self._scale < 1 and progress >= config.full_size_from:
            self._use_size(1.0)
        view = view_of_step(self.step, len(self._full), config.seed)
        if self.step % STEPS_BETWEEN_LIMITS == 0:
            self._limit_shapes()
        factor = self._options.steps.end**progress * settled(self.step, progress, len(self._full), config.settle_epochs)
        for name, rate in self._rates.items():
            self._optimizer.set_rate(name, rate * (config.means_lr_end**progress if name == "means" else factor))
        try:
            loss = self._fit_view(view, progress)
        except StageFailed as error:
            self._roll_back(str(error))
        else:
            self._failures_in_a_row = 0
            self._losses.append(loss)
            if self._density is not None:
                self._splats = self._density.after_step(self.step + 1, self._schedule_step(), self._splats, self._optimizer)
        self.step += 1
        if self._best is not None and self._best.is_due(self.progress):
            self._best.look(self.step, self._splats, self._options.backend)
        self._tell()

    def result(self) -> TrainResult:
        """The model, the best by validation where there is one, and what the run took. StageFailed when no step could be taken."""
        if not self._losses:
            raise StageFailed(f"training: none of {self.step} steps could be taken: check the photographs and the learning rates.")
        shapes = self._limit_shapes()
        best = self._best
        splats = self._splats.to_splats() if best is None or best.splats is None else best.splats
        if self._config.densify != "none":
            splats, num_dead = without_dead(splats)
            shapes = replace(shapes, num_dead=num_dead)
        tenth = max(1, len(self._losses) // 10)
        return TrainResult(
            splats=splats,
            num_steps=self.step,
            first_loss=float(np.mean(self._losses[:tenth])),
            last_loss=float(np.mean(self._losses[-tenth:])),
            seconds=self.seconds,
            density=DensityCounts() if self._density is None else self._density.counts,
            shapes=shapes,
            num_rolled_back=self._num_rolled_back,
            validation=() if best is None else tuple(best.looks),
            best_step=None if best is None else best.step,
            max_exposure=0.0 if self._exposures is None else self._exposures.largest_change,
        )

    def state(self) -> TrainState:
        """A copy of all that changes from step to step."""
        arrays = {f"splats.{name}": tensor.detach().cpu().numpy().copy() for name, tensor in self._splats.tensors().items()}
        arrays |= {f"adam.{name}": array for name, array in self._optimizer.state_arrays().items()}
        arrays["losses"] = np.array(self._losses, np.float64)
        numbers: dict[str, Any] = {
            "step": self.step,
            "seconds": self.seconds,
            "num_rolled_back": self._num_rolled_back,
            "failures_in_a_row": self._failures_in_a_row,
            "adam_step": self._optimizer.num_steps,
        }
        if self._density is not None:
            arrays |= {f"density.{name}": array for name, array in self._density.state_arrays().items()}
            numbers["density"] = asdict(self._density.counts)
        if self._exposures is not None:
            arrays |= {f"exposure.{name}": array for name, array in self._exposures.state_arrays().items()}
        if self._best is not None:
            arrays |= {f"best.{name}": array for name, array in self._best.state_arrays().items()}
            numbers["best"] = {"step": self._best.step, "looks": [list(look) for look in self._best.looks]}
        return TrainState(arrays=arrays, numbers=numbers)

    def restore(self, state: TrainState) -> None:
        """Go on from `state`, of a run of the same inputs and configuration; BadInput where it is of another."""
        arrays, numbers = state.arrays, state.numbers
        try:
            own = {name: torch.from_numpy(arrays[f"splats.{name}"].copy()).to(self._device) for name in self._splats.tensors()}
            self._splats = replace(self._splats, **own)
            self._optimizer, self._rates = self._new_optimizer()
            self._optimizer.restore(_part(arrays, "adam."), int(numbers["adam_step"]))
            if self._density is not None:
                self._density.restore(_part(arrays, "density."), DensityCounts(**numbers["density"]), self._splats)
            if self._exposures is not None:
                self._exposures.restore(_part(arrays, "exposure."))
            if self._best is not None:
                looks = [(int(step), float(psnr_db)) for step, psnr_db in numbers["best"]["looks"]]
                self._best.restore(_part(arrays, "best."), numbers["best"]["step"], looks, antialiased=self._splats.antialiased)
            self._losses = arrays["losses"].tolist()
            self.step, self._spent_s = int(numbers["step"]), float(numbers["seconds"])
            self._num_rolled_back, self._failures_in_a_row = int(numbers["num_rolled_back"]), int(numbers["failures_in_a_row"])
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"the state is of another run ({error}): remove the checkpoint and train from the start.") from error
        self._begun_s = self._reported_s = self._options.clock()
        self._num_reported = len(self._losses)
        self._use_size(self._config.start_scale if self.progress < self._config.full_size_from else 1.0)

    def _new_optimizer(self) -> tuple[SelectiveAdam, dict[str, float]]:
        return _optimizer(self._splats, self._extent, self._config, self._options.steps)

    def _use_size(self, scale: float) -> None:
        self._scale = scale
        self._views = self._full if scale == 1 else self._full.scaled(scale)
        cameras = self._views.cameras
        self._viewmats, self._Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
        self._statistics = StatisticsCache(self._options.statistics_bytes)

    def _schedule_step(self, steps_ahead: int = 1) -> float:
        """Where the schedules that are given in steps of a full run stand after the present step."""
        share = (self.step + steps_ahead) / self._config.num_steps
        if self._config.budget_s is not None:
            share = max(share, self.seconds / self._config.budget_s)
        return round(share * self._config.schedule_steps, 6)

    def _fit_view(self, view: int, progress: float) -> float:
        """Render, compare, step; returns the loss. Raises StageFailed, with nothing changed, for something not finite."""
        config = self._config
        target = self._statistics.get(view, lambda: _target(self._views, view))
        height, width = target.target.shape[:2]
        camera = self._viewmats[view : view + 1], self._Ks[view : view + 1]
        output = rasterize(
            self._splats,
            *camera,
            width,
            height,
            sh_degree=self._sh_degree(),
            background=_background(self.step, config),
            absgrad=self._density is not None and self._density.wants_absgrad(self._schedule_step()),
            backend=self._options.backend,
        )
        image = output.images.view(height, width, 3)
        if self._exposures is not None:
            image = self._exposures.applied(view, image)
        weights = _weights(self._views, view)
        try:
            loss = target_loss(unseen_agrees(image, target.target, weights), target, weights, config.ssim_weight)
        except BadInput as error:
            raise StageFailed(str(error)) from error
        value = float(loss.detach())
        if not np.isfinite(value):
            raise StageFailed(f"the loss became {value}")
        if loss.requires_grad:
            self._optimizer.zero_grad()
            if self._density is not None:
                self._density.watch(self._schedule_step(), output, (width, height))
            loss.backward()
            if self._density is not None:
                self._density.before_step(self._splats)
            if self._exposures is not None:
                self._exposures.require_finite()
            self._optimizer.step(output.visible if config.adam == "visible" else None)
            self._put_back_held()
            if self._exposures is not None:
                self._exposures.step(view, progress)
        return value

    def _limit_shapes(self) -> ShapeCounts:
        counts = limit_shapes(self._splats, self._full.cameras.centers, self._config)
        self._put_back_held()
        return counts

    def _put_back_held(self) -> None:
        if self._held is not None:
            self._held.put_back(self._splats)

    def _sh_degree(self) -> int:
        config = self._config
        allowed = int(self._schedule_step() // config.sh_degree_every) if config.sh_degree_every else config.sh_degree
        return min(config.sh_degree, SH_BASES.index(self._splats.shN.shape[1] + 1), allowed)

    def _roll_back(self, reason: str) -> None:
        # Neither Adam nor the exposures have written anything: what was not finite is refused before.
        self._num_rolled_back += 1
        self._failures_in_a_row += 1
        if self._failures_in_a_row > MAX_FAILURES:
            raise StageFailed(
                f"training: {MAX_FAILURES} steps in a row could not be taken, the last at step {self.step + 1}: {reason}; "
                "lower the learning rates or check the photographs."
            )

    def _tell(self) -> None:
        now_s = self._options.clock()
        losses = self._losses[self._num_reported :]
        if losses and (now_s - self._reported_s >= self._options.report_every_s or self.is_done):
            num_steps = max(self.step, min(self._config.num_steps, round(self.step / max(self.progress, 1e-9))))
            self._options.report(TrainProgress(step=self.step, num_steps=num_steps, loss=float(np.mean(losses))))
            self._reported_s, self._num_reported = now_s, len(self._losses)


def settled(step: int, progress: float, num_views: int, settle_epochs: int | None) -> float:
    """The share of its rates, 0.1 to 1, that a run of N steps still has at step p N: T / (p² N).

    T is `settle_epochs` steps per view, at least `MIN_STEADY_STEPS`, so that rates fall from step √(T N) on: with few views 1,500 steps end
    with 0.47 of them, 6,000 with 0.12. N is what the steps so far and their share of the run, `progress`, make of it, so that a budget of
    time needs no forecast.
    """
    if settle_epochs is None or step <= 0 or progress <= 0:
        return 1.0
    return min(1.0, max(MIN_SETTLED_SHARE, max(MIN_STEADY_STEPS, settle_epochs * num_views) / (step * min(1.0, progress))))


def view_of_step(step: int, num_views: int, seed: int) -> int:
    """Which view step number `step` (from 0) fits: every view once per epoch, each epoch in a new order."""
    epoch, place = divmod(step, num_views)
    return int(np.random.default_rng((seed, epoch)).permutation(num_views)[place])


def _background(step: int, config: TrainConfig) -> Tensor | None:
    """Linear colour (3,) behind the Gaussians at a step (from 0); None for black."""
    if config.background == "black":
        return None
    return torch.from_numpy(np.random.default_rng((config.seed, step, 1)).random(3, np.float32))


def _part(arrays: dict[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def _optimizer(splats: SplatTensors, extent: float, config: TrainConfig, steps: Steps) -> tuple[SelectiveAdam, dict[str, float]]:
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
    return SelectiveAdam(tensors, moving), moving


def _target(views: TrainingViews, view: int) -> Tensor:
    return torch.from_numpy(views.images[view].astype(np.float32) / 255)


def unseen_agrees(image: Tensor, target: Tensor, weights: Tensor | None) -> Tensor:
    """The image, and the target where a weight is 0: else SSIM's window would carry what is masked into the pixels beside it."""
    if weights is None or weights.all():
        return image
    return torch.where((weights > 0).to(image.device)[..., None], image, target.to(image))


def _weights(views: TrainingViews, view: int) -> Tensor | None:
    return None if views.weights is None else torch.from_numpy(views.weights[view].astype(np.float32) / 255)
