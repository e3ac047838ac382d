"""`rasterize`: the one call that renders Gaussians. Once per image and training step."""

from __future__ import annotations

from typing import get_args

import torch
from torch import Tensor

from radiant_core.errors import BadInput
from radiant_core.render.contract import Backend, RenderOutput, SplatTensors, ViewOptions
from radiant_core.render.finite import first_not_finite
from radiant_core.render.gsplat_backend import missing_for_gsplat, rasterize_gsplat
from radiant_core.render.native_backend import rasterize_native
from radiant_core.render.torch_reference import rasterize_reference
from radiant_core.splats import SH_BASES

MAX_SIDE_PX = 1_000_000
"""A longer side of a picture is refused: float32 has too few digits for its pixels."""
FAR_M = 1e10
MAX_FAR_M = 1e15
"""What is farther is not drawn, whatever far_m says: squares of such depths would leave float32."""


def rasterize(
    splats: SplatTensors,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    *,
    sh_degree: int,
    background: Tensor | None = None,
    near_m: float = 0.01,
    far_m: float = FAR_M,
    antialiased: bool | None = None,
    absgrad: bool = False,
    weights: bool = False,
    backend: Backend = "auto",
) -> RenderOutput:
    """Render C cameras: viewmats (C,4,4) cam_from_world in metres, Ks (C,3,3) px, background (3).

    Gaussians between near_m and far_m, at most 1e15 m, are drawn, with harmonics up to sh_degree;
    antialiased, by default as the model says, scales opacities by √(det Σ / det Σ'), Σ before and
    Σ' after dilation, so that what is smaller than a pixel fades (Mip-Splatting, Yu 2024). absgrad
    and weights ask for those of `RenderOutput`. Tensors and pictures are of one floating type,
    viewmats and Ks may be of a finer one; cameras and background may lie on another device than the
    splats.

    Raises BadInput naming tensor, count and first index of values that are not finite, and for a
    wrong shape or type, no camera, one that is not rigid or no pinhole, pictures without pixels or
    a side above 1,000,000 px, a degree without bases, near_m ≥ far_m, and what `backend` cannot do.

    Use it for gradients, of the splats or of cameras; `render` gives pictures in numpy.

    Example:
        >>> splats = radiant.SplatTensors.from_splats(radiant.load_splats("model.ply"))
        >>> pose, K = torch.eye(4)[None], torch.tensor([[[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]])
        >>> radiant.rasterize(splats, pose, K, 64, 48, sh_degree=0).images.shape
        torch.Size([1, 48, 64, 3])
    """
    if backend not in get_args(Backend):
        raise BadInput(f"backend {backend!r} is unknown: use {', '.join(map(repr, get_args(Backend)))}.")
    view = ViewOptions(
        width=width,
        height=height,
        sh_degree=sh_degree,
        near_m=near_m,
        far_m=min(far_m, MAX_FAR_M),
        antialiased=splats.antialiased if antialiased is None else antialiased,
        absgrad=absgrad,
        weights=weights,
        background=torch.zeros(3, device=splats.means.device) if background is None else background.to(splats.means.device),
    )
    _check_tensors(splats, viewmats, Ks, view)
    _check_cameras(viewmats, Ks)
    return rasterize_sound(splats, viewmats, Ks, view, backend)


def rasterize_sound(
    splats: SplatTensors, viewmats: Tensor, Ks: Tensor, view: ViewOptions, backend: Backend, threads: int | None = None
) -> RenderOutput:
    """`rasterize` for tensors of `Splats` and `Cameras`, which have checked all of their values;
    `threads` of the native backend, by default torch's. BadInput for what `view` asks for."""
    _check_view(splats, view)
    if backend == "auto":
        backend = _backend_for(splats, viewmats, Ks)
    if backend == "gsplat":
        return rasterize_gsplat(splats, viewmats, Ks, view)
    if backend == "native":
        return rasterize_native(splats, viewmats, Ks, view, threads=threads)
    return rasterize_reference(splats, viewmats.to(splats.means), Ks.to(splats.means), view)


def _backend_for(splats: SplatTensors, viewmats: Tensor, Ks: Tensor) -> Backend:
    if viewmats.requires_grad or Ks.requires_grad or any(tensor.dtype != torch.float32 for tensor in splats.tensors().values()):
        return "reference"
    devices = {tensor.device.type for tensor in splats.tensors().values()}
    if devices == {"cpu"}:
        return "native"
    return "gsplat" if devices == {"cuda"} and missing_for_gsplat() is None else "reference"


def _check_tensors(splats: SplatTensors, viewmats: Tensor, Ks: Tensor, view: ViewOptions) -> None:
    count, cameras = (tensor.shape[0] if tensor.ndim else 0 for tensor in (splats.means, viewmats))
    bases = splats.shN.shape[1] if splats.shN.ndim == 3 else 0
    shapes = {
        "means": (count, 3),
        "quats": (count, 4),
        "log_scales": (count, 3),
        "logit_opacities": (count,),
        "sh0": (count, 1, 3),
        "shN": (count, bases, 3),
        "viewmats": (cameras, 4, 4),
        "Ks": (cameras, 3, 3),
        "background": (3,),
    }
    tensors = {**splats.tensors(), "viewmats": viewmats, "Ks": Ks, "background": view.background}
    for name, tensor in tensors.items():
        _check_type(name, tensor, shapes[name])
    fault = first_not_finite(tensors)
    if fault is not None:
        name, count, first = fault
        raise BadInput(f"{name} has {count} values that are not finite, the first at index {first}: remove them first.")
    if cameras == 0:
        raise BadInput("viewmats holds no camera: pass at least one.")


def _check_view(splats: SplatTensors, view: ViewOptions) -> None:
    bases = splats.shN.shape[1]
    if not 0 <= view.sh_degree <= 3 or SH_BASES[view.sh_degree] > bases + 1:
        raise BadInput(f"sh_degree is {view.sh_degree} but shN has {bases} bases: use a degree these bases can hold.")
    if not (1 <= view.width <= MAX_SIDE_PX and 1 <= view.height <= MAX_SIDE_PX):
        raise BadInput(f"the image is {view.width} × {view.height} px, expected sides of 1 to {MAX_SIDE_PX:,} px.")
    if not 0 <= view.near_m < view.far_m:
        raise BadInput(f"near_m is {view.near_m} and far_m {view.far_m}, expected 0 ≤ near_m < far_m: only what is in front is drawn.")


def _check_cameras(viewmats: Tensor, Ks: Tensor) -> None:
    # In Python, where a few numbers cost less than one operation of torch.
    for index, pose in enumerate(viewmats.detach().flatten(1).tolist()):
        if not _is_rigid(pose):
            raise BadInput(f"viewmats[{index}] is not a rotation and a translation: pass cam_from_world, unscaled, last row 0 0 0 1.")
    # Row by row [fx 0 cx 0 fy cy 0 0 1].
    if any(K[0] <= 0 or K[4] <= 0 or K[8] != 1 or K[1] or K[3] or K[6] or K[7] for K in Ks.detach().flatten(1).tolist()):
        raise BadInput("Ks has another form than [fx 0 cx; 0 fy cy; 0 0 1] with fx, fy > 0: undistort to pinhole cameras first.")


def _check_type(name: str, tensor: Tensor, shape: tuple[int, ...]) -> None:
    if tuple(tensor.shape) != shape:
        raise BadInput(f"{name} has shape {tuple(tensor.shape)}, expected {shape}: check which tensor was passed.")
    if not tensor.is_floating_point():
        raise BadInput(f"{name} is {tensor.dtype}, expected float32 or float64: convert it.")


def _is_rigid(pose: list[float]) -> bool:
    """Whether 16 numbers are a rotation, to what float32 poses keep, and a translation."""
    x, y, z = pose[0:3], pose[4:7], pose[8:11]
    cross = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    products = [sum(a * b for a, b in zip(*rows, strict=True)) for rows in ((x, x), (y, y), (x, y))]
    off = (products[0] - 1, products[1] - 1, products[2], *(a - b for a, b in zip(cross, z, strict=True)), *pose[12:15], pose[15] - 1)
    return all(abs(value) <= 1e-4 for value in off)
