"""What every policy of densification can do for the trainer, and which one a configuration asks for."""

from __future__ import annotations

from typing import Any, Protocol

from numpy.typing import NDArray

from radiant_core.render.contract import RenderOutput, SplatTensors
from radiant_core.train.config import TrainConfig
from radiant_core.train.density import AdaptiveDensity, DensityCounts
from radiant_core.train.mcmc import RelocatedDensity
from radiant_core.train.optimizer import SelectiveAdam


class DensityPolicy(Protocol):
    """Watches the steps of one training and edits its model; `schedule_step` is where `TrainConfig`'s numbers of steps stand."""

    counts: DensityCounts

    def wants_absgrad(self, schedule_step: float) -> bool:
        """Whether the rendering that is watched next must have `RenderOutput.absgrad`."""
        ...

    def watch(self, schedule_step: float, output: RenderOutput, size_wh: tuple[int, int]) -> None:
        """Look at a rendering of one camera before its backward pass."""
        ...

    def before_step(self, splats: SplatTensors) -> None:
        """Add to the gradients what the policy wants of them."""
        ...

    def after_step(self, step: int, schedule_step: float, splats: SplatTensors, optimizer: SelectiveAdam) -> SplatTensors:
        """The model after step number `step` (from 1), the same or an edited one whose tensors `optimizer` then steps."""
        ...

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Copies of all that changes from step to step, apart from `counts`."""
        ...

    def restore(self, arrays: dict[str, NDArray[Any]], counts: DensityCounts, splats: SplatTensors) -> None:
        """Go on from `state_arrays` and counts of a run whose model is now `splats`."""
        ...


def density_policy(config: TrainConfig, extent: float, splats: SplatTensors) -> DensityPolicy | None:
    """The policy of a configuration for cameras of that extent (in the world's unit); None where nothing is densified."""
    if config.densify == "none":
        return None
    return RelocatedDensity(config) if config.densify == "mcmc" else AdaptiveDensity(config, extent, splats)
