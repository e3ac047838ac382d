"""`Part`: what takes part in a training beside its loop, such as density control and validation.

A training calls each hook of all its parts in turn, once per step unless stated otherwise:

    before_render → wants_absgrad, wants_weights → render → loss → before_backward → backward
                  → after_backward → Adam → hold → after_update → after_step

and once at the end: last → limits of shape → hold → finish
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from radiant_core.render.contract import RenderOutput, SplatTensors
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.results import TrainResult


@dataclass(frozen=True, kw_only=True)
class Moment:
    """Where a run stands at one of its steps."""

    step: int
    """Number of the step, from 1."""
    view: int
    """The view that it fits."""
    progress: float
    """Share of the run that is spent before the step."""
    schedule_step: float
    """Where schedules given in steps of `TrainConfig.schedule_steps` stand after the step."""


class Part(Protocol):
    """A part of a training; a hook that it does not define does nothing.

    Use it for your own densification, regularisation or logging: `train(…, parts=[MyPart()])`.

    Example:
        >>> class Count(radiant.Part):
        ...     name, steps = "count", 0
        ...     def after_step(self, step, progress, splats):
        ...         self.steps = step
    """

    name: str
    """Prefix of its arrays in a checkpoint, and the key of its numbers there."""

    def wants_absgrad(self, moment: Moment) -> bool:
        """Whether the rendering of this step must have `RenderOutput.absgrad`."""
        return False

    def wants_weights(self, moment: Moment) -> bool:
        """Whether the rendering of this step must have `RenderOutput.weights`."""
        return False

    def before_render(self, moment: Moment, splats: SplatTensors) -> SplatTensors:
        """The model as this step renders it, of the same rows, through which gradients reach
        `splats`."""
        return splats

    def before_backward(self, moment: Moment, output: RenderOutput) -> None:
        """Look at a rendering of one camera before its backward pass."""
        return

    def after_backward(self, splats: SplatTensors) -> None:
        """Check or change the gradients; StageFailed keeps the step from being taken."""
        return

    def hold(self, splats: SplatTensors) -> None:
        """Restore what may not change, after Adam or the limits of shape have changed the model."""
        return

    def after_update(self, moment: Moment, splats: SplatTensors, optimizer: SelectiveAdam) -> SplatTensors:
        """The model after a step that was taken: the same, or an edited one for `optimizer`."""
        return splats

    def after_step(self, step: int, progress: float, splats: SplatTensors) -> None:
        """Look at the model after `step` steps, of which the last may not have been taken;
        `progress` is the share spent."""
        return

    def last(self, splats: SplatTensors) -> SplatTensors:
        """The model that becomes the result, of the same rows. Once per run."""
        return splats

    def finish(self, result: TrainResult) -> TrainResult:
        """The result of the run with the figures and changes of this part. Once per run."""
        return result

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Copies of the arrays that change from step to step. Once per checkpoint."""
        return {}

    def state_numbers(self) -> dict[str, Any] | None:
        """The numbers that change from step to step, for JSON; None without. Once per
        checkpoint."""
        return None

    def restore(self, arrays: dict[str, NDArray[Any]], numbers: Any, splats: SplatTensors) -> None:
        """Go on from `state_arrays` and `state_numbers` of a run whose model is now `splats`;
        KeyError, TypeError or ValueError where they are of another run."""
        return
