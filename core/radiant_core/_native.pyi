"""Types of the native module; its sources are in native/."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

def assign_power_cells(positions: NDArray[np.float64], sites: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.int32]: ...
def deal_to_cells(
    positions: NDArray[np.float64],
    multiplicities: NDArray[np.int64] | None,
    sites: NDArray[np.float64],
    counts: NDArray[np.int64],
    start_weights: NDArray[np.float64],
    warm: bool,
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.float64], float, int, int]: ...
def cell_polygons(
    sites: NDArray[np.float64], weights: NDArray[np.float64], outline: NDArray[np.float64], tolerance_m: float
) -> list[NDArray[np.float64]]: ...

NUM_MOMENTS: int

class RenderedView:
    num_instances: int
    num_block_pairs: int

    def __init__(self) -> None: ...
    def forward(
        self,
        instruction_set: str,
        splats: Sequence[NDArray[np.float32]],
        viewmat: NDArray[np.float64],
        K: NDArray[np.float64],
        width: int,
        height: int,
        sh_degree: int,
        near_m: float,
        far_m: float,
        antialiased: bool,
        background: NDArray[np.float32],
        images: NDArray[np.float32],
        alphas: NDArray[np.float32],
        depths: NDArray[np.float32],
        means2d: NDArray[np.float32],
        radii_px: NDArray[np.float32],
        differentiable: bool,
        threads: int,
    ) -> None: ...
    def blend_backward(
        self,
        images: NDArray[np.float32],
        alphas: NDArray[np.float32] | None,
        depths: NDArray[np.float32] | None,
        out_alphas: NDArray[np.float32],
        out_depths: NDArray[np.float32],
        means2d: NDArray[np.float32],
        sums: NDArray[np.float32],
        absgrad: NDArray[np.float32] | None,
        weights: NDArray[np.float32] | None,
        threads: int,
    ) -> None: ...
    def project_backward(
        self,
        splats: Sequence[NDArray[np.float32]],
        means2d: NDArray[np.float32],
        sums: NDArray[np.float32],
        gradients: Sequence[NDArray[np.float32] | None],
        add: bool,
        threads: int,
    ) -> None: ...

def pooled_array(shape: Sequence[int]) -> NDArray[np.float32]: ...
def compiler() -> str: ...
def instruction_sets() -> list[str]: ...
def multiply_adds(instruction_set: str, rounds: int) -> int: ...
def target_statistics(
    target: NDArray[np.float32] | Tensor,
    means: NDArray[np.float32] | Tensor,
    variances: NDArray[np.float32] | Tensor,
    num_threads: int = 1,
    instruction_set: str = "",
) -> None: ...
def training_loss(
    image: NDArray[np.float32] | Tensor,
    target: NDArray[np.float32] | Tensor,
    means: NDArray[np.float32] | Tensor,
    variances: NDArray[np.float32] | Tensor,
    weights: NDArray[np.float32] | Tensor | None,
    gradient: NDArray[np.float32] | Tensor | None,
    ssim_weight: float,
    num_threads: int = 1,
    instruction_set: str = "",
) -> float: ...
def visible_runs(visible: Tensor, steps: Tensor) -> NDArray[np.int32]: ...
def adam_step(
    parameters: NDArray[np.float32] | Tensor,
    gradients: NDArray[np.float32] | Tensor,
    first_moments: NDArray[np.float32] | Tensor,
    second_moments: NDArray[np.float32] | Tensor,
    runs: NDArray[np.int32] | None,
    steps: NDArray[np.int32] | Tensor | None,
    first_factors: NDArray[np.float32] | Tensor,
    second_factors: NDArray[np.float32] | Tensor,
    step: int,
    rate: float,
    beta1: float,
    beta2: float,
    epsilon: float,
    num_threads: int = 1,
    instruction_set: str = "",
) -> None: ...
def find_not_finite(values: NDArray[np.float32] | Tensor, runs: NDArray[np.int32] | None, num_threads: int = 1) -> list[int]: ...
def gather_rows(source: NDArray[np.float32], rows: NDArray[np.int64], target: NDArray[np.float32], first: int) -> None: ...
def add_rows(target: NDArray[np.float32], at: NDArray[np.int64], values: NDArray[np.float32]) -> None: ...
def spread_rows(values: NDArray[np.float32], first: int, rows: NDArray[np.int64], scale: float, target: NDArray[np.float32]) -> None: ...
def to_bfloat16(values: NDArray[np.float32], target: NDArray[np.uint16]) -> None: ...
def to_blocks(
    values: NDArray[np.float32], bounds: NDArray[np.int64], exponents: NDArray[np.uint8], fractions: NDArray[np.int8]
) -> None: ...
def from_blocks(
    exponents: NDArray[np.uint8], fractions: NDArray[np.int8], bounds: NDArray[np.int64], values: NDArray[np.float32]
) -> None: ...
def from_bfloat16(values: NDArray[np.uint16], target: NDArray[np.float32]) -> None: ...
def compare_descriptors(
    first: NDArray[np.uint8], second: NDArray[np.uint8], instruction_set: str = ""
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]: ...
def match_planes(
    reference: NDArray[np.uint8],
    sources: Sequence[NDArray[np.uint8]],
    maps: NDArray[np.float64],
    candidates: NDArray[np.float32],
    camera: NDArray[np.float64],
    limits: NDArray[np.float64],
    passes: NDArray[np.float64],
    seed: int = 0,
    num_threads: int = 1,
    instruction_set: str = "",
) -> NDArray[np.float32]: ...
def sum_agreeing(
    planes: Sequence[NDArray[np.float32]], costs: NDArray[np.float32], cameras: NDArray[np.float64], limits: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]: ...
