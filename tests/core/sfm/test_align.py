"""Similarities: the laws of the fit, and an honest status where positions cannot carry one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.align import compare_centers, fit_sim3, robust_sim3


def some_sim3(rng: np.random.Generator) -> Sim3:
    rotation = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    return Sim3(scale=float(np.exp(rng.normal())), rotation=rotation, translation=rng.normal(scale=1000, size=3))


def same(a: Sim3, b: Sim3, points: np.ndarray, tolerance: float) -> bool:
    return float(np.abs(a.apply(points) - b.apply(points)).max()) < tolerance


@given(st.integers(0, 10_000), st.integers(3, 40))
def test_exact_pairs_give_the_similarity_back(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    true, points = some_sim3(rng), rng.normal(scale=50, size=(count, 3))
    # 1e-8 m: coordinates of 1e3 to 1e4 m in float64 carry 1e-12 m; the SVD of three nearly
    # collinear points loses some.
    assert same(fit_sim3(points, true.apply(points)), true, points, 1e-8)


def test_no_small_change_of_the_fit_makes_the_squared_error_smaller() -> None:
    rng = np.random.default_rng(1)
    source = rng.normal(size=(30, 3))
    target = some_sim3(rng).apply(source) + rng.normal(scale=0.3, size=(30, 3))
    fit = fit_sim3(source, target)
    best = np.square(fit.apply(source) - target).sum()
    for _ in range(200):
        turn = Rotation.from_rotvec(rng.normal(scale=1e-3, size=3)).as_matrix()
        shift = rng.normal(scale=1e-3, size=3)
        moved = Sim3(scale=fit.scale * np.exp(rng.normal(scale=1e-3)), rotation=turn @ fit.rotation, translation=fit.translation + shift)
        assert np.square(moved.apply(source) - target).sum() >= best


def test_a_mirrored_target_is_fitted_by_a_proper_rotation() -> None:
    rng = np.random.default_rng(2)
    source = rng.normal(size=(20, 3))
    assert np.linalg.det(fit_sim3(source, source * (1, 1, -1)).rotation) == pytest.approx(1)


def test_weights_of_zero_leave_pairs_out_and_equal_weights_change_nothing() -> None:
    rng = np.random.default_rng(3)
    source, target = rng.normal(size=(12, 3)), rng.normal(size=(12, 3))
    kept = fit_sim3(source[:8], target[:8])
    assert same(fit_sim3(source, target, np.arange(12) < 8), kept, source, 1e-10)
    assert same(fit_sim3(source, target, np.full(12, 7.0)), fit_sim3(source, target), source, 1e-10)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4])
def test_outliers_of_a_kilometre_do_not_move_the_robust_fit(share: float) -> None:
    rng = np.random.default_rng(4)
    true, source = some_sim3(rng), rng.normal(scale=50, size=(60, 3))
    target = true.apply(source) + rng.normal(scale=0.5, size=(60, 3))
    lost = np.arange(60) < 60 * share
    target[lost] += rng.normal(scale=1000, size=(int(lost.sum()), 3))
    fit = robust_sim3(source, target)
    assert fit.status == "ok"
    assert fit.target_from_source is not None
    assert not fit.inliers[lost].any()
    # 0.5 m of noise over 36 or more inliers leaves about 0.2 m at a point of the scene; 1 m is five
    # times that.
    assert same(fit.target_from_source, true, source, 1.0)


def test_the_robust_fit_is_the_same_every_time() -> None:
    rng = np.random.default_rng(5)
    source, target = rng.normal(size=(2, 25, 3))
    first, second = robust_sim3(source, target, seed=7), robust_sim3(source, target, seed=7)
    assert np.array_equal(first.residuals, second.residuals)


@pytest.mark.parametrize("noise_m", [0.0, 0.3])
def test_a_straight_flight_line_is_called_collinear(noise_m: float) -> None:
    rng = np.random.default_rng(6)
    source = np.outer(np.linspace(0, 10, 30), [1.0, 2.0, 0.5])
    fit = robust_sim3(source, some_sim3(rng).apply(source) + rng.normal(scale=noise_m, size=(30, 3)))
    assert fit.status == "collinear"


def test_positions_that_are_all_alike_or_have_nothing_to_do_with_the_scene_are_inconsistent() -> None:
    rng = np.random.default_rng(7)
    source = rng.normal(size=(40, 3))
    assert robust_sim3(source, rng.normal(scale=5.0, size=(40, 3))).status == "inconsistent"
    assert robust_sim3(source, np.full((40, 3), 3.0)).status in ("inconsistent", "too few")
    assert robust_sim3(np.zeros((40, 3)), source).status in ("inconsistent", "too few")


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_pairs_are_too_few(count: int) -> None:
    fit = robust_sim3(np.eye(3)[:count], np.eye(3)[:count])
    assert fit.status == "too few"
    assert fit.target_from_source is None


def test_the_comparison_does_not_depend_on_the_frame_of_either_side() -> None:
    rng = np.random.default_rng(8)
    scene = rng.normal(scale=20, size=(15, 3))
    reference = scene + rng.normal(scale=0.1, size=(15, 3))
    plain = compare_centers(scene, reference)
    moved = compare_centers(some_sim3(rng).apply(scene), some_sim3(rng).apply(reference))
    assert moved.max_percent == pytest.approx(plain.max_percent, rel=1e-6)


def test_one_lost_camera_shows_in_the_maximum() -> None:
    rng = np.random.default_rng(9)
    reference = rng.normal(scale=20, size=(15, 3))
    lost = reference.copy()
    lost[3] += 30
    assert compare_centers(lost, reference).max_percent > 20


@pytest.mark.parametrize("poison", [np.nan, np.inf])
def test_poison_is_refused(poison: float) -> None:
    bad = np.eye(3)
    bad[1, 1] = poison
    for call in (fit_sim3, robust_sim3, compare_centers):
        with pytest.raises(BadInput, match="not finite"):
            call(bad, np.eye(3))
    with pytest.raises(BadInput, match="coincide"):
        fit_sim3(np.ones((4, 3)), np.eye(4)[:, :3])
