"""The frames of all neighbouring models at once, from pairs, GPS and their errors. Per edge.

    min Σ_m ‖ξ(S_m)‖²_{G_m} + Σ_(a,b) ‖ξ(S_a M_ab S_b⁻¹)‖²_{C_ab}
over one correction S_m per model. ξ = (shift m, rotation rad, ln scale) about the middle of a
model's cameras, or of a pair's common ground; G_m comes from GPS and is the gauge, C_ab from the
pair. 7 M unknowns, a few Gauss–Newton steps with differences for derivatives. Source: Strasdat,
Montiel and Davison, Scale drift-aware large scale monocular SLAM, RSS (2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from radiant_core.frames import FrameUncertainty, Sim3
from radiant_core.geometry.pair_fit import PairFit, compose, similarity_about, xi_about
from radiant_core.numerics import FloatArray, check_array


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameEdge:
    """What a pair of models `a`, `b` (indices) says: the similarity that takes b's frame to a's."""

    a: int
    b: int
    fit: PairFit


@dataclass(frozen=True, kw_only=True, eq=False)
class SolvedFrames:
    """One correction per model and the covariance (7M,7M) of their ξ."""

    corrections: tuple[Sim3, ...]
    covariance: FloatArray

    def uncertainty(self, model: int) -> FrameUncertainty:
        """What is left of one model's uncertainty, the gauge included."""
        return uncertainty_of(self.covariance[7 * model : 7 * model + 7, 7 * model : 7 * model + 7])


def uncertainty_of(covariance: FloatArray) -> FrameUncertainty:
    """Three figures of a covariance (7,7) of ξ: RMS of the axes of the place, worst of rotation."""
    return FrameUncertainty(
        position_m=float(np.sqrt(np.trace(covariance[:3, :3]) / 3)),
        scale=float(np.sqrt(covariance[6, 6])),
        rotation_rad=float(np.sqrt(np.linalg.eigvalsh(covariance[3:6, 3:6])[-1])),
    )


def solve_frames(centers: FloatArray, priors: Sequence[FrameUncertainty], edges: Sequence[FrameEdge]) -> SolvedFrames:
    """Corrections of M models with camera middles (M,3) m, GPS `priors` (M) and edges."""
    from scipy.optimize import least_squares

    centers = check_array("centers", centers, (len(priors), 3))
    sigmas = np.concatenate([prior.sigmas for prior in priors]) if len(priors) else np.zeros(0)
    whitening = [np.linalg.inv(np.linalg.cholesky(edge.fit.covariance)) for edge in edges]

    def residuals(scaled: FloatArray) -> FloatArray:
        moves = [similarity_about(center, xi) for center, xi in zip(centers, (scaled * sigmas).reshape(-1, 7), strict=True)]
        errors = [white @ edge_xi(edge, moves[edge.a], moves[edge.b]) for edge, white in zip(edges, whitening, strict=True)]
        return np.concatenate([scaled, *errors])

    if not len(priors):
        return SolvedFrames(corrections=(), covariance=np.zeros((0, 0)))
    # x in units of its own uncertainty: 1 m and 1 % by GPS then differentiate equally well.
    solved = least_squares(residuals, np.zeros(7 * len(priors)), method="trf", x_scale=1.0, max_nfev=50)
    moves = tuple(similarity_about(center, xi) for center, xi in zip(centers, (solved.x * sigmas).reshape(-1, 7), strict=True))
    covariance = np.linalg.inv(solved.jac.T @ solved.jac) * np.outer(sigmas, sigmas)
    return SolvedFrames(corrections=moves, covariance=covariance)


def strains(solved: SolvedFrames, centers: FloatArray, priors: Sequence[FrameUncertainty]) -> FloatArray:
    """By how many standard deviations (M,7) of its own prior each model was moved."""
    moved = [xi_about(center, move) / prior.sigmas for center, move, prior in zip(centers, solved.corrections, priors, strict=True)]
    return np.abs(np.array(moved).reshape(-1, 7))


def edge_xi(edge: FrameEdge, a_move: Sim3, b_move: Sim3) -> FloatArray:
    """How far (7,) two corrected models are apart on common ground: ξ of S_a M S_b⁻¹."""
    apart = compose(compose(a_move, edge.fit.a_from_b), b_move.inverse())
    return xi_about(a_move.apply(edge.fit.center[None])[0], apart)


def spread_to(center: FloatArray, model_center: FloatArray, prior: FrameUncertainty, bias_m: float) -> FloatArray:
    """Variances (7,) that a frame's uncertainty gives to ξ about another `center` (3,): turns and
    scale shift what is far."""
    distance = float(np.linalg.norm(center - model_center))
    variances = np.square(prior.sigmas)
    variances[:3] += bias_m**2 + (distance * prior.rotation_rad) ** 2 + (distance * prior.scale) ** 2
    return variances
