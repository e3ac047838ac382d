"""What is wrong with an array is reported under its argument's name, in every function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.simulate import BandwidthTrace, fleet_of, simulate
from radiant_core.errors import BadInput
from radiant_core.plan.borders.buffers import BufferRule, plan_buffers
from radiant_core.plan.borders.footprints import Footprints, RegionShares, Views, region_shares
from radiant_core.plan.borders.forecast import forecast_borders
from radiant_core.plan.counts.count_raster import CountRaster, assign_to_regions, count_raster, middles_of_cells
from radiant_core.plan.counts.slack_curve import slack_curve
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.curve_fit import fit_curve
from radiant_core.plan.profiles.profile import ProfileKey
from radiant_core.plan.profiles.profile_warnings import profile_warnings
from radiant_core.plan.regions.capped_transport import deal_within
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.power_diagram import cell_polygons
from radiant_core.plan.regions.region_plan import plan_regions, regions_around, regions_with_counts
from radiant_core.plan.regions.transport import deal_with_counts
from radiant_core.plan.revision.assigned import assigned_plan
from radiant_core.plan.revision.captured import find_captured_elsewhere, plan_captured, plan_of_owners
from radiant_core.plan.revision.replan import FleetChange, replan
from radiant_core.plan.waypoints import Waypoints

from .instances import linear_system

SYSTEM = linear_system(np.array([[0.0, 0.0], [9.0, 0.0]]), np.ones(2))
PLACES = np.array([[0.0, 0.0], [1.0, 0.0], [8.0, 0.0], [9.0, 1.0]])
_MADE = plan_regions(PLACES, SYSTEM)
assert isinstance(_MADE, CloudPlan)
CLOUD = _MADE
EDGES = split_edges(PLACES, CLOUD, SYSTEM)
FLEET = fleet_of(SYSTEM, [2, 2])
WRONG = np.zeros((7, 5, 3))
VIEWS = {"positions": np.zeros((2, 2)), "heights_m": np.ones(2), "corner_rays": np.ones((2, 4, 3))}
SHARES: dict[str, Any] = {"images": [0], "regions": [0], "shares": [0.5], "num_images": 1, "num_regions": 1}
RULE = BufferRule(within_m=3.0)

CALLS: list[tuple[str, Callable[[], object]]] = [
    ("positions", lambda: plan_regions(WRONG, SYSTEM)),
    ("positions", lambda: regions_around(WRONG, CLOUD.edge_of_camera, SYSTEM)),
    ("positions", lambda: regions_with_counts(WRONG, CLOUD.edge_of_camera, SYSTEM)),
    ("positions", lambda: split_edges(WRONG, CLOUD, SYSTEM)),
    ("positions", lambda: place_edges(SYSTEM, WRONG, None, 0)),
    ("positions", lambda: plan_buffers(WRONG, None, CLOUD, EDGES, SYSTEM, RULE)),
    ("positions", lambda: assigned_plan(WRONG, ["d0"], SYSTEM)),
    ("positions", lambda: slack_curve(WRONG, SYSTEM)),
    ("positions", lambda: count_raster(WRONG, 1.0)),
    ("positions", lambda: middles_of_cells(WRONG, 1.0)),
    ("positions", lambda: assign_to_regions(CLOUD, WRONG, SYSTEM)),
    ("positions", lambda: replan(CLOUD, EDGES, WRONG, SYSTEM, FleetChange())),
    ("captured", lambda: replan(CLOUD, EDGES, PLACES, SYSTEM, FleetChange(), captured=WRONG)),
    ("planned_xy", lambda: plan_captured(CLOUD, EDGES, WRONG, PLACES, system=SYSTEM)),
    ("captured_xy", lambda: plan_captured(CLOUD, EDGES, PLACES, WRONG, system=SYSTEM)),
    ("captured_xy", lambda: plan_of_owners(CLOUD, EDGES, np.zeros(4, np.int64), WRONG, system=SYSTEM)),
    ("planned_xy", lambda: find_captured_elsewhere(EDGES, WRONG, np.zeros(4, np.int64), PLACES)),
    ("captured_xy", lambda: find_captured_elsewhere(EDGES, PLACES, np.zeros(4, np.int64), WRONG)),
    ("counts", lambda: deal_with_counts(PLACES, PLACES[:2], WRONG)),  # type: ignore[arg-type]
    ("multiplicities", lambda: deal_with_counts(PLACES, PLACES[:2], np.array([2, 2]), multiplicities=WRONG)),
    ("capacities", lambda: deal_within(PLACES, PLACES[:2], WRONG)),  # type: ignore[arg-type]
    ("counts", lambda: fit_curve(WRONG, [1.0])),
    ("values", lambda: fit_curve([1.0], WRONG)),
    ("outline", lambda: cell_polygons(PLACES, np.zeros(4), WRONG)),
    ("sites", lambda: cell_polygons(WRONG, np.zeros(4), PLACES)),
    ("weights", lambda: cell_polygons(PLACES, WRONG, PLACES)),
    ("quotas", lambda: profile_warnings(SYSTEM, WRONG, ProfileKey(preset="p", num_steps=1, long_side_px=1))),
    ("quotas", lambda: fleet_of(SYSTEM, WRONG)),
    ("times_s", lambda: BandwidthTrace(times_s=WRONG, shares=np.ones(1))),
    ("shares", lambda: BandwidthTrace(times_s=np.zeros(1), shares=WRONG)),
    *((name, lambda name=name: replace(FLEET, **{name: WRONG})) for name in ("start_s", "work_s", "model_bytes", "repair_s")),
    *((name, lambda name=name: replace(FLEET, **{name: WRONG})) for name in ("uplink_bytes_per_s", "edge_uplink_bytes_per_s")),
    *((name, lambda name=name: Views(**{**VIEWS, name: WRONG})) for name in VIEWS),
    *((name, lambda name=name: RegionShares(**{**SHARES, name: WRONG})) for name in ("images", "regions")),
    ("a region", lambda: region_shares(Footprints(polygons=np.zeros((0, 8, 2)), areas_m2=np.zeros(0)), [WRONG])),
    ("cells", lambda: CountRaster(cell_m=1.0, cells=WRONG, counts=np.ones(1, np.int64))),  # type: ignore[arg-type]
    ("counts", lambda: CountRaster(cell_m=1.0, cells=np.zeros((1, 2), np.int64), counts=WRONG)),  # type: ignore[arg-type]
    *((name, lambda name=name: replace(CLOUD, **{name: WRONG})) for name in ("sites", "weights", "edge_time_s", "edge_of_camera")),
    ("borders", lambda: replace(CLOUD, borders=(WRONG, WRONG))),
    *((name, lambda name=name: replace(EDGES[0], **{name: WRONG})) for name in ("camera_indices", "device_of_camera", "device_time_s")),
    ("strips", lambda: replace(EDGES[0], strips=(WRONG,))),
    ("lat_lon_alt", lambda: Waypoints(names=("a",), lat_lon_alt=WRONG)),
    ("heading_pitch_deg", lambda: Waypoints(names=("a",), lat_lon_alt=[[1.0, 1.0, 1.0]], heading_pitch_deg=WRONG)),
]


@pytest.mark.parametrize(("name", "call"), CALLS)
def test_a_wrong_shape_is_told_under_the_name_it_came_as(name: str, call: Callable[[], object]) -> None:
    with pytest.raises(BadInput, match=rf"^{name} has shape \(7, 5, 3\)"):
        call()


def test_a_share_that_is_no_number_is_told_by_its_name() -> None:
    with pytest.raises(BadInput, match=r"^shares has 1 values that are not finite"):
        RegionShares(**{**SHARES, "shares": [np.nan]})


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"start_s": np.array([0.0, -0.1])}, "start_s has negative values"),
        ({"work_s": np.array([0.0, -0.1])}, "work_s has negative values"),
        ({"model_bytes": np.array([0.0, -0.1])}, "model_bytes has negative values"),
        ({"repair_s": np.array([0.0, -0.1])}, "repair_s has negative values"),
        ({"uplink_bytes_per_s": np.array([1.0, 0.0])}, "^uplink_bytes_per_s has values that are not positive"),
        ({"edge_uplink_bytes_per_s": np.array([1.0, 0.0])}, "^edge_uplink_bytes_per_s has values that are not positive"),
        ({"fails_s": np.array([1.0, np.nan])}, "fails_s and dropped need one value per device"),
        ({"fails_s": np.ones(3)}, "fails_s and dropped need one value per device"),
        ({"dropped": np.zeros(3, bool)}, "fails_s and dropped need one value per device"),
        ({"edge_of_device": np.array([0, 0])}, "must rise from 0 to E − 1"),
        ({"edge_of_device": np.array([1, 1])}, "must rise from 0 to E − 1"),
        ({"edge_of_device": np.array([0])}, "a fleet of 2 edges and 1 devices cannot be simulated"),
        ({"edge_of_device": np.array([0, 1, 0, 1])}, "must rise"),
        ({"edge_of_device": np.array([0, 1, 2])}, "must rise from 0 to E − 1"),
        ({"edge_of_device": np.array([0, 2, 1, 1])}, "must rise"),
        ({"aggregate_s": np.zeros(0)}, "a fleet of 0 edges and 2 devices"),
    ],
)
def test_a_fleet_that_cannot_be_played_is_told(change: dict[str, Any], told: str) -> None:
    with pytest.raises(BadInput, match=told):
        replace(FLEET, **change)


def test_a_fleet_may_do_nothing_and_a_trace_may_be_one_step() -> None:
    assert FLEET.dropped.tolist() == [False, False] and FLEET.start_s.tolist() == FLEET.repair_s.tolist() == [0.0, 0.0]
    assert np.isinf(FLEET.fails_s).all() and FLEET.work_s.tolist() == [2.0, 2.0]
    zero = replace(FLEET, work_s=np.zeros(2), model_bytes=np.zeros(2))
    timeline = simulate(zero)
    assert timeline.makespan_s == 0 and timeline.device_done_s.tolist() == [0, 0]
    for fails_s, done in ((0.0, 7.0), (1.999, 8.999), (2.0, 2.0), (np.inf, 2.0)):
        played = simulate(replace(FLEET, fails_s=np.array([fails_s, np.inf]), repair_s=np.array([5.0, 0.0])))
        assert played.device_done_s.tolist() == [done, 2.0] and played.edge_ready_s.tolist() == [done, 2.0]
    gone = simulate(replace(FLEET, dropped=np.array([True, False])))
    assert np.isinf(gone.device_done_s[0]) and gone.edge_done_s.tolist() == [0.0, 2.0] and gone.edge_ready_s[0] == 0
    for times, shares in (([0.0, 1.0, 1.0], [1, 1, 1]), ([0.5], [1]), ([0.0], [0]), ([], [])):
        with pytest.raises(BadInput, match="a bandwidth trace needs rising times from 0 s and positive shares"):
            BandwidthTrace(times_s=np.array(times, float), shares=np.array(shares, float))


def test_forecasts_need_as_many_views_as_cameras() -> None:
    views = Views(**VIEWS)
    with pytest.raises(BadInput, match="the plan is of 4 cameras, there are 2 views and 0 footprints"):
        forecast_borders(CLOUD, views, Footprints(polygons=np.zeros((0, 8, 2)), areas_m2=np.zeros(0)))
