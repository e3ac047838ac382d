"""Colour from spherical harmonics, max(0, ½ + Σ_k Y_k(d) f_k). Once per Gaussian and image."""

from __future__ import annotations

import torch
from torch import Tensor

from radiant_core.spherical_harmonics import sh_terms
from radiant_core.splats import SH_BASES


def basis_values(directions: Tensor, degree: int) -> Tensor:
    """Y_k of unit directions (N,3): (N,K) with K = (degree + 1)²."""
    x, y, z = directions.unbind(-1)
    return torch.stack(sh_terms(x, y, z, degree), dim=-1)


def colors_from_sh(directions: Tensor, sh0: Tensor, shN: Tensor, degree: int) -> Tensor:
    """Colours (N,3) seen along unit `directions` (N,3) of sh0 (N,1,3), shN (N,K-1,3)."""
    coefficients = torch.cat([sh0, shN[:, : SH_BASES[degree] - 1]], dim=1)
    values = basis_values(directions, degree)
    return (0.5 + torch.einsum("nk,nkc->nc", values, coefficients)).clamp_min(0.0)
