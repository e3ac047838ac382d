"""Colour from real spherical harmonics up to degree 3, in the sign and order that 3DGS files use. Once per Gaussian and image.

c(d) = max(0, ½ + Σ_k Y_k(d) f_k)         Basis: Sloan, Stupid Spherical Harmonics Tricks (2008), appendix A2.
"""

from __future__ import annotations

import torch
from torch import Tensor

from radiant_core.splats import SH_BASES, SH_C0


def basis_values(directions: Tensor, degree: int) -> Tensor:
    """Y_k of unit directions (N,3): (N,K) with K = (degree + 1)²."""
    x, y, z = directions.unbind(-1)
    values = [torch.full_like(x, SH_C0)]
    if degree >= 1:
        values += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if degree >= 2:
        values += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * z * z - x * x - y * y),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ]
    if degree >= 3:
        values += [
            -0.5900435899266435 * y * (3 * x * x - y * y),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
            0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
            1.445305721320277 * z * (x * x - y * y),
            -0.5900435899266435 * x * (x * x - 3 * y * y),
        ]
    return torch.stack(values, dim=-1)


def colors_from_sh(directions: Tensor, sh0: Tensor, shN: Tensor, degree: int) -> Tensor:
    """Colours (N,3) seen along unit `directions` (N,3) of coefficients sh0 (N,1,3), shN (N,K-1,3)."""
    coefficients = torch.cat([sh0, shN[:, : SH_BASES[degree] - 1]], dim=1)
    values = basis_values(directions, degree)
    return (0.5 + torch.einsum("nk,nkc->nc", values, coefficients)).clamp_min(0.0)
