"""The cost of a step and of all, against sums made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import Cloud, Device, Edge
from radiant_core.plan.together.costs import LATENCY_S, TogetherLaw, end_cost, shown_share, start_cost, step_cost

LAW = TogetherLaw(views_per_photograph=10.0, steps_of=lambda count: 10.0 * count, num_floats=23, splat_bytes=100.0)
"""33 bytes a row."""
CLOUD = Cloud(latency_s=0.02, add_s_per_byte=2e-8)


def device(name: str, speed: float = 1.0, bytes_per_s: float = 1.65e6) -> Device:
    """0.1 s a view at speed 1; 10,000 Gaussians with 32 photographs."""
    return Device(
        id=name,
        init_s=CostCurve(constant=2.0),
        train_s=CostCurve(linear=1.0 / speed),
        model_bytes=CostCurve(linear=31250.0),
        uplink_bytes_per_s=bytes_per_s,
    )


def edge(name: str, *devices: Device, bytes_per_s: float = 1e7) -> Edge:
    return Edge(
        id=name,
        position=(0.0, 0.0),
        aggregate_s=CostCurve(constant=4.0),
        aggregate_alone_s=CostCurve(constant=1.0),
        uplink_bytes_per_s=bytes_per_s,
        devices=devices,
        latency_s=0.01,
        add_s_per_byte=1e-8,
    )


UNEQUAL = edge("a", device("a1"), device("a2", 0.6))
VIEWS = {"a1": 2, "a2": 1}


def test_photographs_show_gaussians_that_others_show_too() -> None:
    assert [shown_share(views, 32) for views in (1, 2, 3)] == [0.5, 0.75, 0.875]
    assert [shown_share(views, 64) for views in (1, 2)] == [0.25, 0.4375]
    assert shown_share(1, 7) == shown_share(3, 16) == 1.0


def test_a_step_of_an_edge_is_what_its_parts_add_up_to() -> None:
    cost = step_cost([UNEQUAL], None, VIEWS, 32, LAW)
    sent = 33 * 10_000 * np.array([0.75, 0.5, 0.875])  # up by a1, by a2, down
    ready_s = max(2 * 0.1 + sent[0] / 1.65e6, 1 * 0.1 / 0.6 + sent[1] / 1.65e6)
    assert ready_s == pytest.approx(0.35)
    assert cost.seconds == pytest.approx(ready_s + 0.01 + 1e-8 * (sent[0] + sent[1]) + 0.01 + sent[2] / 1.65e6, rel=1e-12)
    assert (cost.up_bytes, cost.down_bytes) == pytest.approx((247_500, 288_750), rel=1e-12)
    assert (cost.views_s, cost.exchange_s) == pytest.approx((0.2, 0.349125), rel=1e-12)


@pytest.mark.parametrize(
    ("bytes_per_s", "exchange_s", "overlaps", "step_s"),
    [
        (8.25e6, 0.089125, False, 0.289125),  # less than half of the views: one after the other
        (3.3e6, 0.186625, True, 0.2),  # hidden behind the views
        (1.65e6, 0.349125, True, 0.349125),  # the views are hidden behind it
    ],
)
def test_an_exchange_longer_than_half_of_the_views_is_overlapped(
    bytes_per_s: float, exchange_s: float, overlaps: bool, step_s: float
) -> None:
    """Views take 0.2 s, the exchange (247,500 + 288,750) / bytes_per_s + 0.02 + 0.004125 s."""
    at = edge("a", device("a1", bytes_per_s=bytes_per_s), device("a2", 0.6, bytes_per_s))
    cost = step_cost([at], None, VIEWS, 32, LAW)
    assert cost.overlaps == overlaps
    assert (cost.exchange_s, cost.step_s) == pytest.approx((exchange_s, step_s), rel=1e-12)


def test_a_step_of_all_edges_goes_through_the_cloud_and_back() -> None:
    edges = [UNEQUAL, edge("b", device("b1", bytes_per_s=3.3e6), bytes_per_s=2e7)]
    cost = step_cost(edges, CLOUD, {**VIEWS, "b1": 1}, 32, LAW)
    rows_a, rows_b, down = 288_750.0, 165_000.0, 33 * 10_000 * (1 - 0.5**4)
    at_a = 0.35 + 0.01 + 1e-8 * 412_500
    at_b = 0.1 + 165_000 / 3.3e6 + 0.01 + 1e-8 * 165_000
    up_s = max(at_a + rows_a / 1e7, at_b + rows_b / 2e7) + 0.02
    down_s = 0.02 + max(down / 1e7 + 0.01 + down / 1.65e6, down / 2e7 + 0.01 + down / 3.3e6)
    assert cost.seconds == pytest.approx(up_s + 2e-8 * (rows_a + rows_b) + down_s, rel=1e-12)


def test_a_group_begins_when_the_first_model_is_down_and_ends_when_its_model_is_at_the_cloud() -> None:
    shares = {"a1": 2 / 3, "a2": 1 / 3}
    assert start_cost([UNEQUAL], None, shares, 32) == pytest.approx(2.0 + 1e6 / 1.65e6 + 0.02, rel=1e-12)
    assert start_cost([UNEQUAL], CLOUD, shares, 32) == pytest.approx(2.0 + 1e6 / 1.65e6 + 0.02 + 1e6 / 1e7 + 0.04, rel=1e-12)
    assert end_cost(UNEQUAL, 32) == pytest.approx(1.0 + 1e6 / 1e7, rel=1e-12)


def test_what_nobody_measured_has_a_default() -> None:
    unknown = replace(UNEQUAL, latency_s=None, add_s_per_byte=None)
    known = replace(UNEQUAL, latency_s=LATENCY_S, add_s_per_byte=2e-9)
    assert step_cost([unknown], None, VIEWS, 32, LAW) == step_cost([known], None, VIEWS, 32, LAW)


def test_latency_counts_twice_a_level() -> None:
    slow = replace(UNEQUAL, latency_s=1.01)
    near, far = (step_cost([at], None, VIEWS, 32, LAW).seconds for at in (UNEQUAL, slow))
    assert far - near == pytest.approx(2.0, rel=1e-12)
    near, far = (step_cost([UNEQUAL], replace(CLOUD, latency_s=at), VIEWS, 32, LAW).seconds for at in (0.0, 1.0))
    assert far - near == pytest.approx(2.0, rel=1e-12)


def test_a_limit_of_gaussians_and_an_estimate_of_a_view_count_in_place_of_curves() -> None:
    limited = step_cost([UNEQUAL], None, VIEWS, 32, replace(LAW, max_num_splats=1000))
    assert limited.up_bytes == pytest.approx(24_750, rel=1e-12)
    assert step_cost([UNEQUAL], None, VIEWS, 32, replace(LAW, view_s=0.5)).views_s == 1.0


@pytest.mark.parametrize(
    ("edges", "views", "num_photographs", "message"),
    [
        ([UNEQUAL], {"b1": 1}, 32, "nobody to train"),
        ([UNEQUAL], VIEWS, 0, "nobody to train"),
        ([UNEQUAL, edge("b", device("b1"))], {**VIEWS, "b1": 1}, 32, "nobody to add up what they send: give the cloud"),
    ],
)
def test_a_step_without_machines_is_refused(edges: list[Edge], views: dict[str, int], num_photographs: int, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        step_cost(edges, None, views, num_photographs, LAW)


@pytest.mark.parametrize("name", ["views_per_photograph", "num_floats", "splat_bytes", "max_num_splats", "view_s"])
@pytest.mark.parametrize("value", [0, -1, float("nan"), float("inf")])
def test_a_law_with_a_number_that_is_not_positive_is_refused(name: str, value: float) -> None:
    with pytest.raises(BadInput, match=f"{name} {value}, expected a positive number"):
        replace(LAW, **{name: value})


@pytest.mark.parametrize("value", [0.0, float("inf"), float("nan"), -1.0])
def test_a_link_that_carries_nothing_or_everything_at_once_is_refused(value: float) -> None:
    with pytest.raises(BadInput, match="expected a positive number of bytes per second"):
        device("a1", bytes_per_s=value)


@pytest.mark.parametrize("name", ["latency_s", "add_s_per_byte"])
@pytest.mark.parametrize("value", [-1e-9, float("inf"), float("nan")])
def test_a_time_of_the_exchange_that_is_none_is_refused(name: str, value: float) -> None:
    with pytest.raises(BadInput, match=name):
        replace(UNEQUAL, **{name: value})
    with pytest.raises(BadInput, match=name):
        replace(CLOUD, **{name: value})
