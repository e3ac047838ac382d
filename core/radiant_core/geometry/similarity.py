"""A similarity applied to a model of 3D Gaussians, or to cameras. Once per model that changes its
frame.

    x → s R x + t      q → q_R q      ln σ → ln σ + ln s      f_l → D_l(R) f_l per degree l,
where D_l keeps every colour at its direction: Y_l(R d) D_l f = Y_l(d) f for all unit d. D_l is
solved for in float64 from 64 directions over the sphere and is orthogonal to 1e-14, as the basis is
orthonormal.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.numerics import FloatArray
from radiant_core.spherical_harmonics import sh_terms
from radiant_core.splats import SH_BASES, Splats

NUM_DIRECTIONS = 64
SHORTEST_QUAT, LONGEST_QUAT = 1e-30, 1e30
"""Lengths of quaternions: shorter ones lose their direction in float32, longer ones overflow when
they are turned."""


def move_cameras(cameras: Cameras, move: Sim3) -> Cameras:
    """The same cameras seen from the frame that `move` leads to."""
    return replace(cameras, cam_from_world=move.apply_to_poses(cameras.cam_from_world))


def move_splats(splats: Splats, similarity: Sim3) -> Splats:
    """N Gaussians in the target frame of `similarity`.

    Opacities, lengths of quaternions and colours in their turned directions stay. Computed in
    float64 and rounded to float32 once: colours agree to 1e-6 of the coefficients. A zero
    quaternion, which is drawn unturned, becomes the rotation itself. Raises BadInput when a result
    leaves float32.
    """
    means = similarity.apply(splats.means)
    log_scales = splats.log_scales.astype(np.float64) + np.log(similarity.scale)
    largest = float(np.abs(means).max(initial=0.0))
    if largest > float(np.finfo(np.float32).max):
        raise BadInput(
            f"moved by scale {similarity.scale:.3g} and translation {np.abs(similarity.translation).max():.3g} m, a mean lies at "
            f"{largest:.3g} m, beyond float32: take a local origin."
        )
    coefficients = splats.shN.astype(np.float64)
    moved = [np.zeros((len(splats), 0, 3))]
    for degree in range(1, splats.sh_degree + 1):
        band = slice(SH_BASES[degree - 1] - 1, SH_BASES[degree] - 1)
        moved.append(np.einsum("jk,nkc->njc", sh_rotation(similarity.rotation, degree), coefficients[:, band]))
    return replace(
        splats,
        means=means.astype(np.float32),
        quats=_turn_quats(splats.quats, similarity.rotation).astype(np.float32),
        log_scales=log_scales.astype(np.float32),
        shN=np.concatenate(moved, axis=1).astype(np.float32),
    )


def sh_rotation(rotation: FloatArray, degree: int) -> FloatArray:
    """D (2l+1,2l+1) that turns the coefficients of degree l by `rotation` (3,3): f' = D f."""
    directions = _spread_directions(NUM_DIRECTIONS)
    solved = np.linalg.lstsq(sh_basis(directions @ rotation.T, degree), sh_basis(directions, degree), rcond=None)[0]
    return np.asarray(solved, np.float64)


def sh_basis(directions: FloatArray, degree: int) -> FloatArray:
    """Y_lm (N,2l+1) of unit directions (N,3) for one degree l of 0 to 3, float64."""
    x, y, z = directions.T
    return np.stack(sh_terms(x, y, z, degree)[degree**2 :], axis=1)


def _turn_quats(quats: NDArray[np.float32], rotation: FloatArray) -> FloatArray:
    """q_R q (N,4) wxyz with the lengths of `quats` (N,4)."""
    exact = quats.astype(np.float64)
    lengths = np.linalg.norm(exact, axis=1, keepdims=True)
    unit = np.where(lengths > 0, exact / np.where(lengths > 0, lengths, 1.0), (1.0, 0.0, 0.0, 0.0))
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    left_product = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.where(lengths > 0, np.clip(lengths, SHORTEST_QUAT, LONGEST_QUAT), 1.0) * (unit @ left_product.T)


def _spread_directions(count: int) -> FloatArray:
    """Unit vectors (N,3) on a Fibonacci spiral, nearly even over the sphere."""
    index = np.arange(count) + 0.5
    z, turn = 1 - 2 * index / count, index * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
