"""What the exact planner is compared with: each does what its name says, and none that owns all cameras beats the bound."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.comparators import compare, kd_split

from .instances import LAYOUTS, linear_system, random_system


@pytest.mark.parametrize("seed", range(10))
def test_only_exact_is_at_the_bound_and_nobody_below(seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = linear_system(rng.random((5, 2)) * [500.0, 250.0], rng.uniform(1, 4, 5))
    rows = {row.method: row for row in compare(LAYOUTS["uniform"](rng, 200), system, max_iterations=60)}
    assert set(rows) == {"exact", "paper", "paper-halved", "paper-literal", "even", "voronoi", "kd", "content"}
    assert rows["exact"].over_bound == 1.0
    for row in rows.values():
        assert row.over_bound >= 1.0 or row.num_orphans > 0
        assert (row.edge_of_camera < 0).sum() == row.num_orphans
        assert row.method == "paper-literal" or row.num_orphans == 0


def test_moving_half_planes_leaves_cameras_in_no_region() -> None:
    # Two edges side by side, the left one slow: it alone shrinks, and nobody grows into what it gives up at first.
    positions = np.stack([np.linspace(0, 100, 101), np.zeros(101)], axis=1)
    system = linear_system(np.array([[25.0, 0.0], [75.0, 0.0]]), np.array([5.0, 1.0]))
    rows = {row.method: row for row in compare(positions, system, max_iterations=5)}
    assert rows["paper-literal"].num_orphans > 0
    assert rows["paper"].num_orphans == 0


@pytest.mark.parametrize("num_edges", [1, 2, 3, 7, 16])
def test_halves_have_equal_counts_and_keep_apart(num_edges: int) -> None:
    rng = np.random.default_rng(num_edges)
    positions = rng.random((160 * num_edges, 2)) * [500.0, 250.0]
    cells = kd_split(positions, rng.random((num_edges, 2)) * [500.0, 250.0], np.ones(len(positions)))
    counts = np.bincount(cells, minlength=num_edges)
    assert np.ptp(counts) <= 4  # a camera per level of the tree
    boxes = [(positions[cells == e].min(axis=0), positions[cells == e].max(axis=0)) for e in range(num_edges)]
    for i in range(num_edges):
        for j in range(i):
            assert (boxes[i][0] > boxes[j][1]).any() or (boxes[j][0] > boxes[i][1]).any()


def test_content_is_shared_instead_of_cameras() -> None:
    rng = np.random.default_rng(0)
    positions = rng.random((2000, 2)) * [2.0, 1.0]
    content = np.where(positions[:, 0] < 1.0, 9.0, 1.0)
    cells = kd_split(positions, np.array([[0.4, 0.5], [1.6, 0.5]]), content)
    shares = np.bincount(cells, weights=content)
    assert shares[0] == pytest.approx(shares[1], rel=0.01)
    assert np.bincount(cells)[0] < 700


@pytest.mark.parametrize("content", [[-1.0, 1.0], [np.nan, 1.0], [1.0]])
def test_poisoned_content_is_refused(content: list[float]) -> None:
    with pytest.raises(BadInput):
        compare(np.eye(2), random_system(np.random.default_rng(0), 2), content=content)
