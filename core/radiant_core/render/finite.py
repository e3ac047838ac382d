"""Finds values that are not finite in one fast pass. Before every rendering and optimizer step.

By native threads on the CPU: torch's would spin on and take a core from the rasterizer (libgomp).
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from radiant_core import _native


def not_finite(tensor: Tensor, visible: Tensor | None = None, runs: NDArray[np.int32] | None = None) -> tuple[int, tuple[int, ...]]:
    """How many values are NaN or infinite and the first's index; (0, ()) without. `visible` (N,)
    limits this to its rows; `runs`, the same as (R,2) of `_native.visible_runs`, is for the CPU."""
    tensor = tensor.detach()
    if tensor.device.type == "cpu" and tensor.dtype == torch.float32 and tensor.ndim:
        count, *first = _native.find_not_finite(tensor.contiguous(), runs, torch.get_num_threads())
        return count, tuple(first)
    bad = ~torch.isfinite(tensor)
    if visible is not None:
        bad &= visible.view(-1, *(1 for _ in tensor.shape[1:]))
    count = int(bad.sum())
    return count, tuple(bad.nonzero()[0].tolist()) if count else ()
