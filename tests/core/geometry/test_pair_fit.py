"""Similarities of pairs with errors, their covariance and joint solution, and failures of ICP."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.frames import FrameUncertainty, Sim3
from radiant_core.geometry.frame_graph import FrameEdge, solve_frames
from radiant_core.geometry.open3d_ops import icp_with_scale, surface_points
from radiant_core.geometry.pair_fit import FLOOR, PairFit, PointPairs, compose, consensus, fit_pairs, similarity_about, xi_about
from radiant_core.geometry.surface_matches import icp_match
from tests.core.geometry.patchy_ground import gps_like_move, ground_model, heights

CENTER = np.array([3.0, -2.0, 1.0])
IDENTITY = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))


def pairs_of(true: Sim3, count: int, seed: int, noise_m: float = 0.1) -> PointPairs:
    rng = np.random.default_rng(seed)
    b = rng.uniform(-20, 20, (count, 3)) * (1, 1, 0.1)
    spread = np.diag([1.0, 1.0, 9.0]) * noise_m**2
    noise = rng.normal(size=(count, 3)) * np.sqrt(np.diag(spread))
    return PointPairs(
        a=true.apply(b) + noise, a_covariances=np.tile(spread, (count, 1, 1)), b=b, b_covariances=np.tile(1e-8 * np.eye(3), (count, 1, 1))
    )


def test_xi_is_the_similarity_about_its_center_and_back() -> None:
    xi = np.array([0.3, -0.2, 0.1, 0.2, -0.1, 0.3, 0.05])
    np.testing.assert_allclose(xi_about(CENTER, similarity_about(CENTER, xi)), xi, atol=1e-12)
    points = np.random.default_rng(0).normal(size=(5, 3))
    one, other = gps_like_move(CENTER, 1), gps_like_move(CENTER, 2)
    np.testing.assert_allclose(compose(one, other).apply(points), one.apply(other.apply(points)), atol=1e-12)


def test_the_fit_misses_by_what_it_predicts() -> None:
    misses = []
    for seed in range(60):
        true = gps_like_move(CENTER, seed)
        fit = fit_pairs(pairs_of(true, 80, seed), IDENTITY)
        off = xi_about(fit.center, compose(fit.a_from_b, true.inverse()))
        misses.append(off / np.sqrt(np.diag(fit.covariance) - FLOOR**2))
    rms = np.sqrt(np.square(misses).mean(axis=0))
    # The cluster-robust part adds to the plain one, so the prediction is cautious: about 0.7 of it,
    # and never beyond.
    assert (rms > 0.4).all() and (rms < 1.1).all(), rms.round(2)


def test_a_third_of_wrong_pairs_does_not_move_the_fit() -> None:
    true, rng = gps_like_move(CENTER, 5), np.random.default_rng(5)
    pairs = pairs_of(true, 120, 5)
    a = pairs.a.copy()
    a[:40] += rng.uniform(-8, 8, (40, 3))
    found = consensus(a, pairs.b, np.full(120, 0.6), seed=0)
    assert found is not None and not found[1][:40].sum() > 3
    fit = fit_pairs(PointPairs(a=a, a_covariances=pairs.a_covariances, b=pairs.b, b_covariances=pairs.b_covariances), found[0])
    # 0.3 m of noise in height over 80 pairs leaves 7 cm at the corners; 25 cm is some three times
    # that, and wrong pairs are 8 m off.
    assert np.linalg.norm(fit.a_from_b.apply(pairs.b) - true.apply(pairs.b), axis=1).max() < 0.25
    # Of the right ones three quarters lie within two standard deviations in three axes.
    assert 45 <= fit.num_pairs <= 80 and fit.residual_m < 0.5


@pytest.mark.parametrize("case", ["few", "one place", "a line"])
def test_pairs_that_fix_no_similarity_are_refused(case: str) -> None:
    line = np.outer(np.linspace(0, 10, 30), [1.0, 2.0, 0.5])
    points = {"few": line[:3], "one place": np.ones((30, 3)), "a line": line}[case]
    covariances = np.tile(0.01 * np.eye(3), (len(points), 1, 1))
    with pytest.raises(BadInput):
        fit_pairs(PointPairs(a=points, a_covariances=covariances, b=points, b_covariances=covariances), IDENTITY)


def test_poison_is_refused_and_chance_finds_no_consensus() -> None:
    bad = np.full((10, 3), np.nan)
    for call in (lambda: consensus(bad, bad, np.ones(10)), lambda: icp_with_scale(bad, bad, IDENTITY, [1.0])):
        with pytest.raises(BadInput, match="not finite"):
            call()
    rng = np.random.default_rng(1)
    found = consensus(rng.uniform(-50, 50, (200, 3)), rng.uniform(-50, 50, (200, 3)), np.ones(200))
    assert found is None or found[1].sum() < 12
    assert consensus(np.ones((20, 3)), np.ones((20, 3)), np.ones(20)) is None


def test_the_joint_solution_shares_the_gauge_by_what_each_gps_is_good_for() -> None:
    # Two models 1 m apart by their pair, one known by GPS ten times better: it stays, the other
    # comes.
    fit = PairFit(
        a_from_b=Sim3(scale=1.0, rotation=np.eye(3), translation=np.array([1.0, 0, 0])),
        center=np.zeros(3), covariance=np.diag(FLOOR**2), num_pairs=100, residual_m=0.0, num_followed=120,
    )  # fmt: skip
    sure, vague = (FrameUncertainty(position_m=p, scale=0.01, rotation_rad=0.01) for p in (0.1, 1.0))
    solved = solve_frames(np.zeros((2, 3)), [sure, vague], [FrameEdge(a=0, b=1, fit=fit)])
    shifts = [move.translation[0] for move in solved.corrections]
    assert shifts[1] - shifts[0] == pytest.approx(1.0, abs=1e-3)
    # Variances 0.01 and 1 share 1 m as 1 : 100.
    assert shifts[0] == pytest.approx(-1 / 101, rel=0.01)
    assert solved.uncertainty(1).position_m < 0.11
    nobody = solve_frames(np.zeros((0, 3)), [], [])
    assert nobody.corrections == ()


def surface(count: int, seed: int) -> np.ndarray:
    x, y = np.random.default_rng(seed).uniform(-15, 15, (2, count))
    return np.column_stack([x, y, 2 * heights(x, y)])


def test_icp_brings_bare_surfaces_together_or_says_that_it_is_lost() -> None:
    move = Sim3(scale=1.01, rotation=Rotation.from_rotvec([0.01, 0.0, 0.02]).as_matrix(), translation=np.array([0.4, -0.3, 0.2]))
    a, b = surface(12_000, 1), surface(12_000, 2)
    fit = icp_match(a, move.apply(b), 2.0)
    assert isinstance(fit, PairFit)
    # Points 0.27 m apart: what is left is a fraction of that.
    assert np.linalg.norm(fit.a_from_b.apply(move.apply(b)) - b, axis=1).max() < 0.25
    flat = a * (1, 1, 0)
    assert isinstance(icp_match(flat[:20], flat[:20], 2.0), str)
    assert isinstance(icp_match(a, a + np.array([500.0, 0, 0]), 2.0), str)


def test_haze_and_sky_are_no_surface() -> None:
    ground = ground_model((0, 6))
    assert surface_points(ground, 1.0)[1].all()
    assert not surface_points(ground, 0.05)[1].any()
    assert len(surface_points(ground.select(np.zeros(len(ground), bool)), 1.0)[0]) == 0
