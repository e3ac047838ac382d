"""Waypoints on a map: each in its region's colour, thinned where they would cover each other."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan
from radiant_viewer.layers.palette import category_colors
from radiant_viewer.layers.waypoint_layer import MAX_DOTS, waypoint_layer


def two_regions(count: int) -> CloudPlan:
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    return CloudPlan(
        method="even",
        edge_ids=("a", "b"),
        sites=np.array([[0.0, 0.0], [1.0, 1.0]]),
        weights=np.zeros(2),
        borders=(square, square),
        edge_of_camera=np.arange(count) % 2,
        edge_time_s=np.ones(2),
        lower_bound_s=1.0,
        status="optimal",
        certified=True,
    )


def test_each_waypoint_has_its_regions_colour() -> None:
    positions = np.random.default_rng(0).random((6, 3))
    layer = waypoint_layer(positions, two_regions(6))
    np.testing.assert_array_equal(layer.points, positions)
    np.testing.assert_array_equal(layer.point_colors, category_colors(2)[[0, 1, 0, 1, 0, 1]])
    assert layer.legend[0].text == "Waypoint, in its region's colour"


def test_more_than_a_map_can_show_are_thinned_and_said() -> None:
    layer = waypoint_layer(np.zeros((3 * MAX_DOTS, 3)), two_regions(3 * MAX_DOTS))
    assert len(layer.points) == MAX_DOTS
    assert layer.legend[0].text == "One of 3 waypoints"


def test_waypoints_of_another_plan_are_refused() -> None:
    with pytest.raises(BadInput, match="4 cameras, there are 3"):
        waypoint_layer(np.zeros((3, 3)), two_regions(4))
