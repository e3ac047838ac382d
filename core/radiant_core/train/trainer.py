"""Fits Gaussians to views by Adam on the rendering loss (Kerbl 2023), on devices and edges.

Once per model; the loop body once per step: render one view, loss, backward, one Adam step over the
Gaussians it saw, or over all (`config.adam`). Density control, validation and held Gaussians are
parts (`parts.py`). Every schedule follows `Training.progress`. All that changes is in
`Training.state`, so that a run can be stopped after any step and go on with the same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_core.errors import BadInput, StageFailed
from radiant_core.render.backends import device_of, resolve_backend
from radiant_core.render.contract import Backend, RenderOutput, SplatTensors
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.density import AdaptiveDensity
from radiant_core.train.densify.mcmc import RelocatedDensity
from radiant_core.train.densify.policies import Mcmc, NoDensification
from radiant_core.train.drop import DroppedGaussians
from radiant_core.train.extent import working_extent
from radiant_core.train.held import HeldRows
from radiant_core.train.mean_model import MeanModel
from radiant_core.train.memory import STATISTICS_BUDGET_BYTES
from radiant_core.train.optimizer import BETA1, SelectiveAdam
from radiant_core.train.parts import Moment, Part
from radiant_core.train.results import TrainProgress, TrainResult, TrainState
from radiant_core.train.shapes import ShapeCounts, limit_shapes, with_needle_width
from radiant_core.train.step_costs import StepCosts
from radiant_core.train.thin_surfaces import ThinSurfaces
from radiant_core.train.validation import BestModel, first_look
from radiant_core.train.view_loss import ImageLoss, ViewLoss, view_of_step
from radiant_core.train.views import TrainingViews

STEPS_BETWEEN_LIMITS = 50
"""How often the limits of shape are applied; centres move slowly."""
MIN_STEADY_STEPS = 700
"""A run of fewer steps keeps its rates to the end, however few photographs it has."""
MIN_SETTLED_SHARE = 0.1
"""The rates of no run fall below this share; longer ones were not measured."""
MAX_FAILURES = 20
"""Steps in a row that may end in something not finite before training gives up."""


@dataclass(frozen=True, kw_only=True)
class Steps:
    """Factors of the configuration's learning rates; 0 keeps a tensor as it is."""

    means: float = 1.0
    quats: float = 1.0
    log_scales: float = 1.0
    logit_opacities: float = 1.0
    sh0: float = 1.0
    shN: float = 1.0
    end: float = 1.0
    """Share of these rates to which they fall over the run, exponentially, in a long one by
    `settled_rate_share` as well; that of the centres falls by `means_lr_end` alone."""


class Checkpoints(Protocol):
    """Where a run saves its state against an interruption; this base saves nothing."""

    def load(self) -> TrainState | None:
        """The last state that was saved whole; None where there is none."""
        return None

    def offer(self, step: int, state: Callable[[], TrainState]) -> None:
        """Called after each step: save `state()` where one is due."""
        return

    def save(self, step: int, state: Callable[[], TrainState]) -> None:
        """Save `state()` after `step` steps, due or not."""
        return


class NoCheckpoints(Checkpoints):
    """An interrupted run begins anew."""


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
    checkpoints: Checkpoints = field(default_factory=NoCheckpoints)
    statistics_bytes: int = STATISTICS_BUDGET_BYTES
    """Memory for the statistics of its targets that the loss keeps."""
    scratch: Path | None = None
    """Folder for what need not stay in memory, such as synthetic views; None: memory."""
    extent: float | None = None
    """That of the larger training of which this one is a part; None: its own (`extent.py`)."""
    frozen: NDArray[np.bool_] | None = None
    """Gaussians (N,) that are rendered and keep their bits; only without densification."""
    loss: ImageLoss | None = None
    parts: tuple[Part, ...] = ()
    """A loss in place of the built-in one, and parts after the built-in ones. Neither is in the key
    of checkpoints: only trainings without checkpoints have them."""


def fit_splats(initial: Splats, views: TrainingViews, config: TrainConfig, options: FitOptions = FitOptions()) -> TrainResult:
    """Fit a copy of `initial` to `views`, for `config.num_steps` or `config.budget_s`, whichever
    ends first.

    Args:
        initial: the Gaussians of the start, such as those of `first_splats`.
        views: the images to fit, with their cameras.
        config: the settings of training, such as `train_preset("default")`.
        options: renderer, progress, checkpoints and validation.

    Returns:
        The fitted model and what it took.

    Raises:
        StageFailed: steps in a row ended in something not finite; the message says what.
        BadInput: the initial model or the cameras are not finite, or the options contradict the
            configuration.
    """
    training = Training(initial, views, config, options)
    state = options.checkpoints.load()
    if state is not None:
        training.restore(state)
    while not training.is_done:
        training.take_step()
        options.checkpoints.offer(training.step, training.state)
    return training.result()


class ModelFit:
    """A model between two steps, its optimizer, its parts and its figures: what a training has, and
    each replica of one that several machines share (`together/replica.py`)."""

    _beta1 = BETA1

    def __init__(self, initial: Splats, config: TrainConfig, options: FitOptions, extent: float) -> None:
        """`extent` in world units."""
        self._config, self._options, self._extent = config, options, extent
        self._device = device_of(resolve_backend(options.backend))
        self._splats = SplatTensors.from_splats(initial, device=self._device)
        self._optimizer, self._rates = self._new_optimizer()
        self._parts: tuple[Part, ...] = ()
        self._losses: list[float] = []
        self._num_rolled_back = self._failures_in_a_row = 0
        self._spent_s = 0.0
        self._begun_s = self._reported_s = options.clock()
        self._num_reported = 0
        self._costs = StepCosts(config, len(initial))
        self.step = 0

    @property
    def seconds(self) -> float:
        """How long this run has taken, without interruptions."""
        return self._spent_s + self._options.clock() - self._begun_s

    @property
    def progress(self) -> float:
        """The share of the steps, or of the time where that is larger, that is spent."""
        return self._progress_after(self.step)

    @property
    def is_done(self) -> bool:
        """Whether steps or time are spent."""
        return self.progress >= 1

    @property
    def num_splats(self) -> int:
        """The Gaussians of the model."""
        return len(self._splats)

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
        for part in self._parts:
            arrays |= {f"{part.name}.{name}": array for name, array in part.state_arrays().items()}
            numbers[part.name] = part.state_numbers()
        return TrainState(arrays=arrays, numbers=numbers)

    def restore(self, state: TrainState) -> None:
        """Go on from `state`; BadInput where it is of other inputs or configuration."""
        arrays, numbers = state.arrays, state.numbers
        try:
            tensors = {
                name: torch.from_numpy(arrays[f"splats.{name}"].copy()).to(old.device) for name, old in self._splats.tensors().items()
            }
            self._splats = replace(self._splats, **tensors)
            self._optimizer, self._rates = self._new_optimizer()
            self._optimizer.restore(_arrays_of("adam", arrays), int(numbers["adam_step"]))
            for part in self._parts:
                part.restore(_arrays_of(part.name, arrays), numbers.get(part.name), self._splats)
            self._losses = arrays["losses"].tolist()
            self.step, self._spent_s = int(numbers["step"]), float(numbers["seconds"])
            self._num_rolled_back, self._failures_in_a_row = int(numbers["num_rolled_back"]), int(numbers["failures_in_a_row"])
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"the state is of another run ({error}): remove the checkpoint and train from the start.") from error
        self._begun_s = self._reported_s = self._options.clock()
        self._num_reported = len(self._losses)

    def _last(self) -> SplatTensors:
        """A copy of the model that becomes the result, before the limits of shape."""
        splats = replace(self._splats, **{name: tensor.detach().clone() for name, tensor in self._splats.tensors().items()})
        for part in self._parts:
            splats = part.last(splats)
        return splats

    def _result(self, splats: SplatTensors, shapes: ShapeCounts) -> TrainResult:
        """The model, the best by validation if any, and its figures. StageFailed without a step."""
        if not self._losses:
            raise StageFailed(f"training: none of {self.step} steps could be taken: check the photographs and the learning rates.")
        tenth = max(1, len(self._losses) // 10)
        result = TrainResult(
            splats=splats.to_splats(),
            num_steps=self.step,
            first_loss=float(np.mean(self._losses[:tenth])),
            last_loss=float(np.mean(self._losses[-tenth:])),
            seconds=self.seconds,
            shapes=shapes,
            num_rolled_back=self._num_rolled_back,
        )
        for part in self._parts:
            result = part.finish(result)
        return result

    def _new_optimizer(self) -> tuple[SelectiveAdam, dict[str, float]]:
        return _optimizer(self._splats, self._extent, self._config, self._options.steps, self._beta1)

    def _progress_after(self, num_steps: int) -> float:
        share = num_steps / self._config.num_steps
        return share if self._config.budget_s is None else max(share, self.seconds / self._config.budget_s)

    def _set_rates(self, progress: float, settled_share: float) -> None:
        """`settled_share` as by `settled_rate_share`."""
        config = self._config
        factor = self._options.steps.end**progress * settled_share
        for name, rate in self._rates.items():
            self._optimizer.set_rate(name, rate * (config.means_lr_end**progress if name == "means" else factor))

    def _count_loss(self, moment: Moment, loss: float) -> None:
        """A step was taken: its loss counts, and parts may edit the model."""
        self._failures_in_a_row = 0
        self._losses.append(loss)
        for part in self._parts:
            self._splats = part.after_update(moment, self._splats, self._optimizer)

    def _end_step(self) -> None:
        self.step += 1
        for part in self._parts:
            part.after_step(self.step, self.progress, self._splats)
        self._report()

    def _hold(self, splats: SplatTensors) -> None:
        for part in self._parts:
            part.hold(splats)

    def _roll_back(self, reason: str) -> None:
        # What was not finite is refused before Adam and the parts write anything.
        self._num_rolled_back += 1
        self._failures_in_a_row += 1
        if self._failures_in_a_row > MAX_FAILURES:
            raise StageFailed(
                f"training: {MAX_FAILURES} steps in a row could not be taken, the last at step {self.step + 1}: {reason}; "
                "lower the learning rates or check the photographs."
            )

    def _report(self) -> None:
        now_s = self._options.clock()
        losses = self._losses[self._num_reported :]
        if losses and (now_s - self._reported_s >= self._options.report_every_s or self.is_done):
            num_steps = max(self.step, min(self._config.num_steps, round(self.step / max(self.progress, 1e-9))))
            spent = self._costs.spent_at(self.progress)
            self._options.report(TrainProgress(step=self.step, num_steps=num_steps, loss=float(np.mean(losses)), spent=spent))
            self._reported_s, self._num_reported = now_s, len(self._losses)


class Training(ModelFit):
    """One run of training on one machine, step by step."""

    def __init__(self, initial: Splats, views: TrainingViews, config: TrainConfig, options: FitOptions) -> None:
        extent = working_extent(views.cameras, initial, config.max_extent_per_distance) if options.extent is None else options.extent
        config = with_needle_width(config, views.cameras)
        super().__init__(initial, config, options, extent)
        self._views = views
        self._parts = training_parts(self._splats, views, config, options, extent)
        self._view_loss = ViewLoss(views, config, options.backend, options.statistics_bytes, options.loss)

    def take_step(self) -> None:
        """Take the next step; one that ends in something not finite is undone and counted."""
        moment = self._moment()
        if self._view_loss.scale < 1 and moment.progress >= self._config.full_size_from:
            self._view_loss.use_size(1.0)
        if self.step % STEPS_BETWEEN_LIMITS == 0:
            self._limit_shapes(self._splats)
        self._set_rates(moment.progress, settled_rate_share(self.step, moment.progress, len(self._views), self._config.settle_epochs))
        try:
            loss = self._fit_view(moment)
        except StageFailed as error:
            self._roll_back(str(error))
        else:
            self._count_loss(moment, loss)
        self._end_step()

    def result(self) -> TrainResult:
        """The model, the best by validation if any, and its figures. StageFailed without a step."""
        splats = self._last()
        return self._result(splats, self._limit_shapes(splats))

    def restore(self, state: TrainState) -> None:
        """Go on from `state`; BadInput where it is of other inputs or configuration."""
        super().restore(state)
        self._view_loss.use_size(self._config.start_scale if self.progress < self._config.full_size_from else 1.0)

    def _moment(self) -> Moment:
        return Moment(
            step=self.step + 1,
            view=view_of_step(self.step, len(self._views), self._config.seed),
            progress=self.progress,
            schedule_step=round(self._progress_after(self.step + 1) * self._config.schedule_steps, 6),
        )

    def _fit_view(self, moment: Moment) -> float:
        """Render, compare, step; the loss. StageFailed, with nothing changed, when not finite."""
        self._optimizer.zero_grad()
        loss, visible = self._view_loss.backward(self._splats, moment, self._parts, self._watch)
        if visible is not None:
            for part in self._parts:
                part.after_backward(self._splats)
            self._optimizer.step(visible if self._config.adam == "visible" else None)
            self._hold(self._splats)
        return loss

    def _watch(self, moment: Moment, output: RenderOutput) -> None:
        for part in self._parts:
            part.before_backward(moment, output)

    def _limit_shapes(self, splats: SplatTensors) -> ShapeCounts:
        counts = limit_shapes(splats, self._views.cameras.centers, self._config)
        self._hold(splats)
        return counts


def training_parts(splats: SplatTensors, views: TrainingViews, config: TrainConfig, options: FitOptions, extent: float) -> tuple[Part, ...]:
    """The parts that a configuration and its options ask for, for a model before its first step.
    The best model replaces the last one before density control removes what no pixel shows."""
    parts: list[Part] = []
    mean = MeanModel(config.average_from) if config.average_from < 1 else None
    if mean is not None:
        parts.append(mean)
    if options.validation is not None:
        parts.append(BestModel(options.validation, config.num_looks, options.backend, first_look(config), mean))
    if config.drop_gaussians == "always":
        parts.append(DroppedGaussians(config.drop_share, config.seed))
    if config.thickness_weight > 0 or config.depth_spread_weight > 0:
        parts.append(ThinSurfaces(views, config, options.backend))
    density = config.density
    if isinstance(density, Mcmc):
        parts.append(RelocatedDensity(density, config))
    elif not isinstance(density, NoDensification):
        parts.append(AdaptiveDensity(density, config, extent, splats, len(views)))
    if options.frozen is not None:
        if not isinstance(density, NoDensification):
            raise BadInput(f"Gaussians are held while density.kind is {density.kind!r}, which moves rows: set density.kind to 'none'.")
        parts.append(HeldRows(splats, options.frozen))
    return (*parts, *options.parts)


def settled_rate_share(step: int, progress: float, num_views: int, settle_epochs: int | None) -> float:
    """The share of its rates, 0.1 to 1, that a run of N steps has at step p N: T / (p² N). T is
    `settle_epochs` steps per view, at least `MIN_STEADY_STEPS`, so that rates fall from step √(T N)
    on: with few views 1,500 steps end with 0.47 of them, 6,000 with 0.12. N = step / `progress`, so
    that a budget of time needs no forecast."""
    if settle_epochs is None or step <= 0 or progress <= 0:
        return 1.0
    return min(1.0, max(MIN_SETTLED_SHARE, max(MIN_STEADY_STEPS, settle_epochs * num_views) / (step * min(1.0, progress))))


def _arrays_of(part: str, arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {name.removeprefix(f"{part}."): array for name, array in arrays.items() if name.startswith(f"{part}.")}


def _optimizer(
    splats: SplatTensors, extent: float, config: TrainConfig, steps: Steps, beta1: float
) -> tuple[SelectiveAdam, dict[str, float]]:
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
    return SelectiveAdam(tensors, moving, beta1=beta1), moving
