"""Adam (Kingma & Ba 2015) over the rows of the splats' tensors that a step saw, or over all rows.

    m ← m + (1 − β₁)(g − m)    v ← β₂ v + (1 − β₂) g²
    x ← x − rate / (1 − β₁ᵗ) · m / (√v / √(1 − β₂ᵗ) + ε)

Once per step. t counts the steps of a row, not of the run: each Gaussian moves as torch's Adam
would move it on the steps that saw it alone, and one first seen at step 5,000 starts no faster than
one seen at once. Rows that were not seen keep value, moments and count. Gradients count as at most
±1e18, so that their squares and v stay finite in float32.
"""

# torch documents its operations on lists of tensors, but does not export them.
# pyright: reportPrivateImportUsage=false
from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from radiant_core import _native
from radiant_core.errors import BadInput, StageFailed
from radiant_core.render.finite import first_not_finite

BETA1, _BETA2 = 0.9, 0.999
_MAX_GRADIENT = 1e18


@dataclass(kw_only=True, eq=False)
class _Group:
    tensor: Tensor
    rate: float
    first_moments: Tensor
    second_moments: Tensor


class SelectiveAdam:
    """Adam over tensors (N,…) that share their rows, each at a rate that may be set between steps.
    Float32 on the CPU is stepped by the native kernel, else by torch, to the same formula.
    """

    def __init__(self, tensors: Mapping[str, Tensor], rates: Mapping[str, float], *, eps: float = 1e-15, beta1: float = BETA1) -> None:
        """`rates` by name; BadInput where tensors differ in rows or are not contiguous, and where a
        rate or eps is no positive number."""
        num_rows = {tensor.shape[0] if tensor.ndim else -1 for tensor in tensors.values()}
        if len(num_rows) > 1 or -1 in num_rows:
            shapes = ", ".join(f"{name} {tuple(tensor.shape)}" for name, tensor in tensors.items())
            raise BadInput(f"the tensors differ in rows: {shapes}: give one row per Gaussian.")
        for name, tensor in tensors.items():
            if not tensor.is_contiguous():
                raise BadInput(f"{name} is not contiguous: pass a contiguous copy, which is stepped in place.")
            _require_rate(name, rates.get(name))
        if not (np.float32(eps) > 0 and np.isfinite(eps)):
            raise BadInput(f"eps is {eps}, expected a positive number that float32 holds: without it 0 / 0 moves what has no gradient.")
        self._groups = {
            name: _Group(
                tensor=tensor.requires_grad_(),
                rate=rates[name],
                first_moments=torch.zeros_like(tensor, requires_grad=False),
                second_moments=torch.zeros_like(tensor, requires_grad=False),
            )
            for name, tensor in tensors.items()
        }
        self._eps, self._beta1 = eps, beta1
        self._step = 0
        device = next(iter(tensors.values())).device if tensors else torch.device("cpu")
        self._row_steps = torch.zeros(num_rows.pop() if num_rows else 0, dtype=torch.int32, device=device)
        self._first_factors, self._second_factors = (factors.to(device) for factors in _bias_factors(beta1))

    def set_rate(self, name: str, rate: float) -> None:
        """Change a tensor's learning rate, if it is optimised. BadInput for no positive number."""
        if name in self._groups:
            _require_rate(name, rate)
            self._groups[name].rate = rate

    def rate(self, name: str) -> float:
        """The learning rate of one tensor, 0 where it is not optimised."""
        return self._groups[name].rate if name in self._groups else 0.0

    @property
    def num_steps(self) -> int:
        """Steps taken so far."""
        return self._step

    def state_arrays(self) -> dict[str, NDArray]:
        """Copies of moments and step counts of the rows."""
        arrays = {"row_steps": self._row_steps.cpu().numpy().copy()}
        for name, group in self._groups.items():
            arrays[f"{name}.first"] = group.first_moments.cpu().numpy().copy()
            arrays[f"{name}.second"] = group.second_moments.cpu().numpy().copy()
        return arrays

    def restore(self, arrays: Mapping[str, NDArray], num_steps: int) -> None:
        """Go on from `state_arrays` after `num_steps` steps; ValueError for other shapes, KeyError
        for missing ones."""
        device = self._row_steps.device
        for name, group in self._groups.items():
            for moments, array in ((group.first_moments, arrays[f"{name}.first"]), (group.second_moments, arrays[f"{name}.second"])):
                if moments.shape != array.shape:
                    raise ValueError(f"moments of {name} are {array.shape}, expected {tuple(moments.shape)}")
                moments.copy_(torch.from_numpy(array))
        self._row_steps = torch.from_numpy(arrays["row_steps"].copy()).to(device)
        self._step = num_steps

    def moments(self, name: str) -> tuple[Tensor, Tensor]:
        """First and second moments of a tensor, in its shape; changed in place by each step."""
        return self._groups[name].first_moments, self._groups[name].second_moments

    def zero_moments(self, name: str) -> None:
        """Zero both moments of a tensor, not its step counts; nothing if it is not optimised."""
        if name in self._groups:
            for moments in self.moments(name):
                moments.zero_()

    @torch.no_grad()
    def select_rows(self, tensors: Mapping[str, Tensor], rows: Tensor, fresh: Tensor) -> None:
        """Go on with `tensors`, whose row i keeps moments and step count of the old row rows[i]
        (M,), or zeros where `fresh` (M,) is True. Other names are left alone; gradients are
        cleared. Raises BadInput, with nothing changed, for a tensor that is missing, not
        contiguous, or of another number of rows."""
        for name in self._groups:
            if name not in tensors or len(tensors[name]) != len(rows) or not tensors[name].is_contiguous():
                raise BadInput(f"{name} is missing, not contiguous or has other than {len(rows)} rows: pass each optimised tensor's rows.")
        for name, group in self._groups.items():
            group.tensor = tensors[name].requires_grad_()
            group.tensor.grad = None
            for moments in ("first_moments", "second_moments"):
                chosen = getattr(group, moments)[rows]
                chosen[fresh] = 0
                setattr(group, moments, chosen)
        self._row_steps = self._row_steps[rows]
        self._row_steps[fresh] = 0

    def zero_grad(self) -> None:
        """Clear the gradients."""
        for group in self._groups.values():
            group.tensor.grad = None

    @torch.no_grad()
    def step(self, visible: Tensor | None = None) -> None:
        """Move the rows where `visible` (N,) is True, or all for None, of tensors that have a
        gradient. Do not mix both forms in one run: they count steps apart. Raises StageFailed
        naming tensor, count and first index, before anything is written, where a gradient of a row
        to be moved is not finite."""
        if visible is not None and (visible.shape != self._row_steps.shape or visible.dtype != torch.bool):
            raise BadInput(f"visible is {tuple(visible.shape)} {visible.dtype}, expected {tuple(self._row_steps.shape)} torch.bool.")
        for name, group in self._groups.items():
            if group.tensor.shape != group.first_moments.shape or not group.tensor.is_contiguous():
                raise BadInput(f"{name} was changed to {tuple(group.tensor.shape)} or is not contiguous: make a new optimizer for it.")
        with_gradients = [(name, group, group.tensor.grad) for name, group in self._groups.items() if group.tensor.grad is not None]
        gradients = {name: gradient.contiguous() for name, _, gradient in with_gradients if gradient is not None}
        row_steps, runs = self._row_steps, None
        if visible is not None and visible.device.type == "cpu":
            # On this thread: see RenderOutput.visible.
            row_steps = torch.from_numpy(row_steps.numpy() + visible.numpy())
            runs = _native.visible_runs(visible.contiguous(), row_steps)
        elif visible is not None:
            row_steps = row_steps + visible
        _require_finite(gradients, visible, runs)
        self._step, self._row_steps = self._step + 1, row_steps
        natively = {name: gradient for name, gradient in gradients.items() if _is_native(self._groups[name].tensor)}
        for name, gradient in natively.items():
            self._step_natively(self._groups[name], gradient, runs)
        remaining = [(self._groups[name], gradient) for name, gradient in gradients.items() if name not in natively]
        if visible is None and remaining:
            self._step_together([group for group, _ in remaining], [gradient for _, gradient in remaining])
        elif visible is not None:
            for group, gradient in remaining:
                self._step_rows(group, gradient, visible)

    def _step_natively(self, group: _Group, gradient: Tensor, runs: NDArray[np.int32] | None) -> None:
        # Autograd does not see what the kernel writes: by the new version it refuses an old graph.
        torch.autograd.graph.increment_version(group.tensor)
        _native.adam_step(
            group.tensor.detach().numpy(),
            gradient.numpy(),
            group.first_moments.numpy(),
            group.second_moments.numpy(),
            runs,
            None if runs is None else self._row_steps.numpy(),
            self._first_factors.numpy(),
            self._second_factors.numpy(),
            self._step,
            group.rate,
            self._beta1,
            _BETA2,
            self._eps,
            torch.get_num_threads(),
        )

    def _step_together(self, groups: list[_Group], gradients: list[Tensor]) -> None:
        """All rows of all tensors by torch's operations on lists: on a GPU one launch each, where a
        launch takes longer than its arithmetic."""
        first, second = (float(factors[min(self._step, len(factors)) - 1]) for factors in _bias_factors(self._beta1))
        tensors = [group.tensor for group in groups]
        m, v = [group.first_moments for group in groups], [group.second_moments for group in groups]
        g = torch._foreach_clamp_max(gradients, _MAX_GRADIENT)
        torch._foreach_clamp_min_(g, -_MAX_GRADIENT)
        torch._foreach_lerp_(m, g, 1 - self._beta1)
        torch._foreach_mul_(v, _BETA2)
        torch._foreach_addcmul_(v, g, g, 1 - _BETA2)
        root = torch._foreach_sqrt(v)
        torch._foreach_mul_(root, second)
        torch._foreach_add_(root, self._eps)
        torch._foreach_addcdiv_(tensors, m, root, [-group.rate * first for group in groups])

    def _step_rows(self, group: _Group, gradient: Tensor, rows: Tensor) -> None:
        at = self._row_steps[rows].clamp_max(len(self._first_factors)).long() - 1
        shape = (-1, *(1 for _ in gradient.shape[1:]))
        g = gradient[rows].clamp(-_MAX_GRADIENT, _MAX_GRADIENT)
        m = group.first_moments[rows].lerp(g, 1 - self._beta1)
        v = _BETA2 * group.second_moments[rows] + (1 - _BETA2) * g * g
        group.first_moments[rows], group.second_moments[rows] = m, v
        root = v.sqrt() * self._second_factors[at].view(shape).to(g)
        group.tensor[rows] -= group.rate * self._first_factors[at].view(shape).to(g) * m / (root + self._eps)


def _is_native(tensor: Tensor) -> bool:
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32


def _require_rate(name: str, rate: float | None) -> None:
    if rate is None or not 0 < rate < math.inf:
        raise BadInput(f"the learning rate of {name} is {rate}, expected above 0 and finite: leave out tensors that keep still.")


@functools.cache
def _bias_factors(beta1: float) -> tuple[Tensor, Tensor]:
    """1 / (1 − β₁ᵗ), 1 / √(1 − β₂ᵗ) float32 (T,) for t = 1 … T, at and after which both are 1."""
    steps = np.arange(1, math.ceil(math.log(2.0**-26) / math.log(_BETA2)) + 1)
    factors = 1 / (1 - beta1**steps), 1 / np.sqrt(1 - _BETA2**steps)
    return torch.from_numpy(factors[0].astype(np.float32)), torch.from_numpy(factors[1].astype(np.float32))


def _require_finite(gradients: Mapping[str, Tensor], visible: Tensor | None, runs: NDArray[np.int32] | None) -> None:
    fault = first_not_finite(gradients, visible, runs)
    if fault is not None:
        name, count, first = fault
        raise StageFailed(
            f"training: the gradient of {name} has {count} values that are not finite, the first at index {first}: nothing was "
            "changed by this step; lower the learning rates or check the photographs."
        )
