"""Borders of edges and devices against polygons; degenerate plans, far origins, many regions."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from benchmarks.methods.device_borders import DeviceBorders
from radiant_core.errors import BadInput
from radiant_core.evaluate.borders import EdgeBorders
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.power_diagram import clip_polygon


def plan_of(sites: np.ndarray, weights: np.ndarray | None = None) -> CloudPlan:
    count = len(sites)
    return CloudPlan(
        method="test",
        edge_ids=tuple(f"edge-{index}" for index in range(count)),
        sites=sites,
        weights=np.zeros(count) if weights is None else weights,
        borders=(np.zeros((0, 2)),) * count,
        edge_of_camera=np.zeros(0, np.int64),
        edge_time_s=np.zeros(count),
        lower_bound_s=0.0,
        status="stopped",
        certified=False,
    )


def edge_plan_of(edge_id: str, strips: list[np.ndarray]) -> EdgePlan:
    return EdgePlan(
        edge_id=edge_id,
        device_ids=tuple(f"{edge_id}-{index}" for index in range(len(strips))),
        camera_indices=np.zeros(0, np.int64),
        device_of_camera=np.zeros(0, np.int64),
        strips=tuple(strips),
        device_time_s=np.zeros(len(strips)),
    )


def two_edges_of_strips(shift: float = 0.0) -> tuple[CloudPlan, tuple[EdgePlan, ...]]:
    """The west edge in three oblique strips, the middle empty; the east edge with one device."""
    west = np.array([[-100.0, -50.0], [0.0, -50.0], [0.0, 50.0], [-100.0, 50.0]])
    axis, cut = np.array([0.8, 0.6]), -40.0
    first, last = clip_polygon(west, axis, cut), clip_polygon(west, -axis, -cut)
    strips = [first + shift, np.empty((0, 2)), last + shift]
    plan = plan_of(np.array([[-50.0, 0.0], [50.0, 0.0]]) + shift)
    return plan, (edge_plan_of("edge-0", strips), edge_plan_of("edge-1", [west + np.array([100.0, 0.0]) + shift]))


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


def test_plans_of_other_edges_are_bad_input() -> None:
    plan, edge_plans = two_edges_of_strips()
    with pytest.raises(BadInput, match="another order"):
        DeviceBorders(plan=plan, edge_plans=edge_plans[::-1])
