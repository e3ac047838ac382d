"""Least-distance dealing with capacities against the Hungarian method, and its optimality."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from scipy.special import logsumexp

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.regions.capped_transport import _Boxes, _boxes, _guess, _within, deal_within
from radiant_core.plan.regions.transport import Dealt
from tests.seeds import for_seeds

from .instances import LAYOUTS


def checked_cost(positions: FloatArray, sites: FloatArray, capacities: np.ndarray, dealt: Dealt) -> float:
    """Σ distance² after proving feasibility and the KKT conditions from scratch."""
    counts = np.bincount(dealt.edge_of_position, minlength=len(sites))
    limits = np.minimum(capacities, len(positions))
    assert (counts <= limits).all()
    cost = np.sum((positions[:, None] - sites) ** 2, axis=-1)
    assert (dealt.weights <= 0).all()
    assert ((dealt.weights == 0) | (counts == limits)).all()
    power = (cost - dealt.weights)[:, limits > 0]
    own = cost[np.arange(len(cost)), dealt.edge_of_position]
    missed_m2 = (own - dealt.weights[dealt.edge_of_position] - power.min(axis=1)).max()
    assert missed_m2 <= 1e-12 * cost.max()  # the certificate's own tolerance
    assert dealt.violation_m2 == pytest.approx(max(missed_m2, 0.0), abs=1e-12 * cost.max())
    return float(own.sum())


def hungarian_cost(positions: FloatArray, sites: FloatArray, capacities: np.ndarray) -> float:
    cost = np.sum((positions[:, None] - sites) ** 2, axis=-1)
    columns = np.repeat(cost, np.minimum(capacities, len(positions)), axis=1)
    return float(columns[linear_sum_assignment(columns)].sum())


@pytest.mark.parametrize("layout", LAYOUTS)
@for_seeds(25)
def test_cost_equals_the_hungarian_method(layout: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_cameras, num_edges = int(rng.integers(1, 60)), int(rng.integers(1, 9))
    positions = LAYOUTS[layout](rng, num_cameras)
    positions = positions - positions.mean(axis=0)
    sites = (rng.random((num_edges, 2)) - 0.5) * 300.0
    capacities = rng.integers(0, num_cameras + 1, num_edges)
    capacities[rng.integers(num_edges)] += max(0, num_cameras - int(capacities.sum()))
    if seed % 5 == 0:  # no room at all: counts are given
        capacities = rng.multinomial(num_cameras, np.ones(num_edges) / num_edges)
    own = checked_cost(positions, sites, capacities, deal_within(positions, sites, capacities))
    assert own == pytest.approx(hungarian_cost(positions, sites, capacities), rel=1e-11, abs=1e-9)


def test_room_for_all_is_the_voronoi_diagram_and_twice_the_same() -> None:
    rng = np.random.default_rng(3)
    positions, sites = rng.random((500, 2)) * 100 - 50, rng.random((7, 2)) * 100 - 50
    dealt = deal_within(positions, sites, np.full(7, 500))
    np.testing.assert_array_equal(dealt.edge_of_position, np.sum((positions[:, None] - sites) ** 2, axis=-1).argmin(axis=1))
    assert not dealt.weights.any()
    tight = np.full(7, 80)
    once, again = deal_within(positions, sites, tight), deal_within(positions, sites, tight)
    np.testing.assert_array_equal(once.edge_of_position, again.edge_of_position)
    np.testing.assert_array_equal(once.weights, again.weights)


@pytest.mark.parametrize("scale_m", [1e-3, 1e7])
def test_small_and_huge_scenes(scale_m: float) -> None:
    rng = np.random.default_rng(5)
    positions, sites = (rng.random((300, 2)) - 0.5) * scale_m, (rng.random((6, 2)) - 0.5) * scale_m
    capacities = np.array([30, 60, 90, 10, 200, 0])
    own = checked_cost(positions, sites, capacities, deal_within(positions, sites, capacities))
    assert own == pytest.approx(hungarian_cost(positions, sites, capacities), rel=1e-11)


def test_capacities_that_are_negative_or_too_few_are_refused() -> None:
    positions, sites = np.zeros((3, 2)), np.array([[0.0, 0.0], [1.0, 0.0]])
    for capacities in ([1, 1], [-1, 5]):
        with pytest.raises(BadInput, match="capacities sum to"):
            deal_within(positions, sites, np.array(capacities))


def test_the_guess_leaves_only_few_cameras_to_move_along_chains() -> None:
    """A chain costs as much as all of the guess; without one, hundreds would be taken."""
    chains = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        positions, sites = rng.random((2000, 2)) * 500 - 250, (rng.random((8, 2)) - 0.5) * 400
        capacities = rng.integers(150, 400, 8)
        capacities[0] += max(0, 2000 - int(capacities.sum()))
        chains.append(deal_within(positions, sites, capacities).num_paths)
    assert max(chains) <= 10, chains


def some_boxes(seed: int = 0, num_cameras: int = 150, num_edges: int = 4) -> tuple[_Boxes, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return _Boxes(rng.random((num_cameras, 2)) * 200 - 100, rng.random((num_edges, 2)) * 150 - 75), rng


@pytest.mark.parametrize("count", [1, 3, 4, 17, 150, 1000])
def test_boxes_hold_every_camera_once_and_about_equally_many(count: int) -> None:
    positions = np.random.default_rng(count).random((count, 2)) * [300.0, 100.0]
    means, cameras, radii_m = _boxes(positions)
    assert len(means) == len(cameras) == len(radii_m) == max(1, int(np.sqrt(count / 4))) ** 2
    assert cameras.sum() == count and np.ptp(cameras) <= 2
    np.testing.assert_allclose(cameras @ means / count, positions.mean(axis=0), rtol=1e-12)
    # Steiner: the spread of all is that within the boxes and that of their means.
    whole = np.sum((positions - positions.mean(axis=0)) ** 2)
    assert cameras @ (radii_m**2 + np.sum((means - positions.mean(axis=0)) ** 2, axis=1)) == pytest.approx(whole, rel=1e-12, abs=1e-9)
    if count == 1000:
        # Columns of a fifteenth of the width, rows of a fifteenth of the height: a box of points
        # spread evenly, ± a third.
        assert np.sqrt((20**2 + 6.7**2) / 12) == pytest.approx(np.sqrt(np.mean(radii_m**2)), rel=0.3)


def test_the_smoothed_dual_has_the_slopes_it_says() -> None:
    """Against differences: the gradient is counts less limits per camera, and the slopes are how
    counts change with weights."""
    boxes, rng = some_boxes()
    limits, weights = np.array([40.0, 30.0, 50.0, 60.0]), -rng.random(4) * 2000
    _, gradient = boxes.dual(weights, limits)
    slopes, step = boxes.slopes(weights), 1e-2
    for edge in range(4):
        ahead, behind = (boxes.dual(weights + sign * step * np.eye(4)[edge], limits) for sign in (1, -1))
        assert (ahead[0] - behind[0]) / (2 * step) == pytest.approx(gradient[edge], rel=1e-5, abs=1e-8)
        np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * step) * 150, slopes[:, edge], rtol=1e-4, atol=1e-7)
    assert (gradient * 150 + limits).sum() == pytest.approx(150)
    np.testing.assert_allclose(slopes.sum(axis=0), 0, atol=1e-9)


def test_the_dual_is_the_sum_of_the_formula() -> None:
    """Σ cameras τ log Σ exp((w − d²)/τ) − Σ u w over the cameras; τ is the mean distance of
    neighbouring sites times a box's radius."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        positions, sites = rng.random((90, 2)) * 200 - 100, rng.random((5, 2)) * 150 - 75
        weights, limits = -rng.random(5) * 3000, rng.random(5) * 40
        boxes = _Boxes(positions, sites)
        means, cameras, radii_m = _boxes(positions)
        apart = cdist(sites, sites) + np.diag(np.full(5, np.inf))
        widths = np.sqrt(np.mean(apart.min(axis=1) ** 2)) * radii_m
        np.testing.assert_allclose(boxes.widths_m2, widths, rtol=1e-12)
        assert boxes.unit_m2 == pytest.approx(np.median(widths))
        soft = widths * logsumexp((weights - cdist(means, sites) ** 2) / widths[:, None], axis=1)
        assert boxes.dual(weights, limits)[0] == pytest.approx(float(cameras @ soft - limits @ weights) / 90, rel=1e-12)
    one_spot = _Boxes(np.zeros((8, 2)), np.array([[3.0, 4.0]]))
    np.testing.assert_allclose(one_spot.widths_m2, 1e-4)  # no neighbour: 1 m


def test_smooth_weights_are_the_best_of_the_dual() -> None:
    """No step to a neighbour makes the convex dual smaller, and weights are at most 0."""
    for seed in range(4):
        boxes, rng = some_boxes(seed)
        limits = np.array([20, 45, 60, 150])
        best = boxes.smooth_weights(limits)
        least = boxes.dual(best, limits.astype(float))[0]
        assert (best <= 0).all()
        for _ in range(30):
            other = np.minimum(best + rng.normal(0, 0.05, 4) * boxes.unit_m2, 0)
            assert boxes.dual(other, limits.astype(float))[0] >= least - 1e-4 * boxes.unit_m2


def test_what_exceeds_the_limits_is_spread_over_the_room_of_the_others() -> None:
    for seed in range(200):
        rng = np.random.default_rng(seed)
        limits = rng.integers(0, 20, 6)
        total = int(rng.integers(0, limits.sum() + 1))
        wanted = rng.multinomial(total, np.ones(6) / 6)
        counts = _within(wanted, limits)
        assert counts.sum() == total and (counts <= limits).all()
        assert (counts >= np.minimum(wanted, limits)).all()
        if (wanted <= limits).all():
            np.testing.assert_array_equal(counts, wanted)
    np.testing.assert_array_equal(
        _within(np.array([90, 5, 5]), np.array([50, 45, 25])), [50, 32, 18]
    )  # 40 as 40 : 20, rounded down; the odd one to the first


@pytest.mark.parametrize("seed", range(6))
def test_the_guess_is_within_a_few_cameras_of_the_optimum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, sites = rng.random((1500, 2)) * 500 - 250, (rng.random((6, 2)) - 0.5) * 400
    capacities = rng.integers(150, 500, 6)
    capacities[0] += max(0, 1500 - int(capacities.sum()))
    counts, weights = _guess(positions, sites, capacities)
    best = deal_within(positions, sites, capacities)
    assert counts.sum() == 1500 and (counts <= capacities).all() and (weights <= 0).all()
    assert np.abs(counts - np.bincount(best.edge_of_position, minlength=6)).sum() <= 12
    # Where capacities bind weights do: a border between two cells lies at weights / 2 / distance,
    # of a site of some 200 m here.
    assert np.abs(weights - best.weights).max() <= 2 * 200 * 15


def test_weights_lie_midway_between_the_least_and_the_greatest_that_prove_it() -> None:
    """Two edges, four cameras on a line, room for one at the first: the border may stand anywhere
    between the cameras at 1 and 3."""
    positions = np.array([[-4.0, 0.0], [1.0, 0.0], [3.0, 0.0], [4.0, 0.0]]) - [1.0, 0.0]
    sites = np.array([[4.0, 0.0], [-4.0, 0.0]])
    dealt = deal_within(positions, sites, np.array([1, 4]))
    np.testing.assert_array_equal(dealt.edge_of_position, [1, 1, 1, 0])
    # ‖x − 4‖² − w ≤ ‖x + 4‖² at x = 3 alone: −16 x ≤ w, so between −48 and −32, and 0 at the edge
    # with room.
    np.testing.assert_allclose(dealt.weights, [-40, 0])
    assert dealt.parts.shape == (0, 3) and dealt.parts.dtype == np.int64 and dealt.violation_m2 == 0
    shut = deal_within(positions, sites, np.array([1, 3]))
    assert shut.weights.max() == 0 and shut.weights[0] - shut.weights[1] == pytest.approx(-40)
    none = deal_within(np.zeros((0, 2)), sites, np.array([0, 0]))
    assert none.edge_of_position.shape == (0,) and none.weights.tolist() == [0, 0]


def test_moving_turning_and_scaling_all_changes_no_dealing() -> None:
    rng = np.random.default_rng(0)
    positions, sites = rng.random((120, 2)) * 100 - 50, rng.random((5, 2)) * 100 - 50
    capacities = np.array([20, 25, 30, 40, 30])
    first = deal_within(positions, sites, capacities)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    for changed, factor in (
        ((positions @ turn.T, sites @ turn.T), 1.0),
        ((positions * 8, sites * 8), 64.0),
        ((positions + 7, sites + 7), 1.0),
    ):
        again = deal_within(*changed, capacities)
        np.testing.assert_array_equal(again.edge_of_position, first.edge_of_position)
        np.testing.assert_allclose(again.weights, factor * first.weights, rtol=1e-6, atol=1e-6 * factor)
    order = rng.permutation(5)
    np.testing.assert_array_equal(order[deal_within(positions, sites[order], capacities[order]).edge_of_position], first.edge_of_position)
