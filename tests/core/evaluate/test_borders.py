"""Borders of edges against their cells; degenerate plans, far origins, many regions."""

from __future__ import annotations

import numpy as np

from radiant_core.evaluate.borders import EdgeBorders
from tests.core.plan.made_plans import plan_of


def test_the_pair_is_that_of_the_two_cells_beside_the_border() -> None:
    rng = np.random.default_rng(4)
    sites, weights = rng.uniform(-40, 40, (6, 2)), rng.uniform(-50, 50, 6)
    borders = EdgeBorders(plan=plan_of(sites, weights))
    points = rng.uniform(-30, 30, (500, 2))
    nearest = borders.nearest(points)
    powers = ((points[:, None] - sites) ** 2).sum(2) - weights
    own = powers.argmin(1)
    other = np.where(nearest.pair[:, 0] == own, nearest.pair[:, 1], nearest.pair[:, 0])
    assert (nearest.pair == np.sort(np.column_stack([own, other]), axis=1)).all()
    # Going straight to the other site by that distance, measured along the line between both,
    # brings to the border.
    toward = sites[other] - sites[own]
    step = toward / np.linalg.norm(toward, axis=1, keepdims=True) * nearest.distance_m[:, None]
    powers = ((points[:, None] + step[:, None] - sites) ** 2).sum(2) - weights
    rows = np.arange(len(points))
    np.testing.assert_allclose(powers[rows, own], powers[rows, other], atol=1e-8)


def test_one_region_has_no_border() -> None:
    nearest = EdgeBorders(plan=plan_of(np.zeros((1, 2)))).nearest(np.array([[1e6, -1e6], [0.0, 0.0]]))
    assert np.isinf(nearest.distance_m).all()
    assert (nearest.pair == -1).all()


def test_no_positions_and_a_million_of_them() -> None:
    borders = EdgeBorders(plan=plan_of(np.random.default_rng(0).uniform(-1e6, 1e6, (16, 2))))
    assert borders.nearest(np.zeros((0, 2))).distance_m.shape == (0,)
    points = np.random.default_rng(1).uniform(-1e6, 1e6, (1_000_000, 2))
    whole = borders.nearest(points)
    some = borders.nearest(points[-10:])
    np.testing.assert_array_equal(whole.distance_m[-10:], some.distance_m)
    assert np.isfinite(whole.distance_m).all()
