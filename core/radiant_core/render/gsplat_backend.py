"""gsplat behind the contract: CUDA kernels for float32 (Ye et al. 2025), an optional extra.

Its α_min, α_max, cut and low-pass filter are those of the contract. It culls a Gaussian by a box of
its own, so pictures agree with the reference inside the frustum, up to pairs at a discrete
decision; `means2d` of what it culls are not written. Once per image and training step.
"""

from __future__ import annotations

import functools
import weakref
from importlib.util import find_spec

import torch
from torch import Tensor

from radiant_core.errors import BadInput
from radiant_core.render.contract import DILATION_PX2, RenderOutput, SplatTensors, ViewOptions
from radiant_core.render.torch_reference import rasterize_reference

INSTALL = "pip install -e '.[cuda]'"


@functools.cache
def missing_for_gsplat() -> str | None:
    """What this machine lacks for gsplat, to end a sentence; None if nothing. Asked once."""
    if not torch.cuda.is_available():
        return "no CUDA device that this PyTorch can use"
    if find_spec("gsplat") is None:
        return f"no package gsplat ({INSTALL})"
    # gsplat builds its kernels when first imported, and keeps None in their place on failure.
    from gsplat.cuda import _backend  # pyright: ignore[reportMissingImports]

    if getattr(_backend, "_C", None) is None:
        return "no CUDA toolkit to build gsplat's kernels with (install nvcc of PyTorch's CUDA version)"
    return None


def free_vram_bytes(backend: str) -> int | None:
    """What the CUDA device has free for `backend`, with what this process has reserved and does not
    use; None for a backend that does not use it."""
    if backend != "gsplat":
        return None
    return torch.cuda.mem_get_info()[0] + torch.cuda.memory_reserved() - torch.cuda.memory_allocated()


def rasterize_gsplat(splats: SplatTensors, viewmats: Tensor, Ks: Tensor, view: ViewOptions) -> RenderOutput:
    """`rasterize` for float32 tensors on one CUDA device; viewmats and Ks get no gradient. Raises
    BadInput where gsplat or CUDA is missing, for another type or device, and where the cameras ask
    for gradients."""
    _check_gsplat(splats, viewmats, Ks)
    if not len(splats):  # gsplat is not asked for nothing
        return rasterize_reference(splats, viewmats.to(splats.means), Ks.to(splats.means), view)
    from gsplat import rasterization  # pyright: ignore[reportMissingImports]

    means = splats.means
    cameras = viewmats.shape[0]
    pictures, alphas, meta = rasterization(
        means=means,
        quats=splats.quats,
        scales=splats.log_scales.exp(),
        opacities=splats.logit_opacities.sigmoid(),
        colors=torch.cat([splats.sh0, splats.shN], dim=1),
        viewmats=viewmats.to(means),
        Ks=Ks.to(means),
        width=view.width,
        height=view.height,
        near_plane=view.near_m,
        far_plane=view.far_m,
        eps2d=DILATION_PX2,
        sh_degree=view.sh_degree,
        backgrounds=view.background.to(means).expand(cameras, 3),
        render_mode="RGB+ED",
        rasterize_mode="antialiased" if view.antialiased else "classic",
        packed=False,
        absgrad=view.absgrad,
    )
    return RenderOutput(
        images=pictures[..., :3],
        alphas=alphas[..., 0],
        depths=pictures[..., 3],
        radii_px=meta["radii"].to(means.dtype).amax(-1),
        means2d=meta["means2d"],
        absgrad=_take_absgrad(meta["means2d"]) if view.absgrad else None,
        weights=_weights(splats, viewmats, Ks, view) if view.weights else None,
    )


@torch.enable_grad()
def _weights(splats: SplatTensors, viewmats: Tensor, Ks: Tensor, view: ViewOptions) -> Tensor:
    """`RenderOutput.weights` (C,N): gradients of a rendering's sum by a colour that all share."""
    from gsplat import rasterization  # pyright: ignore[reportMissingImports]

    means = splats.means.detach()
    sums: list[Tensor] = []
    for viewmat, K in zip(viewmats.to(means), Ks.to(means), strict=True):
        white = torch.ones(len(means), 3, device=means.device, requires_grad=True)
        pictures, _, _ = rasterization(
            means=means,
            quats=splats.quats.detach(),
            scales=splats.log_scales.detach().exp(),
            opacities=splats.logit_opacities.detach().sigmoid(),
            colors=white,
            viewmats=viewmat[None],
            Ks=K[None],
            width=view.width,
            height=view.height,
            near_plane=view.near_m,
            far_plane=view.far_m,
            eps2d=DILATION_PX2,
            rasterize_mode="antialiased" if view.antialiased else "classic",
            packed=False,
        )
        sums.append(torch.autograd.grad(pictures[..., 0].sum(), white)[0][:, 0])
    return torch.stack(sums)


def _take_absgrad(means2d: Tensor) -> Tensor:
    """Zeros that take what gsplat sets as `means2d.absgrad` in its backward pass, just before the
    gradient of means2d arrives."""
    absolute = torch.zeros_like(means2d, requires_grad=False)
    if means2d.requires_grad:
        # A weak reference: a tensor held by its own hook would keep its graph until collection.
        reference = weakref.ref(means2d)

        def take(_: Tensor) -> None:
            tensor = reference()
            if tensor is not None:
                absolute.copy_(tensor.absgrad)  # pyright: ignore[reportAttributeAccessIssue]

        means2d.register_hook(take)
    return absolute


def _check_gsplat(splats: SplatTensors, viewmats: Tensor, Ks: Tensor) -> None:
    missing = missing_for_gsplat()
    if missing is not None:
        raise BadInput(f"backend 'gsplat' cannot be used here, there is {missing}: install it or use backend='auto'.")
    for name, tensor in splats.tensors().items():
        if tensor.dtype != torch.float32 or tensor.device.type != "cuda":
            raise BadInput(f"{name} is {tensor.dtype} on {tensor.device}, backend 'gsplat' takes float32 on CUDA: move it there.")
    for name, tensor in (("viewmats", viewmats), ("Ks", Ks)):
        if tensor.requires_grad:
            raise BadInput(f"{name} requires gradients, which backend 'gsplat' has none for: use backend='reference'.")
