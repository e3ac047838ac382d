"""`Replica`: the model of a training that several machines share, as each of them has it.

    contribute    the gradients of this machine's views            on each holder of photographs
    take          one Adam step by the sum of what all sent        on every replica, the same bits
    limits        which axes are too long for the cameras          at the root, which knows them all

A step of V views is one of Adam at √V times the rates of a step of one view; schedules follow the
share of the views that were shown, as they follow steps in `trainer.py`, which is a step of one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from radiant_core import _native
from radiant_core.choices import StepFormat
from radiant_core.errors import BadInput, StageFailed
from radiant_core.numerics import FloatArray
from radiant_core.render.contract import RenderOutput
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.density import AdaptiveDensity, DensityStatistics
from radiant_core.train.densify.mcmc import RelocatedDensity
from radiant_core.train.densify.policies import Mcmc, NoDensification
from radiant_core.train.drop import DroppedGaussians
from radiant_core.train.mean_model import MeanModel
from radiant_core.train.parts import Moment, Part
from radiant_core.train.results import TrainResult, TrainState
from radiant_core.train.shapes import ShapeCounts, limit_shapes
from radiant_core.train.together.gradients import Layout, StepGradients
from radiant_core.train.together.masking import first_magnitudes, next_magnitudes
from radiant_core.train.trainer import STEPS_BETWEEN_LIMITS, FitOptions, ModelFit, settled_rate_share
from radiant_core.train.view_loss import ViewLoss, view_of_step
from radiant_core.train.views import TrainingViews

OVERLAPPING_MEANS = 0.5
"""Share of the rate of centres where gradients are a step old (docs/experiments/together.md)."""
_MAGNITUDES = "magnitudes"


@dataclass(frozen=True, kw_only=True)
class Group:
    """What all replicas of a training know of it."""

    config: TrainConfig
    """Of one machine that had all photographs: `num_steps` are views to show, rates those of steps
    of one view."""
    num_photographs: int
    """Of all holders."""
    views_per_step: int
    extent: float
    """In whose units centres move, m."""
    overlaps: bool = True
    """Whether a holder renders for the next step while the sum of this one is on its way, so that
    gradients are of the model one step before."""
    form: StepFormat = "blocks"
    """How gradients travel."""
    masked: bool = False
    """Whether devices add masks to what they send, which cancel in the sum (`masking.py`)."""

    @property
    def beta1(self) -> float:
        """Adam's memory of gradients, shorter the more views a step has, and where they are a step
        old (docs/experiments/together.md)."""
        return float(np.clip(0.9 - 0.1 * (math.log2(self.views_per_step) - 2 + self.overlaps), 0.7, 0.9))

    def edits(self, step: int) -> bool:
        """Whether taking a step (from 0) may add or remove Gaussians."""
        density, views = self.config.density, self.views_per_step
        return not isinstance(density, NoDensification) and (step + 1) % _edits_every(density.every, views) == 0

    @property
    def stepping(self) -> TrainConfig:
        """The settings of steps of `views_per_step` views."""
        views, config = self.views_per_step, self.config
        factor, density = math.sqrt(views), config.density
        if not isinstance(density, NoDensification):
            density = replace(density, every=_edits_every(density.every, views))
        return replace(
            config,
            num_steps=group_steps(config.num_steps, views),
            density=density,
            means_lr=factor * config.means_lr * (OVERLAPPING_MEANS if self.overlaps else 1),
            scales_lr=factor * config.scales_lr,
            quats_lr=factor * config.quats_lr,
            opacities_lr=factor * config.opacities_lr,
            sh0_lr=factor * config.sh0_lr,
        )


def _edits_every(every: int, views_per_step: int) -> int:
    return max(1, round(every / views_per_step))


def group_steps(num_steps: int, views_per_step: int) -> int:
    """The steps of a group that shows as many views as one machine in `num_steps`."""
    return max(1, math.ceil(num_steps / views_per_step))


def require_shareable(config: TrainConfig) -> None:
    """Raise BadInput for settings that need photographs of all in one place, or one clock."""
    if config.depth_spread_weight > 0 or config.thickness_weight > 0:
        raise BadInput("machines that train together do not weigh thickness or depth spread: set both weights to 0, or join models.")
    if config.budget_s is not None:
        raise BadInput("machines that train together count steps, not seconds: leave out the budget of time, or join models.")


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """Gaussians (R,) whose axes were too long, and their log_scales (R,3) now."""

    rows: NDArray[np.int64]
    log_scales: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Share:
    """What a holder gives to each step: `num_views` of its photographs, of which the first counts
    as view `first` of the step."""

    views: TrainingViews
    num_views: int
    first: int


class Replica(ModelFit):
    """The model of a group on one machine, step by step."""

    def __init__(self, initial: Splats, group: Group, options: FitOptions, share: Share | None = None) -> None:
        """`share`: the photographs of this machine; None where it has none. BadInput for settings
        that cannot be shared."""
        require_shareable(group.config)
        self._beta1 = group.beta1
        super().__init__(initial, group.stepping, options, group.extent)
        self._group, self._share = group, share
        self._parts = self._parts_of_group()
        self._view_loss = None if share is None else ViewLoss(share.views, self._config, options.backend, options.statistics_bytes)
        self._gradients: dict[str, NDArray[np.float32]] = {}
        self._magnitudes = first_magnitudes(self.layout)
        self.failed_views: list[str] = []
        """Why views of this machine could not be counted."""

    def _parts_of_group(self) -> tuple[Part, ...]:
        config, parts = self._config, list[Part]()
        if config.average_from < 1:
            parts.append(MeanModel(config.average_from))
        if config.drop_gaussians == "always":
            parts.append(DroppedGaussians(config.drop_share, config.seed))
        if isinstance(config.density, Mcmc):
            parts.append(RelocatedDensity(config.density, config))
        elif not isinstance(config.density, NoDensification):
            group = self._group
            density = AdaptiveDensity(config.density, config, self._extent, self._splats, group.num_photographs, group.views_per_step)
            parts.append(density)
        return tuple(parts)

    @property
    def _density(self) -> AdaptiveDensity | None:
        return next((part for part in self._parts if isinstance(part, AdaptiveDensity)), None)

    @property
    def layout(self) -> Layout:
        """The columns of this model's gradients."""
        density = self._density
        return Layout.of(self._splats, tuple(self._rates), with_radii=density is not None and density.measures_radii)

    @property
    def magnitudes(self) -> NDArray[np.int64]:
        """Those of the totals before, (K,) by `next_magnitudes`: units of masked gradients follow
        from them."""
        return self._magnitudes

    def contribute(self, step: int | None = None) -> StepGradients:
        """The gradients of this machine's views of a step, by default the next one, by the model as
        it is; of none where no view of them ends in something finite."""
        share, view_loss, count = self._share, self._view_loss, len(self._splats)
        if share is None or view_loss is None:
            return StepGradients.nothing(self.layout)
        step = self.step if step is None else step
        moment = self._moment(step)
        if view_loss.scale < 1 and moment.progress >= self._config.full_size_from:
            view_loss.use_size(1.0)
        self._optimizer.zero_grad()
        statistics = DensityStatistics(count, self._splats.means.device)
        row_mask, loss, num_counted = np.zeros(count, bool), 0.0, 0

        def watch(at: Moment, output: RenderOutput) -> None:
            if (density := self._density) is not None:
                density.watch(at, output, statistics)

        for number in range(share.num_views):
            try:
                value, visible = view_loss.backward(self._splats, self._moment_of(share, step, number, moment), self._parts, watch)
            except StageFailed as error:
                self.failed_views.append(f"step {step + 1}: {error}")
                continue
            loss, num_counted = loss + value, num_counted + 1
            if visible is not None:
                row_mask |= visible.cpu().numpy()
        gradients = self._gathered(np.flatnonzero(row_mask), statistics, loss, num_counted)
        if not gradients.is_finite:
            self.failed_views.append(f"step {step + 1}: a gradient is not finite")
            return StepGradients.nothing(self.layout)
        return gradients

    def _gathered(self, rows: NDArray[np.int64], statistics: DensityStatistics, loss: float, num_views: int) -> StepGradients:
        layout, tensors = self.layout, self._splats.tensors()
        values = np.empty((len(rows), layout.num_columns), np.float32)
        for name, columns in layout.columns.items():
            gradient = tensors[name].grad
            if gradient is None:
                values[:, columns] = 0
            else:
                table = np.ascontiguousarray(gradient.detach().cpu().numpy().reshape(len(self._splats), -1))
                _native.gather_rows(table, rows, values, columns.start)
        sums, view_counts, radii = (
            np.asarray(torch.as_tensor(array).cpu()) for array in (statistics.sums, statistics.view_counts, statistics.radii_px)
        )
        values[:, layout.growth] = sums[rows]
        return StepGradients(
            num_views=num_views,
            loss=loss,
            rows=rows,
            values=values,
            view_counts=view_counts[rows].astype(np.uint16),
            radii_px=radii[rows] if layout.with_radii else None,
        )

    def share_model(self, source: Replica) -> None:
        """Have the model of another replica of the group, in place of a copy with the same bits: in
        one process one stands for all holders."""
        self._splats, self._optimizer, self._rates = source._splats, source._optimizer, source._rates
        self._parts, self._losses, self.step = source._parts, source._losses, source.step
        self._magnitudes = source._magnitudes

    @property
    def next_step_edits(self) -> bool:
        """Whether taking the next step may add or remove Gaussians, so that gradients of the model
        before it name other rows."""
        return self._group.edits(self.step)

    def take(self, total: StepGradients, limits: Limits | None = None) -> None:
        """Take the next step by the sum of what all machines sent, after applying `limits`; a step
        of no view is counted as not taken. StageFailed after too many of these in a row."""
        if limits is not None:
            with torch.no_grad():
                rows = torch.from_numpy(limits.rows).to(self._splats.log_scales.device)
                self._splats.log_scales[rows] = torch.from_numpy(limits.log_scales).to(self._splats.log_scales)
        if self._group.masked:
            self._magnitudes = next_magnitudes(self._magnitudes, total, self.layout)
        moment, views = self._moment(self.step), self._group.views_per_step
        settled = settled_rate_share(self.step * views, moment.progress, self._group.num_photographs, self._config.settle_epochs)
        self._set_rates(moment.progress, settled)
        if total.num_views:
            self._step_by(total)
            self._count_loss(moment, total.loss / total.num_views)
        else:
            self._roll_back("no machine sent a gradient")
        self._end_step()

    def _step_by(self, total: StepGradients) -> None:
        count, device = len(self._splats), self._splats.means.device
        scale = 1 / total.num_views
        for name, columns in self.layout.columns.items():
            tensor = self._splats.tensors()[name]
            dense = self._dense(name, count, columns.stop - columns.start)
            _native.spread_rows(total.values, columns.start, total.rows, scale, dense)
            tensor.grad = torch.from_numpy(dense).to(device).view(tensor.shape)
        for part in self._parts:
            part.after_backward(self._splats)
        if (density := self._density) is not None:
            density.statistics.add_rows(total.rows, total.values[:, self.layout.growth], total.view_counts, total.radii_px)
        visible = None
        if self._config.adam == "visible":
            row_mask = np.zeros(count, bool)
            row_mask[total.rows] = True
            visible = torch.from_numpy(row_mask).to(device)
        self._optimizer.step(visible)

    def _dense(self, name: str, count: int, width: int) -> NDArray[np.float32]:
        """Memory for the gradient of a tensor, that of the step before: fresh pages cost more than
        writing them."""
        dense = self._gradients.get(name)
        if dense is None or dense.shape != (count, width):
            dense = self._gradients[name] = np.empty((count, width), np.float32)
        return dense

    def limits(self, camera_centers: FloatArray) -> Limits | None:
        """What is too long for cameras at (C,3) before the next step, where that is looked at; the
        replica itself is not changed."""
        if self.step % max(1, round(STEPS_BETWEEN_LIMITS / self._group.views_per_step)):
            return None
        before = self._splats.log_scales.detach()
        limited = replace(self._splats, log_scales=before.clone())
        limit_shapes(limited, camera_centers, self._config)
        rows = torch.nonzero((limited.log_scales != before).any(dim=1))[:, 0]
        return Limits(rows=rows.cpu().numpy(), log_scales=limited.log_scales[rows].cpu().numpy())

    def result(self, camera_centers: FloatArray) -> TrainResult:
        """The model and its figures, within the limits of cameras at (C,3)."""
        splats = self._last()
        return self._result(splats, limit_shapes(splats, camera_centers, self._config))

    def outcome(self) -> TrainResult:
        """The model as this replica has it, and its figures."""
        return self._result(self._last(), ShapeCounts())

    def state(self) -> TrainState:
        """A copy of all that changes from step to step."""
        state = super().state()
        return replace(state, arrays={**state.arrays, _MAGNITUDES: self._magnitudes}) if self._group.masked else state

    def restore(self, state: TrainState) -> None:
        """Go on from `state`; BadInput where it is of other inputs or configuration."""
        super().restore(state)
        if self._group.masked:
            self._magnitudes = _magnitudes_of(state, len(self._magnitudes))
        if self._view_loss is not None:
            self._view_loss.use_size(self._config.start_scale if self.progress < self._config.full_size_from else 1.0)

    def _moment(self, step: int) -> Moment:
        """Where a step (from 0) stands that all machines take."""
        schedule_step = round(self._progress_after(step + 1) * self._config.schedule_steps, 6)
        return Moment(step=step + 1, view=-1, progress=self._progress_after(step), schedule_step=schedule_step)

    def _moment_of(self, share: Share, step: int, number: int, moment: Moment) -> Moment:
        """Where one of this machine's views stands: views of a step are numbered through."""
        view = view_of_step(step * share.num_views + number, len(share.views), self._config.seed)
        return replace(moment, step=step * self._group.views_per_step + share.first + number + 1, view=view)


def _magnitudes_of(state: TrainState, count: int) -> NDArray[np.int64]:
    magnitudes = state.arrays.get(_MAGNITUDES)
    if magnitudes is None or magnitudes.shape != (count,):
        raise BadInput("the state is of a training without masks: remove the checkpoint and train from the start.")
    return magnitudes.astype(np.int64)
