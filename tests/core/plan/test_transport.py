"""Least-cost dealing against the Hungarian method, and weights that separate what was dealt."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from radiant_core.numerics import FloatArray
from tests.seeds import for_seeds

from .instances import LAYOUTS
from .transport_twin import assign_with_counts, largest_violation, separating_weights


def squared_distances(positions: FloatArray, sites: FloatArray) -> FloatArray:
    return np.sum((positions[:, None] - sites) ** 2, axis=-1)


def random_counts(rng: np.random.Generator, num_cameras: int, num_edges: int) -> np.ndarray:
    """Counts that sum to num_cameras; a third of the edges may get none."""
    shares = rng.random(num_edges) * (rng.random(num_edges) < 0.67)
    shares[rng.integers(num_edges)] += 0.1
    return rng.multinomial(num_cameras, shares / shares.sum())


def hungarian_cost(cost: FloatArray, counts: np.ndarray) -> float:
    """The same problem with one column per camera that an edge takes."""
    columns = np.repeat(cost, counts, axis=1)
    return float(columns[linear_sum_assignment(columns)].sum())


@pytest.mark.parametrize("layout", LAYOUTS)
@for_seeds(20)
def test_cost_equals_the_hungarian_method(layout: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    num_cameras, num_edges = int(rng.integers(1, 70)), int(rng.integers(1, 9))
    positions = LAYOUTS[layout](rng, num_cameras)
    cost = squared_distances(positions, rng.random((num_edges, 2)) * 300.0)
    counts = random_counts(rng, num_cameras, num_edges)
    edge_of_camera = assign_with_counts(cost, counts)
    np.testing.assert_array_equal(np.bincount(edge_of_camera, minlength=num_edges), counts)
    own = float(cost[np.arange(num_cameras), edge_of_camera].sum())
    # The same sum in another order.
    assert own == pytest.approx(hungarian_cost(cost, counts), rel=1e-12)


@for_seeds(30)
def test_every_camera_of_a_scattered_scene_lies_strictly_inside_its_own_cell(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cost = squared_distances(rng.random((200, 2)), rng.random((6, 2)))
    edge_of_camera = assign_with_counts(cost, random_counts(rng, 200, 6))
    used = np.unique(edge_of_camera)
    power = (cost - separating_weights(cost, edge_of_camera))[:, used]
    nearest_two = np.sort(power, axis=1)[:, :2]
    np.testing.assert_array_equal(used[power.argmin(axis=1)], edge_of_camera)
    if len(used) > 1:
        # A border through a camera would leave about 1e-16.
        assert (nearest_two[:, 1] - nearest_two[:, 0]).min() > 1e-9


@pytest.mark.parametrize("layout", LAYOUTS)
def test_no_camera_is_outside_its_cell_by_more_than_rounding(layout: str) -> None:
    rng = np.random.default_rng(7)
    cost = squared_distances(LAYOUTS[layout](rng, 90), rng.random((5, 2)) * 300.0)
    edge_of_camera = assign_with_counts(cost, np.array([30, 0, 20, 25, 15]))
    weights = separating_weights(cost, edge_of_camera)
    violation = largest_violation(cost[:, [0, 2, 3, 4]], weights[[0, 2, 3, 4]], np.array([0, 0, 1, 2, 3])[edge_of_camera])
    assert violation <= 1e-13 * cost.max()  # hundreds of roundings


def test_a_swapped_pair_is_no_longer_certified() -> None:
    rng = np.random.default_rng(0)
    cost = squared_distances(rng.random((50, 2)), np.array([[0.0, 0.5], [1.0, 0.5]]))
    edge_of_camera = assign_with_counts(cost, np.array([25, 25]))
    first, second = np.flatnonzero(edge_of_camera == 0)[0], np.flatnonzero(edge_of_camera == 1)[0]
    edge_of_camera[[first, second]] = [1, 0]
    assert largest_violation(cost, separating_weights(cost, edge_of_camera), edge_of_camera) > 1e-6


def test_the_border_of_two_edges_runs_midway_between_the_cameras_beside_it() -> None:
    # Cameras at x = 0, 1, 4, 5 and edges at 0 and 10: with 2 and 2 the border stands at 2.5 m.
    positions = np.array([[0.0, 0.0], [1.0, 0.0], [4.0, 0.0], [5.0, 0.0]])
    sites = np.array([[0.0, 0.0], [10.0, 0.0]])
    weights = separating_weights(squared_distances(positions, sites), np.array([0, 0, 1, 1]))
    border_m = 5.0 + (weights[0] - weights[1]) / (2 * 10.0)
    assert border_m == pytest.approx(2.5, abs=1e-12)
