"""Finds values that are not finite in one fast pass. Before every rendering and optimizer step.

By native threads on the CPU: torch's would spin on and take a core from the rasterizer (libgomp).
Native functions are given numpy's view of a tensor: to read a tensor itself takes ten times as
long, 0.4 ms in all calls of a step.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from radiant_core import _native


def first_not_finite(
    tensors: Mapping[str, Tensor], visible: Tensor | None = None, runs: NDArray[np.int32] | None = None
) -> tuple[str, int, tuple[int, ...]] | None:
    """The first of `tensors` that holds NaN or infinite values: its name, how many, and the index
    of the first; None where all are finite.

    `visible` (N,) limits this to its rows; `runs` are the same as (R,2) from
    `_native.visible_runs`, needed on the CPU.
    """
    # What is not finite stays so in a sum: one wait for the GPU instead of one for each tensor.
    on_gpu = {name: tensor for name, tensor in tensors.items() if tensor.device.type != "cpu"}
    if on_gpu and are_finite(on_gpu.values()):
        tensors = {name: tensor for name, tensor in tensors.items() if name not in on_gpu}
    for name, tensor in tensors.items():
        count, first = _not_finite(tensor.detach(), visible, runs)
        if count:
            return name, count, first
    return None


def are_finite(tensors: Iterable[Tensor]) -> bool:
    """Whether sums over tensors of one device show that all of their values are finite; False also
    where finite values exceed their type together."""
    return math.isfinite(float(torch.stack([tensor.detach().sum() for tensor in tensors]).sum()))


def _not_finite(tensor: Tensor, visible: Tensor | None, runs: NDArray[np.int32] | None) -> tuple[int, tuple[int, ...]]:
    if _is_native(tensor):
        count, *first = _native.find_not_finite(tensor.contiguous().numpy(), runs, torch.get_num_threads())
        return count, tuple(first)
    bad = ~torch.isfinite(tensor)
    if visible is not None:
        bad &= visible.view(-1, *(1 for _ in tensor.shape[1:]))
    count = int(bad.sum())
    return count, tuple(bad.nonzero()[0].tolist()) if count else ()


def _is_native(tensor: Tensor) -> bool:
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32 and tensor.ndim > 0
