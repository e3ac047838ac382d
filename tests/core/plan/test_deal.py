"""The native dealing: count rasters, warm starts, and the twin's cost where cells share few."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.regions.transport import deal_with_counts
from tests.seeds import for_seeds

from .instances import LAYOUTS
from .transport_twin import assign_with_counts


def squared(positions: np.ndarray, sites: np.ndarray) -> np.ndarray:
    return np.sum((positions[:, None] - sites) ** 2, axis=-1)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("seed", range(8))
def test_cost_equals_the_twin(layout: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, sites = LAYOUTS[layout](rng, 600), rng.random((12, 2)) * 400
    counts = rng.multinomial(600, rng.dirichlet(np.full(12, 0.5)))
    cost = squared(positions, sites)
    dealt = deal_with_counts(positions, sites, counts)
    np.testing.assert_array_equal(np.bincount(dealt.edge_of_position, minlength=12), counts)
    own, twin = (cost[np.arange(600), cells].sum() for cells in (dealt.edge_of_position, assign_with_counts(cost, counts)))
    assert own == pytest.approx(twin, rel=1e-12)  # the same sum in another order
    assert dealt.violation_m2 <= 1e-12 * cost.max()


@for_seeds(10)
def test_a_count_raster_is_dealt_as_its_cameras(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = np.stack(np.divmod(np.arange(100), 10), axis=1) * 10.0
    raster = rng.integers(0, 9, 100)
    sites = rng.random((6, 2)) * 100
    counts = rng.multinomial(raster.sum(), rng.dirichlet(np.ones(6)))
    dealt = deal_with_counts(cells, sites, counts, multiplicities=raster)
    single = deal_with_counts(np.repeat(cells, raster, axis=0), sites, counts)
    whole = np.flatnonzero((dealt.edge_of_position >= 0) & (raster > 0))
    taken = np.bincount(dealt.edge_of_position[whole], weights=raster[whole], minlength=6)
    np.add.at(taken, dealt.parts[:, 1], dealt.parts[:, 2])
    np.testing.assert_array_equal(taken, counts)
    cost = squared(cells, sites)
    own = (raster[whole] * cost[whole, dealt.edge_of_position[whole]]).sum() + (
        dealt.parts[:, 2] * cost[dealt.parts[:, 0], dealt.parts[:, 1]]
    ).sum()
    expected = squared(np.repeat(cells, raster, axis=0), sites)[np.arange(raster.sum()), single.edge_of_position].sum()
    assert own == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_start_from_any_weights_ends_in_the_same_optimum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, sites = LAYOUTS["clustered"](rng, 3000), rng.random((16, 2)) * 400
    counts = rng.multinomial(3000, rng.dirichlet(np.ones(16)))
    cold = deal_with_counts(positions, sites, counts)
    for weights in (cold.weights, rng.normal(size=16) * 1e3, np.zeros(16)):
        warm = deal_with_counts(positions, sites, counts, weights=weights)
        np.testing.assert_array_equal(warm.edge_of_position, cold.edge_of_position)


@pytest.mark.parametrize("scale", [1e-300, 1e-9, 1e7])
def test_any_scale_gives_the_counts(scale: float) -> None:
    rng = np.random.default_rng(0)
    dealt = deal_with_counts(rng.random((200, 2)) * scale, rng.random((5, 2)) * scale, np.full(5, 40))
    assert np.bincount(dealt.edge_of_position).tolist() == [40] * 5


@pytest.mark.parametrize("counts", [[1, 1], [3, -1], [0, 0]])
def test_counts_must_sum_to_the_cameras(counts: list[int]) -> None:
    with pytest.raises(BadInput, match="sum"):
        deal_with_counts(np.zeros((3, 2)), np.eye(2), np.array(counts))
