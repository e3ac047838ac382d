"""Real spherical harmonics up to degree 3, in the sign and order that 3DGS files use.

Basis: Sloan, Stupid Spherical Harmonics Tricks (2008), appendix A2.
"""

from __future__ import annotations

from typing import Any

from radiant_core.splats import SH_C0


def sh_terms(x: Any, y: Any, z: Any, degree: int) -> list[Any]:
    """Y_k of unit directions x, y, z (N,) each, numpy or torch: (degree + 1)² arrays (N,)."""
    terms = [SH_C0 + 0 * x]
    if degree >= 1:
        terms += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if degree >= 2:
        terms += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * z * z - x * x - y * y),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ]
    if degree >= 3:
        terms += [
            -0.5900435899266435 * y * (3 * x * x - y * y),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
            0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
            1.445305721320277 * z * (x * x - y * y),
            -0.5900435899266435 * x * (x * x - 3 * y * y),
        ]
    return terms
