"""Models as Open3D draws them: the only place that knows its attribute names. Runs once per model that is shown."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.splats import SH_BASES, Splats

if TYPE_CHECKING:
    import open3d as o3d


def open3d_point_cloud(splats: Splats, max_sh_degree: int = 2) -> o3d.t.geometry.PointCloud:
    """N Gaussians as Open3D's tensor point cloud, as its shader "gaussianSplat" wants them.

    positions (N,3); scale (N,3) linear; rot (N,4) wxyz of length 1; opacity (N,1) logit; f_dc (N,3); f_rest (N,K-1,3).
    Its shader draws spherical harmonics up to degree 2, so higher ones are cut. Raises BadInput on a degree outside 0 to 3
    or a scale that float32 cannot hold. Source: the attributes that open3d 0.20 gives when it reads a 3DGS PLY.
    """
    import open3d as o3d

    if not 0 <= max_sh_degree < len(SH_BASES):
        raise BadInput(f"max_sh_degree is {max_sh_degree}, expected 0 to {len(SH_BASES) - 1}.")
    with np.errstate(over="ignore", under="ignore"):
        scales = np.exp(splats.log_scales)
    if not np.isfinite(scales).all():
        raise BadInput(f"a Gaussian has the log scale {splats.log_scales.max():.3g}, beyond float32: clean the model first.")
    num_rest = min(splats.shN.shape[1], SH_BASES[max_sh_degree] - 1)
    attributes = {
        "positions": splats.means,
        "scale": scales,
        "rot": _unit_quats(splats.quats),
        "opacity": splats.logit_opacities[:, None],
        "f_dc": splats.sh0[:, 0],
        "f_rest": splats.shN[:, :num_rest],
    }
    cloud = o3d.t.geometry.PointCloud()
    for name, array in attributes.items():
        cloud.point[name] = o3d.core.Tensor.from_numpy(np.array(array, np.float32, order="C"))
    return cloud


def _unit_quats(quats: np.ndarray) -> np.ndarray:
    """Quaternions wxyz (N,4) of length 1; a zero quaternion becomes the identity."""
    exact = quats.astype(np.float64)
    lengths = np.linalg.norm(exact, axis=1, keepdims=True)
    return np.where(lengths > 0, exact / np.where(lengths > 0, lengths, 1.0), np.array([1.0, 0.0, 0.0, 0.0]))
