"""The native rasterizer behind autograd: float32 on the CPU (`native/raster*`).

Two autograd steps, so that `means2d` lies on the way of the gradients as it does in the reference:

    splats ──_Project──→ means2d, link ──_Blend──→ images, alphas, depths

The whole rendering is done in `_Project`; `_Blend` hands its pictures on. Going back, `_Blend`
yields ∂loss/∂means2d and, as gradient of `link`, the sums over pixels that all other gradients come
from; so passes through one graph are independent. The C++ kernels are for AVX-512, AVX2 or any CPU.
Once per image and training step.
"""

# pyright: reportIncompatibleMethodOverride=false
from __future__ import annotations

import atexit
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from radiant_core import _native
from radiant_core.errors import BadInput
from radiant_core.render.contract import RenderOutput, SplatTensors, ViewOptions


def instruction_sets() -> tuple[str, ...]:
    """The builds of the kernels that this CPU can run, the fastest first."""
    return tuple(_native.instruction_sets())


class _FreeViews:
    """Rendered views whose memory waits for the next call: a model of 500,000 Gaussians would touch
    60,000 fresh pages each time. The longest unused comes first, so that each is found too large in
    turn. No lock, which a forked child might inherit locked: deque operations are atomic."""

    def __init__(self, most: int) -> None:
        self._views = deque[_native.RenderedView](maxlen=most)

    def take(self) -> _native.RenderedView:
        try:
            return self._views.popleft()
        except IndexError:
            return _native.RenderedView()

    def give_back(self, view: _native.RenderedView) -> None:
        self._views.append(view)

    def close(self) -> None:
        """Keep none from now on: at exit they must be gone before the native module is."""
        self._views = deque(maxlen=0)


_FREE_VIEWS = _FreeViews(most=2)
atexit.register(_FREE_VIEWS.close)


class _Rendering:
    """Native views of C cameras; their memory returns to the pool when nothing refers to this."""

    def __init__(self, num_cameras: int, threads: int) -> None:
        self.views = [_FREE_VIEWS.take() for _ in range(num_cameras)]
        self.threads = threads

    def __del__(self) -> None:
        for view in self.views:
            _FREE_VIEWS.give_back(view)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Call:
    """What one call has besides tensors that carry gradients; pictures come from `_Project`."""

    rendering: _Rendering
    viewmats: np.ndarray
    Ks: np.ndarray
    view: ViewOptions
    background: np.ndarray
    instruction_set: str
    differentiable: bool
    images: Tensor
    alphas: Tensor
    depths: Tensor
    radii_px: Tensor
    absgrad: Tensor | None
    weights: Tensor | None


def rasterize_native(
    splats: SplatTensors, viewmats: Tensor, Ks: Tensor, view: ViewOptions, *, instruction_set: str = "", threads: int | None = None
) -> RenderOutput:
    """`rasterize` for float32 tensors on the CPU; viewmats and Ks may be float64, without gradient.
    `instruction_set`: one of `instruction_sets()`, by default the fastest; `threads`: by default
    torch.get_num_threads(). Raises BadInput for another type or device, and where the cameras ask
    for gradients."""
    _check_native(splats, viewmats, Ks, instruction_set)
    cameras, count = viewmats.shape[0], len(splats)
    shape = (cameras, view.height, view.width)
    call = _Call(
        rendering=_Rendering(cameras, threads or torch.get_num_threads()),
        viewmats=_float64(viewmats),
        Ks=_float64(Ks),
        view=view,
        background=view.background.detach().to(torch.float32).contiguous().numpy(),
        instruction_set=instruction_set,
        differentiable=torch.is_grad_enabled() and any(tensor.requires_grad for tensor in splats.tensors().values()),
        images=_take_pooled(*shape, 3),
        alphas=_take_pooled(*shape),
        depths=_take_pooled(*shape),
        radii_px=_take_pooled(cameras, count),
        absgrad=torch.zeros(cameras, count, 2) if view.absgrad or view.weights else None,
        weights=torch.zeros(cameras, count) if view.absgrad or view.weights else None,
    )
    means2d, link = _Project.apply(call, *splats.tensors().values())
    images, alphas, depths = _Blend.apply(call, means2d, link, view.background)
    return RenderOutput(
        images=images,
        alphas=alphas,
        depths=depths,
        radii_px=call.radii_px,
        means2d=means2d,
        absgrad=call.absgrad if view.absgrad else None,
        weights=call.weights if view.weights else None,
    )


def count_pairs(splats: SplatTensors, viewmat: np.ndarray, K: np.ndarray, width: int, height: int) -> int:
    """Pixel–Gaussian pairs of a rendering of one camera: 16 for each block of 4 × 4 px that a
    Gaussian reaches."""
    shape, count, native = (height, width), len(splats), _native.RenderedView()
    image, alpha, depth = np.empty((*shape, 3), np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32)
    native.forward(
        "", _arrays(list(splats.tensors().values())), viewmat, K, width, height, 0, 0.01, 1e10, False, np.zeros(3, np.float32),
        image, alpha, depth, np.empty((count, 2), np.float32), np.empty(count, np.float32), False, torch.get_num_threads(),
    )  # fmt: skip
    return 16 * native.num_block_pairs


def _check_native(splats: SplatTensors, viewmats: Tensor, Ks: Tensor, instruction_set: str) -> None:
    for name, tensor in splats.tensors().items():
        if tensor.dtype != torch.float32 or tensor.device.type != "cpu":
            raise BadInput(
                f"{name} is {tensor.dtype} on {tensor.device}, backend 'native' takes float32 on the CPU: convert it or use 'reference'."
            )
    for name, tensor in (("viewmats", viewmats), ("Ks", Ks)):
        if tensor.requires_grad:
            raise BadInput(f"{name} requires gradients, which backend 'native' has none for: use backend='reference'.")
    if instruction_set and instruction_set not in instruction_sets():
        raise BadInput(f"instruction set {instruction_set!r} is not one of this CPU's: use {', '.join(instruction_sets())}.")


def _float64(tensor: Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().cpu().to(torch.float64).numpy())


def _take_pooled(*shape: int) -> Tensor:
    """An uninitialised float32 tensor in memory that was touched before: fresh pages cost more than
    what is written."""
    return torch.from_numpy(_native.pooled_array(list(shape)))


def _arrays(tensors: Sequence[Tensor]) -> list[np.ndarray]:
    return [tensor.detach().contiguous().numpy() for tensor in tensors]


class _Project(torch.autograd.Function):
    """Six tensors → means2d (C,N,2) and link (C,N,M), zeros that tie `_Blend` to it."""

    @staticmethod
    def forward(ctx: Any, call: _Call, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        arrays, view = _arrays(tensors), call.view
        means2d = _take_pooled(len(call.rendering.views), tensors[0].shape[0], 2)
        for index, native in enumerate(call.rendering.views):
            native.forward(
                call.instruction_set, arrays, call.viewmats[index], call.Ks[index], view.width, view.height, view.sh_degree,
                view.near_m, view.far_m, view.antialiased, call.background, call.images[index].numpy(), call.alphas[index].numpy(),
                call.depths[index].numpy(), means2d[index].numpy(), call.radii_px[index].numpy(), call.differentiable,
                call.rendering.threads,
            )  # fmt: skip
        ctx.rendering, ctx.arrays = call.rendering, arrays
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(*tensors)
        return means2d, torch.zeros(()).expand(*means2d.shape[:2], _native.NUM_MOMENTS)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, means2d: Tensor | None, sums: Tensor | None) -> tuple[Tensor | None, ...]:
        tensors = ctx.saved_tensors  # raises where one, and so ctx.arrays, was changed since
        wanted = ctx.needs_input_grad[1:]
        gradients = [_native.pooled_array(list(tensor.shape)) if needed else None for tensor, needed in zip(tensors, wanted, strict=True)]
        shape = (len(ctx.rendering.views), len(tensors[0]))
        means2d = torch.zeros(*shape, 2) if means2d is None else means2d.contiguous()
        sums = torch.zeros(*shape, _native.NUM_MOMENTS) if sums is None else sums.contiguous()
        for index, native in enumerate(ctx.rendering.views):
            native.project_backward(ctx.arrays, means2d[index].numpy(), sums[index].numpy(), gradients, index > 0, ctx.rendering.threads)
        return None, *(None if gradient is None else torch.from_numpy(gradient) for gradient in gradients)


class _Blend(torch.autograd.Function):
    """means2d and link → pictures, which `_Project` has already drawn."""

    @staticmethod
    def forward(ctx: Any, call: _Call, means2d: Tensor, link: Tensor, background: Tensor) -> tuple[Tensor, ...]:
        ctx.rendering, ctx.shape, ctx.background_like = call.rendering, means2d.shape, background
        ctx.on_request = call.absgrad, call.weights
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(call.alphas, call.depths)
        return call.images, call.alphas, call.depths

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, images: Tensor | None, alphas: Tensor | None, depths: Tensor | None) -> tuple[Tensor | None, ...]:
        out_alphas, out_depths = ctx.saved_tensors
        by_images = out_alphas.new_zeros(*out_alphas.shape, 3) if images is None else images.contiguous()
        means2d = sums = None
        if ctx.needs_input_grad[1]:
            means2d, sums = _take_pooled(*ctx.shape), _take_pooled(*ctx.shape[:2], _native.NUM_MOMENTS)
            _blend_backward(ctx.rendering, by_images, (alphas, depths), (out_alphas, out_depths), (means2d, sums, *ctx.on_request))
        background = None
        if ctx.needs_input_grad[3]:
            background = ((1 - out_alphas)[..., None] * by_images).sum((0, 1, 2)).to(ctx.background_like.dtype)
        return None, means2d, sums, background


def _blend_backward(
    rendering: _Rendering,
    images: Tensor,
    alphas_depths: tuple[Tensor | None, Tensor | None],
    outputs: tuple[Tensor, Tensor],
    into: tuple[Tensor, Tensor, Tensor | None, Tensor | None],
) -> None:
    """∂loss/∂means2d (C,N,2), sums (C,N,M), absgrad (C,N,2) and weights (C,N) `into` four tensors
    from gradients of the pictures; `outputs`: the alphas and depths that were rendered."""
    by_alphas, by_depths = (None if part is None else part.contiguous() for part in alphas_depths)
    means2d, sums, absgrad, weights = into
    for index, native in enumerate(rendering.views):
        of_view = [None if part is None else part[index].numpy() for part in (by_alphas, by_depths, absgrad, weights)]
        alphas, depths, absolute, weight_sums = of_view
        out_alphas, out_depths = (output[index].numpy() for output in outputs)
        native.blend_backward(
            images[index].numpy(), alphas, depths, out_alphas, out_depths, means2d[index].numpy(), sums[index].numpy(), absolute,
            weight_sums, rendering.threads,
        )  # fmt: skip
