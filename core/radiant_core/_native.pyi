"""Types of the native module; its sources are in native/."""

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

def assign_power_cells(positions: NDArray[np.float64], sites: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.int32]: ...
def training_instruction_sets() -> list[str]: ...
def target_statistics(target: Tensor, means: Tensor, variances: Tensor, num_threads: int = 1, instruction_set: str = "") -> None: ...
def training_loss(
    image: Tensor,
    target: Tensor,
    means: Tensor,
    variances: Tensor,
    weights: Tensor | None,
    gradient: Tensor | None,
    ssim_weight: float,
    num_threads: int = 1,
    instruction_set: str = "",
) -> float: ...
def visible_runs(visible: Tensor, steps: Tensor) -> NDArray[np.int32]: ...
def adam_step(
    parameters: Tensor,
    gradients: Tensor,
    first_moments: Tensor,
    second_moments: Tensor,
    runs: NDArray[np.int32] | None,
    steps: Tensor | None,
    first_factors: Tensor,
    second_factors: Tensor,
    step: int,
    rate: float,
    beta1: float,
    beta2: float,
    epsilon: float,
    num_threads: int = 1,
    instruction_set: str = "",
) -> None: ...
def find_not_finite(values: Tensor, runs: NDArray[np.int32] | None, num_threads: int = 1) -> list[int]: ...
