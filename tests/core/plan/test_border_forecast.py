"""Borders, what images see of them, and buffer captures: counted by hand and by brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely

from radiant_core.errors import BadInput
from radiant_core.plan.borders.borders import Border, distance_outside_m, neighbours_across, shared_borders
from radiant_core.plan.borders.buffers import BufferRule, plan_buffers
from radiant_core.plan.borders.footprints import Optics, ground_footprints, region_shares, views_before_capture
from radiant_core.plan.borders.forecast import BorderForecast, RiskModel, _band_spots, _evenly, _Visibility, band_of, forecast_borders
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import Device, Edge, System

from .instances import dense

OPTICS = Optics(field_of_view_deg=90, aspect=1.0)


def system(max_cameras: int | None = None) -> System:
    def edge(name: str, x_m: float) -> Edge:
        device = Device(
            id=f"{name}-1", init_s=CostCurve(), train_s=CostCurve(linear=1.0), model_bytes=CostCurve(), uplink_bytes_per_s=1e6,
            max_cameras=max_cameras,
        )  # fmt: skip
        return Edge(id=name, position=(x_m, 50.0), aggregate_s=CostCurve(), uplink_bytes_per_s=1e6, devices=(device,))

    return System(edges=(edge("west", 25.0), edge("east", 75.0)))


def grid() -> np.ndarray:
    east, north = np.meshgrid(np.arange(5, 100, 10.0), np.arange(5, 100, 10.0))
    return np.column_stack([east.ravel(), north.ravel()])


def planned(max_cameras: int | None = None) -> CloudPlan:
    plan = plan_regions(grid(), system(max_cameras))
    assert isinstance(plan, CloudPlan)
    return plan


def test_two_regions_share_one_border_with_the_first_on_its_left() -> None:
    plan = planned()
    (border,) = shared_borders(plan)
    np.testing.assert_allclose(border.ends[:, 0], 50.0, atol=0.1)
    assert border.toward_first @ (plan.sites[0] - plan.sites[1]) > 0


def test_support_is_what_brute_force_counts() -> None:
    plan = planned()
    views = views_before_capture(grid(), np.full(100, 10.0), OPTICS)
    footprints = ground_footprints(views)
    (forecast,) = forecast_borders(plan, views, footprints, half_band_m=4.0)
    shapes = [shapely.Polygon(polygon) for polygon in footprints.polygons]
    shares = (np.arange(16) + 0.5) / 16
    for side, sign in enumerate((-1, 1)):
        along = forecast.ends[0, 1] + shares * (forecast.ends[1, 1] - forecast.ends[0, 1])
        spots = [(50 + sign * offset, north) for offset in (1, 3) for north in along]
        seen = [[shape.covers(shapely.Point(spot)) for shape in shapes] for spot in spots]
        used = [row for row in seen if any(row)]
        own = [sum(np.array(row) & (plan.edge_of_camera == side)) for row in used]
        assert forecast.support[side] == pytest.approx(np.mean(own), abs=0.15)
    # Square footprints of 20 m every 10 m: neighbours share half, and at the border half of all
    # images are the neighbour's.
    assert forecast.forward_overlap == pytest.approx(0.5)
    assert forecast.side_overlap == pytest.approx(0.5)
    assert 0.4 < forecast.coverage < 0.85
    assert forecast.num_images == (10, 10)


def test_one_region_has_no_border_and_wrong_sizes_are_refused() -> None:
    plan = plan_regions(grid(), System(edges=system().edges[:1]))
    assert isinstance(plan, CloudPlan)
    views = views_before_capture(grid(), np.full(100, 10.0), OPTICS)
    assert forecast_borders(plan, views, ground_footprints(views)) == ()
    few = views_before_capture(grid()[:3], np.full(3, 10.0), OPTICS)
    with pytest.raises(BadInput, match="100 cameras, there are 3 views"):
        forecast_borders(plan, few, ground_footprints(few))
    with pytest.raises(BadInput, match="half_band_m"):
        forecast_borders(plan, views, ground_footprints(views), half_band_m=np.nan)
    with pytest.raises(BadInput, match="thresholds"):
        RiskModel(high_below=3, medium_below=np.nan)


def test_nobody_sees_anything_and_all_at_one_spot() -> None:
    plan = planned()
    below = views_before_capture(grid(), np.full(100, -1.0), OPTICS)
    (forecast,) = forecast_borders(plan, below, ground_footprints(below))
    assert forecast.support == (0.0, 0.0) and forecast.risk == "high" and forecast.coverage == 0
    same = plan_regions(np.zeros((20, 2)), system())
    assert isinstance(same, CloudPlan)
    views = views_before_capture(np.zeros((20, 2)), np.full(20, 10.0), OPTICS)
    for made in forecast_borders(same, views, ground_footprints(views)):
        assert np.isfinite(made.coverage)


def test_buffers_by_share_and_by_distance_are_those_counted_by_hand() -> None:
    plan, positions = planned(), grid()
    edges = split_edges(positions, plan, system())
    shares = region_shares(ground_footprints(views_before_capture(positions, np.full(100, 10.0), OPTICS)), plan.borders)
    matrix = dense(shares)
    for rule in (BufferRule(min_share=0.2), BufferRule(within_m=6.0)):
        made = plan_buffers(positions, shares, plan, edges, system(), rule)
        for index, buffer in enumerate(made):
            others = plan.edge_of_camera != index
            seeing = matrix[:, index] >= 0.2 if rule.min_share else distance_outside_m(positions, plan.borders[index]) <= 6.0
            assert sorted(buffer.camera_indices) == np.flatnonzero(others & seeing).tolist()
            assert buffer.edge_time_s == pytest.approx(plan.edge_time_s[index] + len(buffer.camera_indices))
            assert len(buffer.camera_indices) == 10 and buffer.num_refused == 0
        views = views_before_capture(positions, np.full(100, 10.0), OPTICS)
        before = forecast_borders(plan, views, ground_footprints(views))[0]
        after = forecast_borders(plan, views, ground_footprints(views), buffers=made)[0]
        assert min(after.support) > min(before.support)


def test_buffers_keep_to_memory_and_deadline() -> None:
    positions = grid()
    plan = planned(53)
    edges = split_edges(positions, plan, system(53))
    made = plan_buffers(positions, None, plan, edges, system(53), BufferRule(within_m=6.0))
    assert [len(buffer.camera_indices) for buffer in made] == [3, 3] and [buffer.num_refused for buffer in made] == [7, 7]
    made = plan_buffers(positions, None, plan, edges, system(), BufferRule(within_m=6.0, deadline_s=54.5))
    assert [len(buffer.camera_indices) for buffer in made] == [4, 4]
    made = plan_buffers(positions, None, plan, edges, system(), BufferRule(within_m=6.0, deadline_s=1.0))
    assert [len(buffer.camera_indices) for buffer in made] == [0, 0]


def test_bad_rules_are_refused() -> None:
    for bad in ({}, {"min_share": 0.2, "within_m": 3.0}, {"min_share": 0.0}, {"min_share": np.nan}, {"within_m": np.inf}):
        with pytest.raises(BadInput, match="buffer capture"):
            BufferRule(**bad)
    plan = planned()
    others = region_shares(ground_footprints(views_before_capture(grid()[:50], np.full(50, 10.0), OPTICS)), plan.borders)
    with pytest.raises(BadInput, match="shares of 100 footprints in 2 regions are needed"):
        plan_buffers(grid(), others, plan, split_edges(grid(), plan, system()), system(), BufferRule(min_share=0.5))
    with pytest.raises(BadInput, match="region_shares"):
        plan_buffers(grid(), None, plan, split_edges(grid(), plan, system()), system(), BufferRule(min_share=0.5))


def test_distances_from_a_polygon_equal_shapelys() -> None:
    rng = np.random.default_rng(0)
    polygon = np.array([[0.0, 0], [4, 0], [5, 3], [1, 4]])
    points = rng.uniform(-5, 9, (500, 2))
    expected = shapely.distance(shapely.points(points), shapely.Polygon(polygon))
    np.testing.assert_allclose(distance_outside_m(points, polygon), expected, atol=1e-12)


def test_a_band_is_a_twentieth_of_the_way_between_two_edges() -> None:
    plan = planned()
    apart_m = float(np.hypot(*(plan.sites[0] - plan.sites[1])))
    assert band_of(plan) == pytest.approx(apart_m / 20)
    alone = plan_regions(grid(), System(edges=system().edges[:1]))
    assert isinstance(alone, CloudPlan) and band_of(alone) == 1.0


def test_each_side_counts_its_own_half_of_the_band() -> None:
    """East of the border four times as many photographs: each side's view by brute force."""
    north = np.arange(2.5, 100, 5.0)
    dense = np.stack(np.meshgrid(np.arange(52.5, 100, 5.0), north), axis=-1).reshape(-1, 2)
    positions = np.concatenate([grid()[grid()[:, 0] < 50], dense])
    slow = replace(system().edges[0].devices[0], train_s=CostCurve(linear=4.0))
    plan = plan_regions(positions, System(edges=(replace(system().edges[0], devices=(slow,)), system().edges[1])))
    assert isinstance(plan, CloudPlan) and plan.counts.tolist() == [50, 200]
    views = views_before_capture(positions, np.full(250, 10.0), OPTICS)
    (forecast,) = forecast_borders(plan, views, ground_footprints(views), half_band_m=4.0)
    shapes = [shapely.Polygon(polygon) for polygon in ground_footprints(views).polygons]
    middle = (forecast.ends[0] + forecast.ends[1]) / 2
    for side, sign in enumerate((-1, 1)):
        spots = [(middle[0] + sign * offset, at) for offset in (1, 3) for at in np.linspace(10, 90, 40)]
        own = [
            sum(shape.covers(shapely.Point(spot)) for shape, edge in zip(shapes, plan.edge_of_camera, strict=True) if edge == side)
            for spot in spots
        ]
        assert forecast.support[side] == pytest.approx(np.mean(own), rel=0.15)
    assert forecast.support[1] > 2 * forecast.support[0]


def test_risk_follows_the_images_of_a_spot() -> None:
    model = RiskModel(high_below=3.0, medium_below=5.0)
    assert [model.risk(support) for support in (0.0, 2.99, 3.0, 4.99, 5.0, 90.0)] == ["high", "high", "medium", "medium", "low", "low"]


@pytest.mark.parametrize(("heading", "forward", "side"), [(90.0, 0.6, 0.5), (0.0, 0.0, 0.8)])
def test_forward_is_along_the_flight_whatever_its_direction(heading: float, forward: float, side: float) -> None:
    """Pictures of 20 m across and 10 m along the flight, every 4 m east and every 10 m north."""
    east, north = np.meshgrid(np.arange(2, 100, 4.0), np.arange(5, 100, 10.0))
    positions = np.column_stack([east.ravel(), north.ravel()])
    plan = plan_regions(positions, system())
    assert isinstance(plan, CloudPlan)
    angles = np.tile([heading, -90.0], (len(positions), 1))
    views = views_before_capture(positions, np.full(len(positions), 10.0), Optics(field_of_view_deg=90, aspect=0.5), angles)
    (forecast,) = forecast_borders(plan, views, ground_footprints(views))
    assert forecast.forward_overlap == pytest.approx(forward, abs=1e-6) and forecast.side_overlap == pytest.approx(side, abs=1e-6)


def test_a_region_of_three_corners_has_borders() -> None:
    plan = planned()
    (whole,) = shared_borders(plan)
    west = np.array([*whole.ends, [0.0, 50.0]])
    (border,) = shared_borders(replace(plan, borders=(west, plan.borders[1])))
    np.testing.assert_array_equal(border.ends, whole.ends)


def test_a_border_knows_its_length_its_side_and_its_distances() -> None:
    border = Border(first=0, second=1, ends=np.array([[3.0, 1.0], [7.0, 4.0]]))
    assert border.length_m == 5.0
    np.testing.assert_allclose(border.toward_first, [-0.6, 0.8])
    points = np.random.default_rng(0).uniform(-5, 12, (200, 2))
    line = shapely.LineString(border.ends)
    np.testing.assert_allclose(border.distances_m(points), shapely.distance(shapely.points(points), line), atol=1e-12)


def test_a_corner_that_stands_twice_is_no_border() -> None:
    plan = planned()
    (whole,) = shared_borders(plan)
    west = np.array([*whole.ends, whole.ends[1], [0.0, 50.0]])
    (border,) = shared_borders(replace(plan, borders=(west, plan.borders[1])))
    np.testing.assert_array_equal(border.ends, whole.ends)
    assert (border.first, border.second) == (0, 1)


@pytest.mark.parametrize(
    ("support", "interior", "coverage"),
    [((3.0, 4.0), (6.0, 4.0), 0.5), ((3.0, 0.25), (3.0, 0.5), 0.5), ((3.0, 2.0), (3.0, 0.0), 0.0), ((3.0, 2.0), (2.0, 2.0), 1.0)],
)
def test_coverage_is_that_of_the_worse_side_and_none_where_nothing_is_seen(
    support: tuple[float, float], interior: tuple[float, float], coverage: float
) -> None:
    forecast = BorderForecast(
        edge_ids=("a", "b"), ends=np.zeros((2, 2)), half_band_m=1.0, num_images=(1, 1), support=support, interior_support=interior,
        forward_overlap=None, side_overlap=None, risk="low",
    )  # fmt: skip
    assert forecast.coverage == coverage


@pytest.mark.parametrize(
    ("count", "at_most", "expected"), [(0, 5, []), (1, 5, [0]), (5, 5, [0, 1, 2, 3, 4]), (9, 5, [0, 2, 4, 6, 8]), (10, 2, [0, 9])]
)
def test_a_few_of_many_are_spread_evenly_from_first_to_last(count: int, at_most: int, expected: list[int]) -> None:
    assert _evenly(count, at_most).tolist() == expected


def test_spots_of_a_band_lie_a_quarter_and_three_quarters_into_either_half() -> None:
    # The first is to the left: the west.
    border = Border(first=0, second=1, ends=np.array([[50.0, 0.0], [50.0, 160.0]]))
    spots = _band_spots(border, 8.0)
    assert spots.shape == (64, 2)
    along = 5.0 + 10.0 * np.arange(16)
    expected = [[50 + east, north] for east in (-2, -6, 2, 6) for north in along]
    np.testing.assert_allclose(spots, expected)


@pytest.mark.parametrize("shift_m", [0.0, 4e6])
def test_who_sees_a_spot_is_what_shapely_says_wherever_the_site_lies(shift_m: float) -> None:
    rng = np.random.default_rng(1)
    positions = rng.random((60, 2)) * 100 + shift_m
    footprints = ground_footprints(views_before_capture(positions, rng.uniform(3, 12, 60), OPTICS, rng.uniform(-80, 80, (60, 2))))
    owners = rng.integers(0, 2, 60)
    visibility = _Visibility(footprints, owners, {1: np.array([0, 1, 2])})
    spots = rng.random((40, 2)) * 30 + 35 + shift_m
    images, sees = visibility(spots)
    shapes = [shapely.Polygon(polygon - shift_m) for polygon in footprints.polygons]
    truth = np.array([[shape.covers(shapely.Point(spot - shift_m)) for spot in spots] for shape in shapes])
    assert set(np.flatnonzero(truth.any(axis=1))) <= set(images.tolist()) and (np.diff(images) > 0).all()
    assert (sees != truth[images]).mean() < (1e-3 if shift_m else 1e-9)
    np.testing.assert_array_equal(visibility.taken_by(images, 0), owners[images] == 0)
    np.testing.assert_array_equal(visibility.taken_by(images, 1), (owners[images] == 1) | np.isin(images, [0, 1, 2]))


def test_an_edge_known_by_its_curve_takes_no_buffers_and_times_count_what_is_sent() -> None:
    positions = grid()
    far = Edge(id="east", position=(75.0, 50.0), aggregate_s=CostCurve(), uplink_bytes_per_s=1e6, devices=(), time_s=CostCurve(linear=1.0))
    heavy = replace(
        system().edges[0],
        aggregate_s=CostCurve(linear=0.5),
        uplink_bytes_per_s=100.0,
        devices=(replace(system().edges[0].devices[0], model_bytes=CostCurve(linear=20.0), uplink_bytes_per_s=10.0),),
    )
    both = System(edges=(heavy, far))
    plan = plan_regions(positions, both)
    assert isinstance(plan, CloudPlan)
    west, east = plan_buffers(positions, None, plan, split_edges(positions, plan, both), both, BufferRule(within_m=12.0))
    assert len(east.camera_indices) == 0 and east.num_refused == 0 and east.edge_time_s == east.planned_edge_time_s == plan.edge_time_s[1]
    count = int(plan.counts[0]) + len(west.camera_indices)
    assert len(west.camera_indices) > 0
    # A second of training and two of sending, half of one to join, a fifth to send on: per camera.
    assert west.device_time_s == pytest.approx([3.0 * count]) and west.edge_time_s == pytest.approx(3.7 * count)
    assert west.planned_edge_time_s == plan.edge_time_s[0]
    np.testing.assert_array_equal(west.cameras_of("west-1"), west.camera_indices)


def test_a_position_exactly_as_far_as_the_rule_says_is_taken_the_nearest_first() -> None:
    """The border lies at 50 m, photographs every 10 m from 5 on: 5 and 15 m away."""
    plan = replace(
        planned(), borders=(np.array([[0.0, 0.0], [50, 0], [50, 100], [0, 100]]), np.array([[50.0, 0.0], [100, 0], [100, 100], [50, 100]]))
    )
    edges = split_edges(grid(), plan, system())
    for within_m, columns in ((4.99, 0), (5.0, 1), (14.99, 1), (15.0, 2)):
        west, east = plan_buffers(grid(), None, plan, edges, system(), BufferRule(within_m=within_m))
        assert (len(west.camera_indices), len(east.camera_indices)) == (10 * columns, 10 * columns)
    np.testing.assert_array_equal(grid()[west.camera_indices][:, 0], [55.0] * 10 + [65.0] * 10)
    np.testing.assert_array_equal(grid()[east.camera_indices][:, 0], [45.0] * 10 + [35.0] * 10)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"min_share": 1.0}, None),
        ({"min_share": 1e-9}, None),
        ({"min_share": 1.01}, r"the least share of a buffer capture is 1\.01, expected above 0 and at most 1"),
        ({"within_m": 1e-9, "deadline_s": 1e-9}, None),
        ({"within_m": 0.0}, r"the distance of buffer captures is 0\.0, expected a positive number"),
        ({"within_m": 1.0, "deadline_s": 0.0}, r"the deadline of buffer captures is 0\.0, expected a positive number"),
        ({"within_m": 1.0, "deadline_s": np.inf}, "the deadline of buffer captures is inf"),
    ],
)
def test_limits_of_a_rule(fields: dict, told: str | None) -> None:
    if told is None:
        BufferRule(**fields)
    else:
        with pytest.raises(BadInput, match=told):
            BufferRule(**fields)


@pytest.mark.parametrize(("high", "medium", "fits"), [(0, 0, True), (3, 3, True), (3, 2.9, False), (-0.1, 3, False), (0, np.inf, False)])
def test_thresholds_of_risk_rise(high: float, medium: float, fits: bool) -> None:
    if fits:
        assert RiskModel(high_below=high, medium_below=medium).risk(1e9) == "low"
    else:
        with pytest.raises(BadInput, match=f"thresholds of support are {high} and {medium}, expected rising numbers of images"):
            RiskModel(high_below=high, medium_below=medium)


@pytest.mark.parametrize("across", [False, True])
def test_a_lone_line_of_photographs_has_neighbours_one_way_alone(across: bool) -> None:
    """Square pictures of 20 m every 5 m to the east: along the flight where the drone looks east,
    beside it where it looks north."""
    positions = np.stack([np.arange(2.5, 100, 5.0), np.full(20, 50.0)], axis=1)
    plan = plan_regions(positions, system())
    assert isinstance(plan, CloudPlan)
    views = views_before_capture(positions, np.full(20, 10.0), OPTICS, np.tile([0.0 if across else 90.0, -90.0], (20, 1)))
    (forecast,) = forecast_borders(plan, views, ground_footprints(views), half_band_m=2.0)
    found = (forecast.side_overlap, forecast.forward_overlap) if across else (forecast.forward_overlap, forecast.side_overlap)
    assert found[0] == pytest.approx(0.75) and found[1] is None
    # A spot is seen by four photographs; those within 10 m of the border by as many of the
    # neighbour's: two own on average near it.
    assert forecast.interior_support[0] == pytest.approx(4, abs=0.6) and forecast.num_images == (2, 2)


def test_support_beside_the_bands_is_that_of_the_regions_own_pictures() -> None:
    """Brute force over the middles of own pictures outside the band, all of up to 64."""
    positions = grid()
    plan = planned()
    views = views_before_capture(positions, np.full(100, 10.0), OPTICS)
    footprints = ground_footprints(views)
    (forecast,) = forecast_borders(plan, views, footprints, half_band_m=11.0)
    shapes = [shapely.Polygon(polygon).buffer(1e-9) for polygon in footprints.polygons]
    for side in range(2):
        own = np.flatnonzero(plan.edge_of_camera == side)
        middles = footprints.polygons[own].mean(axis=1)
        spots = middles[np.abs(middles[:, 0] - 50) > 11]
        assert 30 <= len(spots) < 50
        seen = [sum(shapes[index].covers(shapely.Point(spot)) for index in own) for spot in spots]
        assert forecast.interior_support[side] == pytest.approx(np.mean(seen))


def test_buffers_that_came_into_question_and_did_not_fit_are_counted_by_memory_and_time() -> None:
    positions, plan = grid(), planned(53)
    edges = split_edges(positions, plan, system(53))
    for deadline_s, taken in ((50.5, 0), (51.0, 1), (52.9, 2), (53.0, 3), (99.0, 3)):
        made = plan_buffers(positions, None, plan, edges, system(53), BufferRule(within_m=6.0, deadline_s=deadline_s))
        assert [(len(b.camera_indices), b.num_refused) for b in made] == [(taken, 10 - taken)] * 2
        assert [b.edge_time_s for b in made] == [50.0 + taken] * 2 and [b.device_time_s.tolist() for b in made] == [[50.0 + taken]] * 2


@pytest.mark.parametrize("half_band_m", [0.0, -1.0, np.inf, np.nan])
def test_a_band_has_a_finite_width(half_band_m: float) -> None:
    views = views_before_capture(grid(), np.full(100, 10.0), OPTICS)
    with pytest.raises(BadInput, match=f"half_band_m is {half_band_m}, expected a positive width of the band beside a border"):
        forecast_borders(planned(), views, ground_footprints(views), half_band_m=half_band_m)


@pytest.mark.parametrize("size_m", [1.0, 1e4])
def test_a_border_is_found_though_its_corners_are_rounded_to_a_ten_millionth_of_the_scene(size_m: float) -> None:
    plan = planned()
    middle = shared_borders(plan)[0].ends.mean(axis=0) * size_m
    plan = replace(plan, sites=plan.sites * size_m, weights=plan.weights * size_m**2, borders=tuple(b * size_m for b in plan.borders))
    off = np.array([[1e-7 * 100 * size_m, 0.0], [0.0, 0.0], [-1e-7 * 100 * size_m, 0.0], [100 * size_m / 50, 0.0]])
    for edge in (0, 1):
        assert neighbours_across(plan, edge, middle + off).tolist() == [1 - edge] * 3 + [-1]


def test_a_single_view_has_no_neighbour() -> None:
    plan = plan_regions(np.array([[25.0, 50.0]]), system())
    assert isinstance(plan, CloudPlan)
    views = views_before_capture([[25.0, 50.0]], [10.0], OPTICS)
    assert all(made.forward_overlap is None for made in forecast_borders(plan, views, ground_footprints(views)))
