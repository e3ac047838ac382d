"""Least-distance dealing with capacities against the Hungarian method, and the conditions that prove it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.plan.capped_transport import deal_within
from radiant_core.plan.transport import Dealt

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
@pytest.mark.parametrize("seed", range(25))
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
