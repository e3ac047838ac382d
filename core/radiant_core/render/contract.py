"""The contract of every rasterizer: what goes in, what comes out, and which constants decide.

    image(p) = Σ_i c_i w_i + background · (1 − Σ_i w_i)    w_i = α_i Π_{k<i} (1 − α_k)   (Eqn. 2)
    α_i = min(α_max, o_i exp(−½ (p − m_i)ᵀ Σ'_i⁻¹ (p − m_i)))                         (Eqn. 1)
    Σ' = J W Σ Wᵀ Jᵀ + 0.3 px² I                                                     (Eqn. 3)

EWA splatting: Zwicker 2002; 3DGS: Kerbl 2023; equations are numbered as in the paper.
`rasterize.py` checks arguments and chooses the backend. C cameras, N Gaussians, K SH bases, H W px.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from radiant_core.splats import TENSORS, Splats

ALPHA_MIN = 1 / 255
"""A Gaussian adds to a pixel only where its α reaches this: one step of an 8-bit image."""
ALPHA_MAX = 0.999
"""α is capped here, so that gradients behind a Gaussian never vanish altogether."""
DILATION_PX2 = 0.3
"""Added to the diagonal of each 2D covariance: no Gaussian is narrower than a pixel's filter."""
TRANSMITTANCE_CUT = 1e-4
"""A Gaussian that would bring a pixel's transmittance to this or below is not blended, nor is any
Gaussian behind it."""

Renderer = Literal["gsplat", "native", "reference"]
Backend = Literal["auto", Renderer]
"""auto: gsplat for tensors on CUDA, native on the CPU, else reference. gsplat: CUDA kernels, an
optional extra; native: C++ for float32 on the CPU; reference: plain PyTorch on any device in any
type, the oracle."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SplatTensors:
    """The torch twin of `Splats`: leaves that may require gradients; made inside, not validated.

    Example:
        >>> tensors = radiant.SplatTensors.from_splats(radiant.load_splats("model.ply"))
        >>> tensors.sh0.requires_grad_().shape[1:]
        torch.Size([1, 3])
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    logit_opacities: Tensor
    sh0: Tensor
    shN: Tensor
    antialiased: bool = False

    def __len__(self) -> int:
        return self.means.shape[0]

    def tensors(self) -> dict[str, Tensor]:
        """The six tensors by name."""
        return {name: getattr(self, name) for name in TENSORS}

    @staticmethod
    def from_splats(splats: Splats, dtype: torch.dtype = torch.float32, device: str = "cpu") -> SplatTensors:
        """Copies of the arrays as tensors of `dtype` on `device`."""
        tensors = {name: torch.from_numpy(np.array(array)).to(device, dtype) for name, array in splats.arrays().items()}
        return SplatTensors(**tensors, antialiased=splats.antialiased)

    def to_splats(self) -> Splats:
        """A validated numpy copy; BadInput where training left a value that is not finite."""
        arrays = {name: tensor.detach().cpu().numpy() for name, tensor in self.tensors().items()}
        return Splats(**arrays, antialiased=self.antialiased)


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderOutput:
    """What a rasterizer returns, differentiable in all six tensors of the splats but `radii_px`."""

    images: Tensor
    """(C,H,W,3) colour over the background."""
    alphas: Tensor
    """(C,H,W) Σ w."""
    depths: Tensor
    """(C,H,W) expected depth Σ w z / Σ w, metres; 0 where nothing was hit."""
    radii_px: Tensor
    """(C,N) half the long side of the box in which a Gaussian reaches α_min; 0 where culled."""
    means2d: Tensor
    """(C,N,2) projected centres, of any value where `radii_px` is 0. Densification takes their
    gradient in pixels: `register_hook`, or `retain_grad`, which copies it."""
    absgrad: Tensor | None = None
    """(C,N,2) Σ over pixels p of `|∂loss_p/∂means2d|`, where requested: the loss by way of p, so
    that nothing cancels (AbsGS, Ye 2024). Zeros until a backward pass through the pictures, which
    overwrites it before the gradient of `means2d` comes to its hooks."""
    weights: Tensor | None = None
    """(C,N) Σ over pixels of w = T α, how many pixels a Gaussian makes, where requested and
    something has a gradient; there when the gradient of `means2d` comes to its hooks."""

    @cached_property
    def visible(self) -> Tensor:
        """(N,) bool, Gaussians that a camera sees; by numpy: torch's threads spin on (libgomp)."""
        if self.radii_px.device.type == "cpu":
            radii_px = self.radii_px.numpy()
            return torch.from_numpy(radii_px[0] > 0 if len(radii_px) == 1 else (radii_px > 0).any(0))
        return (self.radii_px > 0).any(0)


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewOptions:
    """What one call has besides splats and cameras."""

    width: int
    height: int
    sh_degree: int
    near_m: float
    far_m: float
    antialiased: bool
    background: Tensor
    absgrad: bool = False
    weights: bool = False
