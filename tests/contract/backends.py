"""Every backend and build this machine has, and how far one rendering lies from the float64 reference, gradients included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import torch
from torch import Tensor

from radiant_core.cameras import Cameras
from radiant_core.render.backends import device_of
from radiant_core.render.contract import Backend, RenderOutput, SplatTensors, ViewOptions
from radiant_core.render.gsplat_backend import missing_for_gsplat
from radiant_core.render.native_backend import instruction_sets, rasterize_native
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import SH_C0, Splats

NATIVE = tuple(f"native-{name}" for name in instruction_sets())
GSPLAT = () if missing_for_gsplat() else ("gsplat",)
BACKENDS = (*GSPLAT, *NATIVE, "reference")

Feature = Literal[
    "colour, alpha, depth",
    "radii",
    "2D-mean gradients",
    "absolute gradients",
    "background",
    "SH 0-3",
    "antialiased",
    "several cameras",
    "float64",
    "camera gradients",
]
FEATURES: dict[str, frozenset[Feature]] = {
    "gsplat": frozenset(get_args(Feature)) - {"float64", "camera gradients"},
    "native": frozenset(get_args(Feature)) - {"float64", "camera gradients"},
    "reference": frozenset(get_args(Feature)),
}
"""What each backend can do. Gradients of all six tensors and the background go without saying."""

BACKGROUND = (0.1, 0.4, 0.7)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rendered:
    """One rendering, its leaves and its background."""

    output: RenderOutput
    leaves: SplatTensors
    background: Tensor

    def gradients(self) -> dict[str, Tensor]:
        """(N, …) as float64 (N, D) per tensor that has elements; zeros where autograd gave none."""
        return {
            name: (torch.zeros_like(leaf) if leaf.grad is None else leaf.grad).cpu().double().reshape(len(leaf), -1)
            for name, leaf in self.leaves.tensors().items()
            if leaf.numel()
        }


def render(splats: Splats | SplatTensors, cameras: Cameras, backend: str, *, threads: int | None = None, **options) -> Rendered:
    """Render in float32, or in float64 for the backend "oracle"; options as those of `rasterize`."""
    dtype = torch.float64 if backend == "oracle" else torch.float32
    device = device_of(backend)
    leaves = SplatTensors.from_splats(splats, dtype, device) if isinstance(splats, Splats) else splats
    for leaf in leaves.tensors().values():
        leaf.requires_grad_()
    width, height = (int(side) for side in cameras.sizes_wh[0])
    background = torch.tensor(BACKGROUND, dtype=dtype, requires_grad=True)
    viewmats, Ks = torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks)
    options = {"sh_degree": 3, "near_m": 0.01, "far_m": 1e10, "antialiased": False, **options}
    if backend.startswith("native-"):
        view = ViewOptions(width=width, height=height, background=background, **options)
        output = rasterize_native(leaves, viewmats, Ks, view, instruction_set=backend.removeprefix("native-"), threads=threads)
    else:
        name: Backend = "gsplat" if backend in GSPLAT else "reference"
        output = rasterize(leaves, viewmats, Ks, width, height, background=background, backend=name, **options)
    if output.means2d.requires_grad:
        output.means2d.retain_grad()
    return Rendered(output=_on_cpu(output), leaves=leaves, background=background)


def _on_cpu(output: RenderOutput) -> RenderOutput:
    """The pictures on the CPU, where they are compared; `means2d` stays, for it holds the gradient."""
    return replace(output, **{part: getattr(output, part).cpu() for part in ("images", "alphas", "depths", "radii_px")})


def random_loss(output: RenderOutput, parts: Sequence[str] = ("images", "alphas", "depths"), keep: Tensor | None = None) -> Tensor:
    """A weighted sum of pictures with fixed random weights in 0..1, the same for every backend; `keep` (C,H,W) drops pixels."""
    generator = torch.Generator().manual_seed(0)
    total = output.images.new_zeros(())
    for part in parts:
        picture = getattr(output, part)
        weights = torch.rand(picture.shape, generator=generator, dtype=torch.float64)
        if keep is not None:
            weights = weights * (keep[..., None] if picture.ndim == 4 else keep)
        total = total + (picture * weights.to(picture)).sum()
    return total


def undecided_pixels(splats: Splats, cameras: Cameras, within: float = 1e-4, **options) -> Tensor:
    """Pixels (C,H,W) with a pair `within` this of ln α from a discrete decision (α_min or the cut):
    they jump when ln o moves by as much.

    The second difference of three renderings is of the order 1e-8 where nothing jumps. 1e-7 also
    finds jumps behind a transmittance of 1e-4, which are a large part of the gradient of a Gaussian
    that is hidden everywhere.
    """
    leaves = SplatTensors.from_splats(splats, torch.float64)
    logits = leaves.logit_opacities.detach()
    by_logit = 1 / torch.sigmoid(-logits).clamp_min(1e-2)  # moves ln o by 1; those above 0.99 by less
    shifted = [replace(leaves, logit_opacities=logits + shift * by_logit) for shift in (-within, 0.0, within)]
    low, middle, high = (render(tensors, cameras, "oracle", **options).output for tensors in shifted)
    jumps = [(getattr(low, part) - 2 * getattr(middle, part) + getattr(high, part)).detach().abs() for part in ("images", "alphas")]
    return (jumps[0].amax(-1) > 1e-7) | (jumps[1] > 1e-7)


def relative_errors(gradient: Tensor, exact: Tensor, rounding: Tensor | float = 0.0) -> Tensor:
    """‖g − g64‖ / ‖g64‖ of each Gaussian that has a gradient, the divisor at least 1e-6 of the
    tensor's largest entry.

    `rounding` (N,) is taken off ‖g − g64‖ first.
    """
    norms = exact.norm(dim=1)
    errors = ((gradient - exact).norm(dim=1) - rounding).clamp_min(0) / norms.clamp_min(1e-6 * float(exact.abs().max()))
    return errors[norms > 0]


def opacity_rounding(splats: Splats, exact: dict[str, Tensor]) -> Tensor:
    """(N,) 2⁻²² (1 − o) Σ_c |∂loss/∂c|: two units of float32 in what ∂loss/∂logit is a difference
    of, were the Gaussian white.

    That gradient is one number, (1 − o) Σ_p w (c·g − B): what the Gaussian shows less what it
    hides. In one Gaussian of a thousand the two agree to three digits, and no float32 colour is
    exact relative to what is left.
    """
    by_color = exact["sh0"].abs().sum(1) / SH_C0
    return 2.0**-22 * torch.sigmoid(-torch.tensor(splats.logit_opacities, dtype=torch.float64)) * by_color
