"""Borders of devices against the polygons of their strips."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from benchmarks.methods.device_borders import DeviceBorders
from radiant_core.errors import BadInput
from tests.core.plan.made_plans import two_edges_of_strips


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_a_cut_between_devices_is_as_far_as_the_next_strip(shift: float) -> None:
    plan, edge_plans = two_edges_of_strips(shift)
    points = np.random.default_rng(0).uniform([-99, -49], [-1, 49], (300, 2)) + shift
    nearest = DeviceBorders(plan=plan, edge_plans=edge_plans).nearest(points)
    first, last = (shapely.Polygon(edge_plans[0].strips[index]) for index in (0, 2))
    line = shapely.intersection(first.buffer(1e-6), last.buffer(1e-6))
    for point, distance_m in zip(points, nearest.distance_m, strict=True):
        reached = shapely.distance(shapely.Point(point), line)
        # The cut reaches across the whole cell, also where the clipped strips end: never farther
        # than the shared side.
        assert distance_m <= reached + 1e-5
    middle = np.abs((points - shift) @ [-0.6, 0.8]) < 20
    distances = [shapely.distance(shapely.Point(point), line) for point in points[middle]]
    np.testing.assert_allclose(nearest.distance_m[middle], distances, atol=1e-5)
    assert (nearest.pair == [0, 2]).all()


def test_devices_have_no_border_with_those_of_another_edge() -> None:
    plan, edge_plans = two_edges_of_strips()
    borders = DeviceBorders(plan=plan, edge_plans=edge_plans)
    nearest = borders.nearest(np.array([[0.5, 0.0], [60.0, 10.0]]))
    assert np.isinf(nearest.distance_m).all()
    assert (nearest.pair == -1).all()
    assert borders.names == ("edge-0-0", "edge-0-1", "edge-0-2", "edge-1-0")


def test_plans_of_other_edges_are_bad_input() -> None:
    plan, edge_plans = two_edges_of_strips()
    with pytest.raises(BadInput, match="another order"):
        DeviceBorders(plan=plan, edge_plans=edge_plans[::-1])
