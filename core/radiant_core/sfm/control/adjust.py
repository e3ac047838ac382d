"""All photographs, points, lenses and ground control adjusted together. Once per scene.

    min Σ ρ(‖u − π(R, c, lens, X)‖ / σ_px) + Σ ρ(‖X_g − G‖_σ) + Σ ρ(‖c + s − gps‖_σ) + lens priors

Gauss–Newton, damped only where a step does not help. Points and ground control are eliminated
(Schur), what is left are 6 unknowns a photograph, the lenses, and s: GPS and ground control may
count from different datums, so where both are there one shift between them is free. ρ: Cauchy for
ties, whose wrong matches are many, Huber at 3 σ for what people measured. The inverse of what is
left is the covariance of all cameras, by which `quality.py` says how well points are known.
Source: Triggs et al., Bundle adjustment, a modern synthesis (2000), sections 6 and 9.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.sparse.linalg import splu

from radiant_core.errors import StageFailed
from radiant_core.numerics import FloatArray
from radiant_core.sfm.control.bundle import Bundle, Rows, Ties
from radiant_core.sfm.control.intersect import sum_by

CAUCHY_SIGMAS, HUBER_SIGMAS = 2.385, 3.0
"""Robust to wrong matches, and 95 % as good as least squares without any."""
FOCAL_SHARE, LENS_SIGMA = 0.03, 0.1
"""What is known of a lens beforehand: it keeps one that nothing fixes where it was."""
MAX_STEPS, LEAST_GAIN = 8, 1e-5
MAX_DENSE = 4000
FIRST_DAMPING, MAX_DAMPING = 1e-4, 1e4


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurements:
    """What is measured beside ties; G may be 0, and GPS NaN throughout, not both."""

    places_m: FloatArray
    """(G,3) ground control that is adjusted to."""
    sigmas_m: FloatArray
    """(3,)"""
    marks: Ties
    """Of ground control in images; `points` are rows of `places_m`."""
    gps_m: FloatArray
    """(C,3), NaN where a photograph has none."""
    gps_sigmas_m: FloatArray
    """(C,3)"""
    tie_sigma_px: float
    mark_sigma_px: float

    @property
    def shifts(self) -> bool:
        """Whether GPS may count from another datum than ground control."""
        return len(self.places_m) > 0 and bool(np.isfinite(self.gps_m).any())


@dataclass(frozen=True, kw_only=True, eq=False)
class Adjusted:
    """The state after an adjustment and the factor of its normal equations."""

    bundle: Bundle
    control_m: FloatArray
    """(G,3) ground control as the photographs have it."""
    shift_m: FloatArray
    """(3,) GPS minus ground control."""
    cost: float
    num_steps: int
    normal: Normal


@dataclass(frozen=True, kw_only=True, eq=False)
class Normal:
    """Normal equations of cameras, lenses and shift, points eliminated."""

    matrix: sparse.csr_matrix
    rhs: FloatArray
    point_from_camera: sparse.csr_matrix
    """V⁻¹ Wᵀ: how points follow cameras."""
    point_inverse: FloatArray
    """V⁻¹ (P+G,3,3)"""
    point_rhs: FloatArray
    """(P+G,3)"""

    def solve(self, rhs: FloatArray, damping: float = 0.0) -> FloatArray:
        """(matrix + damping · its diagonal)⁻¹ rhs; StageFailed where nothing fixes the cameras."""
        diagonal = self.matrix.diagonal()
        if not (diagonal > 0).all():
            raise StageFailed(
                "the adjustment to ground control is not determined: a photograph shows too few of the points that others show."
            )
        matrix = self.matrix + sparse.diags(damping * diagonal) if damping else self.matrix
        # Scaled to a diagonal of ones: angles, metres and pixels differ by many digits.
        scale = 1 / np.sqrt(diagonal)
        scaled = sparse.diags(scale) @ matrix @ sparse.diags(scale)
        scaled_rhs = (scale * rhs.T).T
        try:
            if len(diagonal) <= MAX_DENSE:
                solved = cho_solve(cho_factor(scaled.toarray()), scaled_rhs)
            else:
                solved = splu(scaled.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(scaled_rhs)
        except (LinAlgError, RuntimeError):
            raise StageFailed(
                "the adjustment to ground control is not determined: its points and GPS do not fix all photographs."
            ) from None
        return (scale * solved.T).T


def adjust(bundle: Bundle, ties: Ties, measurements: Measurements, max_steps: int = MAX_STEPS) -> Adjusted:
    """Adjust all of a bundle that stands near the known places already."""
    state = _State(bundle=bundle, control_m=measurements.places_m.copy(), shift_m=_first_shift(bundle, measurements))
    cost, normal = _linearize(state, ties, measurements)
    damping, steps = 0.0, 0
    while steps < max_steps:
        steps += 1
        new = _step(state, normal, damping)
        new_cost, new_normal = _linearize(new, ties, measurements)
        if not new_cost < cost:
            damping = max(10 * damping, FIRST_DAMPING)
            if damping > MAX_DAMPING or new_cost - cost < LEAST_GAIN * cost:
                break
            continue
        gain, damping = (cost - new_cost) / cost, damping / 10 if damping > FIRST_DAMPING else 0.0
        state, cost, normal = new, new_cost, new_normal
        if gain < LEAST_GAIN:
            break
    return Adjusted(bundle=state.bundle, control_m=state.control_m, shift_m=state.shift_m, cost=cost, num_steps=steps, normal=normal)


@dataclass(frozen=True, kw_only=True, eq=False)
class _State:
    bundle: Bundle
    control_m: FloatArray
    shift_m: FloatArray

    @property
    def all_points(self) -> FloatArray:
        """Points, then ground control."""
        return np.concatenate([self.bundle.points, self.control_m])


def _first_shift(bundle: Bundle, measurements: Measurements) -> FloatArray:
    return np.nanmedian(measurements.gps_m - bundle.centers, axis=0) if measurements.shifts else np.zeros(3)


def _step(state: _State, normal: Normal, damping: float) -> _State:
    step = normal.solve(normal.rhs, damping)
    num_images, F = len(state.bundle.names), state.bundle.most_free
    poses = step[: 6 * num_images].reshape(-1, 6)
    lenses = step[6 * num_images : -3].reshape(-1, F)
    point_steps = np.einsum("pij,pj->pi", normal.point_inverse, normal.point_rhs)
    points = state.all_points + point_steps - (normal.point_from_camera @ step).reshape(-1, 3)
    num_points = len(state.bundle.points)
    bundle = state.bundle.moved(poses[:, :3], poses[:, 3:], lenses, points[:num_points])
    return _State(bundle=bundle, control_m=points[num_points:], shift_m=state.shift_m + step[-3:])


def _linearize(state: _State, ties: Ties, measurements: Measurements) -> tuple[float, Normal]:
    """The cost and the normal equations about a state."""
    bundle, num_points = state.bundle, len(state.bundle.points)
    images, points = (
        np.concatenate([ties.images, measurements.marks.images]),
        np.concatenate([ties.points, num_points + measurements.marks.points]),
    )
    is_mark = np.concatenate([np.zeros(len(ties.images), bool), np.ones(len(measurements.marks.images), bool)])
    sigma = np.where(is_mark, measurements.mark_sigma_px, measurements.tie_sigma_px)
    pixels, by_pose, by_lens, by_point = bundle.derivatives(images, state.all_points[points])
    residuals = (np.concatenate([ties.pixels, measurements.marks.pixels]) - pixels) / sigma[:, None]
    in_front = np.isfinite(residuals[:, 0]) & np.isfinite(residuals[:, 1])
    # Behind a camera: as wrong as can be, and without a direction to better it.
    residuals = np.where(in_front[:, None], residuals, 0.0)
    length = np.linalg.norm(residuals, axis=1)
    cost, weights = _robust(length, is_mark)
    cost_total = float(cost[in_front].sum()) + 1e6 * float((~in_front).sum())
    root = np.where(in_front, np.sqrt(weights), 0.0)
    scale = (root / sigma)[:, None, None]
    r = root[:, None] * residuals
    with np.errstate(invalid="ignore"):
        jacobians = [np.where(in_front[:, None, None], part * scale, 0.0) for part in (by_pose, by_lens, by_point)]
    cameras = _camera_jacobian(bundle, images, jacobians[0], jacobians[1])
    extra_cost, diagonal, gradient = _camera_priors(state, measurements)
    V, point_rhs = _point_blocks(jacobians[2], r, points, num_points + len(measurements.places_m))
    control_cost = _add_control(V, point_rhs, state.control_m, measurements, num_points)
    return cost_total + extra_cost + control_cost, _eliminate(cameras, jacobians[2], r, points, (V, point_rhs), (diagonal, gradient))


def _camera_jacobian(bundle: Bundle, images: Rows, by_pose: FloatArray, by_lens: FloatArray) -> sparse.csr_matrix:
    """Rows of two per observation, columns of poses, lenses and the shift, which pixels do not
    depend on."""
    count, F = len(images), bundle.most_free
    width = 6 * len(bundle.names) + F * len(bundle.lenses) + 3
    columns = np.concatenate(
        [6 * images[:, None] + np.arange(6), 6 * len(bundle.names) + F * bundle.lens_of_image[images][:, None] + np.arange(F)], axis=1
    )
    values = np.concatenate([by_pose, by_lens], axis=2)
    starts = np.arange(2 * count + 1) * (6 + F)
    return sparse.csr_matrix((values.ravel(), np.repeat(columns, 2, axis=0).ravel(), starts), shape=(2 * count, width))


def _point_blocks(by_point: FloatArray, r: FloatArray, points: Rows, count: int) -> tuple[FloatArray, FloatArray]:
    """JᵀJ (count,3,3) and Jᵀr (count,3) of every point."""
    return sum_by(points, np.einsum("kij,kil->kjl", by_point, by_point), count), sum_by(points, np.einsum("kij,ki->kj", by_point, r), count)


def _add_control(V: FloatArray, point_rhs: FloatArray, control_m: FloatArray, measurements: Measurements, first: int) -> float:
    """Pull ground control to its places, in the blocks; its cost."""
    if not len(control_m):
        return 0.0
    residuals = (measurements.places_m - control_m) / measurements.sigmas_m
    cost, weights = _huber(np.linalg.norm(residuals, axis=1) / np.sqrt(3))
    V[first:] += weights[:, None, None] * np.diag(measurements.sigmas_m**-2.0)
    point_rhs[first:] += weights[:, None] * residuals / measurements.sigmas_m
    return 3 * float(cost.sum())


def _camera_priors(state: _State, measurements: Measurements) -> tuple[float, sparse.csr_matrix, FloatArray]:
    """Cost, (W,W) and gradient (W,) of GPS, lenses and the shift."""
    bundle = state.bundle
    C, F = len(bundle.names), bundle.most_free
    width = 6 * C + F * len(bundle.lenses) + 3
    shift, gradient, cost = np.arange(width - 3, width), np.zeros(width), 0.0
    entries = [(shift, shift, np.full(3, 0.0 if measurements.shifts else 1.0))]
    for row, (params, free) in enumerate(zip(bundle.params, bundle.free, strict=True)):
        sigmas = np.where(np.abs(params[free]) > 10, FOCAL_SHARE * np.abs(params[free]), LENS_SIGMA)
        at = 6 * C + F * row + np.arange(F)
        entries.append((at, at, np.append(sigmas**-2.0, np.ones(F - len(free)))))
    has_gps = np.flatnonzero(np.isfinite(measurements.gps_m).all(axis=1))
    if len(has_gps):
        sigmas_m = measurements.gps_sigmas_m[has_gps]
        residuals = (measurements.gps_m - bundle.centers - state.shift_m)[has_gps] / sigmas_m
        costs, weights = _huber(np.linalg.norm(residuals, axis=1) / np.sqrt(3))
        cost = 3 * float(costs.sum())
        inverse, sides = (weights[:, None] / sigmas_m**2).ravel(), weights[:, None] * residuals / sigmas_m
        at = (6 * has_gps[:, None] + 3 + np.arange(3)).ravel()
        gradient[at] = sides.ravel()
        entries.append((at, at, inverse))
        if measurements.shifts:
            to = np.tile(shift, len(has_gps))
            entries += [(at, to, inverse), (to, at, inverse), (to, to, inverse)]
            gradient[shift] = sides.sum(axis=0)
    rows, columns, values = (np.concatenate(parts) for parts in zip(*entries, strict=True))
    return cost, sparse.csr_matrix((values, (rows, columns)), shape=(width, width)), gradient


def _eliminate(
    cameras: sparse.csr_matrix,
    by_point: FloatArray,
    r: FloatArray,
    points: Rows,
    of_points: tuple[FloatArray, FloatArray],
    priors: tuple[sparse.csr_matrix, FloatArray],
) -> Normal:
    V, point_rhs = of_points
    count = len(V)
    floor = 1e-12 * np.maximum(np.einsum("pii->p", V), 1e-12)
    inverse = np.linalg.inv(V + floor[:, None, None] * np.eye(3))
    starts = np.arange(2 * len(points) + 1) * 3
    columns = np.repeat(3 * points[:, None] + np.arange(3), 2, axis=0)
    jacobian = sparse.csr_matrix((by_point.ravel(), columns.ravel(), starts), shape=(2 * len(points), 3 * count))
    blocks = sparse.bsr_matrix((inverse, np.arange(count), np.arange(count + 1)), shape=(3 * count, 3 * count)).tocsr()
    W = (cameras.T @ jacobian).tocsr()
    follow = (blocks @ W.T).tocsr()
    matrix = cameras.T @ cameras + priors[0] - W @ follow
    rhs = cameras.T @ r.ravel() + priors[1] - W @ np.einsum("pij,pj->pi", inverse, point_rhs).ravel()
    return Normal(matrix=sparse.csr_matrix(matrix), rhs=rhs, point_from_camera=follow, point_inverse=inverse, point_rhs=point_rhs)


def _robust(length: FloatArray, is_mark: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Cost and weight of residuals in σ: Huber for marks, Cauchy for ties."""
    share = (length / CAUCHY_SIGMAS) ** 2
    cauchy_cost, cauchy_weight = CAUCHY_SIGMAS**2 * np.log1p(share), 1 / (1 + share)
    huber_cost, huber_weight = _huber(length)
    return np.where(is_mark, huber_cost, cauchy_cost), np.where(is_mark, huber_weight, cauchy_weight)


def _huber(length: FloatArray) -> tuple[FloatArray, FloatArray]:
    inside = length <= HUBER_SIGMAS
    cost = np.where(inside, length**2, 2 * HUBER_SIGMAS * length - HUBER_SIGMAS**2)
    return cost, np.where(inside, 1.0, HUBER_SIGMAS / np.maximum(length, HUBER_SIGMAS))


def with_sigmas(measurements: Measurements, tie_px: float, mark_px: float) -> Measurements:
    """The same with other standard deviations of pixels."""
    return replace(measurements, tie_sigma_px=tie_px, mark_sigma_px=mark_px)
