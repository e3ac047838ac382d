"""The similarity between two models from pairs of 3D points. Once per pair of models and round.

    min Σ_i ρ(r_iᵀ C_i⁻¹ r_i),   r_i = a_i − S b_i,   C_i = A_i + s² R B_i Rᵀ,   ρ Geman–McClure
by reweighted Gauss–Newton in the seven unknowns ξ = (shift m, rotation rad, ln scale) about the
middle of the pairs. Pairs of one patch of ground err together, so the covariance is the
cluster-robust one, H⁻¹ (Σ_c g_c g_cᵀ) H⁻¹ with the gradients g_c summed over patches c, never under
a floor. Sources: Umeyama, PAMI 13 (1991); Liang and Zeger, Biometrika 73 (1986).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.align import fit_sim3
from radiant_core.numerics import FloatArray, check_array

NUM_ITERATIONS = 30
ROBUST_SIGMAS = 2.0
NUM_PATCHES_ACROSS = 5
FLOOR = np.array([0.02, 0.02, 0.02, 3e-4, 3e-4, 3e-4, 3e-4])
"""Standard deviations (m, rad, 1) that no number of pairs gets below: models bend by this much."""
NUM_TRIALS = 1500
MAX_SCALE_CHANGE = 0.25
MIN_SIDE_SHARE = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class PointPairs:
    """P pairs of one place in two models: a, b (P,3) m and covariances (P,3,3) m²; may be empty."""

    a: FloatArray
    a_covariances: FloatArray
    b: FloatArray
    b_covariances: FloatArray

    def __len__(self) -> int:
        return len(self.a)


@dataclass(frozen=True, kw_only=True, eq=False)
class PairFit:
    """Similarity a ← b, covariance (7,7) of ξ about `center` (3,) in a's frame, how many of the
    pairs agree, and the median distance of those in m."""

    a_from_b: Sim3
    center: FloatArray
    covariance: FloatArray
    num_pairs: int
    residual_m: float
    num_followed: int
    """Pairs that there were."""


def compose(outer: Sim3, inner: Sim3) -> Sim3:
    """x → outer(inner(x)), its rotation made orthonormal again."""
    U, _, Vt = np.linalg.svd(outer.rotation @ inner.rotation)
    return Sim3(scale=outer.scale * inner.scale, rotation=U @ Vt, translation=outer.apply(inner.translation[None])[0])


def similarity_about(center: FloatArray, xi: FloatArray) -> Sim3:
    """The similarity that turns and grows about `center` (3,) and then shifts it: xi (7,) = shift
    m, rotation vector rad, ln scale."""
    scale, rotation = float(np.exp(xi[6])), Rotation.from_rotvec(xi[3:6]).as_matrix()
    return Sim3(scale=scale, rotation=rotation, translation=center + xi[:3] - scale * rotation @ center)


def xi_about(center: FloatArray, similarity: Sim3) -> FloatArray:
    """xi (7,) with `similarity` = similarity_about(center, xi)."""
    shift = similarity.apply(center[None])[0] - center
    return np.concatenate([shift, Rotation.from_matrix(similarity.rotation).as_rotvec(), [np.log(similarity.scale)]])


def consensus(a: FloatArray, b: FloatArray, tolerances_m: FloatArray, seed: int = 0) -> tuple[Sim3, FloatArray] | None:
    """The similarity a ← b of three random pairs that most pairs (P,3) agree with to tolerances
    (P,), and their mask (P,); None under 3 pairs or where no three give a scale within 25 % of 1.
    Source: Fischler and Bolles, RANSAC (1981).
    """
    a, b = check_array("a", a, (None, 3)), check_array("b", b, (len(a), 3))
    if len(a) < 3:
        return None
    rng = np.random.default_rng(seed)
    spread = float(np.linalg.norm(np.ptp(a, axis=0)))
    best, agreeing = None, np.zeros(len(a), bool)
    for _ in range(NUM_TRIALS):
        picked = rng.choice(len(a), 3, replace=False)
        sides = [np.linalg.norm(points[picked] - points[np.roll(picked, 1)], axis=1) for points in (a, b)]
        # Near pairs fix no rotation, sides of another ratio no similarity: cheaper to see here.
        if min(sides[0].min(), sides[1].min()) <= MIN_SIDE_SHARE * spread or (np.abs(np.log(sides[1] / sides[0])) > MAX_SCALE_CHANGE).any():
            continue
        fit = fit_sim3(b[picked], a[picked])
        close = np.square(fit.apply(b) - a).sum(axis=1) < tolerances_m**2
        if close.sum() > agreeing.sum():
            best, agreeing = fit, close
    if best is None or agreeing.sum() < 3:
        return None
    for _ in range(5):
        best = fit_sim3(b[agreeing], a[agreeing])
        close = np.square(best.apply(b) - a).sum(axis=1) < tolerances_m**2
        if close.sum() < 3:
            break
        agreeing = close
    return best, agreeing


def fit_pairs(pairs: PointPairs, start: Sim3) -> PairFit:
    """The robust fit from `start`; BadInput under 4 pairs or where they cannot fix seven unknowns
    (all in one place or on a line)."""
    if len(pairs) < 4:
        raise BadInput(f"{len(pairs)} pairs of points cannot fix a similarity with its error: at least 4 are needed.")
    center = np.median(pairs.a, axis=0)
    fit = start
    for _ in range(NUM_ITERATIONS):
        residuals, precision, jacobian, weights = _linearise(pairs, fit, center)
        H = np.einsum("n,nia,nij,njb->ab", weights, jacobian, precision, jacobian)
        diagonal = np.diag(H)
        if not (diagonal > 0).all() or np.linalg.cond(H / np.sqrt(np.outer(diagonal, diagonal))) > 1e10:
            raise BadInput("the pairs of points lie on a line or in one place: they fix no similarity.")
        step = np.linalg.solve(H, np.einsum("n,nia,nij,nj->a", weights, jacobian, precision, residuals))
        fit = compose(similarity_about(center, step), fit)
        if np.abs(step).max() < 1e-9:
            break
    residuals, precision, jacobian, weights = _linearise(pairs, fit, center)
    gradients = np.einsum("n,nia,nij,nj->na", weights, jacobian, precision, residuals)
    inverse = np.linalg.inv(np.einsum("n,nia,nij,njb->ab", weights, jacobian, precision, jacobian))
    patch = _patches(pairs.a)
    sums = np.zeros((int(patch.max()) + 1, 7))
    np.add.at(sums, patch, gradients)
    num_patches = len(np.unique(patch))
    correction = num_patches / max(1, num_patches - 1)
    covariance = correction * inverse @ (sums.T @ sums) @ inverse + inverse + np.diag(FLOOR**2)
    agreeing = weights > 0.25
    distances = np.linalg.norm(residuals[agreeing] if agreeing.any() else residuals, axis=1)
    return PairFit(
        a_from_b=fit,
        center=center,
        covariance=covariance,
        num_pairs=int(agreeing.sum()),
        residual_m=float(np.median(distances)),
        num_followed=len(pairs),
    )


def _linearise(pairs: PointPairs, fit: Sim3, center: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Residuals (P,3), precisions (P,3,3), ∂(S b)/∂ξ (P,3,7), weights (P,)."""
    moved = fit.apply(pairs.b)
    residuals = pairs.a - moved
    precision = np.asarray(
        np.linalg.inv(pairs.a_covariances + fit.scale**2 * fit.rotation @ pairs.b_covariances @ fit.rotation.T), np.float64
    )
    squares = np.einsum("ni,nij,nj->n", residuals, precision, residuals)
    weights = 1 / np.square(1 + squares / ROBUST_SIGMAS**2)
    x, y, z = (moved - center).T
    jacobian = np.zeros((len(pairs), 3, 7))
    jacobian[:, :, :3] = np.eye(3)
    jacobian[:, 0, 4], jacobian[:, 0, 5] = z, -y
    jacobian[:, 1, 3], jacobian[:, 1, 5] = -z, x
    jacobian[:, 2, 3], jacobian[:, 2, 4] = y, -x
    jacobian[:, :, 6] = moved - center
    return residuals, precision, jacobian, weights


def _patches(points: FloatArray) -> np.ndarray:
    """Which of 5 × 5 patches over the horizontal extent each point (P,3) lies in (P,)."""
    flat = points[:, :2] - points[:, :2].min(axis=0)
    cells = np.minimum((NUM_PATCHES_ACROSS * flat / np.maximum(flat.max(axis=0), 1e-12)).astype(np.int64), NUM_PATCHES_ACROSS - 1)
    return cells[:, 0] * NUM_PATCHES_ACROSS + cells[:, 1]
